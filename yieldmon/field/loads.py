"""Weighed loads correct the map: the mass of each load as measured, by weight, and what that does to the others."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon import bounded
from yieldmon.errors import InputError
from yieldmon.files import ticket_file
from yieldmon.files.delimited import LARGEST_BYTES

from .mixed import mixed_loads
from .placed import measured_mass_kg
from .sources.delimited import delimiter_of
from .table import Array, HarvestTable

UNKNOWN_SCALE_SD = 0.03
"""Relative standard deviation of a single load's factor about the field's, where fewer than three loads are weighed."""
ALL = "all"
"""As the machine of a ticket: all that have a load of this name."""
_COLUMNS = "load,weighed_kg[,sd_kg][,other_kg[,other_sd_kg]][,machine]"


@dataclass(frozen=True)
class Ticket:
    """A weighed load."""

    load: str
    weighed_kg: float
    sd_kg: float
    machine: str = ""
    """Or file, where the load's name is one of several machines'; ALL: they filled it together."""


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
    """CSV with the columns `load`, `weighed_kg` and, where wanted, `sd_kg`, `machine`, and `other_kg` and `other_sd_kg` as
    `ticket_file.own_part` has them; commas or semicolons between them.

    Raises
    ------
    InputError
        Naming file and row.
    """
    wanted = f"CSV with {_COLUMNS}"
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
        raise InputError(f"{path}: first row", f"names {', '.join(map(str, rows[0]))[:80]}", f"columns {_COLUMNS}")
    tickets = []
    for number, row in enumerate(rows, 1):
        try:
            weighed = _mass(row[names["weighed_kg"]])
            sd, other, other_sd = (_mass_or_none(row.get(names.get(name, ""))) for name in ("sd_kg", "other_kg", "other_sd_kg"))
        except (TypeError, ValueError):
            raise InputError(f"{path}: row {number}", "has no mass in kg", f"columns {_COLUMNS}") from None
        sd = ticket_file.RELATIVE_STD_DEV * weighed if sd is None else sd
        load = (row.get(names["load"]) or "").strip()
        if not (load and 0 < weighed < 1e9 and 0 <= sd < 1e9):
            raise InputError(
                f"{path}: row {number}", f"weighs {weighed:g} kg with sd {sd:g} kg", "a load's name and positive masses"
            )
        if other is not None:
            weighed, sd = ticket_file.own_part(weighed, sd, other, other_sd, f"{path}: row {number}, other_kg")
        tickets.append(Ticket(load, weighed, sd, (row.get(names.get("machine", "")) or "").strip()))
    if not tickets:
        raise InputError(str(path), "has no tickets", "at least one row")
    return tickets


def _mass_or_none(text: str | None) -> float | None:
    """As `_mass`; None for an empty cell or a column that there is not."""
    return _mass(text) if text and text.strip() else None


def _mass(text: str) -> float:
    """A number with a point or a comma before its decimals. Raises ValueError; also for `36,000`, which may be either."""
    plain = text.strip()
    if "," in plain and (plain.count(",") > 1 or "." in plain or len(plain.rpartition(",")[2]) == 3):
        raise ValueError(plain)
    return float(plain.replace(",", "."))


def correct(table: HarvestTable, tickets: Sequence[Ticket]) -> tuple[Array, tuple[LoadResult, ...]]:
    """A factor for each row, and the loads in order.

    A weighed load takes its own factor; any other takes that of all weighed loads together, with the spread between them. Loads
    of one name that several machines have are one for each machine, unless a ticket says that they filled it together.

    Raises
    ------
    InputError
        For a ticket of a load that the harvest does not have, one that measured nothing, and one of which it is not known whose
        load it is: several machines have one of that name, or the rows of two are mixed in it.
    """
    label, owners = table.labels["load"], Owners.of(table)
    together = {_number_of(ticket, label.names) for ticket in tickets if ticket.machine.lower() == ALL}
    key = np.where(np.isin(label.codes, list(together)), 0, owners.of_row)
    count = len(owners.names)
    pairs, codes = np.unique(label.codes.astype(np.intp) * count + key, return_inverse=True)
    loads = [divmod(int(pair), count) for pair in pairs]
    measured = np.bincount(codes, measured_mass_kg(table), len(loads))
    weighed = _by_load(loads, label.names, measured, tickets, owners, together)
    _refuse_mixed({loads[load][0] for load in weighed} - together, label.names, table)
    factors = {load: ticket.weighed_kg / measured[load] for load, ticket in weighed.items()}
    common, spread = _common([(factors[load], measured[load]) for load in weighed])
    results = []
    for load, (number, owner) in enumerate(loads):
        shared = number not in together and sum(one == number for one, _ in loads) > 1
        name, ticket = f"{label.names[number]}, {owners.names[owner]}" if shared else label.names[number], weighed.get(load)
        if ticket is None:
            results.append(LoadResult(name, float(measured[load]), None, common, spread))
        else:
            sd = ticket.sd_kg / measured[load]
            results.append(LoadResult(name, float(measured[load]), ticket.weighed_kg, factors[load], float(sd)))
    return np.array([one.factor for one in results] or [1.0])[codes], tuple(results)


@dataclass(frozen=True)
class Owners:
    """Whose row each is: machines by name, over all files, and files that name none. of_row: index into names."""

    of_row: NDArray[np.intp]
    names: tuple[str, ...]

    @classmethod
    def of(cls, table: HarvestTable) -> Owners:
        """Of a table's rows."""
        label = table.labels["machine"]
        named = np.array([bool(name.strip()) for name in label.names] or [False])[label.codes]
        files = [Path(source.path).name for source in table.sources]
        files = [source.path if files.count(name) > 1 else name for name, source in zip(files, table.sources, strict=True)]
        key = np.where(named, label.codes, len(label.names) + table.source_of_row)
        found, of_row = np.unique(key, return_inverse=True)
        names = (*label.names, *files)
        return cls(of_row.reshape(-1).astype(np.intp), tuple(names[k] for k in found.tolist()))


