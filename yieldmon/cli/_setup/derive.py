"""From the answers to machine, parameters and configuration, each number held against the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, radians, sin
from typing import Any

import numpy as np

from yieldmon.cli._setup.questions import bolted
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import calibrated_machine
from yieldmon.files.crops import crop
from yieldmon.physics.machine import RPM, ImpactSensor, Machine
from yieldmon.service.config.contradictions import channel_problem
from yieldmon.units import N_PER_KGF

_READING_SD_MV, _LARGEST_GAIN_SD = 0.5, 0.1
_LINEAR_SHARE, _UNRELATED_SHARE = 0.01, 0.5
"""Departures from a straight line over what it changes by: most of a cell, and from which readings say nothing of the weights."""
_LARGEST_OFFSET_DEG = 10.0
_LENGTHS = ("sprocket_pitch_radius_m", "paddle_length_m", "paddle_width_m", "plate_pivot_x_m", "plate_length_m")
_ANGLES = ("home_plate_angle", "min_plate_angle", "max_plate_angle")
_SPEEDS = ("nominal_elevator_speed", "min_elevator_speed", "max_elevator_speed")


@dataclass(frozen=True, slots=True)
class CellGain:
    """Force cell by hung weights. sd: relative. worst: largest departure from a straight line over the largest force."""

    gain_n_per_mv: float
    sd: float
    zero_mv: float
    worst: float


def cell_gain(masses_kg: Sequence[float], readings_mv: Sequence[float]) -> CellGain:
    """Line through the readings. Raises InputError for fewer than two weights beside none, a reversed or a crooked cell."""
    where = "cell_readings_mv"
    if len(masses_kg) != len(readings_mv):
        raise InputError(where, f"has {len(readings_mv)} values for {len(masses_kg)} masses", "one for each")
    _check_weights(masses_kg)
    force, mv = N_PER_KGF * np.array(masses_kg), np.array(readings_mv)
    slope, zero = np.polyfit(force, mv, 1)
    residual, change_mv = mv - (slope * force + zero), float(np.ptp(mv))
    if change_mv == 0.0 or np.max(np.abs(residual)) > _UNRELATED_SHARE * abs(slope) * np.ptp(force):
        problem = f"changes by {change_mv:g} mV, and not with the weight"
        expected = "a reading that follows the weights; check the cell's wires, and that nothing holds the plate"
        raise InputError(where, problem, expected)
    if slope <= 0.0:
        raise InputError(where, "falls as weight is added", "more mV with more weight; swap the cell's two signal wires")
    worst = float(np.max(np.abs(residual)) / (slope * np.ptp(force)))
    if worst > _LINEAR_SHARE:
        raise InputError(
            where,
            f"departs by {100.0 * worst:.1f} % from a straight line",
            f"at most {100.0 * _LINEAR_SHARE:.0f} %; hang the weights again, the string level and nothing touching the plate",
        )
    spread = max(float(np.sqrt(np.sum(residual**2) / max(len(mv) - 2, 1))), _READING_SD_MV)
    sd = spread / float(np.sqrt(np.sum((force - force.mean()) ** 2))) / float(slope)
    if sd > _LARGEST_GAIN_SD:
        raise InputError(
            where,
            f"changes by {change_mv:g} mV, which gives the gain to {100.0 * sd:.0f} % only "
            f"(readings count as right to {_READING_SD_MV:g} mV)",
            f"{100.0 * _LARGEST_GAIN_SD:.0f} % or less: readings in mV, heavier weights, or an amplifier behind the cell",
        )
    return CellGain(float(1.0 / slope), sd, float(zero), worst)


def _check_weights(masses_kg: Sequence[float]) -> None:
    if len(set(masses_kg)) < 3:
        raise InputError("cell_weights_kg", f"has {len(set(masses_kg))} different masses", "0 and two weights, such as 0, 5, 10")


def _check_positions(measured: Sequence[float]) -> None:
    if len(measured) < 2:
        raise InputError("plate_measured_deg", "has 1 value", "two positions, such as 45 and 85")
    if abs(measured[0] - measured[1]) < 5.0:
        raise InputError("plate_measured_deg", "are less than 5 deg apart", "two positions well apart, such as 45 and 85")


def plate_offset_deg(measured: Sequence[float], reported: Sequence[float]) -> float:
    """What the reported angle lacks to the true one. Raises InputError where the two positions disagree."""
    _check_positions(measured)
    if len(measured) != len(reported):
        raise InputError("plate_reported_deg", f"has {len(reported)} values for {len(measured)} positions", "one for each")
    error = np.array(measured) - np.array(reported)
    if (measured[1] - measured[0]) * (reported[1] - reported[0]) < 0.0:
        raise InputError(
            "plate_reported_deg",
            "falls as the plate's angle rises",
            "an angle that rises with it; where the signal is mapped, scale: -1 and an offset turn it",
        )
    if float(np.ptp(error)) > 1.0:
        raise InputError(
            "plate_reported_deg", f"is off by {error[0]:+.1f} and {error[1]:+.1f} deg", "the same error within 1 deg at both"
        )
    if abs(float(error.mean())) > _LARGEST_OFFSET_DEG:
        raise InputError("plate_reported_deg", f"is off by {error.mean():+.1f} deg", "within 10 deg; is it counted from level?")
    return float(error.mean())


def check_at_once(answers: Mapping[str, Any], key: str) -> None:
    """Raises InputError for readings that are wrong by themselves, while whoever took them is still at the machine."""
    if key == "cell_weights_kg":
        _check_weights(answers[key])
    elif key == "plate_measured_deg" and not bolted(answers):
        _check_positions(answers[key])
    elif key == "cell_readings_mv" and "cell_weights_kg" in answers:
        cell_gain(answers["cell_weights_kg"], answers[key])
    elif key == "plate_reported_deg" and "plate_measured_deg" in answers:
        plate_offset_deg(answers["plate_measured_deg"], answers[key])
    elif key == "bus_channel" and "bus_interface" in answers:
        check_channel(answers)


def check_channel(answers: Mapping[str, Any]) -> None:
    """Raises InputError for a channel that the interface cannot have."""
    if (problem := channel_problem(answers["bus_interface"], answers["bus_channel"])) is not None:
        raise InputError("bus_channel", *problem)


def offset_deg(answers: Mapping[str, Any]) -> float:
    """`plate_offset_deg` of the answers; 0 for a bolted plate, whose angle is the measured one."""
    if bolted_deg(answers) is not None:
        return 0.0
    return plate_offset_deg(answers["plate_measured_deg"], answers["plate_reported_deg"])


def bolted_deg(answers: Mapping[str, Any]) -> float | None:
    """Angle of a plate that has one only, as measured; None for one that turns. Raises InputError where answers disagree."""
    if not bolted(answers):
        return None
    found = answers["plate_measured_deg"]
    if len(found) != 1:
        raise InputError("plate_measured_deg", f"has {len(found)} values for a plate that does not turn", "one")
    if answers.get("plate_reported_deg"):
        raise InputError(
            "plate_reported_deg", "is given for a plate that does not turn", "no answer, or another largest plate angle"
        )
    home = answers["home_plate_angle_deg"]
    if abs(found[0] - home) > 1.0:
        raise InputError("plate_measured_deg", f"is {found[0]:g}, but home_plate_angle_deg is {home:g}", "the same angle in both")
    return float(found[0])


def machine(answers: Mapping[str, Any]) -> Machine:
    """The machine of the answers, its numbers held against each other. Raises InputError."""
    gain = cell_gain(answers["cell_weights_kg"], answers["cell_readings_mv"])
    for low, middle, high in (
        ("min_plate_angle_deg", "home_plate_angle_deg", "max_plate_angle_deg"),
        ("min_elevator_speed_rpm", "nominal_elevator_speed_rpm", "max_elevator_speed_rpm"),
    ):
        if not answers[low] <= answers[middle] <= answers[high]:
            expected = f"between {low} ({answers[low]:g}) and {high} ({answers[high]:g})"
            raise InputError(middle, f"is {answers[middle]:g}", expected)
    if (fixed_deg := bolted_deg(answers)) is not None:
        answers = {**answers, **dict.fromkeys((f"{key}_deg" for key in _ANGLES), fixed_deg)}
    lengths: dict[str, Any] = {key: answers[key] for key in _LENGTHS}
    turned = {f"{key}_rad": radians(answers[f"{key}_deg"]) for key in _ANGLES}
    speeds = {f"{key}_rad_s": answers[f"{key}_rpm"] * RPM for key in _SPEEDS}
    found = Machine(
        name=str(answers["machine_name"]),
        paddle_spacings_m=tuple(answers["paddle_spacings_m"]),
        plate_pivot_y_m=-answers["plate_pivot_above_m"],
        sensor=ImpactSensor(gain.gain_n_per_mv, answers["cell_full_scale_mv"]),
        **lengths | turned | speeds,
    )
    _check_together(found, answers)
    return found


def _check_together(found: Machine, answers: Mapping[str, Any]) -> None:
    tip_m = found.paddle_length_m
    if tip_m <= found.sprocket_pitch_radius_m:
        raise InputError("paddle_length_m", f"is {found.paddle_length_m:g}", "longer than the sprocket's pitch radius")
    if found.plate_pivot_x_m <= found.paddle_length_m:
        raise InputError("plate_pivot_x_m", f"is {found.plate_pivot_x_m:g}", f"beyond the paddles' tips at {tip_m:g} m")
    if max(found.paddle_spacings_m) > 2.0 * min(found.paddle_spacings_m):
        raise InputError("paddle_spacings_m", "has one twice another", "the pattern that repeats; is a paddle missing?")
    # Grain leaves the tips above the sprocket and falls no further than the plate's lower edge.
    low_edge_m = found.plate_pivot_y_m + found.plate_length_m * sin(found.home_plate_angle_rad)
    if not found.plate_pivot_y_m < 0.0 or low_edge_m < -found.paddle_length_m:
        raise InputError(
            "plate_pivot_above_m",
            f"puts the plate from {-found.plate_pivot_y_m:g} to {-low_edge_m:g} m above the sprocket",
            f"a plate that reaches from above the centre to below the tips at {found.paddle_length_m:g} m",
        )
    nearest = found.plate_pivot_x_m + found.plate_length_m * min(cos(found.max_plate_angle_rad), cos(found.home_plate_angle_rad))
    if nearest <= found.paddle_length_m:
        raise InputError("plate_length_m", "lets the paddles strike the plate", f"a lower edge beyond {tip_m:g} m")
    speed_m_s = found.paddle_speed_m_s(found.nominal_elevator_speed_rad_s)
    passes = speed_m_s / found.paddle_spacing_m
    if not 2.0 <= passes <= 40.0:
        raise InputError(
            "nominal_elevator_speed_rpm",
            f"gives {passes:.1f} paddles a second at {speed_m_s:.1f} m/s of chain",
            "2 to 40; is it the speed of this sprocket, and the radius of its pitch circle?",
        )
    full_kg = (found.paddle_length_m**2 - found.sprocket_pitch_radius_m**2) * found.paddle_width_m * 1000.0
    if full_kg * passes < answers["largest_flow_kg_s"]:
        raise InputError(
            "largest_flow_kg_s",
            f"is {answers['largest_flow_kg_s']:g}, but these paddles carry {full_kg * passes:.0f} kg/s at most",
            "a flow that the elevator can lift; check paddle length, width and spacing",
        )


def parameters(answers: Mapping[str, Any]) -> ParameterSet:
    """The crop's shipped parameters, with the plate's measured offset and the cell's doubt in the impact gain."""
    known = crop(str(answers["crop"])).parameters()
    gain = cell_gain(answers["cell_weights_kg"], answers["cell_readings_mv"])
    offset = offset_deg(answers)
    covariance = np.array(known.covariance)
    place = known.covariance_names.index("restitution")
    covariance[place, place] += ((1.0 + known.values["restitution"]) * gain.sd) ** 2
    values = dict(known.values)
    if abs(offset) > 0.05:
        values["plate_angle_offset.angle_rad"] = radians(offset)
    made_for = calibrated_machine.facts(machine(answers))
    return replace(known, values=values, covariance=covariance, provenance={**known.provenance, **made_for})
