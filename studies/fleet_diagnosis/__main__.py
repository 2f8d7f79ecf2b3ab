"""Does `yieldmon fleet diagnose` name what all machines share as the model's, and what one has at that machine?

    python -m studies.fleet_diagnosis run --out draws.jsonl [--draws N] [--workers N]    # resumable; one line a draw
    python -m studies.fleet_diagnosis run --out fresh.jsonl --seed N                     # other draws
    python -m studies.fleet_diagnosis run --out strong.jsonl --strong                    # with machines' own effects that show
    python -m studies.fleet_diagnosis report draws.jsonl                                 # the table

A draw: twelve machines with one hidden effect in common, and three of them with another one each. What their cells show comes
from the virtual combine's physics, which shares no formula and no code with the model under test. Each machine has three days of
twelve sweeps by the shipped sequence, at three elevator speeds and flows of 5 to 18 kg/s that wander by 3 %; paddles scatter by
7 %. The parameters are the shipped ones, with the restitution that makes the flow at home right at 10 kg/s, as tickets do.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from studies.facility.mean_force import shown_force_n
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweeps.sweep import sweep_sequence
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.fleet.diagnosis import FleetDiagnosis, MachineSweeps, diagnose
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant import scenario
from yieldmon.plant.pulse_table import Condition, Detail, PulseTable
from yieldmon.service.storage.rows import SecondRow, second_row

SEED = 20261122
MACHINES, SINGLE = 12, 3
DAYS, SWEEPS_A_DAY = 3, 12
SPEEDS_RPM = (370.0, 400.0, 430.0)
FLOWS_KG_S = (5.0, 18.0)
HOME_KG_S = 10.0
PADDLE_SCATTER, PADDLES_PER_S = 0.07, 12.16
WANDER, WANDER_S = 0.03, 20.0
STEP_S = 5.0
MOISTURE_PCT = 15.0

SHARED: dict[str, dict[str, float]] = {
    "plate_friction": {"friction": 0.2},
    "residual_radial_speed": {"share_of_tip_speed": 0.1},
    "release_angle": {"angle_deg": 6.0},
    "stream_spread": {"half_width_deg": 12.0},
    "resting_grain": {"time_s": 0.1},
}
"""What a model may lack for all machines alike."""
OWN: dict[str, dict[str, float]] = {
    "plate_angle_offset": {"angle_deg": 3.0},
    "lever_arm": {"slope": 0.4},
    "cell_nonlinearity": {"share": 0.15},
    "plate_buildup": {"mass_kg": 0.5},
    "plate_friction": {"friction": 0.2},
    "stream_spread": {"half_width_deg": 12.0},
}
"""What one machine may have for itself: bent, stuck, worn smooth or rough."""
OWN_STRONG: dict[str, dict[str, float]] = {
    "plate_angle_offset": {"angle_deg": 2.1},
    "lever_arm": {"slope": 1.7},
    "cell_nonlinearity": {"share": 0.5},
    "plate_buildup": {"mass_kg": 1.3},
    "plate_friction": {"friction": 0.12},
    "stream_spread": {"half_width_deg": 17.0},
}
"""Sizes that change the force at one of a sweep's angles, over that at home, by 10 % at 10 kg/s and 400 rpm, without any other
effect; cell_nonlinearity at its largest, which makes 3.7 %."""
Array = NDArray[np.float64]
Force = Callable[[Array, Array, Array], Array]
"""Force, N, from flow (kg/s), angle (rad) and elevator speed (rad/s)."""
DETAIL = Detail(masses=24, angles_deg=(36.0, 94.0, 13), speeds_rpm=(350.0, 450.0, 5), cells=96)


def shown(machine: Machine, effects: dict[str, dict[str, float]]) -> Force:
    """Force, N, that the cell of a machine with these effects (and gravity) shows, from flow, angle and speed."""
    scene = scenario.from_mapping({"effects": {"gravity": "on", **effects}}, "fleet diagnosis")
    grain = scene.crop.grain.at_moisture(scene.crop.moisture_pct, None)
    table = PulseTable(machine, [Condition(scene.crop.moisture_pct, grain, scene.effects)], DETAIL)

    def force(flow_kg_s: Array, angle_rad: Array, speed_rad_s: Array) -> Array:
        response_s, moisture = scene.sensor.response_s, scene.crop.moisture_pct
        return shown_force_n(table, scene.effects, flow_kg_s, angle_rad, speed_rad_s, response_s, moisture)

    return force


def calibrated(machine: Machine, shipped: ParameterSet, force: Force) -> ParameterSet:
    """The shipped parameters with the restitution that gives HOME_KG_S for the force that the plate at home shows."""
    model, at = ForwardModel(machine, shipped.effects), (machine.home_plate_angle_rad, machine.nominal_elevator_speed_rad_s)
    felt = float(force(np.array([HOME_KG_S]), np.array([at[0]]), np.array([at[1]]))[0])
    where = Conditions(*at, mass_flow_kg_s=HOME_KG_S)

    def missing(restitution: float) -> float:
        return float(np.real(model.force(where, {**shipped.values, "restitution": restitution}))) - felt

    return replace(shipped, values={**shipped.values, "restitution": float(brentq(missing, 0.0, 1.0))})


def day_of(machine: Machine, force: Force, rng: np.random.Generator) -> tuple[SecondRow, ...]:
    """The usable seconds of a day's sweeps, two a visit."""
    home_deg = float(np.degrees(machine.home_plate_angle_rad))
    sequence = np.array(sweep_sequence(SweepSettings().angles_deg, home_deg, 2))
    step = np.repeat(np.arange(sequence.size), 2)
    rows: list[SecondRow] = []
    for sweep in range(SWEEPS_A_DAY):
        time_s = 1800.0 * sweep + STEP_S * step + np.tile([STEP_S - 1.0, STEP_S], sequence.size)
        keep = np.exp(-np.diff(time_s, prepend=time_s[0]) / WANDER_S)
        level, state = np.zeros(time_s.size), rng.standard_normal()
        for i, k in enumerate(keep):
            state = k * state + np.sqrt(1.0 - k**2) * rng.standard_normal()
            level[i] = state
        flow = rng.uniform(*FLOWS_KG_S) * np.exp(WANDER * level)
        angle = np.radians(sequence[step])
        speed = np.full(flow.shape, SPEEDS_RPM[sweep % len(SPEEDS_RPM)] * RPM)
        clean = force(flow, angle, speed)
        sd = PADDLE_SCATTER / np.sqrt(PADDLES_PER_S) * clean
        felt = clean + sd * rng.standard_normal(flow.size)
        for i in range(flow.size):
            window = _window(
                time_s=float(time_s[i]), plate_angle_rad=float(angle[i]), force_n=float(felt[i]), force_std_dev_n=float(sd[i]),
                elevator_speed_rad_s=float(speed[i]), sweep_id=sweep + 1, sweep_step=int(step[i]),
            )  # fmt: skip
            rows.append(second_row(len(rows) + 1, window))
    return tuple(rows)


