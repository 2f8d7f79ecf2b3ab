"""Machines of a fleet that are alike but for noise: what is stated of the noise explains what they show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import integrate, stats

from yieldmon.discrepancy.base_fit import fit_base
from yieldmon.discrepancy.frame import effect_parameters, predictions
from yieldmon.discrepancy.machines.fleet import examine
from yieldmon.discrepancy.machines.force_change import ForceChange, Guess, Visible, force_change
from yieldmon.discrepancy.machines.lattice import Lattice, lay
from yieldmon.discrepancy.policy import Policy
from yieldmon.estimation.self_calibration.home_flow import AwayVisits
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

MACHINE, SHIPPED = Machine(), parameter_file.load()
MODEL = ForwardModel(MACHINE, SHIPPED.effects)
ANGLE = np.radians([40.0, 40.0, 40.0, 50.0, 60.0, 80.0, 90.0, 90.0, 90.0])
HOME = np.full(ANGLE.size, MACHINE.home_plate_angle_rad)
FORCE_VARIANCE, FLOW_VARIANCE = 1e-4, 3e-4
SEARCH_NOTHING = Policy(most_effects=0)


def forces(angle_rad: Array, speed_rad_s: Array, flow_kg_s: Array) -> Array:
    """Of all sweeps at once, (sweeps, angles)."""
    angle_rad = np.broadcast_to(angle_rad, flow_kg_s.shape)
    where = Conditions(angle_rad.ravel(), speed_rad_s.ravel(), mass_flow_kg_s=flow_kg_s.ravel(), moisture_pct=15.0)
    return np.real(MODEL.force(where, SHIPPED.values)).reshape(flow_kg_s.shape)


def alike(
    correlation: float, rng: np.random.Generator, machines: int = 5, sweeps: int = 24, offsets_rad: Sequence[float] = ()
) -> Lattice:
    """Machines that are the model's own but for noise, of which visits of one sweep share a part of that in their flow.

    offsets_rad: by how much the plates of the first machines are turned from what they say.
    """
    shared = FLOW_VARIANCE * (correlation + (1.0 - correlation) * np.eye(ANGLE.size))
    shape = (sweeps, ANGLE.size)
    speed = np.resize([380.0 * RPM, 420.0 * RPM], sweeps)[:, None] * np.ones(shape)
    made = []
    for number in range(machines):
        flow, read_noise, flow_noise = np.empty(shape), np.empty(shape), np.empty(shape)
        for sweep in range(sweeps):
            flow[sweep] = rng.uniform(5.0, 14.0)
            read_noise[sweep] = np.sqrt(FORCE_VARIANCE) * rng.standard_normal(ANGLE.size)
            flow_noise[sweep] = rng.multivariate_normal(np.zeros(ANGLE.size), shared)
        turned = offsets_rad[number] if number < len(offsets_rad) else 0.0
        away, home, known = (forces(angle, speed, flow) for angle in (ANGLE + turned, HOME + turned, HOME))
        # Flow is what the force at home says; the gain is brought to one by tickets.
        read, taken = away * known / home * np.exp(read_noise), flow * np.exp(flow_noise)
        variance = np.full(ANGLE.size, FORCE_VARIANCE)
        of_machine = [AwayVisits(ANGLE, speed[k], taken[k], read[k], 15.0, variance, shared) for k in range(sweeps)]
        made.append((f"m{number}", of_machine))
    return lay(MACHINE, SHIPPED, 10.0, made)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_noise_that_visits_of_a_sweep_share_is_no_gap_of_the_model(correlation: float) -> None:
    found = examine(alike(correlation, np.random.default_rng(7)), np.random.default_rng(1), SEARCH_NOTHING)
    assert found.deviating == ()
    assert found.misfit == pytest.approx(1.0, abs=0.15)
    assert found.shared.lack_of_fit_before.f == pytest.approx(1.0, abs=0.3)
    assert found.shared.lack_of_fit_before.p_value > 0.01


@pytest.fixture(scope="module")
def visible_offset() -> Visible:
    """From what angle a turned plate shows."""
    found = examine(alike(0.0, np.random.default_rng(7), sweeps=12), np.random.default_rng(1), SEARCH_NOTHING)
    (offset,) = [v for v in found.visible_from if v.effect == "plate_angle_offset"]
    assert (offset.parameter, offset.unit) == ("angle_rad", "rad")
    assert 0.0 < offset.size < 0.1
    return offset


@pytest.mark.parametrize(("times", "deviating"), [(2.0, ("m0",)), (0.3, ())])
def test_an_effect_shows_from_the_size_that_is_stated(visible_offset: Visible, times: float, deviating: tuple[str, ...]) -> None:
    bent = alike(0.0, np.random.default_rng(7), sweeps=12, offsets_rad=[times * visible_offset.size])
    assert examine(bent, np.random.default_rng(1), SEARCH_NOTHING).deviating == deviating


@pytest.mark.parametrize("offset_rad", [0.008, 0.02])
def test_machines_do_not_hide_behind_the_scatter_of_grain_that_they_make(offset_rad: float) -> None:
    """Each turned plate alone would pass as grain of its own where the others' are taken for that as well."""
    offsets = [offset_rad, offset_rad, -offset_rad]
    bent = alike(0.0, np.random.default_rng(7), machines=9, sweeps=12, offsets_rad=offsets)
    assert examine(bent, np.random.default_rng(1), SEARCH_NOTHING).deviating == ("m0", "m1", "m2")


