"""Kernel noise as an update: whatever it says, and however often, it knows the scale no better than its one bias is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_inputs import WeighedMass
from yieldmon.estimation.self_calibration.steady_drift import DriftingParameters, begin, updated
from yieldmon.estimation.waveform import common_bias
from yieldmon.estimation.waveform.common_bias import CommonBias, KernelMeasurement, measurement_of
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MODEL = ForwardModel(Machine(), ())
TRUE = {"friction": 0.2, "density": 1000.0, "shape_ratio": 2.0, "restitution": 0.5}
KNOWN = ParameterSet(TRUE, ("friction", "density", "restitution"), np.diag([0.02**2, 40.0**2, 0.06**2]))
FLOWS = np.linspace(6.0, 12.0, 9)
ANGLE, SPEED = np.full(9, np.radians(70.0)), np.full(9, 400.0 * RPM)
LASTING_SD = 0.13


def forces(values: dict[str, float]) -> np.ndarray:
    return np.real(MODEL.force(Conditions(ANGLE, SPEED, mass_flow_kg_s=FLOWS), values))


def measurement(values: dict[str, float], log_bias: float) -> KernelMeasurement:
    return KernelMeasurement(FLOWS * np.exp(log_bias), forces(values), ANGLE, SPEED, np.full(9, np.nan), 0.005, LASTING_SD)


def flow(known: ParameterSet, values: dict[str, float]) -> tuple[float, float]:
    """ln of the mean force's flow over the true one, and its relative standard deviation."""
    found = OpenLoop(MODEL, known).estimate(forces(values), ANGLE, SPEED)
    ratio = np.asarray(found.mass_flow_kg_s) / FLOWS
    return float(np.mean(np.log(ratio))), float(np.mean(np.asarray(found.std_dev_kg_s) / (ratio * FLOWS)))


def repeatedly(
    times: int,
    values: dict[str, float],
    log_bias: float,
    drifting: DriftingParameters | None = None,
    bias: CommonBias | None = None,
) -> tuple[DriftingParameters, CommonBias]:
    """So many updates, after those that led to what is given."""
    drifting = drifting or begin(KNOWN, {})
    bias = bias or common_bias.begin(LASTING_SD, len(drifting.joint))
    for _ in range(times):
        updated = common_bias.update(MODEL, drifting, bias, measurement(values, log_bias))
        drifting, bias = updated.drifting, updated.bias
    return drifting, bias


@pytest.mark.parametrize("log_bias", [-0.1, 0.0, 0.1])
def test_many_updates_determine_the_scale_no_better_than_one_exact_one(log_bias: float) -> None:
    _, before = flow(KNOWN, TRUE)
    floor = 1.0 / np.hypot(1.0 / before, 1.0 / LASTING_SD)
    drifting, bias, deviations = None, None, []
    for times in (1, 9, 30):
        drifting, bias = repeatedly(times, TRUE, log_bias, drifting, bias)
        off, sd = flow(drifting.parameters, TRUE)
        deviations.append(sd)
        assert sd >= 0.95 * floor
        assert abs(off) < 3.0 * sd
        # Only the difference of the two is seen, so that the bias is known no better than the scale.
        assert bias.variance**0.5 >= 0.95 * floor
        assert np.all(np.linalg.eigvalsh(drifting.joint) > 0.0)
    assert deviations[0] < before
    assert deviations[2] > 0.97 * deviations[1]


def weighed(drifting: DriftingParameters, bias: CommonBias) -> tuple[DriftingParameters, CommonBias]:
    seconds = np.full(9, 100.0)
    mass = float(seconds @ FLOWS)
    weighed = WeighedMass.from_windows(mass, 0.003 * mass, seconds, forces(TRUE), ANGLE, SPEED)
    outcome = update_from_tickets(MODEL, drifting.parameters, [weighed])
    after = updated(drifting, outcome.parameter_set, widening=outcome.prior_widening)
    return after, common_bias.followed(bias, drifting, after, widening=outcome.prior_widening)


@pytest.mark.parametrize("log_bias", [-0.12, 0.12])
def test_a_weighed_load_fixes_the_bias_and_then_kernels_follow_what_drifts(log_bias: float) -> None:
    drifting, bias = weighed(*repeatedly(3, TRUE, log_bias))
    assert bias.value == pytest.approx(log_bias, abs=0.02)
    assert bias.variance**0.5 < 0.03
    later = {**TRUE, "density": 900.0, "restitution": 0.45}
    widened = drifting.joint + np.diag([0.0, 100.0**2, 0.08**2])
    stale = DriftingParameters(replace(drifting.parameters, covariance=widened), drifting.names, drifting.rates, widened)
    before, _ = flow(stale.parameters, later)
    updated = common_bias.update(MODEL, stale, bias, measurement(later, log_bias))
    after, sd = flow(updated.drifting.parameters, later)
    assert abs(after) < 0.3 * abs(before)
    assert abs(after) < 3.0 * sd


