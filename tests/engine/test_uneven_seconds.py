"""Seconds in which grain comes for a part of the time: their flow is that part of the flow while it came."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engine_bench import MACHINE, ZERO_MV
from test_measurement_by_a_table import GAIN_N_PER_MV, SETTINGS, Seconds

from yieldmon.engine.flow import estimates
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.uneven_seconds import UnevenSeconds
from yieldmon.estimation.open_loop import FlowEstimate, OpenLoop
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.resources import shipped

CORN = parameter_file.load(shipped("config/parameters/corn.yaml"))
SLOPES = {
    f"moisture_dependence.{name}_per_pct": slope
    for name, slope in (("friction", 0.03), ("density", -0.007), ("restitution", -0.02))
}
MOIST = replace(CORN, values=dict(CORN.values) | SLOPES)


class WithThreshold:
    """A curve that gives no flow below 5 N."""

    parameters = CORN

    def estimate(self, force_n: Array, plate_angle_rad: Array, elevator_speed_rad_s: Array, *_: object) -> FlowEstimate:
        flow_kg_s = 0.08 * np.maximum(np.asarray(force_n) - 5.0, 0.0) ** 1.2
        return FlowEstimate(flow_kg_s, 0.05 * flow_kg_s, np.zeros(flow_kg_s.shape, np.int8))

    def force_curve(self, plate_angle_rad: float, elevator_speed_rad_s: float, *_: object) -> tuple[Array, Array]:
        force_n = np.linspace(0.0, 400.0, 401)
        return force_n, np.asarray(self.estimate(force_n, plate_angle_rad, elevator_speed_rad_s).mass_flow_kg_s)


ESTIMATORS: dict[str, FlowEstimator] = {
    "corn": OpenLoop(ForwardModel(MACHINE, CORN.effects), CORN),
    "corn by its moisture": OpenLoop(ForwardModel(MACHINE, MOIST.effects), MOIST),
    "a curve with a threshold": WithThreshold(),
}
ESTIMATOR = ESTIMATORS["corn"]


def second(forces_n: list[float], **of: float) -> Reading:
    """A second in grain whose patterns have these mean forces."""
    seconds = Seconds()
    seconds.harvest(3)
    means_mv = tuple(ZERO_MV + force_n / GAIN_N_PER_MV for force_n in forces_n)
    window = {"pattern_means_mv": means_mv, "pulse_mv": 90.0} | of
    return seconds.second(float(np.mean(forces_n)), {"moisture": 19.0}, **window)  # type: ignore[arg-type]


def flow_kg_s(reading: Reading, estimator: FlowEstimator = ESTIMATOR) -> float:
    [found] = estimates(estimator, [reading])
    assert found is not None
    return found.rate_kg_s


def even(reading: Reading, estimator: FlowEstimator = ESTIMATOR) -> Reading:
    [found] = UnevenSeconds(SETTINGS, MACHINE, estimator).evened([reading])
    return found


@pytest.mark.parametrize("by", ESTIMATORS)
@pytest.mark.parametrize(
    "forces_n", [[90.0] * 3 + [0.0] * 3, [0.0, 0.0, 0.0, 0.0, 90.0, 90.0], [30.0, 90.0, 90.0, 90.0, 60.0, 8.0]]
)
def test_the_flow_is_the_mean_of_the_patterns(forces_n: list[float], by: str) -> None:
    estimator = ESTIMATORS[by]
    wanted_kg_s = np.mean([flow_kg_s(second([force_n] * 6), estimator) if force_n > 0.0 else 0.0 for force_n in forces_n])
    reading = second(forces_n)
    assert flow_kg_s(even(reading, estimator), estimator) == pytest.approx(wanted_kg_s, rel=0.01)
    assert flow_kg_s(reading, estimator) < 0.97 * wanted_kg_s


@pytest.mark.parametrize(("rpm", "force_n"), [(260.0, 50.0), (300.0, 50.0), (347.0, 80.0), (411.0, 90.0), (590.0, 160.0)])
def test_it_is_so_at_other_speeds(rpm: float, force_n: float) -> None:
    forces_n = [0.0] * 4 + [force_n] * 2
    wanted_kg_s = flow_kg_s(second([force_n] * 6, speed_rad_s=rpm * RPM)) / 3.0
    reading = second(forces_n, speed_rad_s=rpm * RPM)
    assert flow_kg_s(even(reading)) == pytest.approx(wanted_kg_s, rel=0.02)
    assert flow_kg_s(reading) < 0.97 * wanted_kg_s


@pytest.mark.parametrize(
    ("forces_n", "of"),
    [
        pytest.param([80.0, 60.0, 75.0, 50.0, 70.0, 85.0], {}, id="paddles that scatter"),
        pytest.param([4.0, 0.0, 8.0, 1.0, 0.0, 6.0], {}, id="little force"),
        pytest.param([90.0, 0.0], {}, id="too few patterns"),
        pytest.param([90.0, 90.0, 90.0, 0.0, 0.0, 0.0], {"covered_s": 0.7}, id="not whole"),
        pytest.param([90.0, 90.0, 90.0, 0.0, 0.0, 0.0], {"surplus_frames": 1}, id="two senders"),
        pytest.param([90.0, 90.0, 90.0, 0.0, 0.0, 0.0], {"samples": 50}, id="single samples of the pulses"),
        pytest.param([90.0, 90.0, 90.0, 0.0, 0.0, 0.0], {"saturated_share": 0.5}, id="cut off"),
        pytest.param([900.0, 0.0, 0.0, 0.0, 0.0, 0.0], {}, id="more than a paddle holds"),
    ],
)
def test_others_count_as_they_are(forces_n: list[float], of: dict[str, float]) -> None:
    reading = second(forces_n, **of)
    assert reading.quality is None or forces_n[0] < 10.0
    assert even(reading) is reading or even(reading).force_n == reading.force_n


def test_three_patterns_are_enough() -> None:
    assert even(second([90.0, 90.0, 0.0])).force_n > 1.03 * 60.0


def test_a_pattern_below_the_zero_has_no_flow() -> None:
    below, none = second([90.0] * 3 + [-9.0] * 3), second([90.0] * 3 + [0.0] * 3)
    assert even(replace(below, force_n=none.force_n)).force_n == pytest.approx(even(none).force_n)


def test_a_mean_that_is_weighted_over_its_edges_changes_by_as_much_as_the_plain_one() -> None:
    plain = second([90.0] * 3 + [0.0] * 3)
    weighted = replace(plain, force_n=1.2 * plain.force_n)
    assert flow_kg_s(even(weighted)) / flow_kg_s(weighted) == pytest.approx(flow_kg_s(even(plain)) / flow_kg_s(plain), rel=1e-3)


class FromTheSecond(WithThreshold):
    """A curve that there is from the second time on."""

    asked = 0

    def force_curve(self, *at: object) -> tuple[Array, Array]:
        self.asked += 1
        return super().force_curve(*at) if self.asked > 1 else (np.zeros(0), np.zeros(0))  # type: ignore[arg-type]


def test_a_curve_that_there_is_not_yet_is_asked_for_again() -> None:
    uneven, reading = UnevenSeconds(SETTINGS, MACHINE, FromTheSecond()), second([90.0] * 3 + [0.0] * 3)
    found_n = [uneven.evened([reading])[0].force_n for _ in range(3)]
    assert found_n[0] == reading.force_n < found_n[1] == found_n[2]


@pytest.mark.parametrize("rpm", [351.0, 359.0, 367.0])
def test_between_two_curves_it_is_as_on_them(rpm: float) -> None:
    """By a curve for each speed: the flow as without steps of speed."""
    reading = second([0.0] * 4 + [90.0] * 2, speed_rad_s=rpm * RPM)
    wanted_kg_s = flow_kg_s(second([90.0] * 6, speed_rad_s=rpm * RPM)) / 3.0
    assert flow_kg_s(even(reading)) == pytest.approx(wanted_kg_s, rel=0.007)
