"""Closed loop: what a sweep determines, what it cannot, and what is refused."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from yieldmon import api
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.fitting.identifiability import FLOW, Direction, directions, relative_jacobian, report, scaled
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import fit_parameters, self_calibrate, update_from_tickets
from yieldmon.estimation.self_calibration.closed_loop_inputs import MeasuredDensity, Sweep, WeighedMass
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

MACHINE = Machine()
MODEL = ForwardModel(MACHINE)
SPEED = MACHINE.nominal_elevator_speed_rad_s
ANGLES = np.radians(np.arange(40.0, 91.0, 5.0))
NAMES = ("friction", "restitution", "density")
CENTRE = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
FLOWS = np.array([2.0, 5.0, 9.0, 12.0, 15.0, 18.0, 21.0, 25.0])


def prior(values: dict[str, float] = CENTRE, widths: tuple[float, float, float] = (0.2, 0.1, 0.1)) -> ParameterSet:
    return ParameterSet(values, NAMES, np.diag([(w * values[n]) ** 2 for w, n in zip(widths, NAMES, strict=True)]))


def sweep(
    flow: float | Array,
    values: dict[str, float] = CENTRE,
    noise: float = 0.01,
    rng: np.random.Generator | None = None,
    angles: Array = ANGLES,
    model: ForwardModel = MODEL,
) -> Sweep:
    force = np.real(model.force(Conditions(angles, SPEED, mass_flow_kg_s=flow), values))
    sd = noise * force
    if rng is not None:
        force = force + sd * rng.normal(size=force.size)
    return Sweep(3.0 * np.arange(force.size), angles, np.full(force.size, SPEED), force, sd)


# The scale


@pytest.mark.parametrize(
    "values", [CENTRE, {"friction": 0.3, "density": 1300.0, "shape_ratio": 2.0, "k1": 1.2, "k2": 0.6}], ids=["1 + e", "k1, k2"]
)
@pytest.mark.parametrize("factor", [0.6, 1.1, 1.59])
def test_scaling_changes_no_force(values: dict[str, float], factor: float) -> None:
    conditions = Conditions(ANGLES[:, None], np.array([32.0, 42.0, 52.0]), mass_flow_kg_s=10.0)
    moved = Conditions(ANGLES[:, None], np.array([32.0, 42.0, 52.0]), mass_flow_kg_s=factor * 10.0)
    force = np.real(MODEL.force(conditions, values))
    assert np.real(MODEL.force(moved, scaled(ParameterSet(values), factor).values)) == pytest.approx(force, rel=1e-12)


def sweep_directions(flow: float) -> tuple[Direction, ...]:
    """Directions of flow and parameters that one sweep at one unknown flow leaves."""
    relative, by_load = relative_jacobian(MODEL, Conditions(ANGLES, SPEED, mass_flow_kg_s=flow), CENTRE, NAMES, 0.1)
    return directions(np.hstack((by_load, relative)), (FLOW, *NAMES))


@pytest.mark.parametrize("flow", [2.0, 6.0, 12.0, 22.0])
def test_the_scale_is_found_numerically_and_named(flow: float) -> None:
    found = sweep_directions(flow)
    assert sum(d.is_scale for d in found) == 1
    scale = next(d for d in found if d.is_scale)
    assert scale.relative_sd == np.inf
    # Of parts that are printed alike the names' order decides, not rounding.
    assert scale.words() == "mass flow +1.00, 1 + restitution -1.00, density +1.00"


@pytest.mark.parametrize("rounding", [-1e-12, 0.0, 1e-12])
def test_the_sign_of_a_direction_of_equal_parts_does_not_turn_with_rounding(rounding: float) -> None:
    """Vector units of different processors round differently."""
    free = directions(np.array([[1.0, 1.0 + rounding]]), ("density", "mass flow"))[0]
    assert free.components == pytest.approx((-np.sqrt(0.5), np.sqrt(0.5)))


@pytest.mark.parametrize("k1", [0.5, -0.5])
def test_the_scale_is_named_and_rests_on_the_prior_with_exchange_coefficients(k1: float) -> None:
    values = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "k1": k1, "k2": 1.6}
    names = ("friction", "density", "k1", "k2")
    flows = (8.0, 20.0)
    conditions = Conditions(np.tile(ANGLES, 2), SPEED, mass_flow_kg_s=np.repeat(flows, ANGLES.size))
    known = ParameterSet(values, names, np.diag([0.04**2, 110.0**2, 0.05**2, 0.16**2]))
    assert sum(d.is_scale for d in report(MODEL, conditions, known, names, 0.1).unknown_load) == 1
    outcome = self_calibrate(MODEL, known, [sweep(f, values, 0.01) for f in flows])
    assert not outcome.scale.observable
    assert outcome.reason.endswith("rests on the prior")


def test_a_thin_stream_that_all_lands_determines_two_numbers_only() -> None:
    # Without misses the force is sin(phi) (A sin(phi) - B cos(phi)): two of four unknowns stay open.
    found = sweep_directions(1.0)
    assert sum(not np.isfinite(d.relative_sd) for d in found) == 2


def test_known_loads_fix_the_scale_and_the_report_says_so() -> None:
    conditions = Conditions(np.tile(ANGLES, 3), SPEED, mass_flow_kg_s=np.repeat([5.0, 12.0, 20.0], 11))
    found = report(MODEL, conditions, ParameterSet(CENTRE), NAMES, 0.01)
    assert all(np.isfinite(d.relative_sd) for d in found.known_load)
    assert sum(d.is_scale for d in found.unknown_load) == 1
    assert any("(mass flow, density, impact gain)" in s for s in found.sentences)
    assert found.document()["remedies"]


def test_the_remedies_work() -> None:
    angle, flow = np.radians([70.0, 70.0, 70.0]), np.array([5.0, 12.0, 20.0])
    known = ParameterSet(CENTRE)
    found = report(MODEL, Conditions(angle, SPEED, mass_flow_kg_s=flow), known, NAMES, 0.05)
    assert found.remedies[0].worst_sd_after < found.known_load[0].relative_sd
    assert found.remedies == tuple(sorted(found.remedies, key=lambda r: r.worst_sd_after))
    relative, _ = relative_jacobian(MODEL, Conditions(angle, SPEED, mass_flow_kg_s=flow), CENTRE, NAMES, 0.05)
    kinds = set()
    for remedy in found.remedies:
        if reported := re.match(r"three more rows at (\S+) deg, (\S+) rpm, (\S+) kg/s", remedy.measurement):
            at_deg, rpm, load = map(float, reported.groups())
            more = Conditions(
                np.append(angle, np.full(3, np.radians(at_deg))),
                np.append(np.full(3, SPEED), np.full(3, rpm * RPM)),
                mass_flow_kg_s=np.append(flow, np.full(3, load)),
            )
            after = report(MODEL, more, known, NAMES, 0.05).known_load[0].relative_sd
        else:
            reported = re.match(r"know (.+) within 5 %", remedy.measurement)
            row = np.array([[20.0 if name == reported[1].removeprefix("1 + ") else 0.0 for name in NAMES]])
            after = 1.0 / np.linalg.svd(np.vstack((relative, row)), compute_uv=False)[-1]
        kinds.add(remedy.measurement[:4])
        assert remedy.worst_sd_after == pytest.approx(after, rel=1e-3)
    assert kinds == {"thre", "know"}


# What is learned


def test_drifted_grain_within_the_published_error_and_covered() -> None:
    drifted = {"friction": 0.1952, "restitution": 0.6360, "density": 1133.0, "shape_ratio": 2.0}
    known = prior({"friction": 0.19, "restitution": 0.60, "density": 1084.0, "shape_ratio": 2.0})
    for noise in (0.0003, 0.01):
        sweeps = [sweep(f, drifted, noise) for f in FLOWS]
        alone = [self_calibrate(MODEL, known, [s]).flows[0] for s in sweeps]
        pooled = self_calibrate(MODEL, known, sweeps).flows
        for flows in (alone, pooled):
            error = np.array([100.0 * abs(f.mass_flow_kg_s / t - 1.0) for f, t in zip(flows, FLOWS, strict=True)])
            inside = [f.interval(0.9)[0] <= t <= f.interval(0.9)[1] for f, t in zip(flows, FLOWS, strict=True)]
            assert all(inside)
            if flows is pooled or noise == 0.0003:
                assert error.mean() <= 1.87


def test_the_posterior_along_the_scale_is_the_prior() -> None:
    truth = dict(CENTRE, density=1250.0, restitution=0.7, friction=0.25)
    outcome = self_calibrate(MODEL, prior(), [sweep(f, truth, 0.002) for f in (8.0, 15.0, 22.0)])
    assert outcome.updated
    assert outcome.scale.ratio == pytest.approx(1.0, abs=1e-6)
    assert abs(outcome.scale.shift) < 1e-6
    assert not outcome.scale.observable
    assert any(d.is_scale for d in outcome.scale.unobservable_directions)
    # Gain times density is learned all the same.
    values = outcome.parameter_set.values
    product = (1.0 + values["restitution"]) * values["density"] / (1.7 * 1250.0)
    assert product == pytest.approx(1.0, abs=0.025)
    assert values["friction"] == pytest.approx(0.25, abs=0.02)


def test_pooling_narrows_the_estimates_of_single_sweeps() -> None:
    sweeps = [sweep(f, noise=0.01) for f in (6.0, 10.0, 14.0, 18.0)]
    one = self_calibrate(MODEL, prior(), sweeps[:1])
    four = self_calibrate(MODEL, prior(), sweeps)
    for name in ("friction", "density"):
        width = [next(p.ratio for p in o.parameters if p.name == name) for o in (one, four)]
        assert width[1] < width[0]


def test_pooled_sweeps_equal_the_same_sweeps_one_after_another() -> None:
    rng = np.random.default_rng(12)
    truth = dict(CENTRE, friction=0.22, density=1150.0)
    sweeps = [sweep(f, truth, 0.01, rng) for f in (9.0, 16.0)]
    loose = ClosedLoopSettings(learned_information=0.0, kept_ratio=1.1)
    pooled = self_calibrate(MODEL, prior(), sweeps, settings=loose)
    first = self_calibrate(MODEL, prior(), sweeps[:1], settings=loose)
    second = self_calibrate(MODEL, first.parameter_set, sweeps[1:], settings=loose)
    for a, b in zip(pooled.parameters, second.parameters, strict=True):
        # Equal but for the second-order terms that a Gaussian in between drops.
        assert b.value == pytest.approx(a.value, abs=0.1 * a.prior_sd)
        assert b.sd == pytest.approx(a.sd, rel=0.1)


def test_ninety_per_cent_intervals_cover_flow_and_parameters() -> None:
    rng = np.random.default_rng(1)
    known, count = prior(), 300
    angles = np.repeat(ANGLES, 2)
    hits = dict.fromkeys(("flow", *NAMES), 0)
    for _ in range(count):
        draw = rng.multivariate_normal([CENTRE[n] for n in NAMES], known.covariance)
        truth = dict(CENTRE, **dict(zip(NAMES, np.clip(draw, [0.0, 0.0, 200.0], [3.0, 1.0, 5000.0]).tolist(), strict=True)))
        flow = float(np.exp(rng.uniform(np.log(4.0), np.log(22.0))))
        clean = np.real(MODEL.force(Conditions(angles, SPEED, mass_flow_kg_s=flow), truth))
        force = clean + np.hypot(0.02 * clean, 0.1) * rng.normal(size=22)
        sd = np.hypot(0.02 * np.abs(force), 0.1)
        outcome = self_calibrate(MODEL, known, [Sweep(3.0 * np.arange(22), angles, np.full(22, SPEED), force, sd)])
        low, high = outcome.flows[0].interval(0.9)
        hits["flow"] += low <= flow <= high
        for p in outcome.parameters:
            low, high = p.interval(0.9)
            hits[p.name] += low <= truth[p.name] <= high
    for name, n in hits.items():
        assert 0.85 <= n / count <= 0.95, name


# Flow that is not constant


def test_a_linear_trend_is_estimated() -> None:
    angles = np.concatenate((ANGLES, [np.radians(70.0)] * 3, ANGLES[::-1]))
    clock = 3.0 * np.arange(angles.size)
    flow = 12.0 * np.exp(0.003 * (clock - clock.mean()))
    rows = sweep(flow, noise=0.005, angles=angles)
    trend = self_calibrate(MODEL, prior(), [rows], settings=ClosedLoopSettings(flow="linear"))
    constant = self_calibrate(MODEL, prior(), [rows])
    assert trend.consistent
    assert not constant.consistent
    assert trend.flows[0].mass_flow_kg_s == pytest.approx(12.0, rel=0.02)


def test_a_wandering_flow_is_fitted_as_a_process_and_its_mean_found() -> None:
    rng = np.random.default_rng(21)
    angles = np.tile(np.concatenate(([np.radians(70.0)], ANGLES)), 2)
    z, known = [], prior(widths=(0.05, 0.01, 0.03))
    settings = ClosedLoopSettings(flow="process", flow_process_sd=0.06, flow_process_time_s=15.0)
    for _ in range(30):
        lag = np.abs(3.0 * (np.arange(angles.size)[:, None] - np.arange(angles.size))) / 15.0
        wander = 0.06 * np.linalg.cholesky(np.exp(-lag) + 1e-12 * np.eye(angles.size)) @ rng.normal(size=angles.size)
        flow = 11.0 * np.exp(wander)
        outcome = self_calibrate(MODEL, known, [sweep(flow, noise=0.01, rng=rng, angles=angles)], settings=settings)
        assert outcome.consistent
        z.append(np.log(outcome.flows[0].mass_flow_kg_s / flow.mean()) / outcome.flows[0].log_sd)
    assert abs(np.mean(z)) < 0.6
    assert 0.4 < np.std(z) < 1.4


def test_the_mean_of_a_wandering_flow_is_as_uncertain_as_the_windows_noise_makes_it() -> None:
    """Grain known, windows far apart: the flow's own ups and downs are in them, so that their noise alone blurs its mean."""
    count, noise = 16, 0.04
    known = prior(widths=(1e-6, 1e-6, 1e-6))
    angles = np.full(count, np.radians(70.0))
    steady = sweep(11.0, noise=noise, angles=angles)
    rows = dataclasses.replace(steady, time_s=1e4 * np.arange(count))
    outcome = self_calibrate(
        MODEL, known, [rows], settings=ClosedLoopSettings(flow="process", flow_process_sd=0.05, flow_process_time_s=20.0)
    )
    near = Conditions(np.radians(70.0), SPEED, mass_flow_kg_s=11.0 * np.exp([-1e-4, 1e-4]))
    elasticity = float(np.diff(np.log(np.real(MODEL.force(near, CENTRE))))[0] / 2e-4)
    assert outcome.flows[0].log_sd == pytest.approx(noise / elasticity / np.sqrt(count), rel=1e-3)


