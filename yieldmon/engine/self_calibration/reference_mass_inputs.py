"""Reference masses as inputs of self-calibration: with the forces over the weighed grain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import hypot, isfinite, sqrt

import numpy as np

from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.scale_alarm import ScaleCheck, as_stated, name_of
from yieldmon.estimation.load_pattern import following
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, NODES_RAD, AngleError, node_shares
from yieldmon.estimation.self_calibration.closed_loop_inputs import WeighedMass, joined
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import ForwardModel

_STEP = 1e-3
"""Relative step of the force for the derivative of a mass."""


def weighed_mass(
    reference: ReferenceMass,
    model: ForwardModel,
    spans: Iterable[tuple[float, ParameterSet]],
    reference_error: float,
    error: AngleError = NO_ERROR,
) -> WeighedMass:
    """The weighed mass with the forces over it; where these were not kept, with the measured total split by the parameters in
    use.

    Parameters
    ----------
    reference : ReferenceMass
    model : ForwardModel
    spans : iterable of (float, ParameterSet)
        Bus time until which parameters were in use, s, and these, in the model's effects, in order; the last with inf.
    reference_error : float
        Relative standard deviation of a reference mass in addition to its own.
    error : AngleError
        Error of the model's force; the forces are corrected by what sweeps have measured of it away from home.

    Returns
    -------
    WeighedMass
    """
    machine, span_s = model.machine, reference.end_s - reference.start_s
    zero_sd = reference.budget.zero_kg / reference.measured_kg if isfinite(reference.budget.zero_kg) else 0.0
    # Relative to the weighed mass: the errors of the force are relative, whatever mass the parameters in use then gave.
    relative = hypot(reference_error, _noise_sd(reference), zero_sd)
    sd = hypot(reference.std_dev_kg, relative * reference.reference_kg)
    forces = reference.forces
    if forces is not None and (not model.needs_moisture or np.all(np.isfinite(forces.moisture_pct))):
        moisture = forces.moisture_pct if model.needs_moisture else None
        return WeighedMass(
            reference_kg=reference.reference_kg,
            std_dev_kg=sd,
            duration_s=forces.duration_s,
            force_n=forces.force_n * np.exp([error.away_at(angle_rad) for angle_rad in forces.plate_angle_rad.tolist()]),
            plate_angle_rad=forces.plate_angle_rad,
            elevator_speed_rad_s=forces.elevator_speed_rad_s,
            moisture_pct=moisture,
            common_kg=reference.common_kg,
        )
    pieces: list[WeighedMass] = []
    begin = reference.start_s
    for until_s, parameters in spans:
        end = min(until_s, reference.end_s)
        if end <= begin:
            continue
        share = (end - begin) / span_s
        flow = max(reference.measured_kg / span_s, 1.0)
        pieces.append(
            WeighedMass.from_total(
                reference.reference_kg,
                reference.std_dev_kg,
                share * reference.measured_kg,
                model=following(model, parameters),
                parameters=parameters,
                mass_flow_kg_s=flow,
                plate_angle_rad=machine.home_plate_angle_rad,
                elevator_speed_rad_s=machine.nominal_elevator_speed_rad_s,
            )
        )
        begin = end
    duration_s, force_n, angle_rad, speed_rad_s = joined(pieces)
    return WeighedMass(reference.reference_kg, sd, duration_s, force_n, angle_rad, speed_rad_s, common_kg=reference.common_kg)


def _noise_sd(reference: ReferenceMass) -> float:
    """Relative standard deviation of the measured mass by the windows' scatter; 0 where it is not known."""
    return sqrt(reference.budget.noise_kg2) / reference.measured_kg if isfinite(reference.budget.noise_kg2) else 0.0


def moisture_sd(references: Iterable[ReferenceMass]) -> float:
    """Largest relative standard deviation of these masses by a measured moisture other than that for which the parameters
    hold."""
    found = [0.0]
    for reference in references:
        known = reference.forces is not None and bool(np.all(np.isfinite(reference.forces.moisture_pct)))
        if known and isfinite(reference.budget.moisture_kg):
            found.append(reference.budget.moisture_kg / reference.measured_kg)
    return max(found)


def with_angle_error(mass: WeighedMass, model: ForwardModel, parameters: ParameterSet, error: AngleError) -> WeighedMass:
    """The mass with a standard deviation widened for the model error away from home relative to home.

    A load that contains a sweep determines the scale at home less well.
    """
    home_rad = model.machine.home_plate_angle_rad
    beside = error.with_home(0.0, home_rad)
    if not beside.moments or np.all(np.abs(mass.plate_angle_rad - home_rad) < SAME_ANGLE_RAD):
        return mass
    known = OpenLoop(model, parameters)
    inputs = mass.plate_angle_rad, mass.elevator_speed_rad_s, mass.moisture_pct
    flow, more = (known.invert(factor * mass.force_n, *inputs) for factor in (1.0, 1.0 + _STEP))
    per_error_kg = mass.duration_s * (more - flow) / _STEP
    at_nodes = np.zeros(NODES_RAD.size)
    for angle_rad, kg in zip(mass.plate_angle_rad.tolist(), np.nan_to_num(per_error_kg).tolist(), strict=True):
        first, share = node_shares(angle_rad)
        at_nodes[first] += (1.0 - share) * kg
        at_nodes[first + 1] += share * kg
    return replace(mass, std_dev_kg=hypot(mass.std_dev_kg, beside.of_sum(at_nodes.tolist())))


def weighed(reference: ReferenceMass, mass: WeighedMass) -> WeighedLoad:
    """A weighed mass as a load, with name and standard deviations of its reference mass."""
    return WeighedLoad(
        name=name_of(reference),
        weighed_kg=mass.reference_kg,
        std_dev_kg=reference.std_dev_kg,
        duration_s=mass.duration_s,
        force_n=mass.force_n,
        plate_angle_rad=mass.plate_angle_rad,
        elevator_speed_rad_s=mass.elevator_speed_rad_s,
        moisture_pct=mass.moisture_pct,
        noise_sd=_noise_sd(reference),
        common_kg=reference.common_kg,
    )


def checked(
    reference: ReferenceMass,
    mass: WeighedMass,
    model: ForwardModel,
    known: ParameterSet,
    *,
    moisture_pct: float,
    model_error: float,
) -> ScaleCheck | None:
    """Compare a mass with the mass that the parameters give for the forces over it; None where neither that nor the counted mass
    is known.

    moisture_pct: for a mass without its own, wet basis, %. model_error: relative standard deviation of the model.
    """
    moisture = moisture_pct if mass.moisture_pct is None else mass.moisture_pct
    flow = OpenLoop(model, known).estimate(mass.force_n, mass.plate_angle_rad, mass.elevator_speed_rad_s, moisture_pct=moisture)
    measured_kg = float(mass.duration_s @ flow.mass_flow_kg_s)
    if not isfinite(measured_kg):
        return as_stated(reference)
    # With forces kept, the standard deviation of the mass contains that of the zero.
    budget, kept = reference.budget, reference.forces is not None
    shared_kg = budget.moisture_kg if kept else hypot(budget.zero_kg, budget.moisture_kg)
    std_dev_kg = hypot(
        mass.std_dev_kg,
        float(mass.duration_s @ flow.std_dev_kg_s),
        model_error * measured_kg,
        shared_kg if isfinite(shared_kg) else 0.0,
    )
    return ScaleCheck(name_of(reference), reference.start_s, mass.reference_kg, measured_kg, std_dev_kg)
