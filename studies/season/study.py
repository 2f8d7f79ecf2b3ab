"""What self-calibration is worth over a season: the same season under several ways of keeping the calibration.

Every strategy sees the same windows of the virtual combine's season (plant.season, which shares no code with the estimator's
model) and only what its sensors would tell it; a load is judged by the parameters that held while it was harvested.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from studies.facility import facility
from studies.season.combines import AS_MODELLED, Combine
from studies.season.season import Season, SeasonSettings
from yieldmon.engine.self_calibration.parameter_knowledge import FOLLOWED_KG
from yieldmon.engine.settings import DisagreementSettings, SweepSettings
from yieldmon.estimation.admission import LARGEST_MODEL_ERROR, allowing_for, refusal
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.fitting.calibration import calibrate
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.fitting.stop_gap import with_stop_gap
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_pattern import with_pattern
from yieldmon.estimation.self_calibration.closed_loop import fit_parameters as learn_from_sweeps
from yieldmon.estimation.self_calibration.closed_loop import update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep, WeighedMass
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome as Update
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.estimation.self_calibration.drift_updates import DriftUpdate, by_weighed_masses, ending
from yieldmon.estimation.self_calibration.misfit import ReducedSweep, reduce_sweep
from yieldmon.estimation.self_calibration.steady_drift import Advance, advance, begin, smoothed, updated
from yieldmon.estimation.self_calibration.sweep_model_error import model_error
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant.effects import MoistureDependence
from yieldmon.plant.scenario import Scenario, ScenarioCrop
from yieldmon.service.config.configuration import calibrator_settings
from yieldmon.service.config.document import Document
from yieldmon.service.history import remeasuring
from yieldmon.units import S_PER_DAY

Array = NDArray[np.float64]
_POSTED_DAYS = remeasuring.SPAN_S / S_PER_DAY
"""Days of harvest that a ticket's posting reaches back over, as the daemon's."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """How the calibration is kept. tickets_per_day: weighed loads told at the end of the day; scale: every load weighed."""

    name: str
    moisture_map: bool = False
    sweeps: bool = False
    tickets_per_day: int = 0
    tank_scale: bool = False


STRATEGIES = (
    Strategy("(a) one calibration"),
    Strategy("(a+) and a moisture map", moisture_map=True),
    Strategy("(b) and sweeps", moisture_map=True, sweeps=True),
    Strategy("(c) and one ticket a day", moisture_map=True, sweeps=True, tickets_per_day=1),
    Strategy("(d) and tank scale", moisture_map=True, sweeps=True, tank_scale=True),
)


@dataclass(frozen=True, slots=True)
class StudySettings:
    """Standard deviations of what is not known beforehand, and the sweep's schedule.

    wandering: the parameters' random walks. steady_per_kilotonne: of their steady rates, which begin at 0 and are learnt; empty:
    no rates. steady_drift_memory_kt: harvested mass over which a rate falls to 1/e; inf: none. map_sd: of the moisture map's
    slopes, 1/%. learned_information, kept_ratio: as in ClosedLoopSettings; scraps may add up here. pattern_sd: of the model's
    error away from home that sweeps separate from the grain; 0: none. reference_error: of a weighed load, relative, beside the
    scale's. refuse_corners: as the daemon, no sweep where a parameter lies at an end of its physical range, and no update that
    would put it there.
    """

    sweep_interval_s: float = 600.0
    sweep_angles_deg: tuple[float, ...] = SweepSettings().angles_deg
    windows_per_angle: int = SweepSettings().windows_per_step
    home_every: int = SweepSettings().home_every
    plate_rate_deg_s: float = 20.0
    settle_s: float = SweepSettings().settle_s
    steady_windows: int = 8
    steady_cv: float = 0.08
    min_flow_kg_s: float = 4.0
    wandering: DriftRates = field(
        default_factory=lambda: DriftRates({}, {"friction": 0.025, "restitution": 0.0025, "density": 0.005}, {})
    )
    steady_per_kilotonne: Mapping[str, float] = field(
        default_factory=lambda: {"friction": 0.2, "restitution": 0.025, "density": 0.05}
    )
    steady_drift_memory_kt: float = float("inf")
    learned_information: float = 1e-6
    kept_ratio: float = 1.0 - 1e-6
    day_s: float = 10.0 * 3600.0
    map_mean: Mapping[str, float] = field(
        default_factory=lambda: {"friction_per_pct": 0.02, "restitution_per_pct": -0.01, "density_per_pct": -0.005}
    )
    pattern_sd: float = 0.0
    map_sd: Mapping[str, float] = field(
        default_factory=lambda: {"friction_per_pct": 0.01, "restitution_per_pct": 0.005, "density_per_pct": 0.0025}
    )
    ticket_sd_kg: float = 10.0
    scale_sd_kg: float = 10.0
    model_error: float = 0.004
    flow_process_sd: float = 0.12
    flow_process_time_s: float = 30.0
    reference_error: float = 0.002
    refuse_corners: bool = False

    @classmethod
    def of_daemon(cls) -> StudySettings:
        """What the daemon does where its configuration says nothing; the moisture map and the plate's drive are the study's."""
        calibration, sweep = calibrator_settings(Document()), SweepSettings()
        loop: ClosedLoopSettings = calibration.closed_loop
        return cls(
            sweep_interval_s=sweep.interval_s,
            steady_windows=sweep.steady_windows,
            steady_cv=sweep.steady_cv,
            min_flow_kg_s=sweep.min_flow_kg_s,
            wandering=calibration.drift,
            steady_per_kilotonne=calibration.steady_per_kilotonne,
            steady_drift_memory_kt=calibration.steady_drift_memory_kt,
            learned_information=loop.learned_information,
            kept_ratio=loop.kept_ratio,
            model_error=loop.model_error,
            flow_process_sd=loop.flow_process_sd,
            flow_process_time_s=loop.flow_process_time_s,
            pattern_sd=calibration.pattern_sd,
            reference_error=calibration.reference_error,
            refuse_corners=True,
        )


@dataclass(frozen=True)
class Outcome:
    """One strategy over the season. load_error_pct: signed, by load, with the parameters that held then. posted_error_pct: the
    same after each day's ticket was used to correct the day's loads (`steady_drift.smoothed`); equal where there are none.
    sweeps, updates: done, and that moved a parameter. history: columns time_h and, for each parameter, value and standard
    deviation.
    """

    strategy: Strategy
    load_error_pct: Array
    posted_error_pct: Array
    window_mean_abs_pct: float
    window_p95_abs_pct: float
    sweeps: int
    updates: int
    history: Mapping[str, Array]

    @property
    def mean_abs_load_error_pct(self) -> float:
        """Mean of the loads' absolute errors."""
        return float(np.mean(np.abs(self.load_error_pct)))

    @property
    def loads_within_1_pct(self) -> float:
        """Share of the loads within 1 %, 0 to 1."""
        return float(np.mean(np.abs(self.load_error_pct) <= 1.0))

    @property
    def within_1_pct_by_third(self) -> tuple[float, ...]:
        """The same of the first, second and last third of the season's loads."""
        return tuple(float(np.mean(np.abs(part) <= 1.0)) for part in np.array_split(self.load_error_pct, 3))

    @property
    def posted_within_1_pct(self) -> float:
        """Share of the loads within 1 % after each day was posted, 0 to 1."""
        return float(np.mean(np.abs(self.posted_error_pct) <= 1.0))