# Weighed masses and densities


def load(reference_flow: float, truth: dict[str, float], sd_kg: float, windows: int = 600) -> WeighedMass:
    flow = reference_flow * (1.0 + 0.3 * np.sin(np.arange(windows) / 40.0))
    force = np.real(MODEL.force(Conditions(np.radians(70.0), SPEED, mass_flow_kg_s=flow), truth))
    ones = np.ones(windows)
    return WeighedMass.from_windows(float(flow.sum()), sd_kg, ones, force, np.radians(70.0) * ones, SPEED * ones)


def test_a_weighed_load_fixes_the_scale() -> None:
    truth = dict(CENTRE, density=1220.0, restitution=0.68, friction=0.23)
    sweeps = [sweep(f, truth, 0.005) for f in (8.0, 14.0)]
    without = self_calibrate(MODEL, prior(), sweeps)
    with_masses = self_calibrate(MODEL, prior(), sweeps, masses=[load(10.0, truth, 20.0)])
    assert with_masses.consistent
    assert with_masses.scale.observable
    assert with_masses.scale.ratio < 0.3 < without.scale.ratio
    for flow, true in zip(with_masses.flows, (8.0, 14.0), strict=True):
        assert flow.mass_flow_kg_s == pytest.approx(true, rel=0.01)
    # An open loop with the new parameters weighs the load right.
    test_load = load(10.0, truth, 20.0)
    measured = test_load.duration_s @ OpenLoop(MODEL, with_masses.parameter_set).invert(
        test_load.force_n, test_load.plate_angle_rad, test_load.elevator_speed_rad_s
    )
    assert measured == pytest.approx(test_load.reference_kg, rel=0.004)


