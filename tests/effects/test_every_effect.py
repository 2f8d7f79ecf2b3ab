"""What must hold for each registered effect: null value, bounds, conservation, derivatives, company of others."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from yieldmon.physics.effects import registry
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

NAMES = tuple(registry())
REQUIRED = {
    "paddle_leakage", "chain_slip", "paddle_wear", "residual_radial_speed", "speed_dependent_shape", "release_angle",
    "gravity", "air_drag", "stream_spread", "miss_capture", "plate_overshoot", "plate_friction", "jet_shielding",
    "speed_dependent_restitution", "secondary_impact", "resting_grain", "zero_offset", "plate_angle_offset", "lever_arm",
    "cell_nonlinearity", "plate_buildup", "moisture_dependence", "unpushed_layers", "stream_rise", "top_edge",
    "speed_dependent_friction",
}  # fmt: skip
MACHINE = Machine()
GRAIN = {"friction": 0.3, "density": 1200.0, "shape_ratio": 2.0}
FORMS = {"restitution": {"restitution": 0.6}, "exchange": {"k1": -0.2, "k2": 1.5}}
ANGLES, LOADS, SPEEDS = np.meshgrid(np.radians([42.0, 58.0, 74.0, 88.0]), [0.1, 0.6, 1.5, 3.0], np.array([330.0, 470.0]) * RPM)
CONDITIONS = Conditions(ANGLES, SPEEDS, paddle_mass_kg=LOADS, moisture_pct=np.full(ANGLES.shape, 21.0))


def values_of(name: str, kind: str) -> dict[str, float]:
    return {f"{name}.{p.name}": getattr(p, kind) for p in registry()[name].parameters}


def momentum(names: tuple[str, ...], extra: dict[str, float], form: str = "restitution") -> np.ndarray:
    return ForwardModel(MACHINE, names).paddle_momentum(CONDITIONS, GRAIN | FORMS[form] | extra, overfull="nan")


def test_the_agreed_names_are_there() -> None:
    assert set(NAMES) >= REQUIRED


@pytest.mark.parametrize("name", NAMES)
def test_description_is_whole(name: str) -> None:
    effect = registry()[name]
    assert effect.name == name
    assert effect.stage in ("fill", "settle", "release", "flight", "impact", "sensor", "crop")
    assert all((effect.summary, effect.signature, effect.source, effect.parameters))
    for p in effect.parameters:
        assert p.lower <= p.null <= p.upper
        assert p.lower <= p.typical <= p.upper
        assert p.typical != p.null
        assert p.prior_sd > 0.0


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", NAMES)
def test_null_value_gives_the_published_model(name: str, form: str) -> None:
    base = momentum((), {}, form)
    np.testing.assert_allclose(momentum((name,), values_of(name, "null"), form), base, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("name", NAMES)
def test_typical_value_matters(name: str) -> None:
    base = momentum((), {})
    change = momentum((name,), values_of(name, "typical")) - base
    assert np.nanmax(np.abs(change)) > 0.005 * np.nanmax(base)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", NAMES)
def test_complex_step_is_the_derivative(name: str, form: str) -> None:
    model = ForwardModel(MACHINE, (name,))
    values = GRAIN | FORMS[form] | values_of(name, "typical")
    names = [*GRAIN, *values_of(name, "typical")]
    _, jacobian = model.derivatives(CONDITIONS, values, names)
    for column, key in enumerate(names):
        step = 1e-6 * abs(values[key])
        up = model.paddle_momentum(CONDITIONS, values | {key: values[key] + step}, overfull="nan")
        down = model.paddle_momentum(CONDITIONS, values | {key: values[key] - step}, overfull="nan")
        scale = np.nanmax(np.abs(jacobian[..., column]))
        np.testing.assert_allclose(jacobian[..., column], (up - down) / (2.0 * step), rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("kind", ["lower", "typical", "upper"])
@pytest.mark.parametrize("name", NAMES)
def test_mass_is_kept_and_no_impact_is_more_than_elastic(name: str, kind: str) -> None:
    model = ForwardModel(MACHINE, (name,))
    values = GRAIN | FORMS["restitution"] | values_of(name, kind)
    throw = model.throw(ANGLES, SPEEDS, values, CONDITIONS.moisture_pct)
    offered = LOADS
    reading = throw.reading(offered)
    impulse = reading.impulse
    arrival = impulse.arrival
    fits = np.isfinite(reading.momentum_kg_m_s)
    assert np.any(fits)
    assert np.all(arrival.jet.load.paddle_mass_kg <= offered[..., None] * (1.0 + 1e-12))
    share = np.broadcast_to(arrival.landing_share, arrival.jet.mass_kg.shape)
    assert np.all((share >= 0.0) & (share <= 1.0 + 1e-12))
    # Shape ratios far above 2 fold the heap's inner surface, where the quadrature holds 0.2 % only.
    landed = np.sum(np.where(fits, arrival.jet.mass_kg * share, 0.0), axis=-1)
    assert np.all(landed <= np.where(fits[..., 0], offered, 0.0) * 1.002)
    gain = np.where(fits & (share > 0.0), impulse.normal_gain, 1.0)
    assert np.all((gain >= 1.0 - 1e-12) & (gain <= 2.0 + 1e-12))
    drag = np.broadcast_to(np.abs(impulse.tangential_m_s), gain.shape)
    assert np.all(np.where(fits & (share > 0.0), drag <= np.abs(arrival.tangential_speed_m_s) * (1.0 + 1e-12), True))
    speed = np.hypot(arrival.normal_speed_m_s, arrival.tangential_speed_m_s)
    fastest = np.hypot(1.0, 1.0) * MACHINE.paddle_length_m * SPEEDS[..., None]
    if registry()[name].stage not in ("flight", "release"):
        assert np.all(np.where(fits & (share > 0.0), speed <= fastest * (1.0 + 1e-9), True))


@pytest.mark.parametrize("name", [n for n in NAMES if registry()[n].stage == "flight" and n != "gravity"])
def test_flight_gives_no_grain_more_momentum(name: str) -> None:
    model = ForwardModel(MACHINE, tuple({"miss_capture", name}))
    values = GRAIN | FORMS["restitution"] | {"miss_capture.share": 1.0} | values_of(name, "upper")
    throw = model.throw(ANGLES, SPEEDS, values, CONDITIONS.moisture_pct)
    arrival = throw.reading(LOADS).impulse.arrival
    arrives = arrival.landing_share > 0.0
    released_m_s = np.hypot(arrival.jet.vx_m_s, arrival.jet.vy_m_s)
    arrives_m_s = np.hypot(arrival.normal_speed_m_s, arrival.tangential_speed_m_s)
    assert np.any(arrives)
    assert np.all(np.where(arrives, arrives_m_s, 0.0) <= released_m_s * (1.0 + 1e-9))
    assert np.all((arrival.landing_share >= 0.0) & (arrival.landing_share <= 1.0 + 1e-12))


@pytest.mark.parametrize("pair", list(combinations(NAMES, 2)), ids="+".join)
def test_two_effects_work_together(pair: tuple[str, str]) -> None:
    both = momentum(pair, values_of(pair[0], "typical") | values_of(pair[1], "typical"))
    one_null = momentum(pair, values_of(pair[0], "typical") | values_of(pair[1], "null"))
    alone = momentum((pair[0],), values_of(pair[0], "typical"))
    assert np.isfinite(both).sum() >= 0.9 * np.isfinite(alone).sum()
    np.testing.assert_allclose(one_null, alone, rtol=1e-9, atol=1e-12)
