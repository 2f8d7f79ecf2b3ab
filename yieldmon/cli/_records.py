"""Numbers, times and tables of a daemon's records, for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime

from rich.console import Console
from rich.table import Column, Table

from yieldmon.errors import InputError


def when(time_s: float | None) -> str:
    """A Unix time as a person reads it, in local time; "-" where it is not known (0: before the bus gave the time)."""
    if time_s is None or time_s <= 0.0:
        return "-"
    return datetime.fromtimestamp(time_s).astimezone().strftime("%Y-%m-%d %H:%M")


def undone_at(time_s: float | None, who: str | None) -> str:
    """When something was undone, and by whom; "-" where it was not."""
    return "-" if time_s is None else f"{when(time_s)} {who or ''}".strip()


def load_numbers(text: str) -> tuple[int, int]:
    """First and last load of what was typed. Raises InputError."""
    first, dash, last = text.partition("-")
    if not first.isdecimal() or (dash and not last.isdecimal()):
        raise InputError("LOAD", repr(text), "a number such as 7, or FIRST-LAST such as 7-9")
    if dash and int(last) < int(first):
        raise InputError("LOAD", repr(text), "the first load before the last, such as 7-9")
    return int(first), int(last) if dash else int(first)


def named(noun: str, numbers: Sequence[int]) -> str:
    """Numbered things in a sentence.

    Examples
    --------
    >>> named("load", [2]), named("load", [2, 4, 5])
    ('load 2', 'loads 2, 4 and 5')
    """
    before, last = ", ".join(map(str, numbers[:-1])), str(numbers[-1])
    return f"{noun}s {before} and {last}" if before else f"{noun} {last}"


def show(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table on standard output; where it is not a terminal, as wide as its content."""
    table = Table(*(Column(head, overflow="fold") for head in heads), box=None)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, emoji=False, width=400)
    console.print(table)
