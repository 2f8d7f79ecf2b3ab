"""Each effect against what is known of it without the model: closed forms, equalities, limits."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special, stats

from yieldmon.physics.effects import get_effect
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.stages import Arrival

MACHINE = Machine()
GRAIN = {"friction": 0.3, "density": 1200.0, "shape_ratio": 2.0, "restitution": 0.6}
ANGLE, LOAD = (a.ravel() for a in np.meshgrid(np.radians([40.0, 55.0, 70.0, 90.0]), [0.05, 0.4, 1.2, 2.5]))
SPEED = np.full(ANGLE.shape, 400.0 * RPM)
AT = Conditions(ANGLE, SPEED, paddle_mass_kg=LOAD, moisture_pct=np.full(ANGLE.shape, 15.0))
PASSES = SPEED * MACHINE.sprocket_pitch_radius_m / MACHINE.paddle_spacing_m


def read(effect: str = "", *, at=AT, machine: Machine = MACHINE, grain: dict[str, float] | None = None, **own: float):
    values = GRAIN | (grain or {}) | {f"{effect}.{key}": value for key, value in own.items()}
    return ForwardModel(machine, (effect,) if effect else ()).paddle_momentum(at, values, overfull="nan")


BASE = read()


def test_slip_is_another_speed() -> None:
    slower = read(at=replace(AT, elevator_speed_rad_s=0.9 * SPEED))
    np.testing.assert_allclose(read("chain_slip", share=0.1), slower, rtol=1e-12)


def test_slip_puts_more_grain_on_each_paddle() -> None:
    at = Conditions(ANGLE, SPEED, mass_flow_kg_s=5.0)
    slower = replace(at, elevator_speed_rad_s=0.9 * SPEED)
    slipped = ForwardModel(MACHINE, ("chain_slip",)).force(at, GRAIN | {"chain_slip.share": 0.1})
    np.testing.assert_allclose(slipped, ForwardModel(MACHINE).force(slower, GRAIN), rtol=1e-12)


def test_wear_is_a_shorter_paddle() -> None:
    shorter = read(machine=replace(MACHINE, paddle_length_m=0.15))
    np.testing.assert_allclose(read("paddle_wear", length_m=0.01), shorter, rtol=1e-12)


def test_angle_offset_is_another_angle() -> None:
    turned = read(at=replace(AT, plate_angle_rad=ANGLE + 0.03))
    np.testing.assert_allclose(read("plate_angle_offset", angle_rad=0.03), turned, rtol=1e-12)


def test_leakage_keeps_what_continuity_leaves() -> None:
    full = 0.5 * 2.0 * 1200.0 * MACHINE.paddle_width_m * MACHINE.paddle_length_m**2
    kept = LOAD / (1.0 + 0.5 * LOAD / full)
    np.testing.assert_allclose(read("paddle_leakage", loss_at_full=0.5), read(at=replace(AT, paddle_mass_kg=kept)), rtol=1e-12)


def test_leakage_halves_at_twice_the_speed() -> None:
    model = ForwardModel(MACHINE, ("paddle_leakage",))
    values = GRAIN | {"paddle_leakage.loss_at_full": 0.2}
    lost = [1.0 - float(model.throw(1.2, speed, values).load_mass(np.asarray(0.5))) / 0.5 for speed in (20.0, 40.0)]
    assert lost[0] / lost[1] == pytest.approx(2.0, rel=0.05)


def test_shape_is_untouched_at_nominal_speed_and_scaled_elsewhere() -> None:
    np.testing.assert_allclose(read("speed_dependent_shape", exponent=1.5), BASE, rtol=1e-12)
    faster = replace(AT, elevator_speed_rad_s=1.2 * SPEED)
    flatter = read(at=faster, grain={"shape_ratio": 2.0 * 1.2**0.5})
    np.testing.assert_allclose(read("speed_dependent_shape", at=faster, exponent=0.5), flatter, rtol=1e-10)


def test_friction_is_untouched_at_nominal_speed_and_scaled_elsewhere() -> None:
    np.testing.assert_allclose(read("speed_dependent_friction", exponent=1.5), BASE, rtol=1e-12)
    faster = replace(AT, elevator_speed_rad_s=1.2 * SPEED)
    rougher = read(at=faster, grain={"friction": GRAIN["friction"] * 1.2**0.5})
    np.testing.assert_allclose(read("speed_dependent_friction", at=faster, exponent=0.5), rougher, rtol=1e-10)


def test_steady_friction_alone_follows_energy() -> None:
    """rho'' = rho - 2 D: (rho'^2 - (rho - 2 D)^2) is kept, with D = d / (l Omega)."""
    law = "speed_dependent_friction-by_sliding"
    throw = ForwardModel(MACHINE, (law,)).throw(1.2, 40.0, GRAIN | {"friction": 0.0, f"{law}.steady_m_s": 0.4})
    jet = throw.reading(np.asarray(1.0)).impulse.arrival.jet
    tip_m_s = MACHINE.paddle_length_m * 40.0
    outwards2 = (jet.vx_m_s**2 + jet.vy_m_s**2) / tip_m_s**2 - 1.0
    twice = 2.0 * 0.4 / tip_m_s
    np.testing.assert_allclose(outwards2, (1.0 - twice) ** 2 - (jet.release_radius - twice) ** 2, rtol=1e-10)


def test_radial_speed_without_friction_follows_energy() -> None:
    """rho'' = rho from rho' = s rho_0: (rho'^2 - rho^2) is kept, so at the tip u^2 = 1 - rho_0^2 (1 - s^2)."""
    model = ForwardModel(MACHINE, ("residual_radial_speed",))
    throw = model.throw(1.2, 40.0, GRAIN | {"friction": 0.0, "residual_radial_speed.share": 0.5})
    jet = throw.reading(np.asarray(1.0)).impulse.arrival.jet
    speed2 = (jet.vx_m_s**2 + jet.vy_m_s**2) / (MACHINE.paddle_length_m * 40.0) ** 2
    np.testing.assert_allclose(speed2 - 1.0, 1.0 - jet.release_radius**2 * (1.0 - 0.25), rtol=1e-12)


def jet_of(effect: str = "", load: float = 1.0, **own: float):
    values = GRAIN | {f"{effect}.{key}": value for key, value in own.items()}
    throw = ForwardModel(MACHINE, (effect, "miss_capture") if effect else ("miss_capture",)).throw(
        1.2, 40.0, values | {"miss_capture.share": 0.0}
    )
    return throw.reading(np.asarray(load)).impulse.arrival.jet


def halves(jet):
    """The carried and the free part of a jet that unpushed_layers has parted, as (mass, x, y, vx, vy) each."""
    columns = [np.broadcast_to(a, jet.mass_kg.shape) for a in (jet.mass_kg, jet.x_m, jet.y_m, jet.vx_m_s, jet.vy_m_s)]
    return [tuple(np.split(column, 2, axis=-1)[k] for column in columns) for k in (0, 1)]


def test_free_grain_flies_level_half_way_to_the_tips_speed() -> None:
    """Free grain leaves level, at the mean of Omega rho_0 and the tip's speed; carried grain as published."""
    base, jet = jet_of(), jet_of("unpushed_layers", rate_per_rad=2.0)
    (_, *carried), (_, x, y, vx, vy) = halves(jet)
    for got, published in zip(carried, (base.x_m, base.y_m, base.vx_m_s, base.vy_m_s), strict=True):
        np.testing.assert_allclose(got, published, rtol=1e-12)
    drawn = 40.0 * MACHINE.paddle_length_m * 0.5 * (1.0 + base.release_radius)
    np.testing.assert_allclose(vx, drawn, rtol=1e-9)
    np.testing.assert_allclose(vy, 0.0, atol=1e-9 * drawn.max())
    np.testing.assert_allclose(y, -MACHINE.paddle_length_m * base.release_radius, rtol=1e-9)
    np.testing.assert_allclose(x, drawn * base.travel_angle_rad / 40.0, rtol=1e-9)


def test_a_layer_is_free_by_the_angle_it_reaches_ahead() -> None:
    """The layer's share is 1 - exp(-rate psi), psi where the heap's straight inner surface crosses its radius."""
    base, jet = jet_of(), jet_of("unpushed_layers", rate_per_rad=2.0)
    (carried, *_), (free, *_) = halves(jet)
    np.testing.assert_allclose(carried + free, base.mass_kg, rtol=1e-12)
    share = free / base.mass_kg
    x = base.inner_radius
    reach = 2.0 * (1.0 - x)
    for rho, got in zip(base.release_radius.ravel(), share.ravel(), strict=True):
        t = np.linspace(0.0, 1.0, 200_001)
        px, py = x + t * (np.cos(reach) - x), t * np.sin(reach)
        crossing = int(np.flatnonzero(np.diff(np.sign(np.hypot(px, py) - rho)))[-1])
        assert got == pytest.approx(1.0 - np.exp(-2.0 * np.arctan2(py[crossing], px[crossing])), abs=1e-4)


def test_a_stream_rises_with_the_depth_of_grain_inside() -> None:
    base, risen = jet_of(), jet_of("stream_rise", ratio=0.2)
    upward = 0.2 * 40.0 * MACHINE.paddle_length_m * (base.release_radius - base.inner_radius)
    np.testing.assert_allclose(base.vy_m_s - risen.vy_m_s, upward, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(base.y_m - risen.y_m, upward * base.travel_angle_rad / 40.0, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(risen.vx_m_s, base.vx_m_s, rtol=1e-12)


def test_a_risen_stream_loses_over_the_top_edge() -> None:
    """Of the stream that gravity and the release leave, an upright plate loses more at large loads and at speed."""
    loads, speeds = np.meshgrid([0.2, 0.9, 1.8], [35.0, 55.0])
    upright = Conditions(np.radians(90.0), speeds, paddle_mass_kg=loads)
    model = ForwardModel(MACHINE, ("gravity", "stream_rise", "unpushed_layers"))
    stream = {"density": 700.0, "shape_ratio": 2.9, "gravity.acceleration_m_s2": 9.81, "unpushed_layers.rate_per_rad": 3.0}
    level, risen = (model.paddle_momentum(upright, GRAIN | stream | {"stream_rise.ratio": size}) for size in (0.0, 0.1))
    kept = risen / level
    assert np.all(kept < 1.0)
    assert np.all(np.diff(kept, axis=1) < -0.002)
    assert np.all(np.diff(kept, axis=0) < -0.02)


def test_what_caught_grain_does_outlasts_a_parted_jet() -> None:
    """miss_capture and plate_overshoot act on what unpushed_layers leaves, not the other way round."""
    own = {"unpushed_layers.rate_per_rad": 3.0}
    for other, key, size in (("miss_capture", "share", 0.8), ("plate_overshoot", "depth_m", 0.02), ("stream_rise", "ratio", 0.1)):
        model = ForwardModel(MACHINE, ("unpushed_layers", other))
        without = model.paddle_momentum(AT, GRAIN | own | {f"{other}.{key}": 0.0}, overfull="nan")
        with_it = model.paddle_momentum(AT, GRAIN | own | {f"{other}.{key}": size}, overfull="nan")
        assert np.nanmax(np.abs(with_it / without - 1.0)) > 0.02, other


def test_unpushed_layers_bring_heavy_loads_onto_a_low_plate() -> None:
    """Their jet clears the low edge that the published one passes below, and is slower where all of both lands."""
    low = Conditions(np.radians(40.0), 40.0, paddle_mass_kg=np.array([0.1, 2.5]))
    light, heavy = read("unpushed_layers", at=low, rate_per_rad=3.0) / read(at=low)
    assert heavy > 1.1 * light
    upright = Conditions(np.radians(90.0), 40.0, paddle_mass_kg=0.1)
    assert read("unpushed_layers", at=upright, rate_per_rad=3.0) < read(at=upright)


def test_unpushed_layers_change_the_same_share_at_every_speed() -> None:
    fast = replace(AT, elevator_speed_rad_s=1.5 * SPEED)
    np.testing.assert_allclose(
        read("unpushed_layers", at=fast, rate_per_rad=3.0) / read(at=fast), read("unpushed_layers", rate_per_rad=3.0) / BASE,
        rtol=1e-9,
    )  # fmt: skip


def test_release_angle_turns_the_jet_and_leaves_its_speed() -> None:
    base = ForwardModel(MACHINE).throw(1.2, 40.0, GRAIN).reading(np.asarray(0.05)).impulse.arrival.jet
    model = ForwardModel(MACHINE, ("release_angle",))
    turned = model.throw(1.2, 40.0, GRAIN | {"release_angle.angle_rad": 0.2}).reading(np.asarray(0.05)).impulse.arrival.jet
    np.testing.assert_allclose(turned.travel_angle_rad, base.travel_angle_rad, rtol=1e-9)
    turn = np.arctan2(turned.vy_m_s, turned.vx_m_s) - np.arctan2(base.vy_m_s, base.vx_m_s)
    np.testing.assert_allclose(turn, 0.2, rtol=1e-9)
    np.testing.assert_allclose(np.hypot(turned.vx_m_s, turned.vy_m_s), np.hypot(base.vx_m_s, base.vy_m_s), rtol=1e-9)


def test_gravity_vanishes_as_the_elevator_speeds_up() -> None:
    change = []
    for factor in (1.0, 4.0, 16.0):
        at = replace(AT, elevator_speed_rad_s=factor * SPEED)
        change.append(np.max(np.abs(read("gravity", at=at, acceleration_m_s2=9.81) / read(at=at) - 1.0)))
    assert change[0] > change[1] > change[2]
    assert change[2] < change[0] / 64.0


def test_drag_takes_a_share_per_metre() -> None:
    light = replace(AT, paddle_mass_kg=1e-9, plate_angle_rad=np.radians(90.0))
    length = MACHINE.plate_pivot_x_m
    np.testing.assert_allclose(read("air_drag", at=light, rate_per_m=0.3) / read(at=light), np.exp(-0.3 * length), rtol=1e-3)


def test_captured_grain_lands_in_proportion() -> None:
    half = read("miss_capture", share=0.5)
    whole = read("miss_capture", share=1.0)
    np.testing.assert_allclose(half, 0.5 * (BASE + whole), rtol=1e-12)
    assert np.all(whole >= BASE * (1.0 - 1e-12))


def test_grain_is_caught_by_the_cosine_of_the_streams_incidence() -> None:
    """What lands of the missing grain's momentum is the share with which the grain on the plate runs down it."""
    for angle in np.radians([40.0, 55.0, 70.0]):
        throw = ForwardModel(MACHINE, ("miss_capture",)).throw(angle, 40.0, GRAIN | {"miss_capture.share": 0.9})
        arrival = throw.reading(np.asarray(2.0)).impulse.arrival
        mass, share = arrival.jet.mass_kg.ravel(), arrival.landing_share.ravel()
        into, along = arrival.normal_speed_m_s.ravel(), arrival.tangential_speed_m_s.ravel()
        hits = share == 1.0
        expected = 0.9 * np.cos(np.arctan2((mass * into)[hits].sum(), (mass * along)[hits].sum()))
        caught = ~hits & np.isfinite(arrival.from_low_edge_m.ravel()) & (into > 0.0)
        np.testing.assert_allclose(share[caught], expected, rtol=1e-9)


def test_spread_moves_grain_across_the_edge_both_ways() -> None:
    low = Conditions(np.radians(36.0), 400.0 * RPM, paddle_mass_kg=np.array([0.4, 2.5]))
    # Rough grain leaves late and low: of a full paddle much passes under the plate.
    rough = {"friction": 0.5}
    light, heavy = read("stream_spread", at=low, grain=rough, spread_rad=0.08) / read(at=low, grain=rough)
    assert light < 1.0 < heavy
    error = [np.max(np.abs(read("stream_spread", at=low, spread_rad=s) / read(at=low) - 1.0)) for s in (0.08, 0.02, 0.005)]
    assert error[0] > error[1] > error[2]
    assert error[2] < 1e-3


def _midpoints(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) / count


def _even_and_normal(evenness: float) -> np.ndarray:
    """Directions with a variance of 1: sums of an even one, which has the share `evenness` of it, and a normal one."""
    even = np.sqrt(3.0 * evenness) * (2.0 * _midpoints(500) - 1.0)
    return (even[:, None] + np.sqrt(1.0 - evenness) * stats.norm.ppf(_midpoints(200))).ravel()


FANS = {
    "normal": ("stream_spread", {}, stats.norm.ppf(_midpoints(10_000))),
    "even": ("stream_spread-even", {"evenness": 0.9}, _even_and_normal(0.9)),
}


@pytest.mark.parametrize("fan_of", FANS)
@pytest.mark.parametrize("gravity", [None, 9.81])
@pytest.mark.parametrize("incidence", [-0.4, 0.3, 0.9])
@pytest.mark.parametrize("kappa_m", [-0.15, -0.02, 0.02, 0.1])
def test_a_fan_is_many_paths_of_which_the_edge_lets_some_pass(
    kappa_m: float, incidence: float, gravity: float | None, fan_of: str
) -> None:
    """Against many paths turned one by one at the point that they leave from; kappa and incidence without gravity."""
    name, shape, directions = FANS[fan_of]
    spread, speed, length, plate = 0.12, 6.0, 0.4, np.radians(60.0)
    down, into = np.array([np.cos(plate), np.sin(plate)]), np.array([np.sin(plate), -np.cos(plate)])
    launch = np.cos(incidence) * into + np.sin(incidence) * down
    machine = SimpleNamespace(plate_length_m=0.2)
    tip = np.array([0.4, -0.2]) + (machine.plate_length_m + kappa_m) * down - length * launch
    setting = SimpleNamespace(
        machine=machine, plate_angle_rad=np.asarray(plate), plate_pivot_x_m=0.4, plate_pivot_y_m=-0.2, gravity_m_s2=gravity,
        restitution=np.asarray(0.5),
    )  # fmt: skip

    def thrown(turn_rad: np.ndarray) -> tuple[np.ndarray, ...]:
        """Place from the low edge, time, speed into the plate and down it, of paths turned towards the low edge."""
        vx, vy = (speed * v for v in (
            launch[0] * np.cos(turn_rad) - launch[1] * np.sin(turn_rad),
            launch[0] * np.sin(turn_rad) + launch[1] * np.cos(turn_rad),
        ))  # fmt: skip
        g, gap = gravity or 0.0, -(tip - np.array([0.4, -0.2])) @ into
        closing, sliding = vx * into[0] + vy * into[1], vx * down[0] + vy * down[1]
        with np.errstate(invalid="ignore"):
            arriving = np.sqrt(np.where(closing > 0.0, closing**2 - 2.0 * g * down[0] * gap, np.nan))
            time = 2.0 * gap / (closing + arriving)
        begins = (tip - np.array([0.4, -0.2])) @ down - machine.plate_length_m
        fallen = g * down[1]
        return begins + sliding * time + 0.5 * fallen * time**2, time, arriving, sliding + fallen * time

    place, time, normal, tangential = thrown(np.zeros(1))
    jet = SimpleNamespace(x_m=tip[0], y_m=tip[1], vx_m_s=speed * launch[0], vy_m_s=speed * launch[1])
    path = Arrival(jet, place, time, normal, tangential, (place < 0.0).astype(float))
    values = {key: np.asarray(value) for key, value in ({"spread_rad": spread} | shape).items()}
    fan = get_effect(name).arrival(path, values, setting)
    place, _, normal, tangential = thrown(spread * directions)
    strikes = np.isfinite(place) & (place < 0.0)
    assert float(fan.landing_share[0]) == pytest.approx(np.mean(strikes), abs=2e-4)
    within = 5e-4 if gravity is None else 1e-2
    for got, of in ((fan.normal_speed_m_s, normal), (fan.tangential_speed_m_s, tangential)):
        expected = np.mean(np.where(strikes, of, 0.0))
        assert float((fan.landing_share * got)[0]) == pytest.approx(expected, abs=within * speed)


@pytest.mark.parametrize(("other", "key", "size"), [("plate_overshoot", "depth_m", 0.02), ("miss_capture", "share", 0.8)])
def test_what_a_fan_lands_is_lost_or_caught_like_other_grain(other: str, key: str, size: float) -> None:
    """The fan settles what passes the low edge; what acts on grain near the edges acts on that."""

    def momentum(share: float):
        values = GRAIN | {"stream_spread.spread_rad": 0.2, f"{other}.{key}": share}
        return ForwardModel(MACHINE, ("stream_spread", other)).paddle_momentum(AT, values, overfull="nan")

    change = momentum(size) / momentum(0.0) - 1.0
    held = np.isfinite(change)
    if other == "plate_overshoot":
        assert np.all(change[held] < -0.1)
    else:
        assert np.all(change[held] > -1e-12)
        assert np.max(change[held]) > 0.02


def test_overshoot_takes_most_from_grain_near_the_top() -> None:
    lost = 1.0 - read("plate_overshoot", depth_m=0.01) / BASE
    light, heavy = lost[LOAD == 0.05], lost[LOAD == 2.5]
    assert np.all(light > heavy)
    assert np.all((lost > 0.0) & (lost < 10.0 / 15.0))


def test_friction_on_the_plate_gives_cot_while_grain_slides() -> None:
    light = replace(AT, paddle_mass_kg=np.full(ANGLE.shape, 1e-6))
    ratio = read("plate_friction", at=light, coefficient=0.01) / read(at=light)
    np.testing.assert_allclose(ratio, 1.0 + 0.01 / np.tan(ANGLE), rtol=1e-3)


def test_friction_on_the_plate_ends_at_rolling() -> None:
    assert np.all(read("plate_friction", coefficient=1.0) >= BASE * (1.0 - 1e-12))
    at = replace(AT, plate_angle_rad=np.full(ANGLE.shape, np.radians(45.0)))
    np.testing.assert_allclose(
        read("plate_friction", at=at, coefficient=0.9), read("plate_friction", at=at, coefficient=1.0), rtol=2e-2
    )


def test_thick_streams_land_without_rebound() -> None:
    dead = read(grain={"restitution": 0.0})
    shielded = read("jet_shielding", rate_per_m=300.0)
    np.testing.assert_allclose(shielded[LOAD > 1.0], dead[LOAD > 1.0], rtol=0.05)
    assert np.all((shielded <= BASE * (1.0 + 1e-12)) & (shielded >= dead * (1.0 - 1e-12)))
    assert np.all(np.diff(shielded.reshape(4, 4) / BASE.reshape(4, 4), axis=0) < 0.0)


def test_restitution_is_the_given_one_at_tip_speed() -> None:
    """A thin load meets a plate at right angles with the tip's speed."""
    level = Conditions(np.radians(90.0), SPEED, paddle_mass_kg=1e-9)
    np.testing.assert_allclose(read("speed_dependent_restitution", at=level, exponent=0.5), read(at=level), rtol=1e-3)
    fast = replace(level, elevator_speed_rad_s=1.3 * SPEED)
    gain = read("speed_dependent_restitution", at=fast, exponent=0.5) / read(at=fast) * 1.6
    np.testing.assert_allclose(gain, 1.0 + 0.6 * 1.3**-0.5, rtol=1e-3)


def test_second_strikes_matter_most_at_normal_incidence() -> None:
    light = replace(AT, paddle_mass_kg=np.full(ANGLE.shape, 1e-6))
    extra = read("secondary_impact", at=light, share=1.0) / read(at=light) - 1.0
    np.testing.assert_allclose(extra, 0.6 * 0.4 / 1.6 * np.sin(ANGLE) ** 2, rtol=0.02)


def test_resting_grain_is_read_as_its_weight() -> None:
    added = read("resting_grain", at=replace(AT, paddle_mass_kg=np.full(ANGLE.shape, 0.05)), time_s=0.1) - read(
        at=replace(AT, paddle_mass_kg=np.full(ANGLE.shape, 0.05))
    )
    np.testing.assert_allclose(added, 0.05 * 9.81 * 0.1, rtol=1e-9)


def test_offset_and_buildup_are_forces_without_grain() -> None:
    np.testing.assert_allclose((read("zero_offset", force_n=3.0) - BASE) * PASSES, 3.0, rtol=1e-9)
    np.testing.assert_allclose((read("plate_buildup", weight_n=3.0) - BASE) * PASSES, 3.0 * np.cos(ANGLE), atol=1e-9)


def test_lever_arm_is_blind_to_grain_in_the_middle() -> None:
    model = ForwardModel(MACHINE, ("lever_arm",))
    throw = model.throw(ANGLE, SPEED, GRAIN | {"lever_arm.slope": 0.6})
    impulse = throw.reading(LOAD).impulse
    place = impulse.arrival.from_low_edge_m / MACHINE.plate_length_m + 0.5
    np.testing.assert_allclose(impulse.weight, 1.0 + 0.6 * np.clip(place, -0.5, 0.5), rtol=1e-12)


def test_cell_depends_on_force_alone() -> None:
    force = BASE * PASSES
    np.testing.assert_allclose(
        read("cell_nonlinearity", softening_per_n=0.002) * PASSES, force / (1.0 + 0.002 * force), rtol=1e-12
    )


def test_moisture_scales_the_grain() -> None:
    effect = "moisture_dependence"
    rates = {"friction_per_pct": 0.05, "density_per_pct": -0.01, "restitution_per_pct": -0.02}
    np.testing.assert_allclose(read(effect, **rates), BASE, rtol=1e-12)
    wet = replace(AT, moisture_pct=np.full(ANGLE.shape, 25.0))
    same = read(
        at=wet,
        grain={"friction": 0.3 * np.exp(0.5), "density": 1200.0 * np.exp(-0.1), "restitution": 0.6 * np.exp(-0.2)},
    )
    np.testing.assert_allclose(read(effect, at=wet, **rates), same, rtol=1e-12)


def test_moisture_must_be_known() -> None:
    dry = {"friction_per_pct": 0.0, "density_per_pct": 0.0, "restitution_per_pct": 0.0}
    with pytest.raises(ValueError, match="moisture is unknown"):
        read("moisture_dependence", at=replace(AT, moisture_pct=None), **dry)


RISEN = {
    "density": 700.0, "shape_ratio": 2.9, "gravity.acceleration_m_s2": 9.81, "stream_rise.ratio": 0.13,
    "unpushed_layers.rate_per_rad": 1.5,
}  # fmt: skip
RISEN_STREAM = ("gravity", "stream_rise", "unpushed_layers")


def test_the_plates_end_takes_nothing_of_a_stream_square_to_the_plate() -> None:
    """Where grain runs up the plate and not down it, a thicker end changes nothing; at low angles it takes more."""
    low, upright = np.radians([40.0, 95.0])
    model = ForwardModel(MACHINE, (*RISEN_STREAM, "top_edge"))
    for angle, grows in ((low, True), (upright, False)):
        at = Conditions(angle, 400.0 * RPM, paddle_mass_kg=np.array([1.3, 1.8]))
        thin, thick = (model.paddle_momentum(at, GRAIN | RISEN | {"top_edge.thickness_m": size}) for size in (0.008, 0.012))
        if grows:
            assert np.all(thick > 1.01 * thin)
        else:
            np.testing.assert_allclose(thick, thin, rtol=3e-3)


def test_an_upright_plate_turns_half_of_what_passes_over_it() -> None:
    """A level stream square to the plate runs up it as much as down it."""
    model = ForwardModel(MACHINE, ("stream_rise", "top_edge"))
    throw = model.throw(np.radians(90.0), 400.0 * RPM, GRAIN | {"stream_rise.ratio": 0.13, "top_edge.thickness_m": 0.01})
    arrival = throw.reading(np.asarray(0.4)).impulse.arrival
    nodes = arrival.jet.mass_kg.shape[-1] // 2
    mass, place = arrival.jet.mass_kg.ravel()[:nodes], arrival.from_low_edge_m.ravel()[:nodes]
    share, into, along = (
        a.ravel()[:nodes] for a in (arrival.landing_share, arrival.normal_speed_m_s, arrival.tangential_speed_m_s)
    )
    above_m = -place - MACHINE.plate_length_m
    over = 0.5 * (1.0 + special.erf(above_m / 0.01))
    landed = mass * (1.0 - over)
    cos = (landed * along).sum() / np.hypot((landed * along).sum(), (landed * into).sum())
    assert abs(cos) < 0.3
    rising = (along < 0.0) & (place < 0.0)
    assert over[rising].max() > 0.3
    np.testing.assert_allclose((share - (1.0 - over))[rising] / over[rising], 0.5 * (1.0 - cos), rtol=0.02)


def test_what_the_plates_end_stops_gives_up_its_speed_along_the_plate() -> None:
    """Grain on the end acts along the plate: its speed down the plate, turned into the horizontal, times the gain."""
    angle = np.radians(45.0)
    model = ForwardModel(MACHINE, (*RISEN_STREAM, "top_edge"))
    throw = model.throw(angle, 500.0 * RPM, GRAIN | RISEN | {"top_edge.thickness_m": 0.01})
    reading = throw.reading(np.asarray(1.3))
    arrival, gain = reading.impulse.arrival, reading.impulse.normal_gain
    nodes = arrival.jet.mass_kg.shape[-1] // 2
    mass, share = arrival.jet.mass_kg.ravel(), np.where(arrival.landing_share > 0.0, arrival.landing_share, 0.0).ravel()
    into, down = arrival.normal_speed_m_s.ravel()[:nodes], arrival.tangential_speed_m_s.ravel()[:nodes]
    gain = np.broadcast_to(gain, arrival.jet.mass_kg.shape).ravel()[:nodes]
    face = np.where(share[:nodes] > 0.0, mass[:nodes] * share[:nodes] * into, 0.0) * gain
    end = np.where(share[nodes:] > 0.0, mass[nodes:] * share[nodes:] * down, 0.0) * gain
    assert end.sum() > 0.05 * face.sum()
    expected = (face * np.sin(angle) + end * np.cos(angle)).sum()
    assert reading.momentum_kg_m_s.item() == pytest.approx(expected, rel=1e-9)
    whole = mass.reshape(2, nodes)[0].sum()
    assert (mass * share).sum() < whole