def scenario_of(settings: SeasonSettings) -> Scenario:
    """The scenario whose crop begins the season: moisture of the first day, and its dependence on moisture switched on."""
    base = Scenario()
    effects = base.effects.model_copy(update={"moisture_dependence": MoistureDependence()})
    crop: ScenarioCrop = base.crop.model_copy(update={"moisture_pct": settings.moisture_pct[0]})
    return base.model_copy(update={"effects": effects, "crop": crop})


def first_calibration(settings: SeasonSettings, machine: Machine, seed: int, combine: Combine = AS_MODELLED) -> ParameterSet:
    """The season's one manual calibration: ten flows, five angles, two speeds on the virtual facility, before the first load."""
    scenario = combine.scenario(scenario_of(settings))
    rows = facility.measure(
        scenario, machine, (2, 4, 6, 8, 10, 12, 15, 18, 20, 22), (50, 60, 70, 80, 90), (380, 400),
        averaging_s=20.0, seed=seed,
    )  # fmt: skip
    speed = rows["elevator_speed_rpm"] * RPM
    passes = machine.passes_per_s(speed)
    if combine.ratio is not None:
        grain = scenario.crop.grain.at_moisture(settings.moisture_pct[0], settings.moisture_dependence)
        friction = np.full(speed.shape, grain.friction)
        rows["force_n"] *= combine.ratio(np.radians(rows["plate_angle_deg"]), rows["mass_flow_kg_s"] / passes, friction)
    conditions = Conditions(np.radians(rows["plate_angle_deg"]), speed, mass_flow_kg_s=rows["mass_flow_kg_s"])
    model = ForwardModel(machine, ("gravity",))
    start = {"friction": 0.3, "density": 1000.0, "shape_ratio": 2.0, "restitution": 0.5, "gravity.acceleration_m_s2": 9.81}
    data = Measurements(conditions, rows["force_n"] / passes, rows["sigma"] / passes)
    free = ("friction", "restitution", "density")
    found = calibrate(model, data, start, free, intervals=False).parameter_set
    # Above this calibrate advises --stop-gap.
    return with_stop_gap(model, data, found, free) if found.own_error > LARGEST_MODEL_ERROR else found


