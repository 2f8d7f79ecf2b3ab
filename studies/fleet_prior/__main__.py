"""How far off are a new machine's loads before its first ticket, with the shipped crop and with the fleet's prior?

    python -m studies.fleet_prior [--machines N] [--seed N] [--json]
    python -m studies.fleet_prior --seeds 10 --out results.jsonl    # seeds 1 to 10, a line each; those in the file are kept

Three crops, N machines each. Hidden: the crop's friction, density and restitution (drawn about the shipped ones by their stated
deviations), each machine's gain (3 %), its plate's angle (1 deg), its own field's density (2 %), and 2 to 10 tickets with scatter
(0.5 %) and with scale errors (0.3 %). Each machine is left out in turn, and the others' tickets make its prior. Forces come from
the forward model with the hidden values: the study judges the pooling, not the model.

Beside it what no prior of a crop can take away: the error with the crop known exactly and nothing known of the machine, and what
of it each of gain, angle and field makes alone.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.estimation.fleet_prior import MachineLoads, load_deviation, load_errors, pooled
from yieldmon.estimation.load_inputs import WeighedLoad
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


OWN = ("gain", "angle", "field")


def machine_of(name: str, truth: dict[str, float], chance: np.random.Generator, own: tuple[str, ...] = OWN) -> MachineLoads:
    """A machine and its weighed loads; own: what of its own it has, the same numbers being drawn whatever that is."""
    model = ForwardModel(Machine(), ("gravity",))
    gain = np.exp(chance.normal(0.0, GAIN_SD) * ("gain" in own))
    bent_rad = np.radians(chance.normal(0.0, ANGLE_SD_DEG)) * ("angle" in own)
    denser = float(np.exp(chance.normal(0.0, FIELD_DENSITY_SD) * ("field" in own)))
    values = truth | {"density": truth["density"] * denser}
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


def error_pct(machine: MachineLoads, known: ParameterSet) -> float:
    """Mean absolute error of a machine's loads with these parameters, %."""
    errors = load_errors(machine.model, known, [load.condensed() for load in machine.loads])
    return 100.0 * float(np.mean(np.abs(np.expm1(errors))))


def study(machines: int, seed: int) -> dict[str, Any]:
    """Mean absolute error of loads, %, by crop: shipped, pooled, and with the crop known exactly, also where machines have but
    one thing of their own; share of machines within 1 and 2 stated deviations."""
    chance = np.random.default_rng(seed)
    found = {}
    for name in CROPS:
        shipped = crop(name).parameters()
        truth = hidden_crop(shipped, chance)
        fleet, alone, exact = [], [], replace(shipped, values=truth)
        for k in range(machines):
            state = chance.bit_generator.state
            for own in OWN:
                chance.bit_generator.state = state
                alone.append((own, machine_of(f"{name}-{k}", truth, chance, (own,))))
            chance.bit_generator.state = state
            fleet.append(machine_of(f"{name}-{k}", truth, chance))
        before, after, normalised = [], [], []
        for left_out in fleet:
            prior = pooled(shipped, [machine for machine in fleet if machine is not left_out]).parameter_set
            loads = [load.condensed() for load in left_out.loads]
            before.append(error_pct(left_out, shipped))
            errors = load_errors(left_out.model, prior, loads)
            after.append(error_pct(left_out, prior))
            deviation = float(np.mean(load_deviation(left_out.model, prior, loads)))
            normalised.append(float(np.mean(errors)) / np.hypot(deviation, SCATTER_SD / np.sqrt(len(loads))))
        z = np.abs(normalised)
        found[name] = {
            "shipped_pct": float(np.mean(before)), "fleet_pct": float(np.mean(after)),
            "known_crop_pct": float(np.mean([error_pct(machine, exact) for machine in fleet])),
            **{f"{own}_alone_pct": float(np.mean([error_pct(m, exact) for of, m in alone if of == own])) for own in OWN},
            "within_1_sd": float(np.mean(z <= 1.0)), "within_2_sd": float(np.mean(z <= 2.0)),
        }  # fmt: skip
    mean = {key: float(np.mean([entry[key] for entry in found.values()])) for key in found[CROPS[0]]}
    return {"seed": seed, "machines": machines * len(CROPS), "crops": found, "all": mean}


def several(seeds: int, machines: int, out: Path) -> bool:
    """Seeds 1 to `seeds`, a line each, and what they say together; whether the prior halves the error of all of them together."""
    done = {}
    if out.exists():
        done = {line["seed"]: line for line in map(json.loads, out.read_text(encoding="utf-8").splitlines())}
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    for seed in range(1, seeds + 1):
        if seed not in done:
            done[seed] = study(machines, seed) | {"commit": commit}
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(done[seed]) + "\n")
    every = [done[seed]["all"] for seed in range(1, seeds + 1)]
    mean = {key: float(np.mean([entry[key] for entry in every])) for key in every[0]}
    for seed, entry in zip(range(1, seeds + 1), every, strict=True):
        print(_line(f"seed {seed}", entry))
    print(_line("mean", mean))
    halved = sum(entry["fleet_pct"] <= 0.5 * entry["shipped_pct"] for entry in every)
    parts = ", ".join(f"{own} alone {mean[f'{own}_alone_pct']:.2f} %" for own in OWN)
    print(f"halved in {halved} of {seeds}; of the error with the crop known exactly: {parts}")
    return mean["fleet_pct"] <= 0.5 * mean["shipped_pct"]


def _line(name: str, entry: dict[str, float]) -> str:
    return (
        f"{name:10} shipped {entry['shipped_pct']:5.2f} %  fleet {entry['fleet_pct']:5.2f} %  "
        f"crop known {entry['known_crop_pct']:5.2f} %  within 1 sd {100 * entry['within_1_sd']:.0f} %  "
        f"within 2 sd {100 * entry['within_2_sd']:.0f} %"
    )


def main() -> int:
    """Exit code 0 when the fleet's prior halves the error."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.fleet_prior", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--out", type=Path, help="results of --seeds")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.seeds is not None:
        return 0 if several(args.seeds, args.machines, args.out or Path("fleet-prior.jsonl")) else 1
    found = study(args.machines, args.seed)
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        for name, entry in (*found["crops"].items(), ("all", found["all"])):
            print(_line(name, entry))
    return 0 if found["all"]["fleet_pct"] <= 0.5 * found["all"]["shipped_pct"] else 1


if __name__ == "__main__":
    sys.exit(main())
