"""What a sweep's pattern says of the model's error at home, from forces of other effects than the parameters know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, NODES_RAD, AngleError
from yieldmon.estimation.self_calibration.misfit import ReducedSweep
from yieldmon.estimation.self_calibration.sweep_model_error import model_error, unswept_error
from yieldmon.files import parameter_file
from yieldmon.physics.effects import registry
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.resources import shipped

PARAMETERS = parameter_file.load(shipped("config/parameters/corn.yaml"))
MODEL = ForwardModel(Machine(), PARAMETERS.effects)
ANGLES = np.radians([40.0, 50.0, 60.0, 70.0, 80.0, 90.0])
FLOW_KG_S, SPEED_RAD_S = 11.0, 400.0 * RPM
SD = 0.012
_CALIBRATED = (PARAMETERS.calibrated.mass_flow_kg_s, PARAMETERS.calibrated.elevator_speed_rad_s)


def _log_force(model: ForwardModel, values: Mapping[str, float]) -> np.ndarray:
    return np.log(np.asarray(model.force(Conditions(ANGLES, SPEED_RAD_S, mass_flow_kg_s=FLOW_KG_S), values)))


def _sweep(change: np.ndarray, seed: int) -> ReducedSweep:
    """A sweep of a machine whose force is exp(change) times the model's: at home the flow absorbs it."""
    noise = SD * np.random.default_rng(seed).standard_normal(ANGLES.size)
    log_force = _log_force(MODEL, PARAMETERS.values) + change - change[3] + noise
    return ReducedSweep(ANGLES, log_force, np.full(ANGLES.size, SD), FLOW_KG_S, SPEED_RAD_S)


def _found(change: np.ndarray, seeds: range, known: ParameterSet = PARAMETERS) -> AngleError:
    return model_error(MODEL, known, [_sweep(change, seed) for seed in seeds], tolerance=0.005)


def _left(change: np.ndarray, found: AngleError) -> np.ndarray:
    """Of ln of the model's force over the measured one, at ANGLES, what is left."""
    return -change - np.array([found.away_at(angle) for angle in ANGLES])


def test_without_sweeps_nothing_is_reported() -> None:
    assert model_error(MODEL, PARAMETERS, []) == NO_ERROR


def test_a_machine_that_follows_the_model_is_widened_by_less_than_its_parameters_are_unsure() -> None:
    found = [_found(np.zeros(6), range(seed, seed + 2)) for seed in range(100, 140, 2)]
    assert np.mean([error.home for error in found]) < 0.004
    assert np.median([max(map(error.at, ANGLES)) for error in found]) < 0.01


@pytest.mark.parametrize("coefficient", [0.1, 0.2, 0.3])
def test_friction_on_the_plate_is_covered(coefficient: float) -> None:
    """Tangential impulse mu cot(phi) of the normal one, without a cap: another law than the library's."""
    change = np.log(1.0 + coefficient / np.tan(ANGLES))
    found = _found(change, range(4))
    assert 0.5 < abs(change[3]) / found.home < 2.0
    left = _left(change, found)
    for angle, by in zip(ANGLES, left, strict=True):
        assert 0.4 < abs(by) / found.at(angle) < 2.5, np.degrees(angle)
    # And of a load half at 40 deg and half at home: of one cause, not of two that are independent.
    half = np.zeros(NODES_RAD.size)
    half[[2, 5]] = 0.5
    assert 0.5 < 0.5 * abs(left[0] + left[3]) / found.of_sum(half) < 2.0
    # What is measured without what has been taken off since has both.
    whole = found.of_sum(half, float(half @ found.away))
    assert 0.5 < 0.5 * (change[0] + change[3]) / whole < 2.0


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(np.log(1.0 + 0.2 / np.tan(ANGLES)), id="friction of the plate"),
        pytest.param(np.log(1.0 - 0.2 / (1.0 + np.exp((ANGLES - 0.8) / 0.1))), id="a share lost at low angles"),
        pytest.param(np.array([0.1, 0.1, 0.0, 0.0, 0.0, 0.0]), id="a step that nothing makes"),
        pytest.param(0.3 * np.log(np.sin(ANGLES)), id="a power of the sine"),
    ],
)
def test_what_sweeps_measure_away_from_home_is_taken_off_whatever_its_cause(change: np.ndarray) -> None:
    against_home = change - change[3]
    for seed in range(0, 40, 4):
        found = _found(change, range(seed, seed + 4))
        left = _left(change, found)
        assert np.abs(left - left[3]).max() < 0.35 * np.abs(against_home).max()
        assert found.away_at(ANGLES[3]) == pytest.approx(0.0, abs=1e-12), "nothing at home"
        assert found.away[0] == found.away[-1] == 0.0, "nothing where no sweep has been"
        known = found.with_home(0.0, ANGLES[3])
        assert np.all(np.abs(left - left[3])[:3] < 4.0 * np.array([known.at(angle) for angle in ANGLES[:3]]))


