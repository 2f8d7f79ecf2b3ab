"""Weighed loads correct the map: the mass of each load as measured, by weight, and what that does to the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.documents.harvest_map import MapLoad
from yieldmon.errors import InputError
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.files.ticket_parts import with_parts_added

from .contradictions import HeldTicket, contradictions
from .crop_figures import crop
from .mixed import mixed_loads
from .placed import measured_mass_kg
from .row_crops import row_crops
from .table import UNKNOWN_SCALE_SD, Array, HarvestTable

ALL = "all"
"""As the machine of a ticket: all that have a load of this name."""


@dataclass(frozen=True)
class LoadResult:
    """measured_kg: integrated. factor, factor_sd: what its points are multiplied by. common_sd: the part of factor_sd by another
    combine's monitor, the same error in all loads."""

    load: str
    measured_kg: float
    weighed_kg: float | None
    factor: float
    factor_sd: float | None
    common_sd: float = 0.0

    def document(self) -> MapLoad:
        """As JSON takes it."""
        return {
            "load": self.load,
            "measured_kg": round(self.measured_kg, 3),
            "weighed_kg": self.weighed_kg,
            "factor": round(self.factor, 6),
            "factor_sd": None if self.factor_sd is None else round(self.factor_sd, 6),
            "corrected_kg": round(self.measured_kg * self.factor, 3),
        }


@dataclass(frozen=True)
class Corrected:
    """factor: of each row; loads: in order; notes: on tickets that others contradict."""

    factor: Array
    loads: tuple[LoadResult, ...]
    notes: tuple[str, ...]


def correct(table: HarvestTable, tickets: Sequence[WeighedTicket]) -> Corrected:
    """What weighed loads make of a harvest.

    A weighed load takes its own factor, one that its source has corrected the source's; any other takes that of all weighed loads
    of its machine, crop and scale together, or where its machine has none of all machines' of its crop, with the spread between
    them. Where only other crops or scales were weighed it stays as measured, with how far off those were. Loads of one name that
    several machines have are one for each machine, unless a ticket says that they filled it together. A ticket that the others
    of its machine, crop and scale contradict is left out. Parts of a load are added where the tickets say that they are parts.

    Raises
    ------
    InputError
        For a ticket of a load that the harvest does not have, one that measured nothing, a second one of a load, and one of which
        it is not known whose load it is: several machines have one of that name, or the rows of two are mixed in it.
    """
    label, owners = table.labels["load"], Owners.of(table)
    together = {
        number
        for ticket in tickets
        if ticket.machine.lower() == ALL
        for numbers in _numbers_of(ticket, label.names)
        for number in numbers
    }
    key = np.where(np.isin(label.codes, list(together)), 0, owners.of_row)
    count = len(owners.names)
    pairs, firsts, codes = np.unique(label.codes.astype(np.intp) * count + key, return_index=True, return_inverse=True)
    loads = [divmod(int(pair), count) for pair in pairs]
    measured = np.bincount(codes, measured_mass_kg(table), len(loads))
    found = _Loads(loads, label.names, owners, _files_of(codes, table), together)
    given = with_parts_added((ticket, _held(ticket, found, measured)) for ticket in tickets)
    held = [HeldTicket(ticket.name, ticket.mass_kg, places) for ticket, places in given]
    _refuse_mixed({loads[load][0] for ticket in held for load in ticket.loads} - together, label.names, table)
    kinds = _kinds(loads, codes, measured, firsts, table)
    left_out, notes = contradictions(held, dict(enumerate(measured.tolist())), kinds)
    kept = [pair for number, pair in enumerate(given) if number not in left_out]
    weighed = _by_load(kept, measured)
    mixed = {load for _, places in kept if len({kinds[load].grain for load in places}) > 1 for load in places}
    factors = {load: mass.kg / measured[load] for load, mass in weighed.items()}
    corrected = [table.sources[table.source_of_row[row]].known_loads.get(label.names[label.codes[row]]) for row in firsts]
    known_of: dict[_Kind | tuple[str, str], list[tuple[float, float]]] = {}
    for load in weighed.keys() - mixed:
        known_of.setdefault(kinds[load].grain, []).append((factors[load], measured[load]))
        if loads[load][0] not in together:
            known_of.setdefault(kinds[load], []).append((factors[load], measured[load]))
    common_of = {kind: _common(known) for kind, known in known_of.items()}
    own = {loads[load][1] for load in weighed if loads[load][0] not in together}
    as_measured = 1.0, _how_far_off([factors[load] for load in weighed])
    unlike: list[str] = []
    results = []
    for load, (number, owner) in enumerate(loads):
        shared = number not in together and sum(one == number for one, _ in loads) > 1
        name, mass = f"{label.names[number]}, {owners.names[owner]}" if shared else label.names[number], weighed.get(load)
        if mass is not None:
            sd, common_sd = float(mass.sd_kg / measured[load]), float(mass.common_kg / measured[load])
            results.append(LoadResult(name, float(measured[load]), mass.kg, factors[load], sd, common_sd))
        elif (known := corrected[load]) is not None:
            results.append(
                LoadResult(name, float(measured[load]), known.weighed_kg, known.factor, known.factor_sd, known.common_sd)
            )
        else:
            others = None if owner in own else common_of.get(kinds[load].grain)
            common, spread = common_of.get(kinds[load], others or as_measured)
            spread = UNKNOWN_SCALE_SD if spread is None and any(corrected) else spread
            if weighed and measured[load] > 0.0 and kinds[load] not in common_of and others is None:
                unlike.append(f"load {name}" if name else "grain of no load")
            results.append(LoadResult(name, float(measured[load]), None, common, spread))
    if unlike:
        notes += (f"as measured, for no weighed load is of the same crop and calibration: {', '.join(unlike)}",)
    return Corrected(np.array([one.factor for one in results] or [1.0])[codes], tuple(results), notes)