def run(
    season: Season,
    first: ParameterSet,
    strategy: Strategy,
    settings: StudySettings,
    progress: Callable[[float], None] | None = None,
) -> Outcome:
    """Harvest the season under one strategy. first: as `first_calibration` gives it."""
    return harvested(Keeper(season, first, strategy, settings), progress)


def harvested(keeper: Keeper, progress: Callable[[float], None] | None = None) -> Outcome:
    """All loads of the keeper's season."""
    season = keeper.season
    for number in range(len(season.loads.start)):
        keeper.harvest(number)
        if progress is not None:
            progress((number + 1) / len(season.loads.start))
    return keeper.outcome()


class Keeper:
    """The monitor's side of a season: measures windows, keeps the parameters."""

    def __init__(self, season: Season, first: ParameterSet, strategy: Strategy, settings: StudySettings) -> None:
        self.season, self.strategy, self.settings = season, strategy, settings
        self.machine = season.machine
        self.home_deg = float(np.degrees(self.machine.home_plate_angle_rad))
        self.parameters = with_map(first, settings, float(season.moisture_reading_pct[0])) if strategy.moisture_map else first
        if settings.pattern_sd and strategy.sweeps:
            self.parameters = with_pattern(self.parameters, settings.pattern_sd)
        self.model = ForwardModel(self.machine, self.parameters.effects)
        self.drifting = begin(self.parameters, settings.steady_per_kilotonne)
        self.drift_updates: list[DriftUpdate] = []
        loop = ClosedLoopSettings(
            flow="process", flow_process_sd=settings.flow_process_sd, flow_process_time_s=settings.flow_process_time_s,
            model_error=settings.model_error,
            learned_information=settings.learned_information, kept_ratio=settings.kept_ratio,
        )  # fmt: skip
        self.loop = loop
        self.flow = np.full(season.time_s.size, np.nan)
        self.angle_deg = np.full(season.time_s.size, self.home_deg)
        self.seen: list[ReducedSweep] = []
        """The newest sweeps, by which the force away from home may be off, where the settings are the daemon's."""
        self.away = np.zeros(season.time_s.size)
        """ln of the model's force over the measured one against that at home, as sweeps before had measured it."""
        self.force, self.force_sd = season.measure(np.arange(season.time_s.size), self.home_deg)
        self.next_sweep_s = settings.sweep_interval_s
        self.grown_to = (0.0, 0)
        self.step_h: list[float] = []
        self.sweeps = self.updates = 0
        self.told_day = 0
        self.posted_kg = np.full(season.loads.mass_kg.size, np.nan)
        self.posted_with: dict[int, ParameterSet] = {}
        """By load, as the newest posting that reached it has them."""
        self.ticketed = 0
        self.load_of_day: list[int] = []
        self.rows: list[tuple[float, ...]] = []
        self.kept = ("friction", "restitution", "density")
        self._remember(0.0)

    def harvest(self, number: int) -> None:
        """One load: windows with the parameters as they stand, sweeps when due, then the update by the load's weight."""
        start, end = int(self.season.loads.start[number]), int(self.season.loads.end[number])
        place = start
        while place < end:
            stop = end
            if self.strategy.sweeps:
                stop = min(end, max(place, int(self.next_sweep_s)))
            if stop > place:
                self._measure(place, stop)
                place = stop
            if place < end and self.strategy.sweeps and place >= int(self.next_sweep_s):
                place = self._try_sweep(place, end)
        self._follow(end)
        hour = float(self.season.time_s[end - 1]) / 3600.0
        self.load_of_day.append(number)
        if self.strategy.tank_scale:
            self._weigh(number, float(self.season.loads.scale_mass_kg[number]), self.settings.scale_sd_kg, hour)
        day = int(self.season.time_s[end - 1] // self.settings.day_s)
        if day > self.told_day:
            if self.strategy.tickets_per_day:
                for ticket in self.load_of_day[-self.strategy.tickets_per_day :]:
                    self._weigh(ticket, float(self.season.loads.mass_kg[ticket]), self.settings.ticket_sd_kg, hour)
                self._post(number + 1)
            self.told_day, self.load_of_day = day, []

    def outcome(self) -> Outcome:
        season = self.season
        measured = np.add.reduceat(np.nan_to_num(self.flow), season.loads.start)
        for number, parameters in self.posted_with.items():
            windows = slice(int(season.loads.start[number]), int(season.loads.end[number]))
            self.posted_kg[number] = float(np.sum(self._flow(windows, parameters)))
        posted = np.where(np.isfinite(self.posted_kg), self.posted_kg, measured)
        rated = season.mass_flow_kg_s >= 4.0
        relative = 100.0 * np.abs(self.flow[rated] / season.mass_flow_kg_s[rated] - 1.0)
        columns = np.array(self.rows).T
        names = ["time_h", *(f"{n}{suffix}" for n in self.kept for suffix in ("", "_sd"))]
        return Outcome(
            self.strategy,
            100.0 * (measured / season.loads.mass_kg - 1.0),
            100.0 * (posted / season.loads.mass_kg - 1.0),
            float(np.nanmean(relative)),
            float(np.nanpercentile(relative, 95.0)),
            self.sweeps,
            self.updates,
            dict(zip(names, columns, strict=True)),
        )

    def _post(self, end: int) -> None:
        """The last days' loads are to be measured again, with the parameters as the weighed masses together have them."""
        updates = by_weighed_masses(self.drift_updates)
        known = smoothed([update.advance for update in updates], ending(self.drifting, updates[-1]))
        hours = np.array([*self.step_h, float(self.season.time_s[self.season.loads.end[end - 1] - 1]) / 3600.0])
        names = self.parameters.covariance_names
        rows = np.array([[values[name] for name in names] for values in known])
        begin_s = 3600.0 * hours[-1] - _POSTED_DAYS * self.settings.day_s
        for number in range(int(np.searchsorted(self.season.loads.start, begin_s)), end):
            windows = slice(int(self.season.loads.start[number]), int(self.season.loads.end[number]))
            hour = float(np.mean(self.season.time_s[windows])) / 3600.0
            here = {n: float(np.interp(hour, hours, rows[:, i])) for i, n in enumerate(names)}
            self.posted_with[number] = replace(self.parameters, values={**self.parameters.values, **here})
        self.ticketed = end

    def _moisture(self, windows: Array | slice) -> Array | None:
        return self.season.moisture_reading_pct[windows] if self.strategy.moisture_map else None

    def _measure(self, start: int, stop: int) -> None:
        """Flow of the windows [start, stop); a window without grain has none."""
        self.flow[start:stop] = self._flow(slice(start, stop), self.parameters)

    def _flow(self, windows: slice, parameters: ParameterSet) -> Array:
        force = self.force[windows] * np.exp(self.away[windows])
        speed = self.season.elevator_speed_rpm[windows] * RPM
        moisture = self._moisture(windows)
        loop = OpenLoop(self.model, parameters)
        flow = np.empty(force.size)
        for angle in np.unique(self.angle_deg[windows]):
            here = self.angle_deg[windows] == angle
            level = None if moisture is None else float(np.mean(moisture))
            flow[here] = inverted(loop, force[here], float(np.radians(angle)), speed[here], level)
        return np.where(force > 1.0, flow, 0.0)

    def _try_sweep(self, place: int, end: int) -> int:
        """A sweep from window `place` if the flow has been steady; returns the first window after it."""
        settings = self.settings
        if settings.refuse_corners and refusal(self.parameters):
            self.next_sweep_s = place + settings.sweep_interval_s
            return place
        before = self.flow[place - settings.steady_windows : place]
        steady = before.size == settings.steady_windows and np.min(before) >= settings.min_flow_kg_s
        if not steady or np.std(before) > settings.steady_cv * np.mean(before):
            self.next_sweep_s = place + 5.0
            return place
        plan = [self.home_deg]
        for i, angle in enumerate(settings.sweep_angles_deg):
            plan.append(angle)
            if (i + 1) % settings.home_every == 0:
                plan.append(self.home_deg)
        travel_s = np.abs(np.diff([self.home_deg, *plan])) / settings.plate_rate_deg_s + settings.settle_s
        lost = np.ceil(travel_s).astype(int)
        strides = lost + settings.windows_per_angle
        length = int(strides.sum())
        if place + length >= end or np.min(self.season.mass_flow_kg_s[place : place + length]) <= 0.0:
            self.next_sweep_s = place + 30.0
            return place
        windows = np.arange(place, place + length)
        self.angle_deg[windows] = np.repeat(plan, strides)
        self.force[windows], self.force_sd[windows] = self.season.measure(windows, self.angle_deg[windows])
        self.away[windows] = self._away(self.angle_deg[windows])
        self._measure(place, place + length)
        used = windows[np.concatenate([np.arange(n) >= k for n, k in zip(strides, lost, strict=True)])]
        self._swept(used, place, length)
        self.sweeps += 1
        self.next_sweep_s = place + length + settings.sweep_interval_s
        return place + length

    def _swept(self, used: Array, place: int, length: int) -> None:
        """What a sweep of `length` windows from `place` on says; used: the windows in which the plate stood still."""
        hour = float(self.season.time_s[place + length - 1]) / 3600.0
        came = self._grow(place + length)
        moisture = self._moisture(slice(place, place + length))
        sweep = Sweep(
            self.season.time_s[used],
            np.radians(self.angle_deg[used]),
            self.season.elevator_speed_rpm[used] * RPM,
            self.force[used],
            np.hypot(self.force_sd[used], 0.1),
            None if moisture is None else np.full(used.size, float(np.mean(moisture))),
        )
        if not self.settings.refuse_corners:
            self._take(learn_from_sweeps(self.model, self.parameters, [sweep], settings=self.loop), came, hour, sweep_alone=True)
            return
        self._see(used, moisture)
        allowed = allowing_for(self.loop, self.parameters)
        update = learn_from_sweeps(self.model, self.parameters, [sweep], settings=allowed)
        self._take(update, came, hour, sweep_alone=True, admitted=not refusal(update.parameter_set))

    def _see(self, used: Array, moisture: Array | None) -> None:
        """Keep a sweep's pattern, as the daemon does."""
        levels = np.full(used.size, np.nan if moisture is None else float(np.mean(moisture)))
        reduced = reduce_sweep(
            self.model, self.parameters, time_s=self.season.time_s[used], plate_angle_rad=np.radians(self.angle_deg[used]),
            elevator_speed_rad_s=self.season.elevator_speed_rpm[used] * RPM, force_n=self.force[used],
            force_std_dev_n=np.hypot(self.force_sd[used], 0.1), moisture_pct=levels,
        )  # fmt: skip
        if reduced is not None:
            self.seen = [*self.seen, reduced][-DisagreementSettings().keep_sweeps :]

    def _away(self, angle_deg: Array) -> Array:
        """What sweeps have shown the force to be off by at angles away from home."""
        if not self.seen:
            return np.zeros(angle_deg.shape)
        error = model_error(self.model, self.parameters, self.seen, tolerance=DisagreementSettings().tolerance)
        return np.array([error.away_at(float(np.radians(angle))) for angle in angle_deg])

    def _weigh(self, number: int, mass_kg: float, sd_kg: float, hour: float) -> None:
        start, end = int(self.season.loads.start[number]), int(self.season.loads.end[number])
        used = np.flatnonzero(self.flow[start:end] > 0.0) + start
        mass = WeighedMass.from_windows(
            mass_kg,
            float(np.hypot(sd_kg, self.settings.reference_error * mass_kg)),
            np.ones(used.size),
            self.force[used] * np.exp(self.away[used]),
            np.radians(self.angle_deg[used]),
            self.season.elevator_speed_rpm[used] * RPM,
        )
        if self.strategy.moisture_map:
            moisture = float(np.mean(self.season.moisture_reading_pct[used]))
            mass = replace(mass, moisture_pct=np.full(mass.force_n.shape, moisture))
        came = self._grow(end)
        self._take(update_from_tickets(self.model, self.parameters, [mass], settings=self.loop), came, hour)

    def _take(self, update: Update, came: Advance, hour: float, *, sweep_alone: bool = False, admitted: bool = True) -> None:
        """came: the time before the update."""
        taken = update.updated and admitted
        widening = update.prior_widening if taken else 1.0
        if taken:
            self.drifting = updated(self.drifting, update.parameter_set, widening=widening)
            self.parameters = self.drifting.parameters
            self.updates += 1
        now = self.drifting
        self.drift_updates.append(DriftUpdate(came, now.state, now.joint, widening, sweep_alone, len(now.names)))
        self._remember(hour)

    def _follow(self, stop: int) -> None:
        """A drift that has been learnt moves the parameters between updates, as in the daemon."""
        harvested_kg = float(np.nansum(self.flow[self.grown_to[1] : stop]))
        if harvested_kg >= FOLLOWED_KG and np.any(self.drifting.rates):
            came = self._grow(stop)
            self.drift_updates.append(DriftUpdate(came, self.drifting.state, self.drifting.joint))
            self._remember(float(self.season.time_s[stop - 1]) / 3600.0)

    def _grow(self, stop: int) -> Advance:
        """What is known at the end of window `stop` - 1, and how it came."""
        hour_before, window_before = self.grown_to
        hour = float(self.season.time_s[stop - 1]) / 3600.0
        harvested_kg = float(np.nansum(self.flow[window_before:stop]))
        self.step_h.append(hour_before)
        self.drifting, came = advance(
            self.drifting, self.settings.wandering, hour - hour_before, harvested_kg,
            per_kilotonne=self.settings.steady_per_kilotonne, memory_kt=self.settings.steady_drift_memory_kt,
        )  # fmt: skip
        self.parameters = self.drifting.parameters
        self.grown_to = (hour, stop)
        return came

    def _remember(self, hour: float) -> None:
        row = [hour]
        for name in self.kept:
            row += [self.parameters.values[name], self.parameters.standard_deviation(name)]
        self.rows.append(tuple(row))


def inverted(loop: OpenLoop, force_n: Array, angle_rad: float, speed_rad_s: Array, moisture_pct: float | None) -> Array:
    """Open loop of many windows at one angle, by interpolation between exact inversions (good to 1e-4 of the flow)."""
    if force_n.size <= 100:
        moisture = None if moisture_pct is None else np.full(force_n.shape, moisture_pct)
        return loop.invert(np.maximum(force_n, 0.0), np.full(force_n.shape, angle_rad), speed_rad_s, moisture)
    top = float(np.max(force_n)) * 1.001 + 1.0
    forces = top * np.linspace(0.0, 1.0, 33) ** 1.5
    speeds = np.linspace(float(np.min(speed_rad_s)), float(np.max(speed_rad_s)) * (1.0 + 1e-9), 3)
    grid = np.broadcast_to(forces[:, None], (33, 3))
    moistures = None if moisture_pct is None else np.full(grid.shape, moisture_pct)
    flows = loop.invert(grid, np.full(grid.shape, angle_rad), np.broadcast_to(speeds, grid.shape), moistures)
    spline = RectBivariateSpline(forces, speeds, flows, kx=3, ky=2, s=0)
    return np.asarray(spline.ev(np.maximum(force_n, 0.0), speed_rad_s))


def with_map(first: ParameterSet, settings: StudySettings, moisture_pct: float) -> ParameterSet:
    """The set with a moisture map's slopes and their variances; the grain's own values moved to the map's reference moisture."""
    from yieldmon.physics.effects.moisture_dependence import REFERENCE_PCT

    values = dict(first.values)
    for name in ("friction", "restitution", "density"):
        values[name] *= float(np.exp(-settings.map_mean[f"{name}_per_pct"] * (moisture_pct - REFERENCE_PCT)))
    values |= {f"moisture_dependence.{name}": mean for name, mean in settings.map_mean.items()}
    slopes = tuple(f"moisture_dependence.{name}" for name in settings.map_sd)
    count = len(first.covariance_names)
    covariance = np.zeros((count + len(slopes),) * 2)
    covariance[:count, :count] = first.covariance
    for i, sd in enumerate(settings.map_sd.values()):
        covariance[count + i, count + i] = sd**2
    return replace(first, values=values, covariance_names=(*first.covariance_names, *slopes), covariance=covariance)