def test_a_weighed_load_alone_updates_too() -> None:
    truth = dict(CENTRE, restitution=0.70)
    outcome = self_calibrate(MODEL, prior(), (), masses=[load(10.0, truth, 10.0)])
    assert outcome.updated
    force = np.real(MODEL.force(Conditions(np.radians(70.0), SPEED, mass_flow_kg_s=10.0), truth))
    assert OpenLoop(MODEL, outcome.parameter_set).invert(force, np.radians(70.0), SPEED) == pytest.approx(10.0, rel=0.01)


def test_former_names_of_masses_and_densities_still_work() -> None:
    with pytest.warns(DeprecationWarning, match="MassAnchor is now called WeighedMass"):
        assert api.MassAnchor is WeighedMass
    with pytest.warns(DeprecationWarning, match="DensityAnchor is now called MeasuredDensity"):
        assert api.DensityAnchor is MeasuredDensity
    with pytest.raises(AttributeError, match="has no attribute"):
        api.Mass  # noqa: B018
    mass = load(10.0, dict(CENTRE, restitution=0.70), 10.0)
    present, former = self_calibrate(MODEL, prior(), (), masses=[mass]), self_calibrate(MODEL, prior(), (), anchors=[mass])
    assert former.parameter_set == present.parameter_set != prior()


