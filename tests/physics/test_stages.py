"""Each stage against a second way of working it out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from yieldmon.physics import flight, release, settling
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP, first_root

MACHINE = Machine()
GRAIN = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
ratios = st.floats(0.5, 3.0)


def throw(friction: float = 0.2, speed: float = 400.0 * RPM, gravity: float | None = None, angle: float = 1.2):  # type: ignore[no-untyped-def]
    effects = () if gravity is None else ("gravity",)
    values = dict(GRAIN, friction=friction) | ({} if gravity is None else {"gravity.acceleration_m_s2": gravity})
    return ForwardModel(MACHINE, effects).throw(angle, speed, values)


# Settling


@settings(max_examples=200)
@given(ratios, st.floats(0.0, 1.0))
def test_inner_radius_inverts_the_filled_fraction(ratio: float, share: float) -> None:
    fraction = np.asarray(share * ratio / 2.0)
    x = settling.inner_radius(fraction, np.asarray(ratio))
    assert 0.0 <= x <= 1.0
    assert settling.filled_fraction(x, np.asarray(ratio)) == pytest.approx(float(fraction), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("fraction", [0.0, 1e-300, 1e-34, 1e-20, 1e-12, 1e-6])
def test_inner_radius_of_the_thinnest_heaps_is_the_limit(fraction: float) -> None:
    x = settling.inner_radius(np.asarray(fraction), np.asarray(2.0))
    assert 1.0 - x == pytest.approx(np.sqrt(fraction), rel=1e-3, abs=1e-16)


@pytest.mark.parametrize("fraction", [-1e-9, 1.0 + 1e-9, np.nan])
def test_inner_radius_of_a_heap_that_cannot_be_is_nan(fraction: float) -> None:
    assert np.isnan(settling.inner_radius(np.asarray(fraction), np.asarray(2.0)))


@settings(max_examples=60)
@given(ratios, st.floats(0.01, 0.99))
def test_opening_angle_encloses_the_filled_area(ratio: float, x: float) -> None:
    # psi may fall back on the paddle for grain inside the line's nearest point; the closed form covers rho >= x.
    psi_f = ratio * (1.0 - x)
    if np.cos(psi_f) < x * np.cos(psi_f) ** 2 + 1e-9 or np.cos(psi_f) * x > 1.0:
        return
    nearest = x * np.sin(psi_f) / np.hypot(np.cos(psi_f) - x, np.sin(psi_f))
    if x * (x - np.cos(psi_f)) > 0.0 or nearest > x:
        return
    area, _ = quad(lambda rho: rho * float(settling.opening_angle(np.asarray(rho), np.asarray(x), np.asarray(ratio))), x, 1.0)
    assert area == pytest.approx(float(settling.filled_fraction(np.asarray(x), np.asarray(ratio))), rel=1e-7)


@settings(max_examples=60)
@given(ratios, st.floats(0.0, 0.99), st.floats(1e-6, 1.0))
def test_opening_angle_lies_on_the_straight_inner_surface(ratio: float, x: float, t: float) -> None:
    psi_f = ratio * (1.0 - x)
    point = np.array([x, 0.0]) + t * np.array([np.cos(psi_f) - x, np.sin(psi_f)])
    rho = np.hypot(*point)
    if rho < x or (np.cos(psi_f) - x) * point[0] + np.sin(psi_f) * point[1] < 0.0:
        return  # on the inner branch, where the heap's surface turns back towards the paddle
    angle = settling.opening_angle(np.asarray(rho), np.asarray(x), np.asarray(ratio))
    assert angle == pytest.approx(np.arctan2(point[1], point[0]), abs=1e-7)


# Release


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("friction", [0.0, 0.2, 0.7, 1.5])
@pytest.mark.parametrize("tau", [0.05, 0.4, 1.1])
def test_outflow_solves_the_sliding_equation(friction: float, tau: float, gravity: float | None) -> None:
    speed = 300.0 * RPM
    setting = throw(friction, speed, gravity).setting
    flow = release.outflow(np.array([tau]), setting)
    number = (gravity or 0.0) / (MACHINE.paddle_length_m * speed**2)

    def sliding(t: float, state: np.ndarray) -> list[float]:
        theta = 1.5 * np.pi + t
        pull = number * (np.sin(theta) + friction * np.cos(theta))
        return [state[1], state[0] - 2.0 * friction * state[1] + pull]

    start = float(np.asarray(flow.release_radius).ravel()[0])
    way = solve_ivp(sliding, (0.0, tau), [start, 0.0], rtol=1e-11, atol=1e-13)
    assert way.y[0, -1] == pytest.approx(1.0, rel=1e-8)
    assert way.y[1, -1] == pytest.approx(float(np.asarray(flow.radial_speed).ravel()[0]), rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("gravity", [None, 9.81])
def test_inward_rate_is_the_slope_of_the_release_radius(gravity: float | None) -> None:
    setting = throw(0.3, 300.0 * RPM, gravity).setting
    tau = np.array([0.1, 0.6, 1.2])
    step = 1e-5
    high, low = release.outflow(tau + step, setting), release.outflow(tau - step, setting)
    slope = -(high.release_radius - low.release_radius) / (2.0 * step)
    assert release.outflow(tau, setting).inward_rate == pytest.approx(slope, rel=1e-7)


@pytest.mark.parametrize("gravity", [None, 9.81])
def test_a_steady_drag_is_part_of_the_motion(gravity: float | None) -> None:
    """rho'' = rho - 2 (mu rho' + D) + G (sin theta + mu cos theta), integrated from the radius of release."""
    speed, drag_m_s = 300.0 * RPM, 0.5
    setting = replace(throw(0.3, speed, gravity).setting, steady_drag_m_s=np.array([drag_m_s]))
    steady, fall = drag_m_s / (0.16 * speed), (gravity or 0.0) / (0.16 * speed**2)
    tau = 0.8
    flow = release.outflow(np.array([tau]), setting)

    def rate(at: float, y: np.ndarray) -> list[float]:
        theta = release.TOP + at
        return [y[1], y[0] - 2.0 * (0.3 * y[1] + steady) + fall * (np.sin(theta) + 0.3 * np.cos(theta))]

    way = solve_ivp(rate, (0.0, tau), [float(flow.release_radius[0]), 0.0], rtol=1e-11, atol=1e-13)
    assert way.y[0, -1] == pytest.approx(1.0, rel=1e-8)
    assert way.y[1, -1] == pytest.approx(float(flow.radial_speed[0]), rel=1e-7)
    high, low = (float(release.outflow(np.array([tau + step]), setting).release_radius[0]) for step in (1e-5, -1e-5))
    assert float(flow.inward_rate[0]) == pytest.approx((low - high) / 2e-5, rel=1e-7)


@pytest.mark.parametrize("inner", [0.999999, 0.9, 0.5, 0.05])
def test_rotation_to_empty_ends_with_the_innermost_grain(inner: float) -> None:
    setting = throw().setting
    tau = release.rotation_to_empty(np.array([inner]), setting, np.array([50.0]))
    assert release.outflow(tau, setting).release_radius == pytest.approx(inner, rel=1e-12)


def test_grain_leaves_the_tip_with_the_paddles_speed_and_its_own() -> None:
    setting = throw().setting
    tau = np.array([0.3])
    flow = release.outflow(tau, setting)
    x, y, vx, vy = release.at_tip(flow, setting)
    tip = 0.16 * 400.0 * RPM
    assert np.hypot(x, y) == pytest.approx(0.16)
    assert np.hypot(vx, vy) == pytest.approx(tip * np.sqrt(1.0 + flow.radial_speed**2))
    assert (x * vx + y * vy) / 0.16 == pytest.approx(tip * flow.radial_speed)


# Flight


@settings(max_examples=100)
@given(st.floats(np.radians(40.0), np.radians(90.0)), st.floats(0.0, 1.2), st.sampled_from([None, 3.0, 9.81]))
def test_meeting_lies_on_path_and_plate(angle: float, tau: float, gravity: float | None) -> None:
    setting = throw(0.2, 350.0 * RPM, gravity, angle).setting
    x, y, vx, vy = release.at_tip(release.outflow(np.array([tau]), setting), setting)
    meeting = flight.meet_plate(x, y, vx, vy, setting)
    if not np.isfinite(meeting.from_low_edge_m[0]):
        return
    t = meeting.time_s
    place = np.concatenate((x + vx * t, y + vy * t + 0.5 * (gravity or 0.0) * t * t))
    along = MACHINE.plate_length_m + meeting.from_low_edge_m
    plate = np.array([0.4, -0.16]) + along * np.array([np.cos(angle), np.sin(angle)])
    assert place == pytest.approx(plate, abs=1e-12 * max(1.0, float(np.abs(along[0]))))
    arriving = np.concatenate((vx, vy + (gravity or 0.0) * t))
    assert meeting.normal_speed_m_s[0] == pytest.approx(arriving @ np.array([np.sin(angle), -np.cos(angle)]), rel=1e-9, abs=1e-9)
    assert meeting.tangential_speed_m_s[0] == pytest.approx(
        arriving @ np.array([np.cos(angle), np.sin(angle)]), rel=1e-9, abs=1e-9
    )
    miss = flight.miss_measure(x, y, vx, vy, setting)
    assert np.sign(miss[0]) == np.sign(meeting.from_low_edge_m[0])


@pytest.mark.parametrize("angle_deg", [40.0, 55.0, 70.0, 90.0])
@pytest.mark.parametrize("gravity", [None, 9.81])
def test_misses_begin_where_the_path_meets_the_low_edge(angle_deg: float, gravity: float | None) -> None:
    setting = throw(0.2, 350.0 * RPM, gravity, np.radians(angle_deg)).setting
    path = release.at_tip(release.outflow(np.linspace(0.0, 1.2, 4001), setting), setting)
    kappa, miss = flight.meet_plate(*path, setting).from_low_edge_m, flight.miss_measure(*path, setting)
    met = np.isfinite(kappa)
    assert np.array_equal(np.sign(miss[met]), np.sign(kappa[met]))
    assert (kappa[met] > 0.0).any()
    assert (kappa[met] < 0.0).any()


# The chain


@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("fill", [1e-4, 0.05, 0.4, 0.9])
def test_nodes_carry_the_mass_that_left_until_misses_begin(fill: float, gravity: float | None) -> None:
    # At 90 deg and low fill all grain lands: the nodes then hold the whole load.
    one = throw(0.2, 400.0 * RPM, gravity, np.radians(90.0))
    mass = fill * float(np.asarray(one.full_mass_kg).ravel()[0])
    jet = one.reading(np.asarray(mass)).impulse.arrival.jet
    carried = float(np.sum(np.real(jet.mass_kg)))
    assert carried <= mass * (1.0 + 1e-9)
    last = float(np.real(jet.release_radius).min())
    if last <= float(np.real(jet.inner_radius).ravel()[0]) * 1.02:
        assert carried == pytest.approx(mass, rel=2e-3)


def test_the_whole_load_is_carried_when_misses_are_followed() -> None:
    model = ForwardModel(MACHINE, ("miss_capture",), nodes=60)
    values = dict(GRAIN, **dict.fromkeys(model.effect_parameters, 0.0))
    # Above 35 % of a full paddle the heap's inner surface comes nearer to the centre than h0, and the published integral from h0
    # outwards leaves that sliver out.
    for mass in (0.05, 0.5, 1.0, 2.0):
        jet = model.throw(np.radians(40.0), 400.0 * RPM, values).reading(np.asarray(mass)).impulse.arrival.jet
        assert float(np.sum(np.real(jet.mass_kg))) == pytest.approx(mass, rel=2e-6)


@pytest.mark.parametrize("nodes", [12, 20])
def test_quadrature_has_converged(nodes: float) -> None:
    conditions = Conditions(np.radians([40.0, 70.0, 90.0]), 42.0, paddle_mass_kg=np.array([0.01, 0.5, 4.0])[:, None])
    fine = ForwardModel(MACHINE, nodes=60).paddle_momentum(conditions, GRAIN)
    assert ForwardModel(MACHINE, nodes=int(nodes)).paddle_momentum(conditions, GRAIN) == pytest.approx(fine, rel=1e-7)


# Numerics


@pytest.mark.parametrize(
    ("shift", "expected"), [(0.37, 0.37), (-0.5, 0.0), (5.0, 2.0)], ids=["inside", "not negative at 0", "negative throughout"]
)
def test_first_root(shift: float, expected: float) -> None:
    root = first_root(lambda t: np.tanh(3.0 * (t - shift)), np.array([2.0]), refinements=3)
    assert root == pytest.approx(expected, abs=1e-9)


def test_first_root_carries_the_derivative() -> None:
    root = first_root(lambda t: t * t - (0.25 + 1j * COMPLEX_STEP), np.array([2.0]), refinements=4)
    # d sqrt(a) / da = 1 / (2 sqrt(a)) = 1 at a = 0.25
    assert np.imag(root) / COMPLEX_STEP == pytest.approx(1.0, rel=1e-6)


def test_first_root_takes_the_first_of_two() -> None:
    root = first_root(lambda t: -(t - 0.3) * (t - 0.9), np.array([1.0]), refinements=3)
    assert root == pytest.approx(0.3, abs=1e-9)
