"""Loads as measured, from what a daemon stored or from logs put through the engine.

Loads of a store keep their numbers. Loads of logs are numbered in the order of the logs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from yieldmon.bus.codec import Codec
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch, process_in_bulk
from yieldmon.service.logs.log_copies import refuse_repeated_loads
from yieldmon.service.logs.recorded import changed_at, is_store_not_log, opened, parameter_sets
from yieldmon.service.logs.recorded_before import LEAST_SHARED_S
from yieldmon.service.logs.sample_spacing import SampleSpacing
from yieldmon.service.logs.time_units import spacing_line
from yieldmon.service.logs.unmeasured import unmeasured
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.load_ends import between_loads, load_of
from yieldmon.service.storage.rows import SecondRow
from yieldmon.utc import EARLIEST_BUS_TIME_S


@dataclass(frozen=True)
class MeasuredLoad:
    """A load as it was measured.

    Parameters
    ----------
    name : str
        Its number.
    log : str
        The log that holds it; "" for a load of a store.
    seconds : tuple of SecondRow
        Those with mass.
    parameters : mapping of int to ParameterSet
        That measured them, by version.
    crop : str
        "" where none was named.
    is_open : bool
        More grain may come.
    before_change : bool
        Measured before parts of the machine were changed.
    unmeasured_s : float
        Time that was not measured although grain may have come, s.
    """

    name: str
    log: str
    seconds: tuple[SecondRow, ...]
    parameters: Mapping[int, ParameterSet]
    crop: str = ""
    is_open: bool = False
    before_change: bool = False
    unmeasured_s: float = 0.0

    @property
    def unmeasured_share(self) -> float:
        """Share of its time with grain that was not measured."""
        measured_s = float(sum(row.duration_s for row in self.seconds))
        return self.unmeasured_s / (self.unmeasured_s + measured_s)

    @property
    def mass_kg(self) -> float:
        """Mass as measured, kg."""
        return float(sum(row.mass_kg for row in self.seconds))


def read(
    sources: Sequence[str], configured: Configuration, progress: Callable[[object], None] | None = None
) -> tuple[MeasuredLoad, ...]:
    """The loads of one store or of several logs.

    Parameters
    ----------
    sources : sequence of str
        Paths.
    configured : Configuration
        By which logs are measured.
    progress : callable, optional
        Called with each stretch of a log that is done.

    Raises
    ------
    InputError
        For a source that cannot be read or holds no load, and for one that is named twice.
    """
    stores = [source for source in sources if is_store_not_log(source)]
    if stores and len(sources) > 1:
        raise InputError("--loads", f"names {stores[0]} together with other sources", "one store, or one or more logs")
    refuse_repeated_loads(sources)
    return _of_store(Path(stores[0]), configured) if stores else _of_logs(sources, configured, progress)


def _of_store(path: Path, configured: Configuration) -> tuple[MeasuredLoad, ...]:
    with opened(path) as store:
        rows, since = store.seconds(), changed_at(store)
        versions = parameter_sets(store)
        known = {str(load.number): load for load in store.loads()}
    rows, found = rows_in_loads(rows, known.values()), []
    for load in _examined(measured_loads(rows, versions), rows, configured, known):
        of_parameters = versions.get(load.seconds[-1].parameter_version)
        crop = known[load.name].crop if load.name in known else ""
        crop = crop or (of_parameters.provenance.get("crop", "") if of_parameters is not None else "")
        is_open = load.name in known and known[load.name].ended_s is None
        before = min(row.parameter_version for row in load.seconds) < since
        found.append(replace(load, crop=crop, is_open=is_open, before_change=before))
    return tuple(found)


def _of_logs(
    sources: Sequence[str], configured: Configuration, progress: Callable[[object], None] | None
) -> tuple[MeasuredLoad, ...]:
    found: list[MeasuredLoad] = []
    for source in sources:
        rows: list[SecondRow] = []
        monitor = build_monitor(
            configured.engine, configured.machine, configured.parameters, None, configured.signals.sources, drives_plate=False
        )
        spacing = SampleSpacing(configured.signals.sources.impact[0])

        def goes_on(part: Stretch | EndOfLog, spacing: SampleSpacing = spacing) -> None:
            spacing.take(part)
            if progress is not None:
                progress(part)

        process_in_bulk(
            [source],
            monitor,
            Codec(),
            rows.append,
            signals=configured.signals,
            channels=configured.log_channels,
            progress=goes_on,
        )
        if (far_off_s := spacing.far_off_s) is not None and not any(row.zero_mv is not None for row in rows):
            raise InputError(source, spacing_line(far_off_s, spacing.mapped_s), "a log of a load, with times in seconds")
        versions = {configured.parameters.version: configured.parameters}
        found += _examined(loads_in_log(rows, source, versions, len(found)), rows, configured)
    return tuple(found)


def logs_of_same_times(loads: Sequence[MeasuredLoad]) -> list[tuple[str, str]]:
    """Logs with grain in the same dated seconds, as one machine's cannot have; each with one before it."""
    seconds: dict[str, set[int]] = {}
    for load in loads:
        times = {int(row.time_s) for row in load.seconds if row.time_s >= EARLIEST_BUS_TIME_S}
        seconds.setdefault(load.log, set()).update(times)
    pairs = combinations(seconds, 2)
    return [(log, other) for other, log in pairs if len(seconds[log] & seconds[other]) >= LEAST_SHARED_S]