@pytest.mark.parametrize("share", [0.5, 0.1, 0.02], ids=lambda share: f"{share:g} of the ticket's")
def test_a_weighed_load_counts_by_its_own_deviation_however_little_it_says(share: float) -> None:
    ticket_sd, off, mass = 0.005, 0.01, load(10.0, CENTRE, 1.0)

    def ln_mass(values: dict[str, float]) -> float:
        loop = OpenLoop(MODEL, ParameterSet(values))
        return float(np.log(mass.duration_s @ loop.invert(mass.force_n, mass.plate_angle_rad, mass.elevator_speed_rad_s)))

    by_restitution = (ln_mass(dict(CENTRE, restitution=0.606)) - ln_mass(CENTRE)) / 0.01
    known = prior(widths=(1e-7, share * ticket_sd / abs(by_restitution), 1e-7))
    weighed_kg = mass.reference_kg * (1.0 - off)
    weighed = dataclasses.replace(mass, reference_kg=weighed_kg, std_dev_kg=ticket_sd * weighed_kg)
    found = update_from_tickets(MODEL, known, [weighed])
    assert found.updated
    # Bayes' rule for one number, known to `share` of the deviation that it is weighed to.
    step = (ln_mass(dict(found.parameter_set.values)) - ln_mass(CENTRE)) / np.log(1.0 - off)
    assert step == pytest.approx(share**2 / (1.0 + share**2), rel=0.1)


