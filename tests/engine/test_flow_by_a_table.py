"""What an estimate is worth: quality by what is wrong with the window, and the standard deviation by cause against its sum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot, inf, isnan, nan, nextafter, radians, sqrt

import numpy as np
import pytest
from engine_bench import MACHINE, N_PER_KG_S, ForceProportional, angle_factor
from numpy.typing import ArrayLike
from test_measurement_by_a_table import HOME_RAD, Seconds

from yieldmon.engine.flow import Circumstances, Estimate, Flow, FlowMeter
from yieldmon.engine.flow_filter import FlowFilter
from yieldmon.engine.measurement import Reading
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.open_loop import FlowEstimate, FlowStatus
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, NODES_RAD, AngleError
from yieldmon.frames import EstimateQuality
from yieldmon.physics.machine import SAME_ANGLE_RAD

SETTINGS = replace(EngineSettings(), sweep=replace(EngineSettings().sweep, max_std_dev_factor=3.0))
GAIN_N_PER_MV = MACHINE.sensor.gain_n_per_mv
MACHINE_GRAIN = {"friction": 0.3, "restitution": 0.5, "density": 1100.0, "shape_ratio": 2.0}
Q, OK = EstimateQuality, FlowStatus.OK
OF_THE_MODEL = AngleError.of(np.diag(np.linspace(0.02, 0.01, NODES_RAD.size)) ** 2, HOME_RAD)
CALM = Circumstances(sweeping=False, calibration_old=False)
FULL = SETTINGS.windows.full_coverage


def reading(**of: float) -> Reading:
    """Of a second of harvest at 60 N; of: fields of the window."""
    machine = Seconds()
    machine.harvest(3)
    return machine.harvest(**of)


def flow(of: Reading, estimate: Estimate | None = None, circumstances: Circumstances = CALM, estimator: object = None) -> Flow:
    given = Estimate(15.0, 0.8, OK, 0.3) if estimate is None else estimate
    return FlowMeter(SETTINGS, MACHINE).flow(of, given, estimator or ForceProportional(), circumstances)  # type: ignore[arg-type]


QUALITY: dict[str, tuple[dict[str, float], FlowStatus, dict[str, bool], EstimateQuality]] = {
    # fields of the window; the estimate's status; circumstances
    "all well": ({}, OK, {}, Q.OK),
    "whole enough": ({"covered_s": FULL}, OK, {}, Q.OK),
    "not whole": ({"covered_s": nextafter(FULL, 0.0)}, OK, {}, Q.DEGRADED),
    "a frame lost": ({"lost_frames": 1}, OK, {}, Q.DEGRADED),
    "two senders": ({"surplus_frames": 1}, OK, {}, Q.DEGRADED),
    "sensor reports a fault": ({"sensor_fault_frames": 1}, OK, {}, Q.DEGRADED),
    "a sample held": ({"held_s": 0.25}, OK, {}, Q.OK),
    "held for longer": ({"held_s": nextafter(0.25, 1.0)}, OK, {}, Q.DEGRADED),
    "angle stale": ({"in_angle_deg": nan}, OK, {}, Q.DEGRADED),
    "calibration old": ({}, OK, {"calibration_old": True}, Q.DEGRADED),
    "no grain": ({}, FlowStatus.NO_GRAIN, {}, Q.OK),
    "outside calibration": ({}, FlowStatus.OUTSIDE_CALIBRATION, {}, Q.OUTSIDE_CALIBRATION),
    "outside and degraded": ({"lost_frames": 1}, FlowStatus.OUTSIDE_CALIBRATION, {}, Q.OUTSIDE_CALIBRATION),
    "sweeping": ({}, OK, {"sweeping": True}, Q.SWEEPING),
    "sweeping, outside and degraded": ({"lost_frames": 1}, FlowStatus.OUTSIDE_CALIBRATION, {"sweeping": True}, Q.SWEEPING),
    "away from home": ({"plate_angle_rad": HOME_RAD - 0.1}, OK, {}, Q.SWEEPING),
    "few samples at the end of the range": ({"saturated_share": nextafter(0.01, 0.0)}, OK, {}, Q.OK),
    "samples at the end of the range": ({"saturated_share": 0.01}, OK, {}, Q.SATURATED),
    "saturated in a sweep": ({"saturated_share": 0.01}, FlowStatus.OUTSIDE_CALIBRATION, {"sweeping": True}, Q.SATURATED),
    "above a full paddle": ({}, FlowStatus.SATURATED, {}, Q.SATURATED),
}  # fmt: skip


@pytest.mark.parametrize("case", QUALITY)
def test_quality(case: str) -> None:
    of, status, around, expected = QUALITY[case]
    found = flow(reading(**of), Estimate(15.0, 0.8, status, 0.3), CALM._replace(**around))
    assert found.quality is expected
    assert found.measured
    assert found.saturated is (expected is Q.SATURATED)
    assert found.out_of_calibration is (status is FlowStatus.OUTSIDE_CALIBRATION)


@pytest.mark.parametrize(
    ("rate", "std_dev", "measured"),
    [(0.0, 0.1, True), (-1e-9, 0.1, False), (nan, 0.1, False), (inf, 0.1, False), (5.0, nan, False), (5.0, inf, False)],
)
def test_what_is_no_flow_is_not_available(rate: float, std_dev: float, measured: bool) -> None:
    found = flow(reading(), Estimate(rate, std_dev, OK, 0.3))
    assert (found.measured, found.quality is Q.NOT_AVAILABLE, isnan(found.std_dev_kg_s)) == (measured, not measured, not measured)
    assert found.force_n == pytest.approx(60.0)


def test_without_an_estimate_the_reading_says_why() -> None:
    of = replace(reading(), quality=Q.NOT_HARVESTING)
    found = FlowMeter(SETTINGS, MACHINE).flow(of, None, ForceProportional(), CALM)
    assert (found.quality, found.measured, found.force_n) == (Q.NOT_HARVESTING, False, of.force_n)


@pytest.mark.parametrize("away", [False, True], ids=["at home", "away"])
@pytest.mark.parametrize("own", [0.3, None], ids=["noise stated", "noise by the force"])
@pytest.mark.parametrize("drift_sd", [0.0, 0.02])
@pytest.mark.parametrize("error", [NO_ERROR, OF_THE_MODEL], ids=["no error", "error of the model"])
@pytest.mark.parametrize("since_zero_s", [0.0, 3600.0])
@pytest.mark.parametrize("moisture_pct", [nan, 15.0])
def test_the_standard_deviation_is_the_sum_of_its_causes(
    away: bool, own: float | None, drift_sd: float, error: AngleError, since_zero_s: float, moisture_pct: float
) -> None:
    of = reading(**({"plate_angle_rad": HOME_RAD - 0.1} if away else {}))
    fresh = {**of.inputs.fresh, "moisture": moisture_pct}
    of = replace(of, zero_age_s=since_zero_s, force_std_dev_n=1.5, inputs=of.inputs._replace(fresh=fresh))
    found = flow(of, Estimate(15.0, 0.8, OK, own), Circumstances(False, False, error, drift_sd)).budget
    # In kg/s, of the rate of 15 kg/s at 60 N.
    noise = 15.0 * 1.5 / of.force_n if own is None else own
    kg_s_per_n, factor = noise / 1.5, 3.0 if away else 1.0
    of_force = of.force_n * kg_s_per_n
    covariance = factor * hypot(sqrt(0.8**2 - noise**2), drift_sd * of_force)
    model = error.at(of.window.plate_angle_rad) * of_force
    zero = hypot(0.2, sqrt(since_zero_s / 3600.0)) * GAIN_N_PER_MV * kg_s_per_n
    moisture = 15.0 * 0.02 * 2.0 if isnan(moisture_pct) else 0.0
    assert (found.noise_kg_s, found.covariance_kg_s) == pytest.approx((factor * noise, covariance))
    assert (found.parameters_kg_s, found.zero_kg_s) == pytest.approx((hypot(covariance, model), zero))
    assert (found.moisture_kg_s, found.per_error_kg_s) == pytest.approx((moisture, of_force))
    assert found.std_dev_kg_s == pytest.approx(sqrt((factor * noise) ** 2 + covariance**2 + model**2 + zero**2 + moisture**2))


@pytest.mark.parametrize("error", [NO_ERROR, OF_THE_MODEL], ids=["nothing known of sweeps", "what sweeps show"])
@pytest.mark.parametrize("away", [False, True])
def test_beyond_the_calibrated_angles_what_sweeps_show_counts_once(away: bool, error: AngleError) -> None:
    """Parameters of one plate angle, 10 deg from home: their error over the angle is in the estimate."""
    known = ParameterSet(MACHINE_GRAIN, calibrated=CalibratedRange(plate_angle_rad=(HOME_RAD + radians(10.0),) * 2))
    of = replace(reading(**({"plate_angle_rad": HOME_RAD - radians(20.0)} if away else {})), force_std_dev_n=1.5)
    by_rad = 0.4 * (radians(30.0 if away else 10.0) - SAME_ANGLE_RAD)
    of_force = of.force_n * 0.3 / 1.5
    sd = hypot(0.3, by_rad * of_force)
    found = flow(of, Estimate(15.0, sd, OK, 0.3), Circumstances(False, False, error), ForceProportional(known)).budget
    # At home, and between home and here where nothing else stands for it.
    left = 0.4 * (radians(10.0) - SAME_ANGLE_RAD) if away and error.moments else by_rad
    assert found.covariance_kg_s == pytest.approx((3.0 if away else 1.0) * left * of_force, rel=1e-6)


def test_a_plate_that_moves_adds_the_delay_of_its_feedback_to_the_noise() -> None:
    moved_rad = radians(4.0)
    of = replace(reading(plate_min_rad=HOME_RAD - moved_rad), force_std_dev_n=1.5)
    assert not of.still
    # 0.07 s of the second and the half second of ramp before it; force grows by 1 % a degree.
    late_deg = 4.0 * 0.07 / 1.5
    other = 15.0 / angle_factor(70.0 - late_deg)
    assert flow(of).budget.noise_kg_s == pytest.approx(hypot(0.3, other - 15.0), rel=1e-6)
    assert flow(replace(of, still=True)).budget.noise_kg_s == pytest.approx(0.3)


def test_the_delay_of_its_feedback_is_of_the_other_sign_on_the_way_back() -> None:
    meter, motion = FlowMeter(SETTINGS, MACHINE), []
    for degrees in (70.0, 66.0, 62.0, 66.0, 70.0):
        at = radians(degrees)
        of = replace(reading(plate_angle_rad=at, plate_min_rad=at - radians(2.0), plate_max_rad=at + radians(2.0)), still=False)
        found = meter.flow(of, Estimate(15.0, 0.8, OK, 0.3), ForceProportional(), CALM).budget  # type: ignore[arg-type]
        factor = 1.0 if of.at_home else SETTINGS.sweep.max_std_dev_factor
        assert abs(found.motion_kg_s) == pytest.approx(sqrt(found.noise_kg_s**2 - (0.3 * factor) ** 2)) or not motion
        motion.append(found.motion_kg_s)
    assert motion[0] == 0.0, "it is not known whence it came"
    assert [by > 0.0 for by in motion[1:]] == [False, False, True, True]


@dataclass
class SameAtAnyAngle(ForceProportional):
    """A curve: it gives the same flow at any angle, and says how far that may be wrong."""

    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = 0.0,
        moisture_pct: ArrayLike | None = None,
    ) -> FlowEstimate:
        rate, away = np.asarray(force_n) / N_PER_KG_S, np.abs(np.asarray(plate_angle_rad) - HOME_RAD)
        return FlowEstimate(rate, 0.8 + 20.0 * away, np.full(rate.shape, int(OK)))


@dataclass
class KnowsHomeAlone(ForceProportional):
    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = 0.0,
        moisture_pct: ArrayLike | None = None,
    ) -> FlowEstimate:
        rate = np.where(np.abs(np.asarray(plate_angle_rad) - HOME_RAD) < 1e-9, np.asarray(force_n) / N_PER_KG_S, nan)
        return FlowEstimate(rate, 0.05 * rate, np.where(np.isfinite(rate), int(OK), int(FlowStatus.NOT_AVAILABLE)))


@pytest.mark.parametrize(
    ("estimator", "adds"),
    [
        (ForceProportional(), 15.0 / angle_factor(69.0) - 15.0),
        (SameAtAnyAngle(), 0.8 + 20.0 * radians(1.0)),
        (KnowsHomeAlone(), 15.0),
    ],
    ids=["by the model", "by the curve's own word", "all of the flow"],
)
def test_an_angle_that_is_held_adds_what_a_degree_makes(estimator: ForceProportional, adds: float) -> None:
    of = replace(reading(in_angle_deg=nan), force_n=60.0, force_std_dev_n=1.5)
    found = flow(of, estimator=estimator)
    assert found.budget.covariance_kg_s == pytest.approx(sqrt(hypot(0.8, adds) ** 2 - 0.3**2), rel=1e-6)


def test_more_than_a_full_paddle_counts_as_a_full_one() -> None:
    found = flow(replace(reading(), force_n=200.0), Estimate(nan, nan, FlowStatus.SATURATED, None))
    assert found.rate_kg_s == pytest.approx(30.0, rel=1e-3)
    assert found.rate_kg_s <= 30.0


PUBLISHED: dict[str, tuple[Callable[[Flow], Flow], bool, bool]] = {
    # what differs from the flows before; whether the plate rests at home; whether they are weighed together
    "like those before": (lambda f: f, True, True),
    "plate elsewhere": (lambda f: f, False, False),
    "saturated": (lambda f: replace(f, saturated=True), True, False),
    "no force": (lambda f: replace(f, force_n=0.0), True, False),
    "no flow": (lambda f: replace(f, rate_kg_s=0.0), True, False),
}


@pytest.mark.parametrize("case", PUBLISHED)
def test_flows_at_rest_at_home_are_weighed_together(case: str) -> None:
    change, at_rest, together = PUBLISHED[case]
    meter, alone = FlowMeter(SETTINGS, MACHINE), FlowFilter(SETTINGS.flow_filter)
    measured = flow(reading())
    noise = measured.budget.noise_kg_s
    for rate in (15.0, 14.0, 16.0, 15.5):
        meter.published(replace(measured, rate_kg_s=rate), plate_rests_at_home=True)
        alone.update(rate, noise)
    last = change(replace(measured, rate_kg_s=16.2))
    shown = meter.published(last, plate_rests_at_home=at_rest)
    if not together:
        assert shown is last
        assert meter.published(measured, plate_rests_at_home=True).rate_kg_s == measured.rate_kg_s, "anew"
        return
    rate, spread = alone.update(16.2, noise)
    common = sqrt(measured.std_dev_kg_s**2 - noise**2)
    assert (shown.rate_kg_s, shown.std_dev_kg_s) == pytest.approx((rate, hypot(spread, common * rate / 16.2)))
    assert rate < 16.0, "what is shared goes with the flow that is shown"
    assert (shown.quality, shown.budget) == (last.quality, last.budget)
