"""Loads of the last days measured again with the parameters of updates after them.

A ticket in the evening also says something of the hours and days before it: a day whose one ticket is of a load at low flow
is measured better with what the next evening's says of its grain at high flow. Each load's seconds are measured again with the
parameters as the weighed masses together have them at its time (`parameter_timeline`). What was measured at first stays as it is:
the result is a factor for each load.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.service.history.load_factor import load_factor
from yieldmon.service.history.parameter_spread import parameter_spread, states_its_scale
from yieldmon.service.history.parameter_timeline import Timeline, timeline
from yieldmon.service.logs.measured_loads import MeasuredLoad, measured_loads, rows_in_loads
from yieldmon.service.logs.recorded import opened, parameter_sets
from yieldmon.service.storage.batch import Action
from yieldmon.service.storage.ledger import PARAMETERS, recropped, undone_versions
from yieldmon.service.storage.load_spread import ParameterSpread
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.units import S_PER_DAY

SPAN_S = 72.0 * 3600.0
"""Loads that began at most so long before an update are measured again after it."""
_MOST_ROWS = 270_000
"""Seconds that are measured again at the most: three days and three hours."""


@dataclass(frozen=True)
class MeasuredAgain:
    """A load that was measured again.

    Parameters
    ----------
    factor : float
        Its mass over the mass as measured.
    spread : ParameterSpread or None
        By how much the mass may be off through the parameters; None where that is no better known than when it was measured.
    """

    factor: float
    spread: ParameterSpread | None


def remeasured(
    loads: Sequence[MeasuredLoad], known: Timeline, machine: Machine, of_crop: Mapping[int, bool] | None = None
) -> dict[int, MeasuredAgain]:
    """Loads measured again with the timeline's parameters.

    Parameters
    ----------
    loads : sequence of MeasuredLoad
    known : Timeline
    machine : Machine
    of_crop : mapping of int to bool, optional
        For each load that was given another crop, by number: whether that crop is the timeline's. Such a load counts whichever
        parameters measured it.

    Returns
    -------
    dict of int to MeasuredAgain
        By load number; without loads with seconds from before the timeline, and those of which less than 90 % rests on a known
        force.
    """
    renamed = {} if of_crop is None else of_crop
    out = {}
    stated = states_its_scale(known.parameters)
    for load in loads:
        versions = {row.parameter_version for row in load.seconds}
        if not renamed.get(int(load.name), versions <= known.versions):
            continue
        moment_s = float(np.average([row.time_s for row in load.seconds], weights=[row.mass_kg for row in load.seconds]))
        there = known.at(moment_s)
        factor = load_factor(load, there, machine)
        if factor is not None:
            spread = parameter_spread(load, there, machine, known.covariance_at(moment_s)) if stated else None
            out[int(load.name)] = MeasuredAgain(factor, spread)
    return out


def of_store(
    path: Path,
    machine: Machine,
    version: int,
    open_load: int | None,
    now_s: float,
    *,
    undone_only: bool = False,
    only: int | None = None,
    crop: str = "",
) -> dict[int, MeasuredAgain]:
    """A store's loads of the last days, measured again with the parameters of a version.

    Parameters
    ----------
    path : path
        Of the store.
    machine : Machine
    version : int
        Of the parameters. What undone versions have measured since these came is measured again too.
    open_load : int or None
        Number of the load that is left out since it is open.
    now_s : float
        Bus time.
    undone_only : bool
        Only loads that undone versions measured, and those that were given this crop.
    only : int, optional
        The only load to measure.
    crop : str
        Of the parameters, where they do not name it.

    Returns
    -------
    dict of int to MeasuredAgain
        By load number.

    Raises
    ------
    InputError
        For a store that cannot be read, or lacks that version.
    """
    out: dict[int, MeasuredAgain] = {}
    with opened(path) as store:
        sets = parameter_sets(store)
        if version not in sets:
            raise InputError(str(path), f"has no parameters of version {version}", "a store that is being written")
        known, loads, actions = timeline(store.steps(), sets[version], sets), store.loads(), store.actions()
        gone = _taken_back(undone_versions(actions), known, sets) | _begun_with(known, sets, actions)
        known = replace(known, versions=known.versions | gone)
        renamed, of_version = recropped(actions), sets[version].provenance.get("crop", crop)
        of_crop = {load.number: load.crop == of_version for load in loads if load.number in renamed}
        for rows in _newest_loads(store, earliest_s(known, now_s), open_load, only):
            measured = measured_loads(rows_in_loads(rows, loads), sets)
            if undone_only:
                measured = tuple(
                    load
                    for load in measured
                    if of_crop.get(int(load.name)) or any(row.parameter_version in gone for row in load.seconds)
                )
            out |= remeasured(measured, known, machine, of_crop)
    return out


def _taken_back(undone: Collection[int], known: Timeline, sets: Mapping[int, ParameterSet]) -> frozenset[int]:
    """Versions after the timeline's first one that were taken back, of its crop where they say theirs."""
    crop, first = known.parameters.provenance.get("crop"), min(known.versions)
    later = {version: sets[version].provenance.get("crop") for version in undone if version > first and version in sets}
    return frozenset(version for version, of in later.items() if of is None or crop is None or of == crop)


