"""Per-grain records to numbers, against cases that can be worked out by hand."""

from __future__ import annotations

from math import acos, cos, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from studies.dem import records
from studies.dem.job import Throw
from yieldmon.physics.machine import Machine

SEED = 711


@given(
    hnp.arrays(float, st.integers(1, 400), elements=st.floats(-500.0, 500.0)),
    st.sampled_from([1e-5, 2e-5, 3e-5]),
    st.sampled_from([1e-5, 1e-3, 7e-4]),
)
def test_resampling_keeps_the_impulse(force: np.ndarray, step_s: float, interval_s: float) -> None:
    again = records.resample_force_n(force, step_s, interval_s)
    assert again.sum() * interval_s == pytest.approx(force.sum() * step_s, abs=1e-9)
    assert len(again) * interval_s >= len(force) * step_s - 1e-12


def test_resampling_to_a_multiple_is_a_block_mean() -> None:
    np.testing.assert_allclose(records.resample_force_n(np.array([1.0, 3.0, 5.0, 7.0]), 1e-3, 2e-3), [2.0, 6.0])


UPRIGHT = records.PlateFrame.of(Machine(), radians(90.0))


@pytest.mark.parametrize(
    ("position", "velocity", "gravity", "hits", "speed"),
    [
        ((0.0, -0.10), (8.0, 0.0), 0.0, True, 8.0),
        ((0.0, -0.17), (8.0, 0.0), 0.0, False, 0.0),
        ((0.0, -0.17), (8.0, 0.0), 9.80665, True, 8.0),
        ((0.0, -0.10), (-8.0, 0.0), 0.0, False, 0.0),
        ((0.5, -0.10), (8.0, 0.0), 0.0, False, 0.0),
        ((0.0, 0.02), (2.0, 0.0), 9.80665, False, 0.0),
        ((0.0, -0.16), (4.0, 1.8), 0.0, True, 4.0),
        ((0.0, -0.16), (4.0, 1.9), 0.0, False, 0.0),
        ((np.nan, np.nan), (np.nan, np.nan), 0.0, False, 0.0),
    ],
    ids=["level", "over the top", "dropped on it", "away", "behind", "drops below", "low edge in", "low edge out", "stays"],
)
def test_aim(position: tuple[float, ...], velocity: tuple[float, ...], gravity: float, hits: bool, speed: float) -> None:
    aims, arriving = records.aim(UPRIGHT, np.array([position]), np.array([velocity]), gravity)
    assert (bool(aims[0]), float(arriving[0])) == (hits, pytest.approx(speed))


@pytest.mark.parametrize(
    ("position", "velocity", "place_m", "into_m_s", "along_m_s"),
    [
        ((0.0, -0.10), (8.0, 0.0), 0.06 + 0.5 * 9.81 * 0.05**2, 8.0, 9.81 * 0.05),
        ((0.0, -0.20), (8.0, 0.0), -0.04 + 0.5 * 9.81 * 0.05**2, 8.0, 9.81 * 0.05),
        ((0.2, -0.10), (2.0, 1.0), 0.06 + 0.1 + 0.5 * 9.81 * 0.1**2, 2.0, 1.0 + 9.81 * 0.1),
        ((0.0, -0.10), (-8.0, 0.0), np.nan, np.nan, np.nan),
        ((0.5, -0.10), (8.0, 0.0), np.nan, np.nan, np.nan),
    ],
    ids=["on it", "over it", "downwards", "away", "behind"],
)
def test_crossing_of_an_upright_plate(position, velocity, place_m: float, into_m_s: float, along_m_s: float) -> None:
    met = records.crossing(UPRIGHT, np.array([position]), np.array([velocity]), 9.81)
    assert (met.place_m[0], met.into_m_s[0], met.along_m_s[0]) == pytest.approx((place_m, into_m_s, along_m_s), nan_ok=True)


def test_a_grain_too_slow_to_reach_a_leaning_plate_does_not_cross_it() -> None:
    """At 45 deg it must rise to the plate, and gravity turns it back."""
    leaning = records.PlateFrame.of(Machine(), radians(45.0))
    met = records.crossing(leaning, np.array([[0.0, 0.0], [0.0, 0.0]]), np.array([[3.0, 0.0], [8.0, 0.0]]), 9.81)
    assert np.isfinite(met.place_m).tolist() == [False, True]


def test_the_arrival_is_what_crosses_and_what_the_plate_took() -> None:
    """Three grains of 1, 2 and 4 g at 8 m/s: over the top, onto the plate, below it; one contact on the face, one on the end."""
    plate = {
        "plate_angle_rad": np.array(radians(90.0)), "time_step_s": np.array(1e-3), "mass_kg": np.array([1e-3, 2e-3, 4e-3]),
        "free_position_m": np.array([[0.0, -0.30, 0.0], [0.0, -0.10, 0.0], [0.0, 0.10, 0.0]]),
        "free_velocity_m_s": np.full((3, 3), [8.0, 0.0, 0.0]), "normal_force_n": np.array([[5.0, 0.0], [0.0, 2.0]]),
    }  # fmt: skip
    assert records.arrival(Throw(paddle_mass_kg=0.5), plate) == pytest.approx(
        {
            "on_plate_kg_m_s": 16e-3,
            "over_top_kg_m_s": 8e-3,
            "below_low_kg_m_s": 32e-3,
            "on_face_kg_m_s": 5e-3,
            "on_end_kg_m_s": 2e-3,
        }
    )


