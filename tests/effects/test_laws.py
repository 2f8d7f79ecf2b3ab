"""Every further law of an effect: nothing at its null value, a smooth change beyond, and a family that exists."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from yieldmon.physics.effects import effect_parameter, family_of, get_effect, laws, registry
from yieldmon.physics.effects.stream_spread import even_and_normal
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP

FURTHER = tuple(law for name in registry() for law in laws(name, unsearched=True)[1:])
GRAIN = {"friction": 0.3, "density": 1150.0, "shape_ratio": 2.0, "restitution": 0.5, "gravity.acceleration_m_s2": 9.81}
ANGLE, SPEED, FLOW = np.meshgrid(
    np.radians([40.0, 55.0, 70.0, 90.0]), np.array([340.0, 460.0]) * RPM, [2.0, 8.0, 16.0], indexing="ij"
)
CONDITIONS = Conditions(ANGLE.ravel(), SPEED.ravel(), mass_flow_kg_s=FLOW.ravel())


def _force(name: str, sizes: dict[str, complex]) -> np.ndarray:
    effects = ("gravity", name) if name else ("gravity",)
    return np.asarray(ForwardModel(Machine(), effects).force(CONDITIONS, GRAIN | sizes, overfull="nan"))


def _sizes(name: str, kind: str) -> dict[str, float]:
    return {f"{name}.{p.name}": getattr(p, kind) for p in get_effect(name).parameters}


def test_there_are_some() -> None:
    assert len(FURTHER) >= 10


@pytest.mark.parametrize("name", FURTHER)
def test_a_law_belongs_to_an_effect_and_says_how_it_differs(name: str) -> None:
    law = get_effect(name)
    assert law.family == family_of(name)
    assert law.family in registry()
    assert name not in registry()
    assert law.law
    assert law.stage == registry()[law.family].stage
    assert law.source != registry()[law.family].source


@pytest.mark.parametrize("name", FURTHER)
def test_nothing_at_its_null_and_something_at_its_typical_size(name: str) -> None:
    plain = _force("", {})
    np.testing.assert_allclose(_force(name, _sizes(name, "null")), plain, rtol=1e-6)
    changed = _force(name, _sizes(name, "typical"))
    assert np.nanmax(np.abs(changed - plain)) > 0.003 * np.nanmax(plain)
    other = _force(family_of(name), _sizes(family_of(name), "typical"))
    assert not np.allclose(changed, other, rtol=1e-3)


@pytest.mark.parametrize("name", FURTHER)
def test_its_derivative_is_the_one_of_differences(name: str) -> None:
    sizes = _sizes(name, "typical")
    (leading, *_) = sizes
    step = 1e-5 * sizes[leading]
    up, down = _force(name, sizes | {leading: sizes[leading] + step}), _force(name, sizes | {leading: sizes[leading] - step})
    slope = np.imag(_force(name, sizes | {leading: sizes[leading] + 1j * COMPLEX_STEP})) / COMPLEX_STEP
    scale = np.nanmax(np.abs(slope))
    np.testing.assert_allclose(slope / scale, (up - down) / (2.0 * step) / scale, atol=2e-3)


FREE = {
    "paddle_leakage-by_powers": ("paddle_leakage", {"loss_at_full": 0.4}, {"fill_power": 1.0, "time_power": 1.0}),
    "cell_nonlinearity-by_power": ("cell_nonlinearity", {"softening_per_n": 0.002}, {"power": 1.0}),
    "resting_grain-leaning": ("resting_grain", {"time_s": 0.1}, {"leaning": 1.0, "slope_power": 2.0}),
    "miss_capture-fading": ("miss_capture-any_incidence", {"share": 0.4}, {"reach_m": 1e6}),
    "unpushed_layers-gradual": ("unpushed_layers", {"rate_per_rad": 2.0}, {"steepness": 1.0, "drawn_along": 0.5}),
    "stream_rise-by_power": ("stream_rise", {"ratio": 0.1}, {"depth_power": 1.0, "edge_m": 0.01}),
    "speed_dependent_restitution-by_power": ("speed_dependent_restitution", {"exponent": 0.3}, {"power": 0.0}),
    "speed_dependent_shape-by_power": ("speed_dependent_shape", {"exponent": -0.8}, {"power": 0.0}),
    "jet_shielding-in_part": ("", {"most": 1.0}, {"depth_m": 1e-9}),
    "stream_spread-even": ("stream_spread", {"spread_rad": 0.12}, {"evenness": 1e-4}),
}
"""Laws of a free shape: the law that each is at some shape, the size, and that shape."""


@pytest.mark.parametrize("name", FREE)
def test_a_law_of_free_shape_is_another_one_at_some_shape(name: str) -> None:
    other, size, shape = FREE[name]
    freely = _force(name, {f"{name}.{key}": value for key, value in (size | shape).items()})
    if other:
        expected = _force(other, {f"{other}.{key}": value for key, value in size.items()})
    else:
        model = ForwardModel(Machine(), ("gravity",))
        expected = np.asarray(model.force(CONDITIONS, GRAIN | {"restitution": 0.0}, overfull="nan"))
    np.testing.assert_allclose(freely, expected, rtol=2e-6)


@pytest.mark.parametrize("name", FREE)
def test_a_law_of_free_shape_is_silent_beside_exchange_coefficients(name: str) -> None:
    grain = {k: v for k, v in GRAIN.items() if k != "restitution"} | {"k1": -0.2, "k2": 1.5}
    model = ForwardModel(Machine(), ("gravity", name))
    plain = np.asarray(ForwardModel(Machine(), ("gravity",)).force(CONDITIONS, grain, overfull="nan"))
    changed = np.asarray(model.force(CONDITIONS, grain | _sizes(name, "typical"), overfull="nan"))
    np.testing.assert_allclose(changed, plain, rtol=1e-12)


@pytest.mark.parametrize("evenness", [0.05, 0.5, 0.98])
@pytest.mark.parametrize("edge_rad", [-0.17, -0.05, 0.0, 0.1, 0.4])
def test_a_fan_between_even_and_normal_has_the_moments_of_their_sum(evenness: float, edge_rad: float) -> None:
    """Share, mean and variance of the directions below an edge, by quadrature of the sum's density."""
    sd = 0.1
    half, soft = sd * np.sqrt(3.0 * evenness), sd * np.sqrt(1.0 - evenness)

    def moment(power: int) -> float:
        def inside(x: float) -> float:
            density = (stats.norm.cdf((x + half) / soft) - stats.norm.cdf((x - half) / soft)) / (2.0 * half)
            return float(x**power * density)

        breaks = [x for x in (-half, half) if x < edge_rad]
        return float(integrate.quad(inside, -1.0, edge_rad, points=breaks, limit=400)[0])

    share = moment(0)
    mean = moment(1) / share
    found = even_and_normal(*(np.asarray([value]) for value in (edge_rad, sd, evenness)))
    expected = (share, mean, moment(2) / share - mean**2)
    np.testing.assert_allclose([part[0] for part in found], expected, rtol=1e-4, atol=1e-8)


