"""How far off are a new machine's loads before its first ticket, with the shipped crop and with the fleet's prior?

    python -m studies.fleet_prior [--machines N] [--seed N] [--json]

Three crops, N machines each. Hidden: the crop's friction, density and restitution (drawn about the shipped ones by their stated
deviations), each machine's gain (3 %), its plate's angle (1 deg), its own field's density (2 %), and 2 to 10 tickets with scatter
(0.5 %) and with scale errors (0.3 %). Each machine is left out in turn, and the others' tickets make its prior. Forces come from
the forward model with the hidden values: the study judges the pooling, not the model.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np

from yieldmon.estimation.fleet_prior import MachineLoads, load_deviation, load_errors, pooled
from yieldmon.estimation.loads import WeighedLoad
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.crops import crop
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

CROPS = ("corn", "soybean", "wheat")
GAIN_SD, ANGLE_SD_DEG, FIELD_DENSITY_SD = 0.03, 1.0, 0.02
SCATTER_SD, SCALE_SD = 0.005, 0.003
WINDOWS, WINDOW_S = 30, 20.0


def hidden_crop(shipped: ParameterSet, chance: np.random.Generator) -> dict[str, float]:
    """The crop as it is."""
    values = dict(shipped.values)
    for name in shipped.covariance_names:
        values[name] += chance.uniform(-1.0, 1.0) * 1.5 * shipped.standard_deviation(name)
    values["restitution"] = float(np.clip(values["restitution"], 0.05, 0.95))
    return values


def machine_of(name: str, truth: dict[str, float], chance: np.random.Generator) -> MachineLoads:
    """A machine and its weighed loads."""
    model = ForwardModel(Machine(), ("gravity",))
    gain = np.exp(chance.normal(0.0, GAIN_SD))
    bent_rad = np.radians(chance.normal(0.0, ANGLE_SD_DEG))
    values = truth | {"density": truth["density"] * float(np.exp(chance.normal(0.0, FIELD_DENSITY_SD)))}
    angle, speed = model.machine.home_plate_angle_rad, model.machine.nominal_elevator_speed_rad_s
    loads = []
    for number in range(int(chance.integers(2, 11))):
        flow = chance.uniform(5.0, 12.0) * np.exp(chance.normal(0.0, 0.15, WINDOWS))
        at = Conditions(np.full(WINDOWS, angle + bent_rad), np.full(WINDOWS, speed), mass_flow_kg_s=flow)
        force = np.real(model.force(at, values)) * gain * np.exp(chance.normal(0.0, SCATTER_SD))
        weighed = float(np.sum(flow) * WINDOW_S * np.exp(chance.normal(0.0, SCALE_SD)))
        loads.append(
            WeighedLoad(
                str(number),
                weighed,
                SCALE_SD * weighed,
                np.full(WINDOWS, WINDOW_S),
                force,
                np.full(WINDOWS, angle),
                np.full(WINDOWS, speed),
            )
        )
    return MachineLoads(name, model, tuple(loads))


def study(machines: int, seed: int) -> dict:
    """Mean absolute error of loads, %, by crop: shipped and pooled; share of machines within 1 and 2 stated deviations."""
    chance = np.random.default_rng(seed)
    found = {}
    for name in CROPS:
        shipped = crop(name).parameters()
        truth = hidden_crop(shipped, chance)
        fleet = [machine_of(f"{name}-{k}", truth, chance) for k in range(machines)]
        before, after, normalised = [], [], []
        for left_out in fleet:
            prior = pooled(shipped, [machine for machine in fleet if machine is not left_out]).parameter_set
            loads = [load.condensed() for load in left_out.loads]
            before.append(float(np.mean(np.abs(np.expm1(load_errors(left_out.model, shipped, loads))))))
            errors = load_errors(left_out.model, prior, loads)
            after.append(float(np.mean(np.abs(np.expm1(errors)))))
            deviation = float(np.mean(load_deviation(left_out.model, prior, loads)))
            normalised.append(float(np.mean(errors)) / np.hypot(deviation, SCATTER_SD / np.sqrt(len(loads))))
        z = np.abs(normalised)
        found[name] = {
            "shipped_pct": 100.0 * float(np.mean(before)), "fleet_pct": 100.0 * float(np.mean(after)),
            "within_1_sd": float(np.mean(z <= 1.0)), "within_2_sd": float(np.mean(z <= 2.0)),
        }  # fmt: skip
    mean = {key: float(np.mean([entry[key] for entry in found.values()])) for key in found[CROPS[0]]}
    return {"seed": seed, "machines": machines * len(CROPS), "crops": found, "all": mean}


def main() -> int:
    """Exit code 0 when the fleet's prior halves the error."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.fleet_prior", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = study(args.machines, args.seed)
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        for name, entry in (*found["crops"].items(), ("all", found["all"])):
            print(
                f"{name:10} shipped {entry['shipped_pct']:5.2f} %  fleet {entry['fleet_pct']:5.2f} %  "
                f"within 1 sd {100 * entry['within_1_sd']:.0f} %  within 2 sd {100 * entry['within_2_sd']:.0f} %"
            )
    return 0 if found["all"]["fleet_pct"] <= 0.5 * found["all"]["shipped_pct"] else 1


if __name__ == "__main__":
    sys.exit(main())
