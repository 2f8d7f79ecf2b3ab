"""What an error of the model over plate angle, the same in all sweeps, does to friction and loads by `calibrate --loads`.

    python -m studies.load_laws.common_error [--first SEED] [--machines N]

Machines whose forces are the virtual combine's throws, which share no code with the estimator's model; grain drawn from the
prior; three loads of 5, 11 and 17 kg/s weighed to 0.3 %, and sweeps of 20 windows of 1 % at 7 to 15 kg/s whose flow wanders.
Judged: friction, density and restitution against the truth, and flows of 3 to 18 kg/s at home.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from studies.facility.mean_force import shown_force_n
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.plant.effects import Effects, PlateFriction
from yieldmon.plant.grain import Grain
from yieldmon.plant.pulse_table import SEASON, Condition, PulseTable

MACHINE = Machine()
MODEL = ForwardModel(MACHINE, ("gravity",))
NAMES = ("friction", "density", "restitution")
PRIOR = ParameterSet(
    {"friction": 0.19, "density": 1075.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81},
    NAMES,
    np.diag([0.06**2, 150.0**2, 0.15**2]),
)
_LEAST, _MOST = np.array([0.01, 760.0, 0.0]), np.array([1.0, 1990.0, 1.0])
_ANGLES = np.radians([70.0, 40.0, 70.0, 90.0, 70.0, 50.0, 70.0, 80.0, 70.0, 60.0])
_NODES = np.radians([40.0, 50.0, 60.0, 70.0, 80.0, 90.0])
_JUDGED_KG_S = np.array([3.0, 6.0, 9.0, 13.0, 18.0])


@dataclass(frozen=True)
class Case:
    """Sweeps, relative error of the model at each angle, whether it is drawn anew for each sweep, hidden plate friction."""

    sweeps: int = 12
    model_error: float = 0.0
    anew: bool = False
    plate_friction: float = 0.0


CASES = {
    "nothing hidden": Case(),
    "1 %, the same in all sweeps": Case(model_error=0.01),
    "1 %, drawn for each sweep": Case(model_error=0.01, anew=True),
    "plate friction 0.05": Case(plate_friction=0.05),
    "1 %, two sweeps": Case(sweeps=2, model_error=0.01),
}


def _force(table: PulseTable, effects: Effects, angle_rad: Array, flow_kg_s: Array) -> Array:
    speed = np.full(angle_rad.shape, MACHINE.nominal_elevator_speed_rad_s)
    return shown_force_n(table, effects, flow_kg_s, angle_rad, speed, 0.008)


def judged(case: Case, seed: int) -> Array:
    """z of friction, density and restitution, error and deviation of friction, rms error of flows, %, and their rms z; (7,)."""
    rng = np.random.default_rng([77, seed])
    centre, sd = np.array([PRIOR.values[n] for n in NAMES]), np.array([PRIOR.standard_deviation(n) for n in NAMES])
    while np.any((true := centre + sd * rng.standard_normal(3)) <= _LEAST) or np.any(true >= _MOST):
        pass
    friction, density, restitution = map(float, true)
    effects = Effects()
    if case.plate_friction:
        effects = effects.model_copy(update={"plate_friction": PlateFriction(friction=case.plate_friction)})
    table = PulseTable(MACHINE, [Condition(0.0, Grain(friction, restitution, density, 2.0, 15.0), effects)], SEASON)
    error = case.model_error * rng.standard_normal(_NODES.size)
    sweeps, angle = [], np.repeat(_ANGLES, 2)
    speed = np.full(angle.size, MACHINE.nominal_elevator_speed_rad_s)
    for _ in range(case.sweeps):
        error = case.model_error * rng.standard_normal(_NODES.size) if case.anew else error
        flow = rng.uniform(7.0, 15.0) * np.exp(0.006 * np.cumsum(rng.standard_normal(angle.size)))
        force = _force(table, effects, angle, flow) * (1.0 + np.interp(angle, _NODES, error))
        noisy = force * (1.0 + 0.01 * rng.standard_normal(angle.size))
        sweeps.append(Sweep(1.5 * np.arange(angle.size, dtype=float), angle, speed, noisy, 0.01 * force))
    home, loads = np.full(600, MACHINE.home_plate_angle_rad), []
    for kg_s in (5.0, 11.0, 17.0):
        flow = np.clip(kg_s * (1.0 + 0.2 * rng.standard_normal(600)), 0.5 * kg_s, 1.3 * kg_s)
        kg = float(flow.sum())
        weighed = kg * (1.0 + 0.003 * rng.standard_normal())
        seconds, turning = np.ones(600), np.full(600, speed[0])
        loads.append(WeighedLoad(str(kg_s), weighed, 0.003 * kg, seconds, _force(table, effects, home, flow), home, turning))
    known = calibrate_loads(MODEL, PRIOR, loads, sweeps=sweeps).parameter_set
    stated = np.array([known.standard_deviation(n) if n in known.covariance_names else np.nan for n in NAMES])
    off = np.array([known.values.get(n, np.nan) for n in NAMES]) - true
    at = home[: _JUDGED_KG_S.size]
    found = OpenLoop(ForwardModel(MACHINE, known.effects), known).estimate(
        _force(table, effects, at, _JUDGED_KG_S), at, speed[: at.size], np.full(at.size, 1e-6)
    )
    away = found.mass_flow_kg_s - _JUDGED_KG_S
    flows = 100.0 * np.sqrt(np.mean((away / _JUDGED_KG_S) ** 2)), np.sqrt(np.mean((away / found.std_dev_kg_s) ** 2))
    return np.array([*(off / stated), off[0], stated[0], *flows])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=200, help="first seed (default: %(default)s)")
    parser.add_argument("--machines", type=int, default=30, help="of each case (default: %(default)s)")
    args = parser.parse_args()
    print("rms of: z of friction, density, restitution; error and deviation of friction; error of flows, %, and their z")
    for name, case in CASES.items():
        rows = np.array([judged(case, seed) for seed in range(args.first, args.first + args.machines)])
        rms = np.sqrt(np.nanmean(rows**2, axis=0))
        print(f"{name:>28}: " + " ".join(f"{value:7.3f}" for value in rms), flush=True)


if __name__ == "__main__":
    main()
