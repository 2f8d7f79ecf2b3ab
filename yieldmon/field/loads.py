"""Weighed loads correct the map: the mass of each load as measured, by weight, and what that does to the others."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from yieldmon import bounded
from yieldmon.errors import InputError
from yieldmon.files import ticket_file
from yieldmon.files.delimited import LARGEST_BYTES

from .placed import measured_mass_kg
from .sources.delimited import delimiter_of
from .table import Array, HarvestTable

UNKNOWN_SCALE_SD = 0.03
"""Relative standard deviation of a single load's factor about the field's, where fewer than three loads are weighed."""


@dataclass(frozen=True)
class Ticket:
    """A weighed load."""

    load: str
    weighed_kg: float
    sd_kg: float


@dataclass(frozen=True)
class LoadResult:
    """measured_kg: integrated. factor, factor_sd: what its points are multiplied by."""

    load: str
    measured_kg: float
    weighed_kg: float | None
    factor: float
    factor_sd: float | None

    def document(self) -> dict[str, object]:
        """As JSON takes it."""
        return {
            "load": self.load,
            "measured_kg": round(self.measured_kg, 3),
            "weighed_kg": self.weighed_kg,
            "factor": round(self.factor, 6),
            "factor_sd": None if self.factor_sd is None else round(self.factor_sd, 6),
            "corrected_kg": round(self.measured_kg * self.factor, 3),
        }


def read_tickets(path: Path) -> list[Ticket]:
    """CSV with the columns `load`, `weighed_kg` and, if known, `sd_kg`, with commas or semicolons between fields.

    Raises
    ------
    InputError
        Naming file and row.
    """
    wanted = "CSV with load,weighed_kg[,sd_kg]"
    try:
        text = bounded.read_whole(path, wanted, LARGEST_BYTES).decode("utf-8-sig")
        lines = [line for line in bounded.split(text, str(path), wanted) if line.strip(" \t,;")]
        delimiter = delimiter_of(lines[0]) if lines else ","
        rows = list(csv.DictReader(lines, delimiter=delimiter, skipinitialspace=True))
    except (UnicodeError, csv.Error) as error:
        raise InputError(str(path), f"cannot be read: {error}", wanted) from error
    if not lines:
        raise InputError(str(path), "has no tickets", "at least one row")
    names = {str(name).strip().lower(): name for name in rows[0]} if rows else {}
    if rows and not {"load", "weighed_kg"} <= set(names):
        raise InputError(f"{path}: first row", f"names {', '.join(map(str, rows[0]))[:80]}", "columns load,weighed_kg[,sd_kg]")
    tickets = []
    for number, row in enumerate(rows, 1):
        try:
            weighed = _mass(row[names["weighed_kg"]])
            sd_text = row.get(names.get("sd_kg", ""))
            sd = _mass(sd_text) if sd_text and sd_text.strip() else ticket_file.RELATIVE_STD_DEV * weighed
        except (TypeError, ValueError):
            raise InputError(f"{path}: row {number}", "has no mass in kg", "columns load,weighed_kg[,sd_kg]") from None
        load = (row.get(names["load"]) or "").strip()
        if not (load and 0 < weighed < 1e9 and 0 <= sd < 1e9):
            raise InputError(
                f"{path}: row {number}", f"weighs {weighed:g} kg with sd {sd:g} kg", "a load's name and positive masses"
            )
        tickets.append(Ticket(load, weighed, sd))
    if not tickets:
        raise InputError(str(path), "has no tickets", "at least one row")
    return tickets


def _mass(text: str) -> float:
    """A number with a point or a comma before its decimals. Raises ValueError; also for `36,000`, which may be either."""
    plain = text.strip()
    if "," in plain and (plain.count(",") > 1 or "." in plain or len(plain.rpartition(",")[2]) == 3):
        raise ValueError(plain)
    return float(plain.replace(",", "."))


def correct(table: HarvestTable, tickets: Sequence[Ticket]) -> tuple[Array, tuple[LoadResult, ...]]:
    """A factor for each row, and the loads in order.

    A weighed load takes its own factor; any other takes that of all weighed loads together, with the spread between them.

    Raises
    ------
    InputError
        For a ticket of a load that the harvest does not have, or one that measured nothing.
    """
    label = table.labels["load"]
    measured = np.bincount(label.codes, measured_mass_kg(table), len(label.names))
    weighed = _by_load(label.names, measured, tickets)
    factors = {load: ticket.weighed_kg / measured[load] for load, ticket in weighed.items()}
    common, spread = _common([(factors[load], measured[load]) for load in weighed])
    results = []
    for load, name in enumerate(label.names):
        ticket = weighed.get(load)
        if ticket is None:
            results.append(LoadResult(name, float(measured[load]), None, common, spread))
        else:
            sd = ticket.sd_kg / measured[load]
            results.append(LoadResult(name, float(measured[load]), ticket.weighed_kg, factors[load], float(sd)))
    return np.array([one.factor for one in results] or [1.0])[label.codes], tuple(results)


def _by_load(names: Sequence[str], measured: Array, tickets: Sequence[Ticket]) -> Mapping[int, Ticket]:
    out: dict[int, Ticket] = {}
    plain = {" ".join(name.split()): number for number, name in enumerate(names)}
    short = {name.split(":")[0].removeprefix("L"): number for name, number in plain.items()}
    behind = [name.split(":", 1)[1].strip() if ":" in name else "" for name in plain]
    for ticket in tickets:
        load = plain.get(ticket.load, short.get(ticket.load.removeprefix("L")))
        if load is None and behind.count(ticket.load) == 1:
            load = list(plain.values())[behind.index(ticket.load)]
        if load is None:
            raise InputError(
                f"ticket of load {ticket.load!r}", "names a load that the harvest does not have", f"one of {', '.join(plain)}"
            )
        if measured[load] <= 0:
            raise InputError(f"ticket of load {ticket.load!r}", "is of a load that measured nothing", "a load with grain")
        whole = ticket
        if load in out:
            old = out[load]
            whole = Ticket(old.load, old.weighed_kg + ticket.weighed_kg, float(np.hypot(old.sd_kg, ticket.sd_kg)))
        out[load] = whole
    return out


def _common(factors: Sequence[tuple[float, float]]) -> tuple[float, float | None]:
    if not factors:
        return 1.0, None
    values, weights = (np.array(part) for part in zip(*factors, strict=True))
    mean = float(np.average(values, weights=weights))
    if len(values) < 3:
        return mean, UNKNOWN_SCALE_SD
    spread = float(np.std(values, ddof=1))
    return mean, float(np.hypot(spread, spread / np.sqrt(len(values))))
