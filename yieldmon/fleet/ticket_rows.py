"""A day's tickets as rows of its table of loads: which logs each covers, and what was measured in them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.errors import InputError, of_the_computer
from yieldmon.files import ticket_file
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.files.ticket_parts import with_parts_added
from yieldmon.fleet import tables
from yieldmon.fleet.overlaps import within
from yieldmon.fleet.own_tickets import own_tickets
from yieldmon.fleet.partition import Partition
from yieldmon.fleet.poisoned import Poisoned, by_name
from yieldmon.utc import EARLIEST_BUS_TIME_S


def ticket_rows(
    logs: Sequence[dict[str, Any]],
    path: str,
    given: Sequence[str],
    seconds: Sequence[tuple[float, float, float]],
    partition: Partition,
) -> tuple[list[dict[str, Any]], list[Poisoned]]:
    """Rows of what tickets cover, and tickets that nothing fits. given: all logs of the partition, in order; seconds:
    end, duration and mass of each."""
    if not path:
        return [], []
    called = {path: Path(path).name}
    try:
        found, others = own_tickets(ticket_file.load(path), partition.machine, partition.sharing)
    except InputError as error:
        if of_the_computer(error) is not None:
            raise
        return [], [Poisoned(called[path], by_name(str(error), called))]
    rows_of = {row["name"]: row for row in logs}
    rows, (matched, unmatched) = [], _one_for_each(found, given, called)
    unmatched += [Poisoned(by_name(error.where, called), by_name(str(error), called)) for error in others]
    for ticket, wanted in matched:
        covered = sorted((rows_of[name] for name in wanted if name in rows_of), key=lambda row: int(row["first_number"]))
        name = ticket.name
        if not covered or len(covered) < len(wanted):
            where = by_name(ticket.where, called)
            unmatched.append(Poisoned(where, f"{where}: no log that was measured is {name}"))
            continue
        rows.append({
            "kind": tables.TICKET, "name": name, "first_number": covered[0]["first_number"],
            "last_number": covered[-1]["last_number"], "start_s": covered[0]["start_s"], "end_s": covered[-1]["end_s"],
            "seconds": sum(row["seconds"] for row in covered), "measured_kg": _mass_kg(covered, seconds),
            "weighed_kg": ticket.mass_kg, "weighed_std_dev_kg": ticket.std_dev_kg,
            "other_monitor_std_dev_kg": ticket.other_std_dev_kg,
            "logs": json.dumps([row["name"] for row in covered]),
        })  # fmt: skip
    return rows, unmatched


def _one_for_each(
    tickets: Sequence[WeighedTicket], given: Sequence[str], called: Mapping[str, str]
) -> tuple[list[tuple[WeighedTicket, Sequence[str]]], list[Poisoned]]:
    """Tickets with the logs they cover, parts of the same logs added; of two whole ones for the same logs neither, as nothing
    says which is right."""
    by_logs: dict[tuple[str, ...], list[tuple[WeighedTicket, Sequence[str]]]] = {}
    for ticket in tickets:
        wanted = tuple(_covered(ticket, given))
        by_logs.setdefault(wanted or (ticket.where,), []).append((ticket, wanted))
    matched, refused = list[tuple[WeighedTicket, Sequence[str]]](), list[Poisoned]()
    for same in by_logs.values():
        try:
            matched += with_parts_added(same)
        except InputError as error:
            refused.append(Poisoned(by_name(error.where, called), by_name(str(error), called)))
    return matched, refused


def _mass_kg(covered: Sequence[dict[str, Any]], seconds: Sequence[tuple[float, float, float]]) -> float:
    """Of logs together; seconds at times that a log before them has too count once."""
    total_kg, before = 0.0, np.empty((0, 3))
    for row in covered:
        dated = row["start_s"] is not None and min(row["start_s"], row["end_s"]) > EARLIEST_BUS_TIME_S
        if len(covered) == 1 or not dated:
            total_kg += row["measured_kg"]
            continue
        own = np.reshape(np.asarray(seconds[row["first_number"] - 1 : row["last_number"]], dtype=float), (-1, 3))
        new = own[~within(own, before)]
        total_kg += row["measured_kg"] if len(new) == len(own) else float(new[:, 2].sum())
        before = np.concatenate([before, new])
        before = before[np.argsort(before[:, 0], kind="stable")]
    return total_kg


def _covered(ticket: WeighedTicket, given: Sequence[str]) -> Sequence[str]:
    """Names of the logs that a ticket speaks of."""
    if ticket.first.isdecimal() and ticket.last.isdecimal():
        first, last = int(ticket.first), int(ticket.last)
        return given[first - 1 : last] if 1 <= first <= last <= len(given) else ()
    found = [name for name in given if ticket_file.names_log(ticket.first, name)]
    if len(found) > 1:
        # Called the same, in folders.
        found = [name for name in found if name == ticket.first]
    return found if len(found) == 1 else ()