@pytest.mark.parametrize(
    ("widths", "expected"),
    [((0.05, 0.002, 0.005), 256.0), ((0.05, 0.002, 0.2), 4.0), ((1.5, 0.002, 0.005), 1.0), ((0.05, 0.5, 0.005), 1.0)],
    ids=["narrow", "density 220 of 625 kg/m3", "friction 0.3 of 0.5", "restitution 0.3 of 0.5"],
)
def test_deviations_are_doubled_no_further_than_half_of_the_physical_range(
    widths: tuple[float, float, float], expected: float
) -> None:
    """Two masses of one force: no parameters explain both, and every doubling is asked for."""
    known = prior(widths=widths)
    windows = [np.array([value]) for value in (100.0, 40.0, MACHINE.home_plate_angle_rad, SPEED)]
    found = update_from_tickets(MODEL, known, [WeighedMass(500.0, 0.5, *windows), WeighedMass(900.0, 0.5, *windows)])
    assert not found.consistent
    assert found.prior_widening == expected


def test_condensed_windows_weigh_what_all_of_them_weigh() -> None:
    rng = np.random.default_rng(4)
    flow = rng.uniform(1.0, 22.0, 900)
    force = np.real(MODEL.force(Conditions(np.radians(70.0), SPEED, mass_flow_kg_s=flow), CENTRE))
    ones = np.ones(900)
    condensed = WeighedMass.from_windows(1.0, 1.0, ones, force, np.radians(70.0) * ones, SPEED * ones)
    assert condensed.force_n.size == 12
    loop = OpenLoop(MODEL, ParameterSet(CENTRE))
    whole = loop.invert(condensed.force_n, condensed.plate_angle_rad, condensed.elevator_speed_rad_s) @ condensed.duration_s
    assert whole == pytest.approx(flow.sum(), rel=0.002)


@pytest.mark.parametrize(("groups", "rows"), [(1, 2), (5, 10), (1000, 60)])
def test_condensed_windows_keep_what_they_hold_at_each_angle(groups: int, rows: int) -> None:
    rng = np.random.default_rng(5)
    seconds, angle = rng.uniform(0.5, 1.0, 60), np.radians(np.repeat([50.0, 70.0], 30))
    force, speed, moisture = (rng.uniform(low, high, 60) for low, high in ((10.0, 50.0), (40.0, 42.0), (12.0, 20.0)))
    found = WeighedMass.from_windows(9.0, 1.0, seconds, force, angle, speed, moisture_pct=moisture, common_kg=0.5, groups=groups)
    assert (found.duration_s.size, found.common_kg) == (rows, 0.5)
    for one in np.unique(angle):
        here, whole = np.isclose(found.plate_angle_rad, one), angle == one
        for condensed, given in ((found.force_n, force), (found.elevator_speed_rad_s, speed), (found.moisture_pct, moisture)):
            assert found.duration_s[here] @ condensed[here] == pytest.approx(seconds[whole] @ given[whole], rel=1e-12)


def test_a_known_density_moves_the_answer_along_the_scale() -> None:
    truth = dict(CENTRE, density=1220.0)
    sweeps = [sweep(f, truth, 0.002) for f in (10.0, 18.0)]
    outcome = self_calibrate(MODEL, prior(), sweeps, density=MeasuredDensity(1220.0, 5.0))
    assert outcome.scale.observable
    assert outcome.flows[0].mass_flow_kg_s == pytest.approx(10.0, rel=0.01)
    assert outcome.flows[0].log_sd < 0.75 * self_calibrate(MODEL, prior(), sweeps).flows[0].log_sd


