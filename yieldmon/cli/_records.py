"""What the verbs that list a daemon's records share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

from rich.console import Console
from rich.table import Column, Table


def when(time_s: float | None) -> str:
    """A Unix time as a person reads it, in local time; "-" where it is not known (0: before the bus gave the time)."""
    if time_s is None or time_s <= 0.0:
        return "-"
    return datetime.fromtimestamp(time_s).astimezone().strftime("%Y-%m-%d %H:%M")


def undone(time_s: float | None, who: str | None) -> str:
    """When something was taken back, and by whom."""
    return "-" if time_s is None else f"{when(time_s)} {who or ''}".strip()


def back(answer: Mapping[str, Any]) -> str:
    """What an undo of a calibration did."""
    tickets = ", ".join(map(str, answer.get("standing_tickets", ())))
    left = f"; what ticket {tickets} taught is undone with it: enter such a mass again if it is right" if tickets else ""
    if answer.get("crop"):
        return f"calibration {answer['undone']} undone for {answer['crop']}; the parameters in use now stay{left}"
    undone_ = str(answer["undone"]) if answer["undone"] == answer["until"] else f"{answer['undone']} to {answer['until']}"
    return f"calibration {undone_} undone, what was in use before is version {answer['version']}{left}"


def show(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table on standard output; where it is not a terminal, as wide as its content."""
    table = Table(*(Column(head, overflow="fold") for head in heads), box=None)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, emoji=False, width=400)
    console.print(table)
