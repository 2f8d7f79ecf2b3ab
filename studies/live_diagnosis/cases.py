"""A live run: a machine with an effect that its daemon does not know, from the first sweep to the adopted parameters.

The virtual combine works with an effect switched on. The daemon's parameters come from a calibration at the home angle alone,
as a machine in the field has it. After some hours `yieldmon diagnose` reads the daemon's store; if it names an effect, that is
adopted, the daemon reloads, and the harvest goes on. Flow is judged second by second against the combine's own truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from studies.facility import facility
from yieldmon.estimation.fitting.calibration import calibrate
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine, pulse_table
from yieldmon.plant.scenario import Scenario
from yieldmon.service.storage.rows import SecondRow
from yieldmon.trial.accuracy import RATED_FROM_KG_S

Array = NDArray[np.float64]

SWEEP_ANGLES_DEG = (40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 75.0, 80.0, 85.0, 90.0)
FLOWS_KG_S = (8.0, 12.0, 16.0, 6.0, 14.0, 10.0, 18.0, 20.0)
_EMPTY_S = 25.0
_PIECE_S = 900.0
_CALIBRATION_FLOWS_KG_S = (4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0)


@dataclass(frozen=True, slots=True)
class Case:
    """A machine: its name here, and what is wrong with it as keys of the combine's `effects`."""

    name: str
    effects: Mapping[str, Mapping[str, float]]


CASES = (
    Case("control", {}),
    Case("plate_angle_offset", {"plate_angle_offset": {"angle_deg": 3.0}}),
    Case("plate_friction", {"plate_friction": {"friction": 0.15}}),
    Case("residual_radial_speed", {"residual_radial_speed": {"share_of_tip_speed": 0.06}}),
)


@dataclass(frozen=True, slots=True)
class FlowError:
    """Errors of the 1 Hz flow, % of the true flow, over seconds with at least RATED_FROM_KG_S; nan where there is none."""

    seconds: int
    mean_abs_pct: float
    p95_abs_pct: float
    bias_pct: float


def harvest(case: Case, hours: float) -> Scenario:
    """Flow in steps of a quarter of an hour with slow variation, after half a minute with the elevator empty."""
    duration_s = 3600.0 * hours
    steps = int(np.ceil((duration_s - _EMPTY_S) / _PIECE_S))
    flows = [FLOWS_KG_S[i % len(FLOWS_KG_S)] for i in range(steps)]
    return scenario.from_mapping(
        {
            "duration_s": duration_s,
            "effects": {"gravity": "on", **case.effects},
            "flow": {
                "variation_pct": 3.0,
                "variation_time_s": 20.0,
                "pieces": [
                    {"kind": "off", "duration_s": 5.0},
                    {"kind": "steady", "duration_s": _EMPTY_S - 5.0, "flow_kg_s": 0.0},
                    {"kind": "step", "duration_s": steps * _PIECE_S, "flows_kg_s": flows},
                ],
            },
        },
        case.name,
    )


def calibrated_at_home(case: Case, machine: Machine, shipped: ParameterSet, seed: int) -> ParameterSet:
    """Parameters of a machine that was calibrated, effect and all, at the home angle alone, with a model that has no such effect.

    Nine flows, 60 s each. At one angle friction, density and restitution make up for each other; what is thought of the crop
    beforehand (friction to 0.03, density to 5 %, restitution to 0.05) decides between them.
    """
    home_deg = float(np.degrees(machine.home_plate_angle_rad))
    rows = facility.measure(harvest(case, 1.0), machine, _CALIBRATION_FLOWS_KG_S, (home_deg,), averaging_s=60.0, seed=seed)
    speed = rows["elevator_speed_rpm"] * RPM
    passes = machine.passes_per_s(speed)
    conditions = Conditions(np.radians(rows["plate_angle_deg"]), speed, mass_flow_kg_s=rows["mass_flow_kg_s"])
    names = ("friction", "density", "restitution")
    sd = np.array([0.03, 0.05 * shipped.values["density"], 0.05])
    thought = replace(shipped, covariance_names=names, covariance=np.diag(sd**2))
    found = calibrate(
        ForwardModel(machine, shipped.effects),
        Measurements(conditions, rows["force_n"] / passes, rows["sigma"] / passes),
        dict(shipped.values),
        names,
        prior=Prior.of(thought),
        starts=4,
        rng=np.random.default_rng(seed),
        intervals=False,
    )
    return replace(found.parameter_set, provenance={"method": "virtual facility, home angle alone", "case": case.name})


def combine_of(case: Case, machine: Machine, hours: float, seed: int) -> VirtualCombine:
    """The machine in the field."""
    scene = harvest(case, hours)
    return VirtualCombine(scene, machine, seed, pulse_table(scene, machine))


def flow_errors(rows: Sequence[SecondRow], combine: VirtualCombine, start_s: float, home_deg: float) -> dict[str, FlowError]:
    """Errors of the stored 1 Hz flow where the plate was "home", "away", and "all". start_s: bus time of the combine's time 0."""
    _, error, away = _errors(rows, combine, start_s, home_deg)
    return {name: _summed(error[part]) for name, part in (("home", ~away), ("away", away), ("all", away | ~away))}


def errors_over_time(
    rows: Sequence[SecondRow], combine: VirtualCombine, start_s: float, home_deg: float
) -> dict[str, tuple[Array, Array]]:
    """Hours of harvest and signed errors of the 1 Hz flow, %, where the plate was "home" and "away"."""
    at_s, error, away = _errors(rows, combine, start_s, home_deg)
    return {name: (at_s[part] / 3600.0, error[part]) for name, part in (("home", ~away), ("away", away))}


def _errors(
    rows: Sequence[SecondRow], combine: VirtualCombine, start_s: float, home_deg: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Time, s, and signed error, %, of the seconds with enough true flow and a figure, and whether the plate was away."""
    machine = combine.machine
    delay_s = 0.5 * machine.pattern_length_m / machine.paddle_speed_m_s(combine.scenario.elevator.speed_rpm * RPM)
    at_s = np.array([row.time_s for row in rows]) - start_s - delay_s
    true = combine.delivered_kg(at_s) - combine.delivered_kg(at_s - 1.0)
    flow, angle = (
        np.array([np.nan if getattr(row, name) is None else getattr(row, name) for row in rows], dtype=float)
        for name in ("mass_flow_kg_s", "plate_angle_deg")
    )
    rated = (true >= RATED_FROM_KG_S) & np.isfinite(flow)
    return at_s[rated], 100.0 * (flow[rated] / true[rated] - 1.0), np.abs(angle[rated] - home_deg) > 1.0


def _summed(error_pct: Array) -> FlowError:
    if not error_pct.size:
        return FlowError(0, float("nan"), float("nan"), float("nan"))
    size = np.abs(error_pct)
    return FlowError(error_pct.size, float(size.mean()), float(np.percentile(size, 95.0)), float(error_pct.mean()))
