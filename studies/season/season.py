"""A season in windows of one second, without 1 kHz samples: crop and machine drift, loads come and go.

Mean forces come from the same throws as the samples of :class:`yieldmon.plant.combine.VirtualCombine`, window noise from the
same scatter and electrical noise. The plate angle is the caller's: :meth:`Season.measure` gives the force that any window
shows at any angle, with noise that belongs to the window, so that strategies can be compared on the same season.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from studies.facility.facility import window_sigma_n
from studies.facility.mean_force import shown_force_n, true_angle_rad, true_speed_rad_s
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.effects import Effects, MoistureDependence, PaddleWear
from yieldmon.plant.grain import Grain
from yieldmon.plant.profiles import correlated_noise
from yieldmon.plant.pulse_table import SEASON, Condition, PulseTable
from yieldmon.plant.scenario import Scenario

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SeasonSettings:
    """What happens over the season. Drifts run smoothly from 0 at the start to the full value at the end.

    drift_exponent: drifts and wear go with this power of the season's progress: 1 is a steady rate, 2 begins slowly, 0.5 fast.
    hours: of windows, headlands included. moisture_pct: start, peak at half time, end. friction_drift, restitution_drift,
    density_drift: relative, on top of moisture. wear_mm: paddle length lost. zero_error_n: standard deviation of what zeroing
    leaves, slow over ten minutes. moisture_error_pct: constant bias of the moisture frames is drawn with this deviation.
    """

    hours: float = 60.0
    moisture_pct: tuple[float, float, float] = (14.0, 26.0, 16.0)
    moisture_dependence: MoistureDependence = field(default_factory=MoistureDependence)
    friction_drift: float = 0.15
    restitution_drift: float = -0.08
    density_drift: float = 0.0
    wear_mm: float = 3.0
    drift_exponent: float = 1.0
    flow_kg_s: tuple[float, float] = (2.0, 22.0)
    pass_s: float = 240.0
    headland_s: float = 15.0
    load_kg: tuple[float, float] = (4000.0, 9000.0)
    zero_error_n: float = 0.1
    moisture_error_pct: float = 0.5
    scale_sd_kg: float = 5.0


@dataclass(frozen=True, slots=True)
class Loads:
    """Loads in order: window range [start, end), true mass, and mass on the tank's own scale when it stands still, kg."""

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    mass_kg: Array
    scale_mass_kg: Array


@dataclass(frozen=True)
class Season:
    """Windows of one second; arrays of equal length.

    time_s: end of the window. mass_flow_kg_s, friction, restitution, density_kg_m3, moisture_pct, paddle_length_m: true.
    elevator_speed_rpm, moisture_reading_pct, test_weight_kg_m3: as frames would tell. load: number of the window's load.
    ratio: of the force to the virtual combine's, by plate angle (rad), paddle mass (kg) and friction; None: 1.
    """

    machine: Machine
    effects: Effects
    table: PulseTable
    scenario: Scenario
    time_s: Array
    mass_flow_kg_s: Array
    elevator_speed_rpm: Array
    moisture_pct: Array
    moisture_reading_pct: Array
    test_weight_kg_m3: Array
    friction: Array
    restitution: Array
    density_kg_m3: Array
    paddle_length_m: Array
    load: NDArray[np.int64]
    loads: Loads
    zero_error_n: Array
    noise: Array
    ratio: Callable[[Array, Array, Array], Array] | None = None

    def measure(self, windows: ArrayLike, plate_angle_deg: ArrayLike) -> tuple[Array, Array]:
        """Mean force (N) that the windows show with the plate at an angle, and the standard deviation of its noise.

        windows: indices or slice-made index array. plate_angle_deg: as the feedback tells it, 40-90, one for all or one each.
        Raises ValueError outside the table (38-92 deg true angle, 300-500 rpm true speed).
        """
        chosen = np.asarray(windows)
        angle = np.broadcast_to(np.deg2rad(np.asarray(plate_angle_deg, dtype=float)), chosen.shape)
        flow, speed = self.mass_flow_kg_s[chosen], self.elevator_speed_rpm[chosen] * RPM
        hours = self.time_s[chosen] / 3600.0
        ratio: Array | float = 1.0
        if self.ratio is not None:
            ratio = self.ratio(angle, flow / self.machine.passes_per_s(speed), self.friction[chosen])
        force = ratio * shown_force_n(self.table, self.effects, flow, angle, speed, self.scenario.sensor.response_s, hours)
        sigma = window_sigma_n(
            self.table,
            self.scenario,
            flow,
            true_angle_rad(self.effects, angle),
            true_speed_rad_s(self.effects, speed),
            1.0,
            hours,
        )
        return force + sigma * self.noise[chosen] + self.zero_error_n[chosen], sigma


_NODES = 13