@dataclass(frozen=True)
class _Kind:
    """Loads that share a factor. grain: their crop, and the scale that they were measured with where their source tells it."""

    owner: int
    grain: tuple[str, str]


def _kinds(
    loads: Sequence[tuple[int, int]], codes: NDArray[np.intp], measured: Array, firsts: NDArray[np.intp], table: HarvestTable
) -> dict[int, _Kind]:
    """Of each load, by its place. firsts: its first row."""
    crops, names = row_crops(table), table.labels["load"].names
    count = max(len(crops.names), 1)
    masses_kg = np.bincount(codes.reshape(-1) * count + crops.codes, measured_mass_kg(table), len(loads) * count)
    crop_of = masses_kg.reshape(-1, count).argmax(axis=1) if len(loads) else []
    found = {}
    for load, (number, owner) in enumerate(loads):
        facts = crop(crops.names[crop_of[load]])
        scale = table.sources[table.source_of_row[firsts[load]]].scales.get(names[number], "")
        found[load] = _Kind(owner, (crops.names[crop_of[load]].lower() if facts is None else facts.name, scale))
    return found


def _how_far_off(factors: Sequence[float]) -> float | None:
    """Standard deviation of a factor that is taken for 1, by others that are not; None without any."""
    return max(float(np.sqrt(np.mean((np.array(factors) - 1.0) ** 2))), UNKNOWN_SCALE_SD) if factors else None


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
            f"two machines without names are mixed in it: its places jump back and forth {mixed[load]} times",
            f"a file for each machine or a column with its name; or {ALL!r} as the ticket's machine where both filled it",
        )


def _numbers_of(ticket: WeighedTicket, names: Sequence[str]) -> list[tuple[int, ...]]:
    """The loads of a ticket, each by its place in the names; by several where names begin with the same number."""
    if ticket.name in names:
        return [(names.index(ticket.name),)]
    if ticket.first == ticket.last:
        return [_number_of(ticket.first, names)]
    if int(ticket.last) < int(ticket.first):
        raise InputError(f"ticket of load {ticket.name!r}", "ends before it begins", "the first load and the last")
    return [_number_of(str(number), names) for number in range(int(ticket.first), int(ticket.last) + 1)]


def _number_of(load_name: str, names: Sequence[str]) -> tuple[int, ...]:
    plain = [" ".join(name.split()) for name in names]
    alike: tuple[Callable[[str], bool], ...] = (
        lambda name: name == load_name,
        lambda name: name.split(":")[0].removeprefix("L") == load_name.removeprefix("L"),
        lambda name: ":" in name and name.split(":", 1)[1].strip() == load_name,
    )
    found: tuple[int, ...] = ()
    for is_alike in alike:
        found = found or tuple(number for number, name in enumerate(plain) if is_alike(name))
    if not found:
        known = ", ".join(name for name in plain if name)
        expected = f"one of {known}" if known else "a harvest whose rows name their loads"
        raise InputError(f"ticket of load {load_name!r}", "names a load that the harvest does not have", expected)
    return found


