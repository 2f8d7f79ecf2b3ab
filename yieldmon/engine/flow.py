"""From the force in a window to its mass flow: estimate, error budget, quality, and the flow to publish."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, isfinite, radians
from typing import NamedTuple

import numpy as np

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.flow_budget import flow_budget, without_noise
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.flow_filter import FlowFilter
from yieldmon.engine.mass.budget import NO_BUDGET, FlowBudget, zero_std_dev_mv
from yieldmon.engine.mass.moisture_reference import MoistureReference
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.hidden_force import hidden_share
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.beyond_range import angle_error_beyond
from yieldmon.estimation.open_loop import FlowStatus
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.frames import EstimateQuality
from yieldmon.physics.machine import Machine

_NAN = float("nan")
_STATUSES = tuple(FlowStatus)
"""By code."""
_FEEDBACK_DELAY_S = 0.07
"""Standard deviation of the time between the plate's angle and the grain that strikes it: feedback comes every 50 ms, the cell
answers after 16 ms, and grain flies for some 50 ms."""


@dataclass(frozen=True, slots=True)
class Flow:
    """Flow of a window, nan where there is none. budget: std_dev_kg_s by cause."""

    rate_kg_s: float
    std_dev_kg_s: float
    quality: EstimateQuality
    force_n: float
    force_std_dev_n: float
    out_of_calibration: bool = False
    saturated: bool = False
    budget: FlowBudget = NO_BUDGET

    @property
    def measured(self) -> bool:
        """Whether the flow is known."""
        return isfinite(self.rate_kg_s)


_flow = maker_of(Flow)


class Estimate(NamedTuple):
    """One row of a FlowEstimate; noise_kg_s is None where the estimator does not state it."""

    rate_kg_s: float
    std_dev_kg_s: float
    status: FlowStatus
    noise_kg_s: float | None


class Circumstances(NamedTuple):
    """What a flow depends on beside its window.

    sweeping: a sweep is under way. calibration_old: the fault CalibrationOld is shown. model_error: of the force, as sweeps show.
    drift_sd: relative standard deviation of the force by drift since the last update. plate_doubted: plate or feedback did not
    follow in the last sweep, after which the plate was commanded home.
    """

    sweeping: bool
    calibration_old: bool
    model_error: AngleError = NO_ERROR
    drift_sd: float = 0.0
    plate_doubted: bool = False


def estimates(estimator: FlowEstimator, readings: Sequence[Reading]) -> list[Estimate | None]:
    """The estimate of each window that has a force to estimate from, in one call of the estimator; else None."""
    undecided = [reading for reading in readings if reading.quality is None]
    if not undecided:
        return [None] * len(readings)
    inputs = np.array(
        [
            (r.force_n, r.window.plate_angle_rad, r.window.speed_rad_s, r.force_std_dev_n, r.inputs.fresh["moisture"])
            for r in undecided
        ]
    ).T.copy()
    found = estimator.estimate(*inputs)
    size = len(undecided)
    columns = [
        np.broadcast_to(column, size).tolist() if column is not None else [None] * size
        for column in (found.mass_flow_kg_s, found.std_dev_kg_s, found.status, found.noise_std_dev_kg_s)
    ]
    rows = (Estimate(rate, sd, _STATUSES[status], own) for rate, sd, status, own in zip(*columns, strict=True))
    return [next(rows) if reading.quality is None else None for reading in readings]


class FlowMeter:
    """Turns estimates into flows with budget and quality, and smooths the published ones."""

    def __init__(self, settings: EngineSettings, machine: Machine) -> None:
        self._settings = settings
        self._gain_n_per_mv = machine.sensor.gain_n_per_mv
        self._full_scale_mv = machine.sensor.full_scale_mv
        self._home_rad = machine.home_plate_angle_rad
        self._filter = FlowFilter(settings.flow_filter)
        self._angle_rad = _NAN
        """Plate angle of the window before."""
        self.moisture = MoistureReference(settings.budget)

    def flow(self, reading: Reading, estimate: Estimate | None, estimator: FlowEstimator, circumstances: Circumstances) -> Flow:
        """The flow of a window, as it is counted in the mass."""
        if estimate is None:
            assert reading.quality is not None, "without an estimate the reading says why"
            return Flow(_NAN, _NAN, reading.quality, reading.force_n, reading.force_std_dev_n)
        rate, std_dev, status, own = estimate
        excess = 0.0
        if status is FlowStatus.SATURATED:
            (rate, std_dev, _, own), excess = _full_paddle(reading, estimator)
        if not (isfinite(rate) and isfinite(std_dev)) or rate < 0.0:
            return Flow(_NAN, _NAN, EstimateQuality.NOT_AVAILABLE, reading.force_n, reading.force_std_dev_n)
        if reading.inputs.angle_stale:
            held_rad = radians(self._settings.inputs.held_angle_std_dev_deg)
            # A curve gives the same flow at any angle; its standard deviation at the other angle contains the error.
            change, there = _change_by_angle(reading, rate, estimator, held_rad)
            std_dev = hypot(std_dev, change if change > 0.0 else there)
        elif circumstances.plate_doubted and not (reading.at_home or circumstances.sweeping):
            away_rad = reading.window.plate_angle_rad - self._home_rad
            std_dev = hypot(std_dev, _change_by_angle(reading, rate, estimator, away_rad)[0])
        saturated = status is FlowStatus.SATURATED or reading.window.saturated_share >= self._settings.windows.saturated_share
        outside = status is FlowStatus.OUTSIDE_CALIBRATION
        quality = self._quality(reading, saturated, outside, circumstances)
        if saturated and rate > 0.0:
            std_dev = hypot(std_dev, rate * excess + self._hidden_kg_s(reading, rate, own))
        budget = self._budget(reading, rate, std_dev, own, estimator, circumstances)
        return _flow(rate, budget.std_dev_kg_s, quality, reading.force_n, reading.force_std_dev_n, outside, saturated, budget)

    def published(self, flow: Flow, *, plate_rests_at_home: bool, coverage: float = 1.0) -> Flow:
        """The flow to publish: filtered over windows in which the plate rests at home, else as measured. coverage: of the window;
        below the minimum no flow is published."""
        found = self._filtered(flow, plate_rests_at_home=plate_rests_at_home)
        if not found.measured or coverage >= self._settings.windows.min_coverage:
            return found
        return replace(found, rate_kg_s=_NAN, std_dev_kg_s=_NAN, quality=EstimateQuality.NOT_AVAILABLE)

    def _filtered(self, flow: Flow, *, plate_rests_at_home: bool) -> Flow:
        usable = plate_rests_at_home and not flow.saturated and flow.force_n > 0.0 and flow.rate_kg_s > 0.0
        if not usable:
            self._filter.reset()
            return flow
        noise = flow.budget.noise_kg_s
        common = max(0.0, flow.std_dev_kg_s**2 - noise**2) ** 0.5
        rate, std_dev = self._filter.update(flow.rate_kg_s, noise)
        spread = hypot(std_dev, common * rate / flow.rate_kg_s)
        return _flow(
            rate, spread, flow.quality, flow.force_n, flow.force_std_dev_n, flow.out_of_calibration, flow.saturated, flow.budget
        )

    def _budget(
        self,
        reading: Reading,
        rate: float,
        std_dev: float,
        own: float | None,
        estimator: FlowEstimator,
        circumstances: Circumstances,
    ) -> FlowBudget:
        """The flow's standard deviation by cause. std_dev: by noise and parameters; own: the estimator's noise, None:
        unstated."""
        settings, parameters = self._settings.budget, estimator.parameters
        noise = _noise(rate, own, reading)
        per_n = noise / reading.force_std_dev_n if reading.force_std_dev_n > 0.0 else _NAN
        common, motion = without_noise(std_dev, noise), 0.0
        angle_rad, before_rad = reading.window.plate_angle_rad, self._angle_rad
        self._angle_rad = angle_rad
        if not (reading.still or reading.inputs.angle_stale):
            # Signed: the motion back has the opposite error.
            late_rad = _late_rad(reading.window, self._settings.windows.max_ramp_s)
            size = _change_by_angle(reading, rate, estimator, late_rad)[0]
            noise, motion = hypot(noise, size), size if angle_rad > before_rad else -size if angle_rad < before_rad else 0.0
        zero_n = zero_std_dev_mv(settings, reading.zero_age_s, reading.zero_away_mv) * self._gain_n_per_mv
        relative = self.moisture.std_dev_by(reading.inputs.fresh["moisture"], parameters)
        per_error = reading.force_n * per_n if reading.force_n > 0.0 and isfinite(per_n) else 0.0
        model_error = circumstances.model_error
        if model_error.moments and not reading.at_home and parameters.curve is None:
            # The parameters' own allowance for angles away from home is replaced by what sweeps show.
            away, at_home = angle_error_beyond(parameters, np.array([angle_rad, self._home_rad]))
            common = max(0.0, common**2 - max(0.0, away**2 - at_home**2) * per_error**2) ** 0.5
        if reading.speed_change != 0.0:
            # At one fill the force grows with the square of the speed, and fill with flow over speed.
            common = hypot(common, reading.speed_change * (2.0 * per_error - rate))
        return flow_budget(
            self._settings.sweep,
            model_error,
            angle_rad,
            at_home=reading.at_home,
            drift_sd=circumstances.drift_sd,
            per_error_kg_s=per_error,
            noise_kg_s=noise,
            common_kg_s=common,
            zero_kg_s=zero_n * per_n,
            moisture_kg_s=relative * rate,
            motion_kg_s=motion,
        )

    def _hidden_kg_s(self, reading: Reading, rate: float, own: float | None) -> float:
        """Flow hidden by samples at the end of the sensor's range, kg/s. own: as in `_budget`."""
        window, zero_mv = reading.window, 0.0 if reading.zero is None else reading.zero.zero_mv
        limit_mv = window.ceiling_mv or self._full_scale_mv
        hidden = hidden_share(window.mean_mv - zero_mv, limit_mv - zero_mv, window.saturated_share)
        per_n = _noise(rate, own, reading) / reading.force_std_dev_n if reading.force_std_dev_n > 0.0 else 0.0
        return hidden * max(rate, reading.force_n * per_n)

    def _quality(self, reading: Reading, saturated: bool, outside: bool, circumstances: Circumstances) -> EstimateQuality:
        if saturated:
            return EstimateQuality.SATURATED
        if not reading.at_home or circumstances.sweeping:
            return EstimateQuality.SWEEPING
        if outside:
            return EstimateQuality.OUTSIDE_CALIBRATION
        if circumstances.calibration_old or reading.inputs.angle_stale or self._incomplete(reading.window):
            return EstimateQuality.DEGRADED
        return EstimateQuality.OK

    def _incomplete(self, window: Window) -> bool:
        """Whether samples of a window are missing or unreliable."""
        settings = self._settings.windows
        return (
            window.coverage < settings.full_coverage
            or window.lost_frames > 0
            or window.contested
            or window.sensor_fault_frames > 0
            or window.held_s > 0.25 * settings.window_s
        )