def simulate(
    settings: SeasonSettings | None = None,
    machine: Machine | None = None,
    scenario: Scenario | None = None,
    seed: int = 0,
    table: PulseTable | None = None,
    ratio: Callable[[Array, Array, Array], Array] | None = None,
) -> Season:
    """Make a season. scenario: its crop (at the reference moisture), effects, elevator, sensor noise and scatter are used.

    table: from :func:`season_table` with the same settings, machine and scenario, where several seeds share one.
    """
    settings, machine, scenario = settings or SeasonSettings(), machine or Machine(), scenario or Scenario()
    flow_rng, speed_rng, noise_rng, zero_rng, load_rng, crop_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(6)
    )
    count = round(settings.hours * 3600.0)
    time = np.arange(1.0, count + 1.0)
    flow = _flow(settings, count, flow_rng)
    speed = _speed(scenario, flow, speed_rng)
    progress = time / time[-1]
    table = table or season_table(settings, machine, scenario)
    fine = [condition_at(settings, scenario, float(p)) for p in np.linspace(0.0, 1.0, 1001)]
    grid = np.linspace(0.0, 1.0, 1001)

    def along(values: list[float]) -> Array:
        return np.asarray(np.interp(progress, grid, values))

    moisture = along([c.grain.moisture_pct for c in fine])
    density = along([c.grain.bulk_density_kg_m3 for c in fine])
    worn = along([c.effects.paddle_wear.length_mm if c.effects.paddle_wear else 0.0 for c in fine])
    load, loads = _loads(settings, flow, load_rng)
    bias = settings.moisture_error_pct * crop_rng.standard_normal()
    return Season(
        machine=machine,
        effects=scenario.effects,
        table=table,
        scenario=scenario,
        time_s=time,
        mass_flow_kg_s=flow,
        elevator_speed_rpm=speed,
        moisture_pct=moisture,
        moisture_reading_pct=moisture + bias + scenario.crop.moisture_noise_pct * crop_rng.standard_normal(count),
        test_weight_kg_m3=density * scenario.crop.test_weight_share,
        friction=along([c.grain.friction for c in fine]),
        restitution=along([c.grain.restitution for c in fine]),
        density_kg_m3=density,
        paddle_length_m=machine.paddle_length_m - 1e-3 * worn,
        load=load,
        loads=loads,
        zero_error_n=settings.zero_error_n * correlated_noise(count, 600.0, zero_rng),
        noise=noise_rng.standard_normal(count),
        ratio=ratio,
    )


def season_table(settings: SeasonSettings, machine: Machine, scenario: Scenario) -> PulseTable:
    """Pulses along a season; the coordinate is the hour."""
    conditions = [condition_at(settings, scenario, float(p)) for p in np.linspace(0.0, 1.0, _NODES)]
    return PulseTable(machine, conditions, SEASON)


def condition_at(settings: SeasonSettings, scenario: Scenario, progress: float) -> Condition:
    """Grain and machine at a share of the season; the coordinate is the hour."""
    start, peak, end = settings.moisture_pct
    rise = 0.5 - 0.5 * np.cos(2.0 * np.pi * progress)
    moisture = (start if progress < 0.5 else end) * (1.0 - rise) + peak * rise
    grain: Grain = scenario.crop.grain.at_moisture(float(moisture), settings.moisture_dependence)
    drifted = progress**settings.drift_exponent
    grain = replace(
        grain,
        friction=grain.friction * (1.0 + settings.friction_drift * drifted),
        restitution=grain.restitution * (1.0 + settings.restitution_drift * drifted),
        bulk_density_kg_m3=grain.bulk_density_kg_m3 * (1.0 + settings.density_drift * drifted),
    )
    already = scenario.effects.paddle_wear.length_mm if scenario.effects.paddle_wear else 0.0
    wear = PaddleWear(length_mm=already + settings.wear_mm * drifted)
    return Condition(settings.hours * progress, grain, scenario.effects.model_copy(update={"paddle_wear": wear}))


def _flow(settings: SeasonSettings, count: int, rng: np.random.Generator) -> Array:
    """Passes whose level changes from pass to pass and along the way, headlands without grain, both at 1 Hz."""
    low, high = settings.flow_kg_s
    yields = correlated_noise(count, 4.0 * settings.pass_s, rng)
    along = correlated_noise(count, 30.0, rng)
    middle, spread = 0.5 * (low + high), 0.25 * (high - low)
    flow = np.clip(middle + spread * (0.9 * yields + 0.45 * along), low, high)
    working = np.zeros(count, dtype=bool)
    place = 0
    while place < count:
        length = max(int(settings.pass_s * rng.uniform(0.6, 1.4)), 10)
        working[place : place + length] = True
        place += length + max(int(settings.headland_s * rng.uniform(0.7, 1.5)), 1)
    return np.where(working, flow, 0.0)


def _speed(scenario: Scenario, flow: Array, rng: np.random.Generator) -> Array:
    settings = scenario.elevator
    droop = 1.0 - settings.droop_pct_at_25_kg_s / 100.0 * flow / 25.0
    keep = np.exp(-1.0 / settings.lag_s)
    loaded = np.asarray(lfilter([1.0 - keep], [1.0, -keep], droop, zi=[keep * droop[0]])[0])
    noise = correlated_noise(len(flow), max(settings.noise_time_s, 0.1), rng)
    return np.asarray(settings.speed_rpm * loaded * (1.0 + settings.noise_pct / 100.0 * noise))


def _loads(settings: SeasonSettings, flow: Array, rng: np.random.Generator) -> tuple[NDArray[np.int64], Loads]:
    """Cut the season into loads of drawn mass; what is left at the end joins the last load."""
    total = np.cumsum(flow)
    cuts: list[int] = []
    reached = 0.0
    while True:
        wanted = rng.uniform(*settings.load_kg)
        end = int(np.searchsorted(total, reached + wanted)) + 1
        if end >= len(flow):
            break
        cuts.append(end)
        reached = float(total[end - 1])
    if cuts and total[-1] - reached < settings.load_kg[0]:
        cuts.pop()
    ends = np.array([*cuts, len(flow)], dtype=np.int64)
    starts = np.concatenate([[0], ends[:-1]]).astype(np.int64)
    mass = np.diff(total[ends - 1], prepend=0.0)
    number = np.repeat(np.arange(len(ends), dtype=np.int64), ends - starts)
    return number, Loads(starts, ends, mass, mass + settings.scale_sd_kg * rng.standard_normal(len(mass)))