def test_of_a_machine_that_follows_its_model_little_is_taken_off_and_seldom() -> None:
    found = [_found(np.zeros(6), range(seed, seed + 2)) for seed in range(100, 160, 2)]
    assert np.mean([error.away != () for error in found]) < 0.2
    assert max(abs(error.away_at(angle)) for error in found for angle in ANGLES) < 0.03


def test_nothing_is_taken_off_where_home_lies_between_two_nodes() -> None:
    home_rad = np.radians(65.0)
    machine = replace(MODEL.machine, home_plate_angle_rad=home_rad)
    angles = np.append(ANGLES[:3], home_rad)
    change = np.log(1.0 + 0.2 / np.tan(angles))
    model = ForwardModel(machine, MODEL.effects)
    log_force = np.log(np.asarray(model.force(Conditions(angles, SPEED_RAD_S, mass_flow_kg_s=FLOW_KG_S), PARAMETERS.values)))
    sweep = ReducedSweep(angles, log_force + change - change[3], np.full(angles.size, 0.002), FLOW_KG_S, SPEED_RAD_S)
    found = model_error(model, PARAMETERS, [sweep])
    assert found.away_at(home_rad) == pytest.approx(0.0, abs=1e-12)
    assert found.away_at(angles[0]) == pytest.approx(change[3] - change[0], rel=0.05)


def test_an_error_that_two_angles_share_cancels_where_their_seconds_are_counted_against_each_other() -> None:
    found = _found(np.log(1.0 + 0.2 / np.tan(ANGLES)), range(4))
    against = np.zeros(NODES_RAD.size)
    against[[2, 5]] = 1.0, -1.0
    assert found.of_sum(against) < 0.8 * np.hypot(found.at(ANGLES[0]), found.at(ANGLES[3]))


def test_a_weighed_mass_leaves_what_differs_from_home() -> None:
    found = _found(np.log(1.0 + 0.2 / np.tan(ANGLES)), range(4))
    known = found.with_home(0.0, ANGLES[3])
    against = np.zeros(NODES_RAD.size)
    against[[2, 5]] = 1.0, -1.0
    assert known.at(ANGLES[3]) == pytest.approx(0.0, abs=1e-9)
    assert known.at(ANGLES[0]) == pytest.approx(found.of_sum(against))


def test_what_no_effect_of_the_library_makes_is_stated_where_it_was_seen() -> None:
    """A force that is 8 % off at 50 deg alone."""
    found = _found(np.array([0.0, 0.08, 0.0, 0.0, 0.0, 0.0]), range(6))
    there = np.zeros(NODES_RAD.size)
    there[3] = 1.0
    assert found.of_sum(there, found.away_at(ANGLES[1])) > 0.03


