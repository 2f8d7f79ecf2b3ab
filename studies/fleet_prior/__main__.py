"""How far off are a new machine's loads before its first ticket, with the shipped crop and with the fleet's prior?

    python -m studies.fleet_prior [--machines N] [--seed N] [--json]
    python -m studies.fleet_prior --seeds 10 --out results.jsonl    # seeds 1 to 10, a line each; those in the file are kept
    python -m studies.fleet_prior --seeds 10 --oracle               # what is reachable in each of them
    python -m studies.fleet_prior --seeds 3 --sweeps                # with sweeps before and after the first tickets

Three crops, N machines each. Hidden: the crop's friction, density and restitution (drawn about the shipped ones by their stated
deviations), each machine's gain (3 %), its plate's angle (1 deg), its own field's density (2 %), and 2 to 10 tickets with scatter
(0.5 %) and with scale errors (0.3 %). Each machine is left out in turn, and the others' tickets make its prior. Forces come from
the forward model with the hidden values: the study judges the pooling, not the model.

Beside it what no prior of a crop can take away: the error with the crop known exactly and nothing known of the machine, and what
of it each of gain, angle and field makes alone. `--oracle` gives, from the same draws and without pooling, what is reachable:

- true_pct: the prior of one who knows the crop and the law by which machines differ, its centre the median of that law (of 400
  machines drawn anew), which has the least expected error;
- hindsight_pct: density and gain chosen for the very loads that are judged, one pair a crop (errors linear in both): no prior
  common to its machines can leave less;
- angle_known_pct: the crop and each machine's plate angle known, as by sweeps before the first ticket; gain and field are left.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.density_and_gain import moved
from yieldmon.estimation.weighing.fleet_prior import MachineLoads, load_errors, pooled
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.files.crops import crop
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from . import sweeps
from .draws import (
    ANGLE_SD_DEG,
    CROPS,
    FIELD_DENSITY_SD,
    GAIN_SD,
    OWN,
    SCATTER_SD,
    hidden_crop,
    machine_of,
    mean_std_dev,
)

_DRAWN, _STEP = 400, 0.01


def error_pct(machine: MachineLoads, known: ParameterSet) -> float:
    """Mean absolute error of a machine's loads with these parameters, %."""
    errors = load_errors(machine.model, known, [load.condensed for load in machine.loads])
    return 100.0 * float(np.mean(np.abs(np.expm1(errors))))


def _centred(known: ParameterSet, seed: int) -> ParameterSet:
    """The crop's parameters with the gain at which errors of machines that differ by the study's law have the median 0."""
    chance = np.random.default_rng([seed, len(CROPS)])
    model = ForwardModel(Machine(), ("gravity",))
    angle, speed = model.machine.home_plate_angle_rad, model.machine.nominal_elevator_speed_rad_s
    seen = []
    for _ in range(_DRAWN):
        values = dict(known.values) | {"density": known.values["density"] * float(np.exp(chance.normal(0.0, FIELD_DENSITY_SD)))}
        flow = chance.uniform(5.0, 12.0) * np.exp(chance.normal(0.0, 0.15, 4))
        at = Conditions(np.full(4, angle + np.radians(chance.normal(0.0, ANGLE_SD_DEG))), speed, mass_flow_kg_s=flow)
        force = np.asarray(np.real(model.force(at, values)) * np.exp(chance.normal(0.0, GAIN_SD)))
        seen.append(WeighedLoad("", float(flow.sum()), 1.0, np.ones(4), force, np.full(4, angle), np.full(4, speed)))
    # ln mass falls by about 1 with ln gain, and the median by as much.
    return moved(known, 0.0, float(np.median(load_errors(model, known, seen))))


@dataclass(frozen=True)
class _Judged:
    """The loads of a crop's machines, which are all of one model, and the weight of each in the mean over machines."""

    loads: list[WeighedLoad]
    weight: Array

    @classmethod
    def of(cls, fleet: Sequence[MachineLoads]) -> _Judged:
        """Of these machines, each with the weight of one."""
        shares = [np.full(len(machine.loads), 1.0 / (len(machine.loads) * len(fleet))) for machine in fleet]
        return cls([load.condensed for machine in fleet for load in machine.loads], np.concatenate(shares))

    def errors(self, known: ParameterSet) -> Array:
        """ln of measured over weighed mass."""
        return load_errors(ForwardModel(Machine(), ("gravity",)), known, self.loads)

    def pct(self, errors: Array) -> float:
        """Mean absolute error, %."""
        return 100.0 * float(self.weight @ np.abs(np.expm1(errors)))