def _window(**given: Any) -> WindowRecord:
    values: dict[str, Any] = dict.fromkeys(WindowRecord.__dataclass_fields__, 0.0) | {
        "window": 1, "duration_s": 1.0, "coverage": 1.0, "plate_still": True, "moisture_pct": MOISTURE_PCT,
        "quality": EstimateQuality.SWEEPING, "operating_state": OperatingState.SWEEPING, "load_number": 1, "lost_frames": 0,
        "surplus_frames": 0, "repeated_frames": 0, "usable_for_calibration": True, "parameter_version": 1, "faults": (),
    } | given  # fmt: skip
    return WindowRecord(**values)


def hidden_of(draw: int, seed: int = SEED) -> tuple[str, dict[str, str]]:
    """The shared effect of a draw, and machine -> its own effect."""
    rng = np.random.default_rng([seed, draw])
    shared = str(rng.choice(list(SHARED)))
    own = rng.choice([name for name in OWN if name != shared], SINGLE, replace=False)
    machines = rng.choice(MACHINES, SINGLE, replace=False)
    return shared, {f"m{number:02d}": str(name) for number, name in zip(machines, own, strict=True)}


def fleet_of(draw: int, *, strong: bool, seed: int = SEED) -> list[MachineSweeps]:
    """The machines of a draw."""
    shared, own = hidden_of(draw, seed)
    sizes = OWN_STRONG if strong else OWN
    machine, shipped = Machine(), parameter_file.load()
    common = {shared: SHARED[shared]}
    forces = {name: shown(machine, common | ({name: sizes[name]} if name else {})) for name in ("", *own.values())}
    fleet = []
    for number in range(MACHINES):
        name = f"m{number:02d}"
        force = forces[own.get(name, "")]
        days = tuple(day_of(machine, force, np.random.default_rng([seed, draw, number, day])) for day in range(DAYS))
        fleet.append(MachineSweeps(name, machine, calibrated(machine, shipped, force), days))
    return fleet