def test_a_law_that_is_searched_no_more_is_still_understood() -> None:
    name = "stream_spread-both_edges"
    assert name not in laws("stream_spread")
    assert name in laws("stream_spread", unsearched=True)
    assert effect_parameter(f"{name}.spread_rad").unit == "rad"


def test_an_orifice_and_a_weir_lose_by_their_powers_of_fill() -> None:
    """Share lost over share kept, of paddles half and wholly filled: 2 to the power of fill."""
    name = "paddle_leakage-by_powers"
    machine = Machine()
    full = 0.5 * GRAIN["shape_ratio"] * GRAIN["density"] * machine.paddle_width_m * machine.paddle_length_m**2
    for power in (0.0, 1.5):
        values = GRAIN | {f"{name}.loss_at_full": 0.2, f"{name}.fill_power": power, f"{name}.time_power": 1.0}
        throw = ForwardModel(machine, ("gravity", name)).throw(1.2, machine.nominal_elevator_speed_rad_s, values)
        half, whole = (0.0 + offered / float(throw.load_mass(np.asarray(offered))) - 1.0 for offered in (0.5 * full, full))
        assert whole == pytest.approx(0.2, rel=1e-6)
        assert whole / half == pytest.approx(2.0**power, rel=1e-6)


@pytest.mark.parametrize("bend", [-3.0, 1.0, 4.0])
def test_a_shape_by_a_power_of_speed_is_that_heap_at_every_speed(bend: float) -> None:
    """log shape ratio = exponent (s^p - 1) / p, by hand: at each speed the heap of that ratio."""
    name, exponent = "speed_dependent_shape-by_power", -0.9
    freely = _force(name, {f"{name}.exponent": exponent, f"{name}.power": bend})
    for rpm in (340.0, 460.0):
        at = np.isclose(CONDITIONS.elevator_speed_rad_s, rpm * RPM)
        ratio = GRAIN["shape_ratio"] * np.exp(exponent * ((rpm / 400.0) ** bend - 1.0) / bend)
        model = ForwardModel(Machine(), ("gravity",))
        expected = np.asarray(model.force(CONDITIONS, GRAIN | {"shape_ratio": ratio}, overfull="nan"))
        np.testing.assert_allclose(freely[at], expected[at], rtol=1e-6)
