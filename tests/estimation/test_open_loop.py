"""Force to flow: round trips, statuses, standard deviations."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.estimation.open_loop import FlowStatus, OpenLoop
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
GRAIN = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
NAMES = ("friction", "restitution", "density")
FLOWS = np.array([0.1, 0.3, 1.0, 2.0, 5.0, 9.0, 13.0, 17.0, 21.0, 25.0])


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("form", [{"restitution": 0.6}, {"k1": 1.2, "k2": 0.6}, {"k1": 0.0, "k2": 1.6}], ids=str)
def test_flow_force_flow_is_the_same_to_1e_9(friction: float, form: dict[str, float]) -> None:
    values = {"friction": friction, "density": 1400.0, "shape_ratio": 2.0} | form
    model = ForwardModel(MACHINE)
    flow, angle, speed = np.meshgrid(
        FLOWS, np.radians(np.arange(40.0, 91.0, 10.0)), np.array([300.0, 400.0, 500.0]) * RPM, indexing="ij"
    )
    force = np.real(model.force(Conditions(angle, speed, mass_flow_kg_s=flow), values))
    found = OpenLoop(model, ParameterSet(values)).invert(force, angle, speed)
    again = np.real(model.force(Conditions(angle, speed, mass_flow_kg_s=found), values))
    assert found == pytest.approx(flow, rel=1e-9)
    assert again == pytest.approx(force, rel=1e-9)


@pytest.mark.parametrize(
    ("effects", "values"),
    [
        (("gravity",), {"gravity.acceleration_m_s2": 9.81}),
        (("zero_offset",), {"zero_offset.force_n": 3.0}),
        (("zero_offset",), {"zero_offset.force_n": -3.0}),
    ],
)
def test_round_trip_with_effects(effects: tuple[str, ...], values: dict[str, float]) -> None:
    model, known = ForwardModel(MACHINE, effects), GRAIN | values
    force = np.real(model.force(Conditions(1.2, 42.0, mass_flow_kg_s=FLOWS), known))
    assert OpenLoop(model, ParameterSet(known)).invert(force, 1.2, 42.0) == pytest.approx(FLOWS, rel=1e-8)


@pytest.mark.parametrize(
    "added",
    [{}, {"gravity.acceleration_m_s2": 9.81}, {"zero_offset.force_n": 3.0}, {"paddle_leakage.loss_at_full": 0.1}],
    ids=str,
)
@pytest.mark.parametrize(("angle_deg", "rpm"), [(70.0, 400.0), (50.0, 300.0), (90.0, 550.0)])
def test_the_force_curve_goes_to_a_full_paddle_and_is_what_flows_give(
    added: dict[str, float], angle_deg: float, rpm: float
) -> None:
    angle, speed, known = np.radians(angle_deg), rpm * RPM, GRAIN | added
    model = ForwardModel(MACHINE, tuple(name.split(".")[0] for name in added))
    force, flow = OpenLoop(model, ParameterSet(known)).force_curve(angle, speed)
    wanted = model.force(Conditions(angle, speed, mass_flow_kg_s=flow[1:-1]), known)
    assert force[1:-1] == pytest.approx(np.real(wanted), rel=1e-8)
    assert flow[0] == 0.0
    assert np.all(np.diff(flow) > 0.0)
    assert flow[-1] == pytest.approx(model.throw(angle, speed, known).full_mass_kg * MACHINE.passes_per_s(speed), rel=1e-12)


def loop(sd: tuple[float, float, float] = (0.0, 0.0, 0.0), calibrated: CalibratedRange = CalibratedRange()) -> OpenLoop:  # noqa: B008
    return OpenLoop(ForwardModel(MACHINE), ParameterSet(GRAIN, NAMES, np.diag(np.square(sd)), calibrated))


ANGLE, SPEED = np.radians(70.0), 400.0 * RPM
RANGE = CalibratedRange((2.0, 20.0), (np.radians(50.0), np.radians(80.0)), (350.0 * RPM, 450.0 * RPM), (13.0, 20.0))


@pytest.mark.parametrize(
    ("force", "angle", "speed", "moisture", "status"),
    [
        (100.0, ANGLE, SPEED, 15.0, FlowStatus.OK),
        (0.0, ANGLE, SPEED, 15.0, FlowStatus.NO_GRAIN),
        (-5.0, ANGLE, SPEED, 15.0, FlowStatus.NO_GRAIN),
        (10.0, ANGLE, SPEED, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (100.0, np.radians(85.0), SPEED, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (100.0, ANGLE, 300.0 * RPM, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (100.0, ANGLE, SPEED, 25.0, FlowStatus.OUTSIDE_CALIBRATION),
        (100.0, ANGLE, SPEED, 20.9, FlowStatus.OK),
        (100.0, ANGLE, SPEED, 21.1, FlowStatus.OUTSIDE_CALIBRATION),
        (100.0, ANGLE, SPEED, 12.1, FlowStatus.OK),
        (100.0, ANGLE, SPEED, 11.9, FlowStatus.OUTSIDE_CALIBRATION),
        (1e4, ANGLE, SPEED, 15.0, FlowStatus.SATURATED),
        (np.nan, ANGLE, SPEED, 15.0, FlowStatus.NOT_AVAILABLE),
        (np.inf, ANGLE, SPEED, 15.0, FlowStatus.NOT_AVAILABLE),
        (100.0, np.nan, SPEED, 15.0, FlowStatus.NOT_AVAILABLE),
        (100.0, ANGLE, np.nan, 15.0, FlowStatus.NOT_AVAILABLE),
        (100.0, ANGLE, 0.0, 15.0, FlowStatus.NOT_AVAILABLE),
        (100.0, ANGLE, -1.0, 15.0, FlowStatus.NOT_AVAILABLE),
        (100.0, 70.0, SPEED, 15.0, FlowStatus.NOT_AVAILABLE),
        (100.0, -4.0, SPEED, 15.0, FlowStatus.NOT_AVAILABLE),
    ],
)
def test_status(force: float, angle: float, speed: float, moisture: float, status: FlowStatus) -> None:
    found = loop(calibrated=RANGE).estimate(force, angle, speed, 0.5, moisture)
    assert FlowStatus(int(found.status)) is status
    known = status not in (FlowStatus.SATURATED, FlowStatus.NOT_AVAILABLE)
    assert np.isfinite(found.mass_flow_kg_s) == known
    assert np.isfinite(found.std_dev_kg_s) == known


@pytest.mark.parametrize("force", [-5.0, -1e-9, 0.0, 1e-9, 1e-3])
@pytest.mark.parametrize("effects", [(), ("zero_offset",), ("paddle_leakage",)], ids=str)
def test_no_flow_is_as_uncertain_as_next_to_none(force: float, effects: tuple[str, ...]) -> None:
    """0.5 N of noise on what thin loads make of a force, on either side of the empty reading."""
    values = GRAIN | {name: effect_parameter(name).typical for name in ForwardModel(MACHINE, effects).effect_parameters}
    model = ForwardModel(MACHINE, effects)
    thin = model.force(Conditions(ANGLE, SPEED, mass_flow_kg_s=np.array([0.0, 1e-4])), values)
    slope = float(np.diff(np.real(thin))[0] / 1e-4)
    found = OpenLoop(model, ParameterSet(values)).estimate(float(np.real(thin[0])) + force, ANGLE, SPEED, 0.5)
    assert found.std_dev_kg_s == pytest.approx(0.5 / slope, rel=2e-3)
    assert found.noise_std_dev_kg_s == pytest.approx(0.5 / slope, rel=2e-3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("angle", "speed"), [(70.0, SPEED), (ANGLE, 0.0), (ANGLE, -1.0), (np.nan, SPEED), (ANGLE, np.inf)])
def test_no_flow_of_an_angle_or_a_speed_that_cannot_be(angle: float, speed: float) -> None:
    flow = loop().invert([60.0, 60.0], [angle, ANGLE], [speed, SPEED])
    assert np.isnan(flow[0])
    assert flow[1] == loop().invert(60.0, ANGLE, SPEED)


@pytest.mark.parametrize("noise_n", [-1.0, np.nan, np.inf])
def test_no_flow_of_a_noise_that_cannot_be(noise_n: float) -> None:
    found = loop().estimate([60.0, 60.0], ANGLE, SPEED, [noise_n, 1.0])
    assert found.status.tolist() == [FlowStatus.NOT_AVAILABLE, FlowStatus.OK]
    assert np.isnan([found.mass_flow_kg_s[0], found.std_dev_kg_s[0], found.noise_std_dev_kg_s[0]]).all()


def test_no_rows_give_no_rows() -> None:
    assert loop().invert([], ANGLE, SPEED).shape == (0,)
    assert loop().estimate([], ANGLE, SPEED).status.shape == (0,)


def test_one_bad_row_does_not_spoil_the_others() -> None:
    force = np.array([50.0, np.nan, 1e5, 100.0])
    together = loop().estimate(force, ANGLE, SPEED, 1.0)
    for i in (0, 3):
        single = loop().estimate(force[i], ANGLE, SPEED, 1.0)
        assert together.mass_flow_kg_s[i] == pytest.approx(float(single.mass_flow_kg_s), rel=1e-12)


@pytest.mark.parametrize("effects", [(), ("gravity",), ("gravity", "paddle_leakage", "stream_spread")])
def test_no_row_depends_on_those_beside_it(effects: tuple[str, ...]) -> None:
    """To the last bit: a log estimated many windows at a time must give what a window alone gives."""
    values = GRAIN | {name: effect_parameter(name).typical for name in ForwardModel(MACHINE, effects).effect_parameters}
    parameters = ParameterSet(values, NAMES, np.diag([0.02, 0.03, 40.0]) ** 2)
    estimator = OpenLoop(ForwardModel(MACHINE, effects), parameters)
    rng = np.random.default_rng(20261121)
    count = 150
    force = rng.choice([np.nan, -3.0, 0.0, 1e4, *rng.uniform(0.01, 160.0, 60)], count)
    rows = (force, np.radians(rng.uniform(40.0, 90.0, count)), rng.uniform(250.0, 500.0, count) * RPM,
            rng.uniform(0.0, 3.0, count), rng.choice([np.nan, 12.0, 18.0], count))  # fmt: skip
    alone = [estimator.estimate(*(column[i : i + 1] for column in rows)) for i in range(count)]
    for size in (150, 61, 7):
        for first in range(0, count - size + 1, size):
            together = estimator.estimate(*(column[first : first + size] for column in rows))
            for name in ("mass_flow_kg_s", "std_dev_kg_s", "noise_std_dev_kg_s", "status"):
                expected = np.concatenate([getattr(one, name) for one in alone[first : first + size]])
                np.testing.assert_array_equal(getattr(together, name), expected)


def test_standard_deviation_matches_drawn_parameters_and_noise() -> None:
    rng = np.random.default_rng(3)
    sd = (0.02, 0.03, 40.0)
    force, noise = 60.0, 1.5
    estimate = loop(sd).estimate(force, ANGLE, SPEED, noise)
    count = 2000
    drawn = {n: GRAIN[n] + s * rng.normal(size=count) for n, s in zip(NAMES, sd, strict=True)}
    flows = np.array(
        [
            OpenLoop(ForwardModel(MACHINE), ParameterSet(GRAIN | {n: float(drawn[n][i]) for n in NAMES})).invert(
                force + noise * rng.normal(), ANGLE, SPEED
            )
            for i in range(200)
        ]
    )
    # 200 draws know a standard deviation to 5 %.
    assert flows.std() == pytest.approx(float(estimate.std_dev_kg_s), rel=0.15)


def test_the_window_s_own_noise_is_separated_from_the_parameters() -> None:
    noise_only = loop((0.0, 0.0, 0.0)).estimate(60.0, ANGLE, SPEED, 1.5)
    both = loop((0.02, 0.03, 40.0)).estimate(60.0, ANGLE, SPEED, 1.5)
    parameters_only = loop((0.02, 0.03, 40.0)).estimate(60.0, ANGLE, SPEED)
    assert both.noise_std_dev_kg_s == pytest.approx(noise_only.std_dev_kg_s)
    assert parameters_only.noise_std_dev_kg_s == 0.0
    assert both.std_dev_kg_s == pytest.approx(np.hypot(noise_only.std_dev_kg_s, parameters_only.std_dev_kg_s))


def test_correlated_parameters_count_their_correlation() -> None:
    # Density and 1 + e that move against each other along the scale direction leave the force of a thin load as uncertain as e.
    covariance = np.diag([0.0, 0.06**2, 110.0**2])
    covariance[1, 2] = covariance[2, 1] = -0.999 * 0.06 * 110.0
    alone = loop((0.0, 0.06, 110.0)).estimate(150.0, ANGLE, SPEED)
    both = OpenLoop(ForwardModel(MACHINE), ParameterSet(GRAIN, NAMES, covariance)).estimate(150.0, ANGLE, SPEED)
    assert abs(float(both.std_dev_kg_s) / float(alone.std_dev_kg_s) - 1.0) > 0.02


def test_effects_of_model_and_parameters_must_agree() -> None:
    with pytest.raises(ValueError, match="effects"):
        OpenLoop(ForwardModel(MACHINE, ("gravity",)), ParameterSet(GRAIN))


def test_an_effect_that_needs_moisture_gives_no_estimate_without_it():
    from yieldmon.physics.machine import RPM, Machine
    from yieldmon.physics.model import ForwardModel

    values = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.5}
    values |= {f"moisture_dependence.{n}_per_pct": v for n, v in (("friction", 0.03), ("restitution", -0.01), ("density", 0.0))}
    loop = OpenLoop(ForwardModel(Machine(), ("moisture_dependence",)), ParameterSet(values))
    found = loop.estimate([80.0, 80.0], np.radians(70.0), 400.0 * RPM, 1.0, [np.nan, 18.0])
    assert list(found.status) == [FlowStatus.NOT_AVAILABLE, FlowStatus.OK]
    assert np.isnan(found.mass_flow_kg_s[0])


def test_a_speed_in_rpm_gives_no_flow() -> None:
    """400 rpm are 42 rad/s: taken for rad/s they would be a tenth of the flow."""
    found = OpenLoop(ForwardModel(MACHINE), ParameterSet(GRAIN)).estimate([60.0, 60.0], np.radians(70.0), [400.0, 400.0 * RPM])
    assert found.status.tolist() == [FlowStatus.NOT_AVAILABLE, FlowStatus.OK]
    assert np.isnan(found.mass_flow_kg_s).tolist() == [True, False]


def test_shapes_that_do_not_broadcast_are_named() -> None:
    with pytest.raises(
        ValueError, match=r"inputs: shapes force_n \(3,\), plate_angle_rad \(2,\): expected shapes that broadcast"
    ):
        loop().estimate([1.0, 2.0, 3.0], [1.0, 1.2], 40.0)


def test_parameters_are_a_parameter_set() -> None:
    values = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
    with pytest.raises(ValueError, match=r"^parameters: is of type dict; expected a ParameterSet"):
        OpenLoop(ForwardModel(Machine()), values)  # type: ignore[arg-type]