def oracle(machines: int, seed: int) -> dict[str, Any]:
    """What is reachable in the draws of `study`: mean absolute errors of loads, %, by crop and of all."""
    chance, found = np.random.default_rng(seed), {}
    for name in CROPS:
        shipped = crop(name).parameters()
        exact = replace(shipped, values=hidden_crop(shipped, chance))
        fleet, straight = [], []
        for k in range(machines):
            state = chance.bit_generator.state
            straight.append(machine_of(f"{name}-{k}", dict(exact.values), chance, ("gain", "field")))
            chance.bit_generator.state = state
            fleet.append(machine_of(f"{name}-{k}", dict(exact.values), chance))
        judged, without_angle = _Judged.of(fleet), _Judged.of(straight)
        errors = judged.errors(exact)
        slopes = [(judged.errors(moved(exact, *step)) - errors) / _STEP for step in ((_STEP, 0.0), (0.0, _STEP))]
        by_shift = np.stack(slopes, axis=-1)

        def of_hindsight(shift: Array, judged: _Judged = judged, errors: Array = errors, slopes: Array = by_shift) -> float:
            return judged.pct(errors + slopes @ shift)

        corners = [(0.0, 0.0), (0.0, 0.03), (0.05, 0.0)]
        best = minimize(of_hindsight, corners[0], method="Nelder-Mead", options={"initial_simplex": corners, "maxfev": 400})
        found[name] = {
            "shipped_pct": judged.pct(judged.errors(shipped)), "known_crop_pct": judged.pct(errors),
            "true_pct": judged.pct(judged.errors(_centred(exact, seed))), "hindsight_pct": float(best.fun),
            "angle_known_pct": without_angle.pct(without_angle.errors(exact)),
        }  # fmt: skip
    mean = {key: float(np.mean([entry[key] for entry in found.values()])) for key in found[CROPS[0]]}
    return {"seed": seed, "machines": machines * len(CROPS), "crops": found, "all": mean}


def oracles(seeds: int, machines: int) -> bool:
    """Print them for seeds 1 to `seeds`; whether the prior of the true law halves the shipped crop's error in each."""
    keys = ("known_crop_pct", "true_pct", "hindsight_pct", "angle_known_pct")
    halved = Counter[str]()
    for seed in range(1, seeds + 1):
        entry = oracle(machines, seed)["all"]
        halved.update(key for key in keys if entry[key] <= 0.5 * entry["shipped_pct"])
        parts = ", ".join(f"{key.removesuffix('_pct')} {entry[key]:.2f}" for key in keys)
        print(f"seed {seed}: shipped {entry['shipped_pct']:.2f} %, half {0.5 * entry['shipped_pct']:.2f}; {parts}", flush=True)
    print("halved: " + ", ".join(f"{key.removesuffix('_pct')} in {halved[key]}" for key in keys) + f" of {seeds}")
    return halved["true_pct"] == seeds


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
            loads = [load.condensed for load in left_out.loads]
            before.append(error_pct(left_out, shipped))
            errors = load_errors(left_out.model, prior, loads)
            after.append(error_pct(left_out, prior))
            deviation = mean_std_dev(left_out.model, prior, loads)
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


def with_sweeps(seeds: int, machines: int, *, as_json: bool) -> int:
    """Print what sweeps do with seeds 1 to `seeds`; 0."""
    found = {}
    for name, hidden in sweeps.HIDDEN.items():
        found[name] = sweeps.compare(hidden, range(1, seeds + 1), machines)
        if not as_json:
            each = ", ".join(f"{way} {entry['error_pct']:.2f} % (z {entry['z']:.2f})" for way, entry in found[name].items())
            print(f"{name}: {each}", flush=True)
    if as_json:
        print(json.dumps({"seeds": seeds, "machines": machines * len(CROPS), "hidden": found}, indent=2))
    return 0


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
    parser.add_argument("--oracle", action="store_true", help="what is reachable in seeds 1 to --seeds")
    parser.add_argument("--sweeps", action="store_true", help="what sweeps do before and after a machine's first tickets")
    parser.add_argument("--out", type=Path, help="results of --seeds")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.sweeps:
        return with_sweeps(args.seeds or 1, args.machines, as_json=args.json)
    if args.oracle:
        return 0 if oracles(args.seeds or 1, args.machines) else 1
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
