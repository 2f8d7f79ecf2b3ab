"""Weighed loads from what a daemon stored, or from logs put through the engine, with their tickets.

Loads of a store keep their numbers. Loads of logs are numbered in the order of the logs; a log with one load may be named
instead.
Each second of a load counts with the time for which its flow, by the parameters that measured it, gives its mass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from yieldmon.bus.codec import Codec
from yieldmon.errors import InputError
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.files.ticket_file import COLUMNS, WeighedTicket, names_log, unit_slip
from yieldmon.files.ticket_parts import with_parts_added
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.repeats import repeated
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch, process_in_bulk
from yieldmon.service.logs.log_copies import refuse_copies
from yieldmon.service.logs.recorded import changed_at, is_store_not_log, opened, parameter_sets
from yieldmon.service.logs.sample_spacing import SampleSpacing
from yieldmon.service.logs.time_units import spacing_line
from yieldmon.service.logs.unmeasured import unmeasured
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.load_ends import between_loads, load_of
from yieldmon.service.storage.rows import SecondRow

LEAST_KNOWN_SHARE = 0.9
"""Of a load's mass that must rest on a known force, angle and speed."""
_KEPT_SWEEPS = 20
_TELLING_SECONDS, _LEAST_SECONDS = 300, 20


@dataclass(frozen=True)
class MeasuredLoad:
    """Seconds of one load with mass, and the parameters that measured each version's. crop: "" where none was named. is_open:
    more may come. before_change: measured before parts of the machine were changed. unmeasured_s: time not measured although
    grain may have come."""

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
        """Of its time with grain."""
        measured_s = float(sum(row.duration_s for row in self.seconds))
        return self.unmeasured_s / (self.unmeasured_s + measured_s)

    @property
    def mass_kg(self) -> float:
        """As measured."""
        return float(sum(row.mass_kg for row in self.seconds))


def read(
    sources: Sequence[str], configured: Configuration, progress: Callable[[object], None] | None = None
) -> tuple[MeasuredLoad, ...]:
    """The loads of one store or of several logs. Raises InputError."""
    stores = [source for source in sources if is_store_not_log(source)]
    if stores and len(sources) > 1:
        raise InputError("--loads", f"names {stores[0]} together with other sources", "one store, or one or more logs")
    if twice := repeated(sources):
        raise InputError("--loads", f"names {twice[0]} twice", "each log once")
    refuse_copies(sources)
    return _of_store(Path(stores[0]), configured) if stores else _of_logs(sources, configured, progress)


def _of_store(path: Path, configured: Configuration) -> tuple[MeasuredLoad, ...]:
    with opened(path) as store:
        rows, since = store.seconds(), changed_at(store)
        versions = parameter_sets(store)
        known = {str(load.number): load for load in store.loads()}
    rows, found = of_loads(rows, known.values()), []
    for load in _examined(loads_of(rows, versions), rows, configured, known):
        of_parameters = versions.get(load.seconds[-1].parameter_version)
        crop = known[load.name].crop if load.name in known else ""
        crop = crop or (of_parameters.provenance.get("crop", "") if of_parameters is not None else "")
        is_open = load.name in known and known[load.name].ended_s is None
        before = min(row.parameter_version for row in load.seconds) < since
        found.append(replace(load, crop=crop, is_open=is_open, before_change=before))
    return tuple(found)


def alike(loads: Sequence[MeasuredLoad], tickets: Sequence[WeighedTicket]) -> tuple[MeasuredLoad, ...]:
    """The loads of the crop that the tickets are for, all others left out. Raises InputError where those are of two crops."""
    first: MeasuredLoad | None = None
    for ticket in tickets:
        for load in loads_on(ticket, loads):
            if first is None or not first.crop:
                first = load
            elif load.crop and load.crop != first.crop:
                raise InputError(
                    ticket.where,
                    f"load {load.name} is of {load.crop}, load {first.name} of {first.crop}",
                    "the tickets of one crop in a file",
                )
    return tuple(load for load in loads if first is None or load.crop == first.crop)


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


def of_loads(rows: Iterable[SecondRow], loads: Iterable[Load]) -> list[SecondRow]:
    """The seconds that belong to loads; grain between loads counts in the total alone."""
    rows = list(rows)
    between = between_loads(rows, loads)
    return [row for row in rows if load_of(row, between) is not None]


def loads_of(rows: Iterable[SecondRow], versions: Mapping[int, ParameterSet]) -> tuple[MeasuredLoad, ...]:
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