def away_from_home(flow: Flow, reading: Reading, error: AngleError) -> Flow:
    """A flow away from home, corrected by the error that sweeps have measured there relative to home."""
    if reading.at_home or not (error.away and flow.rate_kg_s > 0.0 and isfinite(flow.budget.per_error_kg_s)):
        return flow
    away = error.away_at(reading.window.plate_angle_rad)
    factor = exp(away * flow.budget.per_error_kg_s / flow.rate_kg_s)
    budget = flow.budget.without(away, factor)
    return replace(flow, rate_kg_s=factor * flow.rate_kg_s, std_dev_kg_s=budget.std_dev_kg_s, budget=budget)


def _late_rad(window: Window, max_ramp_s: float) -> float:
    """Standard deviation of the plate angle in a window in which it moved, by the delay of its feedback, rad."""
    # The range of the angle covers the window and its ramp in the window before.
    moved_s = window.end_s - window.start_s + max_ramp_s
    return (window.plate_max_rad - window.plate_min_rad) * _FEEDBACK_DELAY_S / moved_s


def _change_by_angle(reading: Reading, rate: float, estimator: FlowEstimator, by_rad: float) -> tuple[float, float]:
    """Change of the flow if the plate angle is by_rad less, and the flow's standard deviation there, kg/s; the whole flow for
    both where the model gives none there."""
    other = _estimate_at(reading, estimator, reading.force_n, reading.window.plate_angle_rad - by_rad)
    return (abs(other.rate_kg_s - rate), other.std_dev_kg_s) if isfinite(other.rate_kg_s) else (rate, rate)