def guess_of(law: str, size: float) -> Guess:
    (parameter,) = effect_parameters(law, 1.0)
    return Guess(ForceChange(law, (parameter,), np.array([[parameter.start + size]]), np.zeros((1, 1))), 0, 1.0)


@pytest.mark.parametrize(
    ("law", "size"), [("lever_arm", 1.4), ("lever_arm", -1.4), ("plate_friction", 0.4), ("plate_angle_offset", 0.08)]
)
def test_a_large_effect_is_known_by_its_change_though_that_bends_with_size(law: str, size: float) -> None:
    base = fit_base(alike(0.0, np.random.default_rng(7), sweeps=4).frame)
    """Half a percent of a change of 40 % is many deviations of the sweeps' mean."""
    drawn = force_change(base, law)
    assert drawn is not None
    (name,) = (p.name for p in drawn.parameters)
    true = np.log(
        np.real(predictions(base.frame, (*base.effects, law), {**base.values, name: size}))
        / np.real(predictions(base.frame, base.effects, base.values))
    )
    shares = (drawn.change @ true) / np.sum(drawn.change**2, axis=1)
    left = np.linalg.norm(true - shares[:, None] * drawn.change, axis=1) / np.linalg.norm(true)
    assert left.min() < 0.004


@pytest.mark.parametrize(("law", "sides"), [("lever_arm", 1.0), ("plate_friction", 2.0)])
@pytest.mark.parametrize("size", [0.02, 0.2, 0.8])
def test_a_size_costs_what_its_prior_gives_to_the_width_of_its_likelihood(law: str, sides: float, size: float) -> None:
    length = 40.0
    (prior,) = (p.prior_sd for p in effect_parameters(law, 1.0))
    sd = size / length

    def both(x: float) -> float:
        return sides * stats.cauchy.pdf(x, scale=prior) * np.exp(-0.5 * ((x - size) / sd) ** 2)

    expected, _ = integrate.quad(both, size - 8.0 * sd, size + 8.0 * sd)
    assert guess_of(law, size).surprise(length) == pytest.approx(-2.0 * np.log(expected), abs=0.02)


def test_grain_of_its_own_is_unlikely_at_one_machine() -> None:
    common, own = (guess_of(law, 0.1) for law in ("residual_radial_speed", "plate_friction"))
    ratio = [p.prior_sd for g in (common, own) for p in g.change.parameters]
    by_width = 2.0 * np.log((1.0 + (0.1 / ratio[0]) ** 2) * ratio[0] / ((1.0 + (0.1 / ratio[1]) ** 2) * ratio[1]))
    assert common.surprise(40.0) - own.surprise(40.0) - by_width == pytest.approx(2.0 * np.log(20.0))