def match(loads: Sequence[MeasuredLoad], tickets: Sequence[WeighedTicket], machine: Machine) -> tuple[WeighedLoad, ...]:
    """Each ticket with the seconds of its loads. Raises InputError for a ticket without a load, or with one that has another."""
    out = []
    for ticket, covered in each_on_one(loads, tickets):
        for load in covered:
            if load.is_open:
                problem = f"load {load.name} is still open, so more grain may come"
                raise InputError(
                    ticket.where,
                    problem,
                    "`yieldmon load stop` first, with the daemon running, or the tickets of the other loads",
                )
            if load.before_change:
                problem = f"load {load.name} was measured before the machine was changed (`yieldmon calibrations restart`)"
                raise InputError(ticket.where, problem, "tickets of loads after it")
        out.append(_weighed(ticket.name, ticket, covered, machine))
    return tuple(out)


def each_on_one(
    loads: Sequence[MeasuredLoad], tickets: Sequence[WeighedTicket]
) -> list[tuple[WeighedTicket, tuple[MeasuredLoad, ...]]]:
    """Each ticket with its loads, parts of a load added. Raises InputError as `loads_on` and `with_parts_added`."""
    by_name = {load.name: load for load in loads}
    named = [(ticket, [load.name for load in loads_on(ticket, loads)]) for ticket in tickets]
    return [(ticket, tuple(by_name[name] for name in names)) for ticket, names in with_parts_added(named)]


def loads_on(ticket: WeighedTicket, loads: Sequence[MeasuredLoad]) -> list[MeasuredLoad]:
    """The loads that a ticket is for. Raises InputError where there is none such."""
    names = [load.name for load in loads]
    if ticket.first in names and ticket.last in names:
        first, last = names.index(ticket.first), names.index(ticket.last)
        if last < first:
            raise InputError(ticket.where, f"is {ticket.first}-{ticket.last}", "the first load first")
        return list(loads[first : last + 1])
    wanted = Path(ticket.first).name
    of_log = [load for load in loads if load.log and names_log(ticket.first, load.log)]
    if len(of_log) == 1:
        return of_log
    if len(of_log) > 1:
        held = ", ".join(load.name for load in of_log)
        raise InputError(ticket.where, f"{wanted} holds {len(of_log)} loads", f"one of the numbers {held}")
    known = f"{names[0]} to {names[-1]}" if names else "none was measured"
    raise InputError(ticket.where, f"is {ticket.first}, no load that was measured", known)


def _weighed(name: str, ticket: WeighedTicket, covered: Sequence[MeasuredLoad], machine: Machine) -> WeighedLoad:
    for load in covered:
        if load.unmeasured_share > 1.0 - LEAST_KNOWN_SHARE:
            share = f"{100.0 * load.unmeasured_share:.0f} % of its time"
            raise InputError(
                ticket.where,
                f"{load.unmeasured_s:.0f} s of load {load.name}, {share}, were not measured",
                f"at most {100.0 * (1.0 - LEAST_KNOWN_SHARE):.0f} %; a load measured whole",
            )
    parts, total_kg = [], sum(load.mass_kg for load in covered)
    if slip := unit_slip(ticket.mass_kg, total_kg):
        expected = (
            f"the masses in the unit of their column: {COLUMNS}; or, where all loads are off by one factor, the force cell's own "
            "sensor.gain_n_per_mv in the machine file"
        )
        raise InputError(ticket.where, f"load {name} {slip}", expected)
    for load in covered:
        for version in sorted({row.parameter_version for row in load.seconds}):
            rows = [row for row in load.seconds if row.parameter_version == version]
            if version not in load.parameters:
                raise InputError(
                    ticket.where,
                    f"load {load.name} was measured with parameters version {version}",
                    "a store that still holds them",
                )
            parts.append(force_columns(rows, load.parameters[version], machine))
    columns = np.concatenate(parts, axis=1)
    counted = columns[:, np.isfinite(columns[0]) & (columns[0] > 0.0)]
    kept_kg = float(counted[5].sum())
    if kept_kg < LEAST_KNOWN_SHARE * total_kg:
        raise InputError(
            ticket.where,
            f"of load {name} only {100.0 * kept_kg / total_kg:.0f} % rests on a known force, angle and speed",
            f"{100.0 * LEAST_KNOWN_SHARE:.0f} %; a load measured whole",
        )
    duration, force, angle, speed, moisture, _ = counted
    # The little that no force stands for is taken to go with the rest.
    return WeighedLoad(
        name=name,
        weighed_kg=ticket.mass_kg,
        std_dev_kg=ticket.std_dev_kg,
        duration_s=duration * total_kg / kept_kg,
        force_n=force,
        plate_angle_rad=angle,
        elevator_speed_rad_s=speed,
        moisture_pct=moisture if np.all(np.isfinite(moisture)) else None,
        noise_sd=_noise_sd(covered, total_kg),
        common_kg=ticket.other_std_dev_kg,
    )


