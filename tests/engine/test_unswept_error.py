"""Loads before the first sweep are stated with what it may show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.parameter_updater import ParameterUpdater
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sweeps.disagreement import DisagreementState, SweepPattern
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import SCALE, WEIGHED
from yieldmon.estimation.self_calibration.misfit import ReducedSweep
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.resources import shipped

MACHINE = Machine()
PARAMETERS = parameter_file.load(shipped("config/parameters/corn.yaml"))
MODEL = ForwardModel(MACHINE, PARAMETERS.effects)
SETTINGS = EngineSettings()
AWAY_RAD = np.radians(40.0)


def updater(settings: EngineSettings = SETTINGS, *, learns: bool = True) -> ParameterUpdater:
    calibrator = ClosedLoopCalibrator(MODEL, CalibratorSettings()) if learns else None
    return ParameterUpdater(settings, MACHINE, OpenLoop(MODEL, PARAMETERS), calibrator)


def swept(of: ParameterUpdater) -> ParameterUpdater:
    """After one whole sweep of a machine that follows the model."""
    angles = np.radians([40.0, 50.0, 60.0, 70.0, 80.0, 90.0])
    force_n = MODEL.force(Conditions(angles, 400.0 * RPM, mass_flow_kg_s=11.0), PARAMETERS.values)
    sweep = ReducedSweep(angles, np.log(np.asarray(force_n)), np.full(6, 0.01), 11.0, 400.0 * RPM)
    of.disagreement.restore(DisagreementState((SweepPattern.of(100.0, sweep),)), PARAMETERS)
    of.judge_model()
    return of


def test_before_the_first_sweep_a_load_is_as_unsure_as_that_may_show() -> None:
    before, after = updater(), swept(updater())
    assert before.load_error.home > 0.01
    assert before.model_error.home == 0.0, "no second at home is stated otherwise: rows are not stated anew"
    assert before.model_error.at(AWAY_RAD) > 0.05, "of the first seconds away from home nothing is known"
    assert after.model_error.at(AWAY_RAD) < 0.2 * before.model_error.at(AWAY_RAD)
    assert after.load_error == after.model_error
    assert after.load_error.home < 0.2 * before.load_error.home


def test_it_is_of_the_angles_that_the_sweep_visits_and_counts_the_calibrations_own_error_once() -> None:
    def found(angles_deg: tuple[float, ...], model_error: float = 0.0) -> float:
        of = updater(replace(SETTINGS, sweep=replace(SETTINGS.sweep, angles_deg=angles_deg)))
        of.use(OpenLoop(MODEL, replace(PARAMETERS, model_error=model_error)), None)
        return of.load_error.home

    usual = SETTINGS.sweep.angles_deg
    assert found(usual) == pytest.approx(found((*usual, 70.0, 40.0)), rel=1e-12)
    assert found((90.0,)) != pytest.approx(found(usual), rel=0.05), "other effects show in it"
    assert found((70.0,)) == 0.0, "a sweep that stays at home may show nothing"
    assert np.hypot(found(usual, 0.02), 0.02) == pytest.approx(found(usual), rel=1e-6), "the flow has it from the parameters"


@pytest.mark.parametrize(
    "of",
    [
        pytest.param(lambda: updater(replace(SETTINGS, sweep=replace(SETTINGS.sweep, enabled=False))), id="sweeps off"),
        pytest.param(lambda: updater(replace(SETTINGS, sweep=replace(SETTINGS.sweep, when="information"))), id="by information"),
        pytest.param(lambda: updater(learns=False), id="nothing learns"),
    ],
)
def test_where_no_sweep_is_to_come_the_parameters_are_taken_at_their_word(of) -> None:  # type: ignore[no-untyped-def]
    assert of().load_error.home == 0.0


def test_a_weighed_mass_ends_it() -> None:
    found = updater()
    found.judge_model(weighed=True)
    assert found.load_error.home == 0.0


def test_parameters_whose_scale_was_weighed_need_no_sweep_wherever_they_come_from() -> None:
    """A file of `calibrate --loads`, or those that an undo or a crop's return brings back."""
    weighed = replace(PARAMETERS, provenance={SCALE: WEIGHED})
    found = updater()
    found.use(OpenLoop(MODEL, weighed), None)
    assert found.load_error.home == 0.0
    found.use(OpenLoop(MODEL, PARAMETERS), None)
    assert found.load_error.home > 0.01
    found.use(OpenLoop(MODEL, weighed), None)
    assert swept(found).load_error.home == 0.0