def loads_in_log(
    rows: Sequence[SecondRow], log: str, versions: Mapping[int, ParameterSet], before: int
) -> tuple[MeasuredLoad, ...]:
    """The loads of a log, numbered on from `before`. Raises InputError where it holds none."""
    found = _loads(rows, log, versions, before)
    if not found:
        raise InputError(log, _why_no_mass(rows), "a log of a load, from the empty machine on")
    return found


def _why_no_mass(rows: Sequence[SecondRow]) -> str:
    if not any(row.zero_mv is not None for row in rows):
        return "holds no measured mass: it has no stretch with the elevator running empty, so there is no zero"
    return "holds no measured mass"


def rows_in_loads(rows: Iterable[SecondRow], loads: Iterable[Load]) -> list[SecondRow]:
    """The seconds that belong to loads; grain between loads counts in the total alone."""
    rows = list(rows)
    between = between_loads(rows, loads)
    return [row for row in rows if load_of(row, between) is not None]


def measured_loads(rows: Iterable[SecondRow], versions: Mapping[int, ParameterSet]) -> tuple[MeasuredLoad, ...]:
    """The loads in a store's seconds, by number; versions: the parameters that measured them."""
    return _loads(rows, "", versions)


def _loads(
    rows: Iterable[SecondRow], log: str, versions: Mapping[int, ParameterSet], before: int = 0
) -> tuple[MeasuredLoad, ...]:
    by_number: dict[int, list[SecondRow]] = {}
    for row in rows:
        if row.mass_kg > 0.0 and row.load_number > 0:
            by_number.setdefault(row.load_number, []).append(row)
    if log:
        by_number = {i: by_number[number] for i, number in enumerate(sorted(by_number), 1)}
    return tuple(MeasuredLoad(str(before + number), log, tuple(part), versions) for number, part in sorted(by_number.items()))


def _examined(
    loads: Iterable[MeasuredLoad],
    rows: Iterable[SecondRow],
    configured: Configuration,
    stored: Mapping[str, Load] | None = None,
) -> list[MeasuredLoad]:
    """The loads with what of their time was not measured; rows: all of theirs, those without mass too."""
    by_number: dict[int, list[SecondRow]] = {}
    for row in rows:
        by_number.setdefault(row.load_number, []).append(row)
    out = []
    for load in loads:
        known = (stored or {}).get(load.name)
        lacks = unmeasured(
            by_number[load.seconds[0].load_number],
            configured.machine,
            configured.engine,
            started_s=known.started_s if known is not None else None,
            ended_s=known.ended_s if known is not None else None,
        )
        out.append(load if lacks.none else replace(load, unmeasured_s=lacks.seconds_s + lacks.gaps_s))
    return out