def test_a_test_weight_carries_the_uncertainty_of_its_ratio() -> None:
    density = MeasuredDensity.from_test_weight(720.0, 7.2, 1.5, 0.15)
    assert density.density_kg_m3 == pytest.approx(1080.0)
    assert density.std_dev_kg_m3 == pytest.approx(1080.0 * np.hypot(0.01, 0.1))


# Refusals


def test_what_was_not_learned_keeps_value_and_variance() -> None:
    # A thin stream says next to nothing of density or restitution.
    outcome = self_calibrate(MODEL, prior(widths=(0.2, 0.02, 0.1)), [sweep(1.5, dict(CENTRE, friction=0.3), 0.02)])
    kept = [p for p in outcome.parameters if not p.learned]
    assert {p.name for p in kept} >= {"restitution"}
    for p in kept:
        assert p.value == p.prior
        assert p.sd == p.prior_sd
        assert outcome.parameter_set.values[p.name] == prior().values[p.name]


def test_nothing_learned_is_nothing_changed() -> None:
    known = prior()
    outcome = self_calibrate(MODEL, known, [sweep(3.0, noise=0.5)])
    assert not outcome.updated
    assert outcome.parameter_set is known
    assert outcome.consistent
    assert "too little" in outcome.reason
    assert outcome.learned() == ()


def test_windows_that_disagree_with_the_model_change_nothing_and_are_placed() -> None:
    known = prior()
    rows = sweep(12.0, noise=0.005)
    force = rows.force_n.copy()
    force[8] *= 1.2
    outcome = self_calibrate(MODEL, known, [dataclasses.replace(rows, force_n=force)])
    assert not outcome.consistent
    assert outcome.parameter_set is known
    assert outcome.p_value < 1e-3
    assert outcome.region == "80 deg"
    assert "around 80 deg" in outcome.reason


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.3, 0.5])
def test_flows_of_a_model_that_windows_disagree_with_are_covered(friction: float) -> None:
    """Plate friction by a law of its own, the scale right at home: the parameters bend to it, and the flows with them."""
    known, true = prior(widths=(0.1, 0.01, 0.02)), np.array([8.0, 14.0])
    law = (1.0 + friction / np.tan(ANGLES)) / (1.0 + friction / np.tan(np.radians(70.0)))
    sweeps = [dataclasses.replace(one, force_n=one.force_n * law) for one in (sweep(flow, noise=0.005) for flow in true)]
    found, bent = self_calibrate(MODEL, known, sweeps), fit_parameters(MODEL, known, sweeps, settings=ClosedLoopSettings())
    assert not found.consistent
    assert (found.parameter_set, found.p_value, found.reason) == (known, bent.p_value, bent.reason)
    assert [f.mass_flow_kg_s for f in found.flows] == [f.mass_flow_kg_s for f in bent.flows]

    def off(outcome: Outcome) -> Array:
        return np.array([np.log(f.mass_flow_kg_s / t) / f.log_sd for f, t in zip(outcome.flows, true, strict=True)])

    assert np.all(np.abs(off(found)) < 2.5)
    assert np.all(np.abs(off(bent)) > 5.0)


def test_a_model_error_makes_room_for_a_misfit() -> None:
    rows = sweep(12.0, noise=0.005)
    bent = dataclasses.replace(rows, force_n=rows.force_n * (1.0 + 0.02 * (-1.0) ** np.arange(11)))
    assert not self_calibrate(MODEL, prior(), [bent]).consistent
    assert self_calibrate(MODEL, prior(), [bent], settings=ClosedLoopSettings(model_error=0.02)).consistent


def test_the_parameters_own_model_error_counts() -> None:
    """As `calibrate` writes it; without it the windows would contradict, and the flow be surer than the calibration was."""
    rows = sweep(12.0, noise=0.005)
    bent = dataclasses.replace(rows, force_n=rows.force_n * (1.0 + 0.02 * (-1.0) ** np.arange(11)))
    known = dataclasses.replace(prior(), model_error=0.02)
    by_parameters, by_settings = (
        self_calibrate(MODEL, parameters, [bent], settings=ClosedLoopSettings(model_error=error))
        for parameters, error in ((known, 0.0), (prior(), 0.02))
    )
    assert by_parameters.consistent
    assert by_parameters.flows == by_settings.flows


