"""Sentences on what a daemon did for a ticket, an undo or a correction, for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from yieldmon.cli._records import named


def calibration_undone(answer: Mapping[str, Any]) -> str:
    """On the undo of a calibration."""
    left = _silenced(answer) + _updates(answer)
    if answer.get("crop"):
        return f"calibration {answer['undone']} undone for {answer['crop']}; the parameters in use now stay{left}"
    undone_ = str(answer["undone"]) if answer["undone"] == answer["until"] else f"{answer['undone']} to {answer['until']}"
    return f"calibration {undone_} undone, what was in use before is version {answer['version']}{left}"


def _silenced(answer: Mapping[str, Any]) -> str:
    """On the tickets whose own update was undone."""
    numbers = answer.get("silenced", ())
    if not numbers:
        return ""
    one = len(numbers) == 1
    does = f"still {'corrects its load' if one else 'correct their loads'} and {'updates' if one else 'update'} no parameters"
    return f"; {named('ticket', numbers)} {does}: `yieldmon ticket undo {numbers[0]}` takes that back too"


def _updates(answer: Mapping[str, Any]) -> str:
    """On updates by standing tickets and sweeps since."""
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


def tickets_replaced(answer: Mapping[str, Any]) -> str:
    """On the tickets that a new one replaces."""
    rows = answer.get("taken_back", ())
    numbers, stood = [row["ticket"] for row in rows], answer["replaces"]
    undo = f"`yieldmon ticket undo {answer['ticket']}` if it is for another load"
    parts = f"of loads weighed in parts, as on two trucks, enter all in one: `yieldmon ticket {_loads_of(answer)} 9.1t+8.4t`"
    said = f"the new ticket replaces {named('ticket', stood)} ({undo}; {parts})"
    if numbers:
        said += f", as if {named('ticket', numbers)} had never been entered"
    if without := answer.get("without_ticket"):
        first, last = (f(row[key] for row in (*rows, answer)) for f, key in ((min, "first_load"), (max, "last_load")))
        whole = f"`yieldmon ticket {first}-{last} MASS`"
        enter = "one for it" if len(without) == 1 else "those"
        said += f"; {loads_without_ticket(without)}: enter {enter}, or one for all ({whole})"
    for row in answer.get("still_replaced", ()):
        said += f"; `yieldmon ticket undo {row['by']}` brings back ticket {row['ticket']}, which ticket {row['by']} replaced"
    for row in rows:
        if "update_kept_because" in row:
            said += f"; the update of the parameters by ticket {row['ticket']} stays: {row['update_kept_because']}"
        said += _updates(row)
    return said


def ticket_undone(answer: Mapping[str, Any]) -> str:
    """On the undo of a ticket."""
    if "undone" in answer:
        return f"ticket {answer['ticket']} undone; {calibration_undone(answer)}"
    stays = f"; its update of the parameters stays: {answer['update_kept_because']}" if "update_kept_because" in answer else ""
    return f"ticket {answer['ticket']} undone{stays}{_updates(answer)}"


def loads_corrected(answer: Mapping[str, Any]) -> str:
    """On a correction of loads' crop or field."""
    first, last = answer["first_load"], answer["last_load"]
    names = " ".join(name for name in (answer["field"], answer["crop"]) if name) or "no field"
    parts = [f"load {first}: {names}" if first == last else f"loads {first} to {last}: {names}"]
    if again := answer.get("measured_again"):
        parts.append(f"{named('load', again)} recomputed with the parameters of {answer['crop']}, the seconds are unchanged")
    parts += [f"load {row['load']} is not recomputed: {row['why']}" for row in answer.get("not_measured_again", ())]
    for update in answer.get("taken_back", ()):
        of_other = f"the update of another crop by ticket {update['ticket']}"
        if "undone" in update:
            parts.append(f"{of_other} is taken back: {calibration_undone(update)}")
        elif "update_kept_because" in update:
            parts.append(f"{of_other} stays: {update['update_kept_because']}")
    if updated := answer.get("updated_again"):
        parts.append(f"the parameters of {answer['crop']} are updated by {named('ticket', updated)}")
    parts += [f"ticket {row['ticket']} updates no parameters: {row['why']}" for row in answer.get("not_updated_again", ())]
    if goes_on := answer.get("goes_on"):
        parts.append(f"the next load is still {goes_on}: `yieldmon load start --crop {answer['crop']}` if it is not")
    return "; ".join(parts)


def loads_without_ticket(numbers: Sequence[int]) -> str:
    """On loads that a newer ticket for other loads has left without one.

    Examples
    --------
    >>> loads_without_ticket([2]), loads_without_ticket([2, 4])
    ('load 2 has no ticket any more', 'loads 2 and 4 have no ticket any more')
    """
    return f"{named('load', numbers)} {'has' if len(numbers) == 1 else 'have'} no ticket any more"


def _loads_of(answer: Mapping[str, Any]) -> str:
    first, last = answer["first_load"], answer["last_load"]
    return str(first) if first == last else f"{first}-{last}"