def _by_integration(error: float, sd: float) -> float:
    """Root mean square of the error at home that the library's effects leave possible after one visit at 40 deg, each of a size
    drawn from its normal distribution, of effects that act in one direction its half."""
    sizes = np.linspace(-8.0, 8.0, 16001)
    angles = ANGLES[[0, 3]]

    def log_force(model: ForwardModel, values: Mapping[str, float]) -> np.ndarray:
        at = Conditions(angles, np.full(2, SPEED_RAD_S), mass_flow_kg_s=np.full(2, FLOW_KG_S))
        return np.log(np.asarray(model.force(at, values)))

    missing = [e for n, e in registry().items() if n not in ("angle_pattern", "load_pattern", "moisture_dependence")]
    missing = [effect for effect in missing if effect.name not in PARAMETERS.effects]
    evidence, square = 0.5 * np.exp(-0.5 * (error / sd) ** 2) / sd, 0.0
    for effect in missing:
        typical = {f"{effect.name}.{parameter.name}": parameter.typical for parameter in effect.parameters}
        with_it = log_force(MODEL.with_effects((*MODEL.effects, effect.name)), {**PARAMETERS.values, **typical})
        away, home = log_force(MODEL, PARAMETERS.values) - with_it
        if not abs(away - home) >= 0.5 * abs(home) or away == home:
            continue
        first = effect.parameters[0]
        possible = np.where(sizes >= 0.0, 2.0, 0.0) if first.null in (first.lower, first.upper) else np.ones_like(sizes)
        prior = possible * np.exp(-0.5 * sizes**2)
        variance = sd**2 + (0.1 * (away - home)) ** 2
        likely = prior / np.sum(np.exp(-0.5 * sizes**2)) * np.exp(-0.5 * (error - sizes * (away - home)) ** 2 / variance)
        likely *= 0.5 / len(missing) / np.sqrt(variance)
        evidence += np.sum(likely)
        square += np.sum(likely * (sizes * home) ** 2)
    return float(np.sqrt(square / evidence))


@pytest.mark.parametrize("error", [0.06, -0.06, -0.1])
def test_effects_that_act_in_one_direction_have_no_size_in_the_other(error: float) -> None:
    """One visit at 40 deg, known to 8 %: what is possible at home, by integration over the sizes."""
    known = ParameterSet(PARAMETERS.values, calibrated=PARAMETERS.calibrated)
    model = ForwardModel(Machine(), known.effects)
    log_force = _log_force(model, known.values)[[0, 3]] - [error, 0.0]
    sweep = ReducedSweep(ANGLES[[0, 3]], log_force, np.full(2, 0.08), FLOW_KG_S, SPEED_RAD_S)
    assert model_error(model, known, [sweep]).home == pytest.approx(_by_integration(error, 0.08), rel=0.03)


def test_an_angle_seen_with_noise_alone_is_as_unsure_as_before_it() -> None:
    """One visit at 40 deg, known to 20 %: the effects that would change the force there by less than that stay possible."""
    sweep = ReducedSweep(
        ANGLES[[0, 3]], _log_force(MODEL, PARAMETERS.values)[[0, 3]], np.array([0.2, 0.2]), FLOW_KG_S, SPEED_RAD_S
    )
    assert model_error(MODEL, PARAMETERS, [sweep]).at(ANGLES[0]) > 0.03


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(0.5 * (ANGLES - ANGLES[3]) + 0.06, id="rising with the angle"),
        pytest.param(-0.25 * np.sin(2.0 * ANGLES), id="largest at 45 deg"),
        pytest.param(np.log(np.sin(ANGLES + 0.06) / np.sin(ANGLES)) * 2.0, id="turned feedback"),
    ],
)
def test_other_patterns_widen_by_per_cents(change: np.ndarray) -> None:
    assert 0.01 < _found(change, range(4)).home < 0.25