def test_a_sweep_that_leads_to_an_end_of_the_range_of_grain_determines_nothing() -> None:
    """Grain of 600 kg/m3, which no calibration looks for; what weighs it does."""
    known, light = prior(widths=(0.02, 0.02, 0.9)), {**CENTRE, "density": 600.0}
    found = self_calibrate(MODEL, known, [sweep(12.0, light)])
    assert not found.updated
    assert found.parameter_set is known
    assert "density to 750 kg/m3 (750 to 2000), to an end of its range" in found.reason
    assert [(p.value, p.sd, p.learned) for p in found.parameters] == [(p.prior, p.prior_sd, False) for p in found.parameters]
    weighed = self_calibrate(MODEL, known, [sweep(12.0, light)], density=MeasuredDensity(600.0, 30.0))
    assert weighed.parameter_set.values["density"] == pytest.approx(600.0, abs=60.0)
    put_there = dataclasses.replace(known, values={**CENTRE, "density": 650.0})
    below = self_calibrate(MODEL, put_there, [sweep(12.0, light)]).parameter_set
    assert below.values["density"] == pytest.approx(600.0, abs=2.0 * below.standard_deviation("density"))


def test_the_covariance_after_a_refusal_in_part_is_one() -> None:
    rng = np.random.default_rng(8)
    for seed in range(12):
        correlated = np.array([[1.0, 0.6, -0.3], [0.6, 1.0, 0.4], [-0.3, 0.4, 1.0]])
        sd = np.array([0.04, 0.06, 110.0])
        known = ParameterSet(CENTRE, NAMES, correlated * np.outer(sd, sd))
        settings = ClosedLoopSettings(learned_information=0.3, kept_ratio=float(rng.uniform(0.7, 0.99)))
        outcome = self_calibrate(MODEL, known, [sweep(3.0 + 1.5 * seed, noise=0.02, rng=rng)], settings=settings)
        values = np.linalg.eigvalsh(outcome.parameter_set.covariance / np.outer(sd, sd))
        assert values.min() > 0.0
        assert np.all(np.diag(outcome.parameter_set.covariance) <= sd**2 * (1.0 + 1e-9))