def _refuse_mixed(loads: set[int], names: Sequence[str], table: HarvestTable) -> None:
    """Raises InputError for a weighed load in which two machines took turns without names."""
    mixed = mixed_loads(table) if loads else {}
    for load in sorted(loads & set(mixed)):
        raise InputError(
            f"ticket of load {names[load]!r}",
            f"two machines without names are mixed in it: its places leap to and fro {mixed[load]} times",
            f"a file for each machine or a column with its name; or {ALL!r} as the ticket's machine where both filled it",
        )


def _number_of(ticket: Ticket, names: Sequence[str]) -> int:
    plain = {" ".join(name.split()): number for number, name in enumerate(names)}
    short = {name.split(":")[0].removeprefix("L"): number for name, number in plain.items()}
    behind = [name.split(":", 1)[1].strip() if ":" in name else "" for name in plain]
    load = plain.get(ticket.load, short.get(ticket.load.removeprefix("L")))
    if load is None and behind.count(ticket.load) == 1:
        load = list(plain.values())[behind.index(ticket.load)]
    if load is None:
        raise InputError(
            f"ticket of load {ticket.load!r}", "names a load that the harvest does not have", f"one of {', '.join(plain)}"
        )
    return load


def _by_load(
    loads: Sequence[tuple[int, int]],
    names: Sequence[str],
    measured: Array,
    tickets: Sequence[Ticket],
    owners: Owners,
    together: set[int],
) -> Mapping[int, Ticket]:
    out: dict[int, Ticket] = {}
    for ticket in tickets:
        number = _number_of(ticket, names)
        where = f"ticket of load {ticket.load!r}"
        held = [load for load, (name, _) in enumerate(loads) if name == number]
        whose = [owners.names[loads[load][1]] for load in held]
        if ticket.machine and number not in together:
            if ticket.machine not in whose:
                raise InputError(where, f"names the machine {ticket.machine!r}", f"one of {', '.join(whose)}, or {ALL}")
            held = [held[whose.index(ticket.machine)]]
        if len(held) > 1:
            expected = f"a column machine with one of these, or with {ALL!r} where they filled it together"
            raise InputError(where, f"is of {len(held)} machines or files: {', '.join(whose)}", expected)
        load = held[0] if held else -1
        if load < 0 or measured[load] <= 0:
            raise InputError(where, "is of a load that measured nothing", "a load with grain")
        whole = ticket
        if load in out:
            old = out[load]
            whole = Ticket(old.load, old.weighed_kg + ticket.weighed_kg, float(np.hypot(old.sd_kg, ticket.sd_kg)), old.machine)
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