def _noise(rate: float, own: float | None, reading: Reading) -> float:
    """The part of the standard deviation that is independent from window to window, kg/s."""
    if own is not None:
        return own
    # Not stated: flow is nearly proportional to force, so relative errors are equal.
    return rate * reading.force_std_dev_n / reading.force_n if reading.force_n > 0.0 else _NAN


def _full_paddle(reading: Reading, estimator: FlowEstimator) -> tuple[Estimate, float]:
    """The largest flow of the model at a window's angle and speed, by bisection of the force; and by how much the measured force
    exceeds that flow's force, relative."""
    low, high = 0.0, reading.force_n
    largest = Estimate(_NAN, _NAN, FlowStatus.SATURATED, None)
    for _ in range(12):
        middle = 0.5 * (low + high)
        found = _estimate_at(reading, estimator, middle, reading.window.plate_angle_rad)
        if found.status is FlowStatus.SATURATED:
            high = middle
        else:
            low, largest = middle, found
    return largest, reading.force_n / low - 1.0 if low > 0.0 else 0.0


def _estimate_at(reading: Reading, estimator: FlowEstimator, force_n: float, angle_rad: float) -> Estimate:
    """The estimate of a window with another force or angle."""
    moisture_pct = reading.inputs.fresh["moisture"]
    found = estimator.estimate(force_n, angle_rad, reading.window.speed_rad_s, reading.force_std_dev_n, moisture_pct)
    noise = None if found.noise_std_dev_kg_s is None else float(found.noise_std_dev_kg_s)
    return Estimate(float(found.mass_flow_kg_s), float(found.std_dev_kg_s), FlowStatus(int(found.status)), noise)