def record(draw: int, found: FleetDiagnosis, seed: int = SEED) -> dict[str, Any]:
    """What was hidden beside what was said."""
    shared, own = hidden_of(draw, seed)
    said = {verdict.name: verdict for verdict in found.machines if verdict.verdict != "none"}

    def own_named(name: str, effect: str) -> bool:
        return name in said and said[name].verdict == "effect" and said[name].named[0].may_be(effect)

    return {
        "draw": draw, "shared": shared, "own": own, "shared_verdict": found.shared,
        "model": [[item.effect, item.confidence, dict(item.values), list(item.equivalent)] for item in found.model],
        "machines": {name: [verdict.verdict, *([item.effect, *item.equivalent] for item in verdict.named)]
                     for name, verdict in said.items()},
        "shared_named": [item.effect for item in found.model] == [shared],
        "shared_in_tie": len(found.model) == 1 and found.model[0].may_be(shared),
        "shared_among_named": shared in [item.effect for item in found.model],
        "own_named": {name: own_named(name, effect) for name, effect in own.items()},
        "named_elsewhere": [name for name in said if name not in own],
    }  # fmt: skip


def _draw(draw: int, strong: bool, seed: int) -> dict[str, Any]:
    return record(draw, diagnose(fleet_of(draw, strong=strong, seed=seed)), seed)


def run(out: Path, draws: Sequence[int], workers: int, *, strong: bool, seed: int = SEED) -> None:
    """Append the draws that are not in the file yet."""
    done = {line["draw"] for line in read(out)} if out.exists() else set()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    with ProcessPoolExecutor(workers) as pool:
        for found in pool.map(_draw, *zip(*((draw, strong, seed) for draw in draws if draw not in done), strict=True)):
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps({**found, "strong": strong, "seed": seed, "commit": commit}) + "\n")
            print(_line(found), file=sys.stderr, flush=True)


def read(path: Path) -> list[dict[str, Any]]:
    """Draws of a results file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]


def _line(found: dict[str, Any]) -> str:
    own = ", ".join(f"{name} {effect}: {found['own_named'][name]}" for name, effect in found["own"].items())
    model = ", ".join(item[0] for item in found["model"]) or "none"
    return f"draw {found['draw']}: {found['shared']}; model: {model}; {own}; elsewhere: {found['named_elsewhere'] or 'none'}"


def report(records: Sequence[dict[str, Any]]) -> bool:
    """Print the table; whether every draw is right in all."""
    for found in sorted(records, key=lambda found: found["draw"]):
        print(_line(found))
    own = [right for found in records for right in found["own_named"].values()]
    others = (MACHINES - SINGLE) * len(records)
    wrong = sum(len(found["named_elsewhere"]) for found in records)
    shared = sum(found["shared_named"] for found in records)
    in_tie = [found["shared_in_tie"] for found in records if "shared_in_tie" in found]
    whole = [found["shared_named"] and all(found["own_named"].values()) and not found["named_elsewhere"] for found in records]
    print(
        f"{len(records)} draws: the shared effect, and no other, is the model's in {shared}, it or one tied with it in "
        f"{sum(in_tie)} of the {len(in_tie)} that record ties, among the model's in "
        f"{sum(found['shared_among_named'] for found in records)}; own effects named (or tied) at their machine {sum(own)} of "
        f"{len(own)}; named at a machine without one {wrong} of {others}; all right in {sum(whole)}"
    )
    return all(whole)


def main() -> int:
    """Exit code of report: 0 when every draw is right in all."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.fleet_diagnosis", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="draws that are not in the results yet")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--draws", type=int, default=20)
    running.add_argument("--first", type=int, default=0)
    running.add_argument("--seed", type=int, default=SEED)
    running.add_argument("--workers", type=int, default=2)
    running.add_argument("--strong", action="store_true", help="machines' own effects of OWN_STRONG")
    reporting = verbs.add_parser("report", help="the table")
    reporting.add_argument("results", type=Path)
    args = parser.parse_args()
    if args.verb == "run":
        run(args.out, range(args.first, args.first + args.draws), args.workers, strong=args.strong, seed=args.seed)
        return 0
    return 0 if report(read(args.results)) else 1


if __name__ == "__main__":
    sys.exit(main())
