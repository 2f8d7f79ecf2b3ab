"""The forward model against the published table, an independent quadrature, and what must hold for any grain."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import quadrature
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects import get_effect
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
MODEL = ForwardModel(MACHINE)
PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "published_tables.yaml").read_text())
GRAIN = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
FULL_KG = 0.5 * 2.0 * 1100.0 * 0.21 * 0.16**2
ROUNDING = 0.005

grains = st.fixed_dictionaries(
    {
        "friction": st.floats(0.0, 1.0),
        "restitution": st.floats(0.0, 1.0),
        "density": st.floats(750.0, 2000.0),
        "shape_ratio": st.floats(1.2, 2.6),
    }
)
angles = st.floats(np.radians(40.0), np.radians(90.0))
speeds = st.floats(300.0 * RPM, 500.0 * RPM)
fills = st.floats(1e-4, 1.0)


def momentum(mass_kg, angle, speed, values, model=MODEL):  # type: ignore[no-untyped-def]
    return np.real(model.paddle_momentum(Conditions(angle, speed, paddle_mass_kg=mass_kg), values))


def full(values: dict[str, float]) -> float:
    return 0.5 * values["shape_ratio"] * values["density"] * MACHINE.paddle_width_m * MACHINE.paddle_length_m**2


def test_all_88_values_of_the_published_table_within_0_4_per_cent_beyond_their_printed_digits() -> None:
    table = PUBLISHED["generated_momentum"]
    angle = np.radians(np.array(table["plate_angle_deg"], dtype=float))
    flows = [key for key in table if key != "plate_angle_deg"]
    printed = np.array([table[flow] for flow in flows])
    # The table was made with the mean spacing of 0.18635 m and V = 2.27 m/s.
    mass = np.array(flows, dtype=float)[:, None] * 0.18635 / (400.0 * RPM * 0.0541)
    ours = momentum(mass, angle, 400.0 * RPM, GRAIN)
    beyond = np.maximum(np.abs(ours - printed) - ROUNDING, 0.0) / printed
    assert printed.size == 88
    assert 100.0 * beyond.max() < 0.4


@pytest.mark.parametrize("flow", [2.0, 9.0, 15.0, 25.0])
def test_table_cells_match_adaptive_quadrature(flow: float) -> None:
    mass = flow * 0.18635 / (400.0 * RPM * 0.0541)
    for degrees in (40, 45, 55, 65, 70, 80, 90):
        expected = quadrature.paddle_momentum(mass, np.radians(degrees), 400.0 * RPM, 0.2, 0.6, 1100.0, 2.0)
        assert momentum(mass, np.radians(degrees), 400.0 * RPM, GRAIN) == pytest.approx(expected, rel=1e-7)


@settings(max_examples=40)
@given(grains, angles, speeds, st.floats(0.005, 0.97))
def test_any_grain_matches_adaptive_quadrature(values: dict[str, float], angle: float, speed: float, fill: float) -> None:
    mass = fill * full(values)
    expected = quadrature.paddle_momentum(mass, angle, speed, **values)
    assert momentum(mass, angle, speed, values) == pytest.approx(expected, rel=1e-7)


@settings(max_examples=60)
@given(grains, angles, speeds, fills, st.floats(0.5, 1.9))
def test_scale_of_flow_density_and_gain_is_unobservable(
    values: dict[str, float], angle: float, speed: float, fill: float, factor: float
) -> None:
    gain = {k: v for k, v in values.items() if k != "restitution"} | {"k1": 0.4, "k2": 1.0 + values["restitution"]}
    moved = dict(gain, density=factor * gain["density"], k1=gain["k1"] / factor, k2=gain["k2"] / factor)
    mass = fill * full(values)
    assert momentum(factor * mass, angle, speed, moved) == pytest.approx(momentum(mass, angle, speed, gain), rel=1e-12)


@settings(max_examples=60)
@given(grains, angles, speeds, fills)
def test_momentum_goes_as_speed_and_never_above_what_the_load_carries(
    values: dict[str, float], angle: float, speed: float, fill: float
) -> None:
    mass = fill * full(values)
    value = momentum(mass, angle, speed, values)
    assert momentum(mass, angle, 2.0 * speed, values) == pytest.approx(2.0 * value, rel=1e-12)
    # A grain's speed at the tip is at most sqrt(2) times the tip's.
    assert 0.0 <= value <= (1.0 + values["restitution"]) * np.sqrt(2.0) * mass * MACHINE.paddle_length_m * speed


@settings(max_examples=40)
@given(grains, angles, speeds)
def test_more_load_never_gives_less_force(values: dict[str, float], angle: float, speed: float) -> None:
    loads = np.linspace(0.0, full(values), 40)
    curve = momentum(loads, angle, speed, values)
    assert curve[0] == 0.0
    assert np.all(np.diff(curve) >= -1e-12 * curve.max())


def test_exchange_coefficients_without_slope_are_one_plus_restitution() -> None:
    exchange = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "k1": 0.0, "k2": 1.6}
    loads = np.linspace(0.01, 3.0, 7)
    assert momentum(loads, 1.2, 42.0, exchange) == pytest.approx(momentum(loads, 1.2, 42.0, GRAIN), rel=1e-15)


def test_exchange_gain_is_linear_in_fill() -> None:
    values = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "k1": 1.5, "k2": 0.6}
    loads = np.array([0.1, 1.0, 4.0])
    gain = 1.5 * loads / FULL_KG + 0.6
    assert momentum(loads, 1.2, 42.0, values) == pytest.approx(gain / 1.6 * momentum(loads, 1.2, 42.0, GRAIN), rel=1e-13)


def test_exchange_gain_goes_by_what_the_paddle_still_carries() -> None:
    """With a load of half a paddle offered and a loss of 0.4 at full fill, a share 1 / 1.2 of it arrives."""
    leaky, offered = ForwardModel(MACHINE, ("paddle_leakage",)), 0.5 * FULL_KG
    grain = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "paddle_leakage.loss_at_full": 0.4}
    conditions = Conditions(1.2, 400.0 * RPM, paddle_mass_kg=offered)
    unit = leaky.paddle_momentum(conditions, grain | {"k1": 0.0, "k2": 1.0})
    found = leaky.paddle_momentum(conditions, grain | {"k1": 1.5, "k2": 0.6})
    assert found == pytest.approx((1.5 * 0.5 / 1.2 + 0.6) * unit, rel=1e-12)


def test_force_is_momentum_times_paddle_passes_and_flow_is_mass_times_passes() -> None:
    conditions = Conditions(1.2, 42.0, mass_flow_kg_s=10.0)
    passes = 42.0 * 0.0541 / MACHINE.paddle_spacing_m
    by_mass = momentum(10.0 / passes, 1.2, 42.0, GRAIN)
    assert np.real(MODEL.force(conditions, GRAIN)) == pytest.approx(by_mass * passes, rel=1e-14)


def test_broadcasting_gives_what_single_calls_give() -> None:
    flow, angle, friction = np.array([1.0, 8.0, 20.0]), np.radians([40.0, 70.0]), np.array([0.0, 0.3, 0.8, 1.0])
    together = MODEL.force(Conditions(angle[:, None], 42.0, mass_flow_kg_s=flow[:, None, None]), dict(GRAIN, friction=friction))
    assert together.shape == (3, 2, 4)
    for i, j, k in np.ndindex(3, 2, 4):
        single = MODEL.force(Conditions(angle[j], 42.0, mass_flow_kg_s=flow[i]), dict(GRAIN, friction=friction[k]))
        assert together[i, j, k] == pytest.approx(single, rel=1e-13)


@pytest.mark.parametrize("excess", [1.001, 3.0])
def test_a_load_above_a_full_paddle_is_refused_with_both_numbers(excess: float) -> None:
    with pytest.raises(ValueError, match=rf"load of {excess * FULL_KG:.6g} kg a paddle: expected 0 to {FULL_KG:.6g} kg"):
        momentum(excess * FULL_KG, 1.2, 42.0, GRAIN)
    conditions = Conditions(1.2, 42.0, paddle_mass_kg=np.array([1.0, excess * FULL_KG]))
    value = MODEL.paddle_momentum(conditions, GRAIN, overfull="nan")
    assert np.isfinite(value[0])
    assert np.isnan(value[1])


@pytest.mark.parametrize(
    ("angle", "speed", "message"),
    [
        (70.0, 42.0, r"plate_angle_rad 70: expected radians"),
        ([1.2, -4.0], 42.0, r"plate_angle_rad -4: expected radians"),
        (1.2, 0.0, r"elevator_speed_rad_s 0: expected rad/s above 0"),
        (1.2, np.array([42.0, -1.0]), r"elevator_speed_rad_s -1: expected rad/s above 0"),
        (1.2, 400.0, r"elevator_speed_rad_s 400: expected at most 199 rad/s; one rpm is 0\.1047 rad/s"),
        (1.2, np.inf, r"elevator_speed_rad_s inf: expected at most 199 rad/s"),
    ],
)
def test_an_angle_or_a_speed_that_cannot_be_is_refused(angle: float, speed: float, message: str) -> None:
    conditions = Conditions(angle, speed, mass_flow_kg_s=10.0)
    for reading in (MODEL.force, MODEL.paddle_momentum):
        with pytest.raises(ValueError, match=message):
            reading(conditions, GRAIN)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda at: MODEL.force(at, GRAIN, overfull="nans"), "overfull 'nans': expected 'raise' or 'nan'"),
        (
            lambda at: MODEL.derivatives(at, GRAIN, ["density"], of="forse"),
            "derivatives of 'forse': expected 'momentum' or 'force'",
        ),
        (lambda at: MODEL.force(at, GRAIN | {"gravity.acceleration_m_s2": 9.81}), "gravity.*does not have this effect"),
        (lambda at: MODEL.paddle_momentum(at, GRAIN | {"gravity.acceleration_m_s2": 9.81}), "gravity.*does not have this effect"),
    ],
)
def test_a_question_that_means_something_else_is_refused(ask: Callable[[Conditions], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask(Conditions(1.2, 42.0, mass_flow_kg_s=10.0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"friction": -0.2}, r"parameters: friction -0\.2: expected 0 to 5$"),
        ({"friction": np.nan}, r"parameters: friction nan: expected 0 to 5$"),
        ({"friction": [0.2, 1e6]}, r"parameters: friction 1e\+06: expected 0 to 5$"),
        ({"friction": "0.2"}, r"parameters: friction: '0\.2': expected numbers$"),
        ({"friction": None}, r"parameters: friction: None: expected numbers$"),
        ({"density": -1100.0}, r"parameters: density -1100: expected 1 to 20000 kg/m3$"),
        ({"restitution": -2.0}, r"parameters: restitution -2: expected -1 to inf$"),
        ({"shape_ratio": 0.0}, r"parameters: shape_ratio 0: expected 0\.05 to 6$"),
        ({"frction": 0.3}, r"parameters: frction: unknown; expected some of friction, density"),
        (
            {"friction": np.full(2, 0.3), "density": np.full(3, 1100.0)},
            r"shapes friction \(2,\), density \(3,\): expected shapes that",
        ),
    ],
)
def test_grain_that_cannot_be_is_refused(values: dict[str, object], message: str) -> None:
    conditions = Conditions(1.2, 42.0, mass_flow_kg_s=1.0)
    for reading in (MODEL.force, MODEL.paddle_momentum):
        with pytest.raises(ValueError, match=message):
            reading(conditions, GRAIN | values)


def test_parameters_are_values_by_name() -> None:
    conditions = Conditions(1.2, 42.0, mass_flow_kg_s=1.0)
    with pytest.raises(ValueError, match=r"^parameters: is of type ParameterSet; expected values by name, such as the `values`"):
        MODEL.force(conditions, ParameterSet(values=GRAIN))  # type: ignore[arg-type]


def test_an_unknown_parameter_of_an_own_effect_is_refused() -> None:
    model = MODEL.with_effects(["gravity"])
    values = GRAIN | {"gravity.acceleration_m_s2": 9.81, "gravity.acceleration": 3.7}
    with pytest.raises(ValueError, match=r"gravity\.acceleration: unknown; expected some of .*gravity\.acceleration_m_s2"):
        model.force(Conditions(1.2, 42.0, mass_flow_kg_s=1.0), values)


def test_conditions_that_do_not_broadcast_are_named() -> None:
    conditions = Conditions([1.0, 1.1], 42.0, mass_flow_kg_s=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"plate_angle_rad \(2,\), mass_flow_kg_s \(3,\): expected shapes that broadcast"):
        MODEL.force(conditions, GRAIN)


def test_a_negative_load_is_refused() -> None:
    with pytest.raises(ValueError, match=r"load of -0\.1 kg"):
        momentum(-0.1, 1.2, 42.0, GRAIN)


def test_a_full_paddle_to_the_last_digit_is_a_load() -> None:
    assert np.isfinite(momentum(FULL_KG, 1.2, 42.0, GRAIN))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"friction": 0.2, "density": 1e3, "shape_ratio": 2.0}, "either restitution, or k1 and k2"),
        (dict(GRAIN, k1=1.0, k2=1.0), "either restitution, or k1 and k2"),
        ({"friction": 0.2, "restitution": 0.5, "shape_ratio": 2.0}, "density is missing"),
    ],
)
def test_incomplete_parameters_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        momentum(1.0, 1.2, 42.0, values)


CASES = [
    pytest.param((), GRAIN, id="published, 1 + e"),
    pytest.param((), {"friction": 0.4, "density": 1500.0, "shape_ratio": 1.8, "k1": 1.2, "k2": 0.6}, id="published, k1 k2"),
    pytest.param(("gravity",), dict(GRAIN, **{"gravity.acceleration_m_s2": 9.81}), id="gravity"),
    pytest.param(("zero_offset",), dict(GRAIN, **{"zero_offset.force_n": 2.0}), id="zero offset"),
]


@pytest.mark.parametrize(("effects", "values"), CASES)
def test_derivatives_match_a_high_order_difference(effects: tuple[str, ...], values: dict[str, float]) -> None:
    model = ForwardModel(MACHINE, effects, nodes=40)
    flow, angle = np.array([1.0, 4.0, 15.0, 24.0])[:, None], np.radians([41.0, 57.0, 70.0, 88.0])
    names = (*values, "mass_flow_kg_s")
    conditions = Conditions(angle, 400.0 * RPM, mass_flow_kg_s=flow)
    value, slopes = model.derivatives(conditions, values, names, of="force")
    assert value == pytest.approx(np.real(model.force(conditions, values)), rel=1e-14)
    for j, name in enumerate(names):
        here = flow if name == "mass_flow_kg_s" else values[name]

        def at(shift, name=name, here=here):  # type: ignore[no-untyped-def]
            if name == "mass_flow_kg_s":
                return np.real(model.force(Conditions(angle, 400.0 * RPM, mass_flow_kg_s=here + shift), values))
            return np.real(model.force(conditions, dict(values, **{name: here + shift})))

        step = 1e-3 * np.maximum(np.abs(here), 0.05)
        # Eighth-order central difference.
        weights = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
        expected = sum(w * (at((k + 1) * step) - at(-(k + 1) * step)) for k, w in enumerate(weights)) / step
        scale = np.max(np.abs(expected)) + 1e-9 * np.max(value)
        assert slopes[..., j] == pytest.approx(expected, rel=1e-6, abs=1e-7 * scale), name


@settings(max_examples=40)
@given(grains, angles, speeds, fills)
def test_effects_at_nothing_change_nothing(values: dict[str, float], angle: float, speed: float, fill: float) -> None:
    model = ForwardModel(MACHINE, ("gravity", "zero_offset"))
    still = dict(values, **{"gravity.acceleration_m_s2": 0.0, "zero_offset.force_n": 0.0})
    mass = fill * full(values)
    assert momentum(mass, angle, speed, still, model) == pytest.approx(momentum(mass, angle, speed, values), rel=1e-9)


def test_gravity_matters_less_the_faster_the_elevator() -> None:
    model = ForwardModel(MACHINE, ("gravity",))
    heavy = dict(GRAIN, **{"gravity.acceleration_m_s2": 9.81})
    speed = np.array([250.0, 400.0, 450.0, 1800.0]) * RPM
    change = np.abs(momentum(0.8, np.radians(45.0), speed, heavy, model) / momentum(0.8, np.radians(45.0), speed, GRAIN) - 1.0)
    assert np.all(np.diff(change) < 0.0)
    # The gravity number falls with the square of the speed.
    assert change[2] / change[3] == pytest.approx(16.0, rel=0.1)


def test_zero_offset_adds_the_same_force_everywhere() -> None:
    model = ForwardModel(MACHINE, ("zero_offset",))
    flow, speed = np.array([0.0, 5.0, 20.0]), np.array([32.0, 42.0, 52.0])
    conditions = Conditions(np.radians([40.0, 65.0, 90.0]), speed, mass_flow_kg_s=flow)
    offset = np.real(model.force(conditions, dict(GRAIN, **{"zero_offset.force_n": 2.5})) - MODEL.force(conditions, GRAIN))
    assert offset == pytest.approx(2.5, rel=1e-12)


@pytest.mark.parametrize(("lowest", "highest", "limit"), [(1.95, 2.05, 2e-8), (1.0, 2.2, 1e-6), (1.0, 4.0, 5e-5)])
def test_the_default_order_of_the_quadrature_is_as_right_as_stated(lowest: float, highest: float, limit: float) -> None:
    rng, count = np.random.default_rng(7), 4000
    parameters = {
        "friction": rng.uniform(0.0, 1.0, count),
        "density": 1100.0,
        "shape_ratio": rng.uniform(lowest, highest, count),
        "restitution": 0.5,
    }
    full_kg = 0.5 * parameters["shape_ratio"] * 1100.0 * MACHINE.paddle_width_m * MACHINE.paddle_length_m**2
    at = Conditions(
        np.radians(rng.uniform(40.0, 90.0, count)), 400.0 * np.pi / 30.0, paddle_mass_kg=rng.uniform(0.001, 0.99, count) * full_kg
    )
    here, fine = (ForwardModel(MACHINE, **order).paddle_momentum(at, parameters) for order in ({}, {"nodes": 200}))
    assert np.max(np.abs(here / fine - 1.0)) < limit


def test_effects_are_given_by_name() -> None:
    with pytest.raises(ValueError, match=r"effects\[0\]: is of type Effect; expected names"):
        ForwardModel(MACHINE, (get_effect("gravity"),))  # type: ignore[arg-type]
    assert ForwardModel(MACHINE, "gravity").effects == ("gravity",)