def test_what_the_covariance_explains_is_no_error_of_the_model() -> None:
    """Friction known to a tenth and as far off: the pattern is the parameters'."""
    friction = PARAMETERS.values["friction"]
    other = {**PARAMETERS.values, "friction": 1.5 * friction}
    change = _log_force(MODEL, other) - _log_force(MODEL, PARAMETERS.values)
    wide = replace(PARAMETERS, covariance_names=("friction",), covariance=np.array([[(0.5 * friction) ** 2]]))
    sure, unsure = _found(change, range(6)), _found(change, range(6), wide)
    assert unsure.home < 0.5 * sure.home


def test_more_sweeps_raise_the_confidence() -> None:
    change = np.log(1.0 + 0.04 / np.tan(ANGLES))
    found = _found(change, range(12))
    assert np.hypot(found.at(ANGLES[0]), found.away_at(ANGLES[0])) > 0.01
    assert _found(change, range(12)).home > _found(np.zeros(6), range(12)).home


def test_before_any_sweep_it_is_what_sweeps_that_say_nothing_leave() -> None:
    """Of the same causes: one that a sweep of these angles shows too little of is in neither."""
    log_force = _log_force(MODEL, PARAMETERS.values)
    vague = ReducedSweep(ANGLES, log_force, np.full(ANGLES.size, 3.0), *(np.mean(r) for r in _CALIBRATED))
    said = model_error(MODEL, PARAMETERS, [vague])
    before = unswept_error(MODEL, PARAMETERS, ANGLES)
    assert 0.01 < before.home < 0.1
    for angle in (*ANGLES, *NODES_RAD):
        assert said.at(angle) == pytest.approx(before.at(angle), rel=0.02)


def test_a_sweep_that_stays_at_home_may_show_nothing() -> None:
    assert unswept_error(MODEL, PARAMETERS, ANGLES[3:4]) == NO_ERROR


def test_before_any_sweep_it_is_that_of_machine_grain_and_range_whatever_was_asked_before() -> None:
    grain = replace(PARAMETERS, values={**PARAMETERS.values, "friction": 0.3})
    fast = replace(PARAMETERS, calibrated=replace(PARAMETERS.calibrated, elevator_speed_rad_s=(50.0, 52.0)))
    steep = ForwardModel(replace(MODEL.machine, home_plate_angle_rad=np.radians(80.0)), MODEL.effects)
    cases = ((MODEL, PARAMETERS), (MODEL, grain), (MODEL, fast), (steep, PARAMETERS))
    found = [unswept_error(*case, ANGLES) for case in cases]
    assert len({error.home for error in found}) == len(cases)
    assert [unswept_error(*case, ANGLES) for case in reversed(cases)] == found[::-1]


def test_a_whole_sweep_of_a_machine_that_follows_the_model_takes_most_of_it_away() -> None:
    assert _found(np.zeros(6), range(2)).home < 0.2 * unswept_error(MODEL, PARAMETERS, ANGLES).home


def test_sweeps_before_a_weighed_mass_say_no_more_of_the_model_after_it() -> None:
    """It moves the scale by 15 %: by the parameters that come of it the flow was another, and the pattern is the same."""
    values = PARAMETERS.values
    moved = {"restitution": 1.15 * (1.0 + values["restitution"]) - 1.0, "density": values["density"] / 1.15}
    after = replace(PARAMETERS, values={**values, **moved})
    home = float(_log_force(MODEL, values)[3])
    for change in (np.zeros(6), np.log(1.0 + 0.2 / np.tan(ANGLES))):
        sweeps = [replace(_sweep(change, seed), home_log_force=home) for seed in range(4)]
        before, now = (model_error(MODEL, known, sweeps, tolerance=0.005) for known in (PARAMETERS, after))
        for angle in ANGLES:
            assert now.at(angle) == pytest.approx(before.at(angle), abs=0.01)
            assert now.away_at(angle) == pytest.approx(before.away_at(angle), abs=0.01)
