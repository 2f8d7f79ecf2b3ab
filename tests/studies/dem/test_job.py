"""A throw's description: defaults, limits, round trip, keys."""

from __future__ import annotations

import json
from dataclasses import replace
from math import pi, radians

import pytest

from studies.dem.job import (
    Contact,
    Grain,
    Release,
    Throw,
    kernel_defaults,
    merged,
    paddle_mass_kg,
    throw_from_dict,
    to_dict,
)
from yieldmon.physics.machine import RPM, Machine

THROW = Throw(paddle_mass_kg=0.5)
CLUMPS = throw_from_dict(merged(kernel_defaults("clump"), {"paddle_mass_kg": 0.5}))


def test_published_kernel_as_a_sphere() -> None:
    assert Grain().radius_m == pytest.approx(4.1697e-3, rel=1e-4)
    assert Throw(paddle_mass_kg=0.4).grain_count == 988


def test_published_clump() -> None:
    grain = CLUMPS.grain
    assert (grain.mass_kg, grain.sphere_count, CLUMPS.grain_count) == (4.0e-4, 4, 1250)
    assert (CLUMPS.contact.rolling_friction, CLUMPS.contact.friction, CLUMPS.contact.restitution) == (0.01, 0.3, 0.75)
    assert grain.smallest_sphere_m == pytest.approx(2.5e-3, rel=1e-3)
    # A fifth of the Rayleigh time goes as the smallest sphere's radius.
    ratio = CLUMPS.critical_time_step_s / THROW.critical_time_step_s
    assert ratio == pytest.approx(2.5e-3 / Grain().radius_m, rel=1e-3)
    assert CLUMPS.time_step_s < CLUMPS.critical_time_step_s < THROW.time_step_s


def test_spheres_keep_their_keys() -> None:
    """The shipped campaign's rows are found by digests that know of no kernel."""
    assert "kernel" not in to_dict(THROW)["grain"]
    assert to_dict(CLUMPS)["grain"]["kernel"] == "clump"
    named = throw_from_dict({"paddle_mass_kg": 0.5, "grain": {"kernel": "sphere"}})
    assert (named, named.throw_key(), named.heap_key()) == (THROW, THROW.throw_key(), THROW.heap_key())
    assert CLUMPS.throw_key() != replace(CLUMPS, grain=replace(CLUMPS.grain, kernel="sphere")).throw_key()
    assert throw_from_dict(json.loads(json.dumps(to_dict(CLUMPS)))) == CLUMPS


def test_fields_laid_over_a_kernels_own() -> None:
    throw = throw_from_dict(merged(kernel_defaults("clump"), {"paddle_mass_kg": 0.1, "contact": {"friction": 0.15}}))
    assert (throw.contact.friction, throw.contact.rolling_friction) == (0.15, 0.01)
    assert kernel_defaults("sphere") == {}
    with pytest.raises(ValueError, match="kernel is cube, expected sphere or clump"):
        kernel_defaults("cube")


def test_production_flow_to_paddle_load() -> None:
    # 12 kg/s * 0.18635 m / (400 rpm * 0.0541 m) = 0.9868 kg
    assert paddle_mass_kg(Machine(), 12.0, 400.0 * RPM) == pytest.approx(0.98679, rel=1e-4)


def test_round_trip_through_json() -> None:
    throw = replace(
        THROW,
        seed=7,
        contact=Contact(friction=0.15),
        release=Release("open", radians(280.0)),
        machine=replace(Machine(), plate_length_m=0.2, paddle_spacings_m=(0.2,)),
    )
    assert throw_from_dict(json.loads(json.dumps(to_dict(throw)))) == throw


@pytest.mark.parametrize(
    ("change", "same_heap"),
    [
        ({"release": Release("open")}, True),
        ({"plate_width_m": 0.5}, True),
        ({"seed": 2}, False),
        ({"contact": Contact(friction=0.31)}, False),
        ({"elevator_speed_rad_s": 41.0}, False),
        ({"machine": replace(Machine(), paddle_length_m=0.161)}, False),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else str(value),
)
def test_what_a_heap_depends_on(change: dict[str, object], same_heap: bool) -> None:
    other = replace(THROW, **change)  # type: ignore[arg-type]
    assert (other.heap_key() == THROW.heap_key()) is same_heap
    assert other.throw_key() != THROW.throw_key()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"paddle_mass_kg": 1e-5}, "at least one grain"),
        ({"paddle_mass_kg": 30.0}, "at most 12000 grains"),
        ({"time_step_s": 5e-5}, "Rayleigh"),
        ({"elevator_speed_rad_s": -1.0}, "elevator_speed_rad_s"),
        ({"gravity_m_s2": float("nan")}, "gravity_m_s2"),
        ({"settle_revolutions": 0.0}, "settle_revolutions"),
        ({"seed": -1}, "seed"),
    ],
)
def test_limits_name_the_value(change: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        replace(THROW, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: Contact(restitution=0.0), "contact.restitution is 0.0"),
        (lambda: Contact(friction=-0.1), "contact.friction is -0.1"),
        (lambda: Grain(mass_kg=0.0), "grain.mass_kg is 0.0"),
        (lambda: Grain(poisson=0.5), "grain.poisson is 0.5"),
        (lambda: Grain(kernel="cube"), "grain.kernel is cube"),  # type: ignore[arg-type]
        (lambda: Throw(paddle_mass_kg=0.1, grain=Grain(kernel="clump")), "time_step_s is 3e-05"),
        (lambda: Release("edge", 0.5 * pi), "release.angle_rad"),
        (lambda: Release("drop"), "release.kind is drop"),  # type: ignore[arg-type]
    ],
)
def test_parts_name_the_value(build: object, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        build()  # type: ignore[operator]


def test_softer_grains_allow_a_longer_step() -> None:
    soft = replace(THROW, stiffness_factor=0.25)
    assert soft.critical_time_step_s == pytest.approx(2.0 * THROW.critical_time_step_s)


def test_an_unknown_key_is_named() -> None:
    with pytest.raises(ValueError, match="frixion: not a key of Contact"):
        throw_from_dict({"paddle_mass_kg": 0.5, "contact": {"frixion": 0.3}})