@pytest.mark.parametrize("angle_deg", [40.0, 55.0, 70.0, 80.0])
def test_aim_with_gravity_agrees_with_the_flight_stepped_through(angle_deg: float) -> None:
    frame = records.PlateFrame.of(Machine(), radians(angle_deg))
    rng = np.random.default_rng(SEED)
    position = np.column_stack([rng.uniform(-0.1, 0.1, 200), rng.uniform(-0.18, 0.0, 200)])
    velocity = np.column_stack([rng.uniform(3.0, 9.0, 200), rng.uniform(-1.0, 3.0, 200)])
    aims, arriving = records.aim(frame, position, velocity, 9.80665)
    time = np.arange(0.0, 0.3, 2e-5)[:, None]
    offset = [position[:, i] + velocity[:, i] * time + (0.5 * 9.80665 * time**2 if i else 0.0) - frame.pivot_m[i] for i in (0, 1)]
    depth = offset[0] * frame.inward[0] + offset[1] * frame.inward[1]
    first = (depth > 0.0).argmax(axis=0)
    grain = np.arange(200)
    place = offset[0][first, grain] * frame.along[0] + offset[1][first, grain] * frame.along[1]
    stepped = (depth[first, grain] > 0.0) & (place >= 0.0) & (place <= frame.length_m)
    assert (aims == stepped).mean() > 0.99
    expected = velocity @ frame.inward + 9.80665 * frame.inward[1] * time[first, 0]
    np.testing.assert_allclose(arriving[aims & stepped], expected[aims & stepped], atol=1e-3)


@pytest.mark.parametrize(("h0_over_l", "shape_ratio"), [(0.8, 2.0), (0.6, 1.5), (0.7, 3.0)])
def test_a_straight_heap_is_found_again(h0_over_l: float, shape_ratio: float) -> None:
    """Grains on a fine lattice filled up to the thesis's straight line give back h0, psi_f, h_f and the bulk density."""
    length, width = Machine().paddle_length_m, Machine().paddle_width_m
    reach = shape_ratio * (1.0 - h0_over_l)
    slope = (length * cos(reach) - h0_over_l * length) / (length * sin(reach))
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform(0.0, length, 400_000), rng.uniform(0.0, length, 400_000)
    inside = (np.hypot(x, y) < length) & (x > h0_over_l * length + slope * y) & (y < length * sin(reach))
    area = 0.5 * length**2 * reach - 0.5 * length**2 * h0_over_l * sin(reach)
    throw = Throw(paddle_mass_kg=700.0 * area * width)
    shape = records.heap_shape(throw, x[inside], y[inside], np.zeros(inside.sum()))
    assert shape.inner_radius_m == pytest.approx(h0_over_l * length, abs=1.5e-3)
    assert shape.reach_rad == pytest.approx(reach, rel=0.04)
    assert shape.shape_ratio == pytest.approx(shape_ratio, rel=0.06)
    assert shape.bulk_density_kg_m3 == pytest.approx(700.0, rel=0.06)
    assert shape.straightness_m < 1.0e-3


def test_a_heap_of_a_few_grains_has_no_surface() -> None:
    with pytest.raises(ValueError, match="strips of surface"):
        records.heap_shape(Throw(paddle_mass_kg=0.01), np.full(9, 0.15), np.full(9, 0.004), np.full(9, 0.004))


def test_paddle_frame_is_along_and_ahead() -> None:
    angle = 1.4 * pi
    along, ahead = records.paddle_frame(np.array([[0.1 * cos(angle), 0.1 * sin(angle)], [0.1 * cos(1.5 * pi), -0.1]]), angle)
    np.testing.assert_allclose(along, [0.1, 0.1 * cos(0.1 * pi)], atol=1e-12)
    np.testing.assert_allclose(ahead, [0.0, 0.1 * sin(0.1 * pi)], atol=1e-12)


def test_thickness_of_an_even_stream() -> None:
    """1 kg in 0.1 s at 5 m/s over the paddle's width is a solid layer of 1 / (0.1 * 5 * 0.21 * density)."""
    throw = Throw(paddle_mass_kg=1.0)
    n = 4000
    at = np.linspace(0.0, 0.1, n)
    position = np.tile([0.1, -0.1, 0.0], (n, 1))
    velocity = np.tile([5.0, 0.0, 0.0], (n, 1))
    thickness = records.stream_thickness_kernels(throw, position, velocity, np.full(n, 1.0 / n), at)
    density = throw.grain.mass_kg / throw.grain.volume_m3
    expected = 1.0 / (0.1 * 5.0 * 0.21 * density) / (2.0 * throw.grain.radius_m)
    assert thickness == pytest.approx(expected, rel=0.02)


def test_reach_at_the_housing() -> None:
    """A level surface (slope 0) at h0 meets the housing at acos(h0 / l)."""
    throw = Throw(paddle_mass_kg=1.0)
    y = np.linspace(0.001, 0.12, 200_000)
    shape = records.heap_shape(throw, np.full_like(y, 0.1), y, np.zeros_like(y))
    assert shape.reach_rad == pytest.approx(acos(0.1 / 0.16), rel=1e-6)
