"""What the verbs that list a daemon's records share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from yieldmon.errors import InputError


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
    left = _silenced(answer) + _updates(answer)
    if answer.get("crop"):
        return f"calibration {answer['undone']} undone for {answer['crop']}; the parameters in use now stay{left}"
    undone_ = str(answer["undone"]) if answer["undone"] == answer["until"] else f"{answer['undone']} to {answer['until']}"
    return f"calibration {undone_} undone, what was in use before is version {answer['version']}{left}"


def _silenced(answer: Mapping[str, Any]) -> str:
    """The tickets whose own update was undone."""
    numbers = answer.get("silenced", ())
    if not numbers:
        return ""
    one = len(numbers) == 1
    does = f"still {'corrects its load' if one else 'correct their loads'} and {'updates' if one else 'update'} no parameters"
    return f"; {named('ticket', numbers)} {does}: `yieldmon ticket undo {numbers[0]}` takes that back too"


def _updates(answer: Mapping[str, Any]) -> str:
    """What becomes of the updates by standing tickets and sweeps since."""
    parts = []
    if again := answer.get("updated_again"):
        parts.append(f"the update by {named('ticket', again)} is made again without it")
    parts += [
        f"the update by ticket {row['ticket']} is not made again: {row['why']}" for row in answer.get("not_updated_again", ())
    ]
    if "not_updated_again" not in answer and answer.get("standing_tickets"):
        tickets = named("ticket", answer["standing_tickets"])
        parts.append(f"the update by {tickets} is undone with it: enter such a mass again if it is right")
    if count := answer.get("sweeps_undone"):
        sweeps = "a sweep" if count == 1 else f"{count} sweeps"
        parts.append(f"the update by {sweeps} since then is undone with it; the next one makes its own")
    return "".join(f"; {part}" for part in parts)


def replaced(answer: Mapping[str, Any]) -> str:
    """What a new ticket leaves of those that stood for its loads."""
    rows = answer.get("taken_back", ())
    numbers, stood = [row["ticket"] for row in rows], answer["replaces"]
    undo = f"`yieldmon ticket undo {answer['ticket']}` if it is for another load"
    parts = f"of loads weighed in parts, as on two trucks, enter all in one: `yieldmon ticket {_loads_of(answer)} 9.1t+8.4t`"
    said = f"{named('ticket', stood)} stood for it; the newer one counts ({undo}; {parts})"
    if numbers:
        said += f", as if {named('ticket', numbers)} had never been entered"
    if without := answer.get("without_ticket"):
        first, last = (f(row[key] for row in (*rows, answer)) for f, key in ((min, "first_load"), (max, "last_load")))
        whole = f"`yieldmon ticket {first}-{last} MASS`"
        said += f"; {without_ticket(without)}: enter {'one for it' if len(without) == 1 else 'those'}, or one for all ({whole})"
    for row in answer.get("still_replaced", ()):
        said += f"; `yieldmon ticket undo {row['by']}` brings back ticket {row['ticket']}, which ticket {row['by']} replaced"
    for row in rows:
        if "update_kept_because" in row:
            said += f"; the update of the parameters by ticket {row['ticket']} stays: {row['update_kept_because']}"
        said += _updates(row)
    return said


def taken_back(answer: Mapping[str, Any]) -> str:
    """What an undo of a ticket did."""
    if "undone" in answer:
        return f"ticket {answer['ticket']} undone; {back(answer)}"
    stays = f"; its update of the parameters stays: {answer['update_kept_because']}" if "update_kept_because" in answer else ""
    return f"ticket {answer['ticket']} undone{stays}{_updates(answer)}"


def load_numbers(text: str) -> tuple[int, int]:
    """First and last load of what was typed. Raises InputError."""
    first, dash, last = text.partition("-")
    if not first.isdecimal() or (dash and not last.isdecimal()):
        raise InputError("LOAD", repr(text), "a number such as 7, or FIRST-LAST such as 7-9")
    if dash and int(last) < int(first):
        raise InputError("LOAD", repr(text), "the first load before the last, such as 7-9")
    return int(first), int(last) if dash else int(first)


def corrected(answer: Mapping[str, Any]) -> str:
    """What a correction of names did."""
    first, last = answer["first_load"], answer["last_load"]
    names = " ".join(name for name in (answer["field"], answer["crop"]) if name) or "no field"
    parts = [f"load {first}: {names}" if first == last else f"loads {first} to {last}: {names}"]
    if again := answer.get("measured_again"):
        parts.append(f"{named('load', again)} measured again with the parameters of {answer['crop']}, seconds stay as they are")
    parts += [f"load {row['load']} is not measured again: {row['why']}" for row in answer.get("not_measured_again", ())]
    for update in answer.get("taken_back", ()):
        of_other = f"the update of another crop by ticket {update['ticket']}"
        if "undone" in update:
            parts.append(f"{of_other} is taken back: {back(update)}")
        elif "update_kept_because" in update:
            parts.append(f"{of_other} stays: {update['update_kept_because']}")
    if updated := answer.get("updated_again"):
        parts.append(f"the parameters of {answer['crop']} are updated by {named('ticket', updated)}")
    parts += [f"ticket {row['ticket']} updates no parameters: {row['why']}" for row in answer.get("not_updated_again", ())]
    if goes_on := answer.get("goes_on"):
        parts.append(f"the next load is still {goes_on}: `yieldmon load start --crop {answer['crop']}` if it is not")
    return "; ".join(parts)


def named(noun: str, numbers: Sequence[int]) -> str:
    """Numbered things in a sentence.

    Examples
    --------
    >>> named("load", [2]), named("load", [2, 4, 5])
    ('load 2', 'loads 2, 4 and 5')
    """
    before, last = ", ".join(map(str, numbers[:-1])), str(numbers[-1])
    return f"{noun}s {before} and {last}" if before else f"{noun} {last}"


def without_ticket(numbers: Sequence[int]) -> str:
    """What is said of loads that a newer ticket for others has left without one.

    Examples
    --------
    >>> without_ticket([2]), without_ticket([2, 4])
    ('load 2 has no ticket any more', 'loads 2 and 4 have no ticket any more')
    """
    return f"{named('load', numbers)} {'has' if len(numbers) == 1 else 'have'} no ticket any more"


def _loads_of(answer: Mapping[str, Any]) -> str:
    first, last = answer["first_load"], answer["last_load"]
    return str(first) if first == last else f"{first}-{last}"


def show(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table on standard output; where it is not a terminal, as wide as its content."""
    table = Table(*(Column(head, overflow="fold") for head in heads), box=None)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, emoji=False, width=400)
    console.print(table)