@dataclass(frozen=True)
class _Weighed:
    """A load's mass by its ticket. common_kg: the part of sd_kg that is the same error in all."""

    kg: float
    sd_kg: float
    common_kg: float


@dataclass(frozen=True)
class _Loads:
    """The loads of a harvest. of: name and owner of each, by their places; files: how the one file with its rows may be called;
    together: names of loads that several machines filled."""

    of: Sequence[tuple[int, int]]
    names: Sequence[str]
    owners: Owners
    files: Sequence[frozenset[str]]
    together: set[int]

    def called(self, load: int, machine: str) -> bool:
        """Whether a load is that of a machine or file of this name."""
        return machine in (self.owners.names[self.of[load][1]], *self.files[load])

    def whose(self, load: int) -> str:
        """Whose it is, for a message."""
        return self.owners.names[self.of[load][1]]


def _files_of(codes: NDArray[np.intp], table: HarvestTable) -> list[frozenset[str]]:
    """Of each load the name of the one file with its rows, with and without ending; of one in several files nothing."""
    sources = [Path(source.path) for source in table.sources]
    pairs = np.unique(np.stack([codes.reshape(-1), table.source_of_row]), axis=1) if len(codes) else np.empty((2, 0), np.intp)
    files: list[set[int]] = [set() for _ in range(int(codes.max()) + 1 if len(codes) else 0)]
    for load, source in pairs.T.tolist():
        files[load].add(source)
    called = [sources[min(of)] if len(of) == 1 else None for of in files]
    return [frozenset() if one is None else frozenset((one.name, one.stem)) for one in called]


def _held(ticket: WeighedTicket, loads: _Loads, measured: Array) -> tuple[int, ...]:
    """The loads with grain that a ticket is for. Raises InputError where there is none."""
    held = [load for numbers in _numbers_of(ticket, loads.names) for load in _held_by(ticket, numbers, loads)]
    if not float(sum(measured[load] for load in held)) > 0:
        raise InputError(f"ticket of load {ticket.name!r}", "is for a load without measured mass", "a load with grain")
    return tuple(load for load in held if measured[load] > 0)


def _by_load(tickets: Sequence[tuple[WeighedTicket, tuple[int, ...]]], measured: Array) -> Mapping[int, _Weighed]:
    out: dict[int, _Weighed] = {}
    for ticket, held in tickets:
        total = float(sum(measured[load] for load in held))
        for load in held:
            share = float(measured[load]) / total
            # How a mass divides among several loads is not weighed: their deviations add up to that of the whole.
            out[load] = _Weighed(ticket.mass_kg * share, ticket.std_dev_kg * share**0.5, ticket.other_std_dev_kg * share)
    return out


def _held_by(ticket: WeighedTicket, numbers: Sequence[int], loads: _Loads) -> list[int]:
    """Places of the machine's load that a ticket is of, by its names; of several that machines filled together."""
    where = f"ticket of load {ticket.name!r}"
    held = [load for load, (name, _) in enumerate(loads.of) if name in numbers]
    if not held:
        raise InputError(where, "is for a load without measured mass", "a load with grain")
    if loads.together.issuperset(numbers):
        return held
    if ticket.machine:
        own = [load for load in held if loads.called(load, ticket.machine)]
        if not own:
            known = ", ".join(dict.fromkeys(map(loads.whose, held)))
            raise InputError(where, f"names the machine {ticket.machine!r}", f"one of {known}, or {ALL}")
        held = own
    if len(held) == 1:
        return held
    whose = list(dict.fromkeys(map(loads.whose, held)))
    if len(whose) > 1:
        expected = f"a column machine with one of these, or with {ALL!r} where they filled it together"
        raise InputError(where, f"is of {len(whose)} machines or files: {', '.join(whose)}", expected)
    called = ", ".join(repr(loads.names[loads.of[load][0]]) for load in held)
    raise InputError(where, f"is of {len(held)} loads of {whose[0]}", f"one of {called}, or the file as the ticket's machine")


def _common(factors: Sequence[tuple[float, float]]) -> tuple[float, float | None]:
    if not factors:
        return 1.0, None
    values, weights = (np.array(part) for part in zip(*factors, strict=True))
    mean = float(np.average(values, weights=weights))
    if len(values) < 2:
        return mean, UNKNOWN_SCALE_SD
    spread = float(np.std(values, ddof=1))
    known = float(np.hypot(spread, spread / np.sqrt(len(values))))
    # Two that agree may do so by chance; two that contradict each other say nothing of the others.
    return mean, known if len(values) > 2 else max(known, UNKNOWN_SCALE_SD)