def weighed(mass: WeighedMass) -> object:
    return self_calibrate(MODEL, prior(), (), masses=[mass])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: self_calibrate(MODEL, prior(), ()), "neither a sweep nor a weighed mass"),
        (lambda: self_calibrate(MODEL, ParameterSet(CENTRE), [sweep(5.0)]), "no covariance"),
        (lambda: self_calibrate(ForwardModel(MACHINE, ("gravity",)), prior(), [sweep(5.0)]), "effects"),
        (lambda: Sweep(np.zeros(2), ANGLES[:2], np.full(2, SPEED), np.array([1.0, np.nan]), np.ones(2)), "force_n must hold"),
        (lambda: Sweep(np.zeros(2), ANGLES[:2], np.full(2, SPEED), np.ones(2), np.zeros(2)), "above 0"),
        (lambda: Sweep(np.zeros(3), ANGLES[:2], np.full(2, SPEED), np.ones(2), np.ones(2)), "time_s must hold"),
        (lambda: self_calibrate(MODEL, prior(), [dataclasses.replace(sweep(5.0), force_n=np.full(11, 1e5))]), "full paddle"),
        (lambda: weighed(WeighedMass(900.0, 9.0, np.ones(3), np.ones(2), np.ones(3), np.ones(3))), "duration_s must hold"),
        (
            lambda: weighed(WeighedMass(900.0, 0.0, np.ones(3), np.ones(3), np.ones(3), np.ones(3))),
            "900 kg within 0 kg: expected",
        ),
        (lambda: weighed(WeighedMass(900.0, 9.0, np.ones(3), np.ones(3), 70.0 * np.ones(3), np.ones(3))), "70: expected radians"),
        (lambda: self_calibrate(MODEL, prior(), [dataclasses.replace(sweep(5.0), plate_angle_rad=np.full(11, 70.0))]), "sweep: "),
        (
            lambda: self_calibrate(MODEL, prior(), [sweep(5.0)], density=MeasuredDensity(-720.0, 10.0)),
            "density_kg_m3 -720: expected a number above 0",
        ),
        (
            lambda: self_calibrate(MODEL, prior(), [sweep(5.0)], density=MeasuredDensity(720.0, 0.0)),
            "std_dev_kg_m3 0: expected a number above 0",
        ),
        (lambda: ClosedLoopSettings(flow="cubic"), "expected constant, linear or process"),
        (lambda: ClosedLoopSettings(model_error=float("nan")), "model_error is nan; expected a number, 0 or more"),
        (lambda: ClosedLoopSettings(flow_process_time_s=0.0), "flow_process_time_s is 0.0; expected a number above 0"),
    ],
)
def test_bad_input_is_refused(call, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        call()


def test_effect_parameters_take_part_by_name() -> None:
    model = ForwardModel(MACHINE, ("zero_offset",))
    values = CENTRE | {"zero_offset.force_n": 0.0}
    names = (*NAMES, "zero_offset.force_n")
    known = ParameterSet(values, names, np.diag([0.04**2, 0.06**2, 110.0**2, 3.0**2]))
    rows = sweep(10.0, values | {"zero_offset.force_n": 4.0}, 0.002, model=model)
    outcome = self_calibrate(model, known, [rows])
    offset = next(p for p in outcome.parameters if p.name == "zero_offset.force_n")
    assert offset.learned
    assert offset.value == pytest.approx(4.0, abs=3.0 * offset.sd)
    assert offset.ratio < 0.7


def test_exchange_coefficients_and_a_responses_own_unit() -> None:
    values = {"friction": 0.3, "density": 1300.0, "shape_ratio": 2.0, "k1": 300.0, "k2": 200.0}
    names = ("friction", "density", "k1", "k2")
    known = ParameterSet(values, names, np.diag([0.06**2, 130.0**2, 30.0**2, 10.0**2]), response_unit="response")
    outcome = self_calibrate(MODEL, known, [sweep(12.0, dict(values, friction=0.34), 0.002)])
    assert outcome.updated
    assert outcome.parameter_set.response_unit == "response"
    assert outcome.flows[0].mass_flow_kg_s == pytest.approx(12.0, rel=0.1)
    assert not outcome.scale.observable


def test_lists_of_numbers_are_taken_as_arrays() -> None:
    arrays = sweep(12.0)
    columns = ("time_s", "plate_angle_rad", "elevator_speed_rad_s", "force_n", "force_std_dev_n")
    lists = Sweep(*(list(getattr(arrays, name)) for name in columns))
    assert all(np.array_equal(getattr(lists, name), getattr(arrays, name)) for name in columns)
    mass = WeighedMass(100.0, 1.0, [1.0, 1.0], [20.0, 30.0], [1.2, 1.2], [42.0, 42.0])
    mass.require_usable()
    with pytest.raises(ValueError, match="one finite number for each window"):
        Sweep([0.0, 1.0], [1.0], [42.0], [20.0], [1.0])


# The model's error that sweeps share


@pytest.mark.parametrize("flow_model", ["constant", "process"])
def test_more_sweeps_do_not_average_the_models_error_out(flow_model: str) -> None:
    settings, wide = ClosedLoopSettings(flow=flow_model, model_error=0.01, flow_process_sd=1e-4), prior(widths=(1.0, 0.01, 0.01))  # type: ignore[arg-type]
    one, many = (
        self_calibrate(MODEL, wide, [sweep(16.0, noise=1e-4)] * count, settings=settings).parameter_set for count in (1, 12)
    )
    assert many.standard_deviation("friction") == pytest.approx(one.standard_deviation("friction"), rel=0.05)


def test_an_error_common_to_all_sweeps_is_within_the_standard_deviation() -> None:
    settings, missed = ClosedLoopSettings(model_error=0.01), []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        drawn = CENTRE | {"friction": 0.2 + 0.04 * rng.standard_normal()}
        error = 1.0 + 0.01 * rng.standard_normal(ANGLES.size)
        sweeps = [sweep(float(flow), drawn, 0.005, rng) for flow in rng.uniform(8.0, 16.0, 12)]
        bent = [dataclasses.replace(each, force_n=each.force_n * error) for each in sweeps]
        found = self_calibrate(MODEL, prior(), bent, settings=settings).parameter_set
        missed.append((found.values["friction"] - drawn["friction"]) / found.standard_deviation("friction"))
    assert 0.7 < np.sqrt(np.mean(np.square(missed))) < 1.3


def test_residuals_of_several_sweeps_hold_the_error_that_they_share() -> None:
    bent = [dataclasses.replace(s, force_n=s.force_n * np.where(ANGLES < 0.8, 1.02, 1.0)) for s in [sweep(12.0, noise=0.002)] * 3]
    found = self_calibrate(MODEL, prior(widths=(1e-4, 1e-4, 1e-4)), bent, settings=ClosedLoopSettings(model_error=0.02))
    assert found.residuals[0][ANGLES < 0.8].mean() > 0.01 * bent[0].force_n[0]
    assert found.region in ("40 deg", "45 deg")