def _noise_sd(covered: Sequence[MeasuredLoad], total_kg: float) -> float:
    """Relative, of the loads' mass, by the windows' scatter; windows without one, as older stores hold them, count as exact."""
    rows = [row for load in covered for row in load.seconds if row.noise_std_dev_kg_s is not None]
    return float(np.sqrt(sum((row.noise_std_dev_kg_s * row.duration_s) ** 2 for row in rows))) / total_kg


def force_columns(rows: Sequence[SecondRow], parameters: ParameterSet, machine: Machine) -> np.ndarray:
    """(6, n): time that each second stands for (nan where unknown), force N, angle rad, speed rad/s, moisture %, mass kg."""

    def column(attribute: str) -> np.ndarray:
        return np.array([np.nan if (v := getattr(row, attribute)) is None else v for row in rows], dtype=float)

    force, angle, speed = column("force_n"), np.radians(column("plate_angle_deg")), column("elevator_speed_rpm") * RPM
    moisture, mass = column("moisture_pct"), column("mass_kg")
    model = ForwardModel(machine, parameters.effects)
    usable = np.isfinite(force) & np.isfinite(angle) & np.isfinite(speed) & (force > 0.0)
    if model.needs_moisture:
        usable &= np.isfinite(moisture)
    flow = np.full(force.shape, np.nan)
    if np.any(usable):
        flow[usable] = estimator_of(machine, parameters, model).invert(
            force[usable], angle[usable], speed[usable], moisture[usable]
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        duration = np.where(flow > 0.0, mass / flow, np.nan)
    return np.stack((duration, force, angle, speed, moisture, mass))


def times_what_a_machine_makes(loads: Sequence[MeasuredLoad], machine: Machine) -> float | None:
    """Masses of a store's newest seconds over what a machine makes of their forces by the parameters that measured them: 1 with
    the machine that did. None for logs, and where too few seconds tell."""
    found: list[np.ndarray] = []
    for load in [load for load in reversed(loads) if not load.log]:
        of_version: dict[int, list[SecondRow]] = {}
        for row in load.seconds[-_TELLING_SECONDS:]:
            of_version.setdefault(row.parameter_version, []).append(row)
        for version, rows in of_version.items():
            if version in load.parameters:
                found.append(force_columns(rows, load.parameters[version], machine)[0] / [row.duration_s for row in rows])
        if sum(map(len, found)) >= _TELLING_SECONDS:
            break
    times = np.concatenate([np.zeros(0), *found])
    times = times[np.isfinite(times)]
    return float(np.median(times)) if len(times) >= _LEAST_SECONDS else None


def weighed_until_s(measured: Sequence[MeasuredLoad], weighed: Sequence[WeighedLoad]) -> float | None:
    """Time of the last second, s, of the loads of a store that tickets are for; None for loads of logs."""
    last = {load.name.rpartition("-")[2] for load in weighed}
    return max((load.seconds[-1].time_s for load in measured if not load.log and load.name in last), default=None)


def sweeps_of(loads: Iterable[MeasuredLoad]) -> tuple[Sweep, ...]:
    """The newest whole sweeps in the loads."""
    seconds = ((load.log, row) for load in loads if not load.before_change for row in load.seconds)
    usable = ((log, row) for log, row in seconds if row.usable_for_calibration and row.sweep_id and _complete(row))
    # Ids begin anew in a store whose state was lost: a run of one id is one sweep.
    found = [[row for _, row in run] for _, run in groupby(usable, key=lambda one: (one[0], one[1].sweep_id))]
    out = []
    for rows in found[-_KEPT_SWEEPS:]:
        table = np.array(
            [(r.time_s, np.radians(r.plate_angle_deg), r.elevator_speed_rpm * RPM, r.force_n, r.force_std_dev_n) for r in rows]
        )
        if np.unique(np.round(np.degrees(table[:, 1]))).size >= 3:
            out.append(Sweep(*table.T.copy()))
    return tuple(out)


def _complete(row: SecondRow) -> bool:
    values = (row.plate_angle_deg, row.elevator_speed_rpm, row.force_n, row.force_std_dev_n)
    return all(v is not None for v in values) and float(row.force_std_dev_n or 0.0) > 0.0