def test_without_a_weighed_load_the_bias_is_not_learnt_from_kernels_alone() -> None:
    """Kernel noise 12 % high: the parameters, known to 8 %, share it by what either is known to."""
    drifting, bias = repeatedly(50, TRUE, 0.12)
    off, _ = flow(drifting.parameters, TRUE)
    assert off + bias.value == pytest.approx(0.0, abs=0.13)
    assert 0.0 < off < 0.08
    assert bias.variance**0.5 > 0.05


def test_the_bias_follows_an_update_as_if_it_had_been_one_of_its_states() -> None:
    """Against a Kalman update of all states together, written out."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((4, 4))
    whole = root @ root.T + 4.0 * np.eye(4)
    names, size = KNOWN.covariance_names, np.array([0.01, 20.0, 0.02, 0.05])
    whole = whole * np.outer(size, size)
    row, noise, seen = np.array([5.0, 0.002, 1.5, 0.0]), 0.05, 0.1
    variance = row @ whole @ row + noise**2
    gain = whole @ row / variance
    after, step = whole - np.outer(gain, row @ whole), gain * seen

    def states(shift: np.ndarray, joint: np.ndarray) -> DriftingParameters:
        values = dict(TRUE)
        for name, moved in zip(names, shift, strict=False):
            values[name] += float(moved)
        return DriftingParameters(ParameterSet(values, names, joint[:3, :3]), (), np.zeros(0), joint[:3, :3])

    bias = CommonBias(0.0, whole[3, 3], whole[3, :3], np.inf)
    found = common_bias.followed(bias, states(np.zeros(3), whole), states(step, after))
    assert found.value == pytest.approx(step[3], rel=1e-9)
    assert found.variance == pytest.approx(after[3, 3], rel=1e-9)
    np.testing.assert_allclose(found.cross, after[3, :3], rtol=1e-8)


def test_a_step_too_long_to_be_linear_and_a_flow_that_is_none_are_refused() -> None:
    wide = begin(replace(KNOWN, covariance=np.diag([0.02**2, 300.0**2, 0.3**2])), {})
    bias = common_bias.begin(LASTING_SD, len(wide.joint))
    with pytest.raises(ValueError, match="would move the flow by"):
        common_bias.update(MODEL, wide, bias, measurement(TRUE, 1.0))
    with pytest.raises(ValueError, match="gives no flow"):
        common_bias.update(MODEL, wide, bias, replace(measurement(TRUE, 0.0), force_n=np.full(9, np.nan)))


def test_seconds_of_independent_noise_average_out_and_what_lasts_does_not() -> None:
    found = measurement_of([(8.0, 70.0, 1.22, 41.9, 15.0)] * 4, [0.02] * 4, 0.13)
    assert found.random_sd == pytest.approx(0.01)
    assert found.lasting_sd == 0.13
    assert found.kernels_kg_s.shape == (4,)


@pytest.mark.parametrize("scatter", [0.35, 0.5])
@pytest.mark.parametrize("updates", [1, 2, 30])
def test_kernels_whose_masses_scatter_leave_a_deviation_that_covers(scatter: float, updates: int) -> None:
    # Shot noise goes with the mean square of the masses, so that kernels' flow is low by 1 + scatter^2; the bias is thought to be
    # known to 5 %.
    drifting = begin(KNOWN, {})
    bias = common_bias.begin(0.05, len(drifting.joint))
    for _ in range(updates):
        low = replace(measurement(TRUE, -np.log(1.0 + scatter**2)), lasting_sd=0.05)
        updated = common_bias.update(MODEL, drifting, bias, low)
        drifting, bias = updated.drifting, updated.bias
        joined = np.block([[drifting.joint, bias.cross[:, None]], [bias.cross[None], np.array([[bias.variance]])]])
        assert np.linalg.eigvalsh(joined)[0] > -1e-12
    off, sd = flow(drifting.parameters, TRUE)
    assert off < -0.04
    assert abs(off) < 1.5 * sd
    assert sd < 0.1


def test_updates_that_agree_narrow_as_before() -> None:
    drifting, bias = repeatedly(1, TRUE, 0.0)
    before = flow(KNOWN, TRUE)[1]
    assert flow(drifting.parameters, TRUE)[1] == pytest.approx(1.0 / np.hypot(1.0 / before, 1.0 / LASTING_SD), rel=0.02)
    assert bias.largest == LASTING_SD**2