def _begun_with(known: Timeline, sets: Mapping[int, ParameterSet], actions: Iterable[Action]) -> frozenset[int]:
    """Versions with which the timeline's crop began on this machine as it is, where the scale was another crop's: it may have
    changed before the crop was weighed."""
    crop = known.parameters.provenance.get("crop")
    changed = (
        int(a.document["version"])
        for a in actions
        if a.kind == PARAMETERS and a.document.get("origin") == ParameterOrigin.HARDWARE
    )
    first = max((version for version in changed if version <= known.parameters.version), default=0)
    begun = {
        version: of
        for version, of in sets.items()
        if version >= first and of.scale_error > 0.0 and of.provenance.get("crop") == crop
    }
    carried = any(of.carried_from for of in begun.values())
    unweighed = known.parameters.scale_error > 0.0 or bool(known.versions & begun.keys())
    return frozenset(begun if carried and unweighed else ())


def earliest_s(known: Timeline, now_s: float) -> float:
    """Bus time from which on loads are measured again: three days back; one where an update since contradicts the drift."""
    return max(now_s - SPAN_S, min(now_s - S_PER_DAY, known.holds_from_s))


def at_its_end(path: Path, load: int, version: int) -> int:
    """The version that measured the end of a load, where it followed on this one and was not taken back. Raises InputError."""
    with opened(path) as store:
        last = store.seconds_of_load(load, on_damage=_passed_over)[-1:]
        return max({version, *(row.parameter_version for row in last)} - undone_versions(store.actions()), default=version)


def _passed_over(number: int) -> None:
    """A second that is damaged is left out."""


def _newest_loads(store: Store, begin_s: float, open_load: int | None, only: int | None) -> Iterator[list[SecondRow]]:
    """Rows of each whole load that began after begin_s, the newest first: days at once would fill the memory. only: the number of
    the only load wanted."""
    last, oldest, read = store.last_second(), store.oldest_second(), 0
    newest = last.load_number if last is not None else 0
    for number in range(newest, 0, -1) if only is None else (only,):
        rows = store.seconds_of_load(number, on_damage=_passed_over)
        read += len(rows)
        if read > _MOST_ROWS or (rows and rows[0].time_s < begin_s):
            return
        yield rows_of_whole_loads(rows, begin_s, open_load, oldest)


def rows_of_whole_loads(rows: Sequence[SecondRow], begin_s: float, open_load: int | None, oldest: int) -> list[SecondRow]:
    """Rows of closed loads that began after begin_s and have lost none. oldest: number of the oldest second in the store; a load
    that holds it has lost what came before, unless the second is number 1."""
    cut = {row.load_number for row in rows if row.time_s < begin_s or row.number == oldest > 1}
    return [row for row in rows if row.load_number not in cut and row.load_number != open_load]
