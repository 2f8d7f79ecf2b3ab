"""What a sweep would tell before it is made, against what the closed loop says after it."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import self_calibrate
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels, SweepPlan, SweepWorth, sweep_worth, window_times_s
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MODEL = ForwardModel(Machine())
HOME_RAD = float(np.deg2rad(70.0))
SPEED = 400.0 * RPM
VALUES = {"friction": 0.25, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
NAMES = ("friction", "restitution", "density")
KNOWN = ParameterSet(VALUES, NAMES, np.diag([0.08**2, 0.08**2, 150.0**2]))
STOPS = [angle for angle in (70.0, 40.0, 40.0, 70.0, 90.0, 55.0, 70.0) for _ in range(2)]
LOOP = ClosedLoopSettings()


def worth(
    flow: float = 12.0, known: ParameterSet = KNOWN, channels: OtherChannels | None = None, loop: ClosedLoopSettings = LOOP
) -> SweepWorth:
    plan = SweepPlan(window_times_s(STOPS), np.radians(STOPS), HOME_RAD, SPEED, flow, 0.01, nan)
    found = sweep_worth(MODEL, known, plan, channels or OtherChannels(), loop)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("flow", "loop"),
    [
        (5.0, LOOP), (12.0, LOOP), (18.0, LOOP), (12.0, ClosedLoopSettings(flow="linear")),
        (12.0, ClosedLoopSettings(model_error=0.02)), (12.0, ClosedLoopSettings(learned_information=1e9)),
    ],
)  # fmt: skip
def test_it_is_what_a_sweep_without_noise_then_leaves(flow: float, loop: ClosedLoopSettings) -> None:
    angles, size = np.radians(STOPS), np.ones(len(STOPS))
    force = np.real(MODEL.force(Conditions(angles, SPEED, mass_flow_kg_s=flow), VALUES))
    swept = self_calibrate(MODEL, KNOWN, [Sweep(window_times_s(STOPS), angles, SPEED * size, force, 0.01 * force)], settings=loop)
    home = np.real(MODEL.force(Conditions(HOME_RAD, SPEED, mass_flow_kg_s=flow), VALUES))
    expected = []
    for known in (KNOWN, swept.parameter_set):
        found = OpenLoop(MODEL, known).estimate(home, HOME_RAD, SPEED)
        expected.append(float(found.std_dev_kg_s) / float(found.mass_flow_kg_s))
    stated = worth(flow, loop=loop)
    assert (stated.at_home_sd, stated.with_sweep_sd) == pytest.approx(tuple(expected), rel=0.06)


def test_kernels_of_a_known_bias_leave_a_sweep_no_information() -> None:
    alone, heard = worth(), worth(channels=OtherChannels(kernels_sd=0.005))
    assert alone.ratio > 1.2
    assert heard.at_home_sd < 0.006
    assert heard.ratio < 1.05


def test_a_bias_that_a_weighed_load_fixed_adds_nothing_to_that_update() -> None:
    """Where the bias's error is that of the mean force's flow, both together know the flow no better."""
    known = replace(KNOWN, covariance=np.diag([1e-12, 0.08**2, 1e-6]))
    gain = worth(known=known).at_home_sd
    home = [float(np.real(MODEL.force(Conditions(HOME_RAD, SPEED, mass_flow_kg_s=f), VALUES))) for f in (11.99, 12.01)]
    exponent = np.log(home[1] / home[0]) / np.log(12.01 / 11.99)
    of_restitution = 0.08**2 / 1.6 / exponent
    found = {
        sign: worth(known=known, channels=OtherChannels(kernels_sd=gain, kernels_cross=(0.0, sign * of_restitution, 0.0)))
        for sign in (-1.0, 0.0, 1.0)
    }
    assert found[1.0].at_home_sd == pytest.approx(gain, rel=0.02)
    assert found[0.0].at_home_sd == pytest.approx(gain / sqrt(2.0), rel=0.05)
    assert found[-1.0].at_home_sd < 0.2 * gain


@settings(max_examples=25)
@given(
    flow=st.floats(3.0, 18.0), shape=st.one_of(st.just(inf), st.floats(0.01, 1.0)),
    kernels=st.one_of(st.just(inf), st.floats(0.005, 0.3)), friction=st.floats(0.005, 0.1),
    density=st.floats(5.0, 300.0),
)  # fmt: skip
def test_a_sweep_and_a_channel_never_make_the_flow_less_certain(
    flow: float, shape: float, kernels: float, friction: float, density: float
) -> None:
    known = replace(KNOWN, covariance=np.diag([friction**2, 0.08**2, density**2]))
    alone, found = worth(flow, known), worth(flow, known, OtherChannels(shape, kernels))
    assert found.with_sweep_sd <= found.at_home_sd * (1.0 + 1e-9)
    assert found.at_home_sd <= alone.at_home_sd * (1.0 + 1e-9)


@pytest.mark.parametrize(("known", "flow"), [(ParameterSet(VALUES), 12.0), (KNOWN, 500.0)])
def test_without_variance_or_a_force_nothing_is_reported(known: ParameterSet, flow: float) -> None:
    plan = SweepPlan(window_times_s(STOPS), np.radians(STOPS), HOME_RAD, SPEED, flow, 0.01, nan)
    assert sweep_worth(MODEL, known, plan, OtherChannels(), LOOP) is None
