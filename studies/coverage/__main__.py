"""Whether the published standard deviations of flow and load mass hold: z over scenarios of the virtual combine.

    python -m studies.coverage                            # all scenarios; table here as results.json
    python -m studies.coverage --seeds 2 --duration 200   # quicker
    python -m studies.coverage --only slip lively --out F

z = (published - true) / published standard deviation. Flow: every second from 4 kg/s. Load: every load of a minute. In the slip
scenario the first load is weighed; there the alarm counts and not z.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.faults import FaultCode
from yieldmon.engine.results import frames_in, records_in
from yieldmon.physics.machine import RPM
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.effects import ChainSlip, Effects, MoistureDependence, PlateFriction
from yieldmon.plant.profiles import FlowProfile, Oscillating, Steady
from yieldmon.plant.scenario import Crop, Scenario
from yieldmon.resources import shipped
from yieldmon.service import configuration
from yieldmon.service.assembly import build_monitor

FOLDER = Path(__file__).resolve().parent
FIRST_SEED = 41000
EMPTY_S = 8.0
LOAD_S = 60.0
LEAST_KG_S = 4.0
LINE = "{scenario:>10} {of}: {count} z, mean {mean:+.2f}, sd {sd:.2f}, {within_1:.0%} / {within_2:.0%}"
SETTLING_S = 15.0
"""Of harvest, before the first second that counts."""


@dataclass(frozen=True)
class Case:
    """What differs from the ordinary harvest. sweep_every_s: 0 for none; weighs: the first load gets its ticket."""

    name: str
    effects: dict[str, Any] = field(default_factory=dict)
    scatter_pct: float = 7.0
    variation_pct: float = 1.5
    variation_time_s: float = 20.0
    end_moisture_pct: float | None = None
    sweep_every_s: float = 0.0
    weighs: bool = False


CASES = (
    Case("ordinary"),
    Case("scatter", scatter_pct=12.0),
    Case("lively", variation_pct=8.0, variation_time_s=6.0),
    Case("moisture", effects={"moisture_dependence": MoistureDependence()}, end_moisture_pct=22.0),
    Case("sweeps", effects={"plate_friction": PlateFriction(friction=0.15)}, sweep_every_s=90.0),
    Case("slip", effects={"chain_slip": ChainSlip(share=0.06)}, weighs=True),
)


@dataclass(frozen=True)
class Found:
    """z of seconds and loads of one run, and whether the alarm of scale was shown after the first ticket."""

    flow: NDArray[np.float64]
    load: NDArray[np.float64]
    alarm: bool


def scenario_of(case: Case, duration_s: float) -> Scenario:
    """The case's harvest: steady at 10 kg/s, then swinging about 12 kg/s by 3 in 60 s."""
    pieces: list[Any] = [
        Steady(kind="steady", duration_s=EMPTY_S, flow_kg_s=0.0),
        Steady(kind="steady", duration_s=60.0, flow_kg_s=10.0),
        Oscillating(kind="oscillating", duration_s=duration_s, mean_kg_s=12.0, amplitude_kg_s=3.0, period_s=60.0),
    ]
    flow = FlowProfile(pieces=pieces, variation_pct=case.variation_pct, variation_time_s=case.variation_time_s, smoothing_s=0.7)
    crop = Crop(end_moisture_pct=case.end_moisture_pct)
    effects = Effects().model_copy(update=case.effects)
    return Scenario(duration_s=duration_s, crop=crop, effects=effects, flow=flow, paddle_scatter_pct=case.scatter_pct)


def one(case: Case, duration_s: float, seed: int) -> Found:
    """One run with the shipped configuration."""
    settings = configuration.load(shipped("config/yieldmon.yaml"))
    sweep = replace(
        settings.engine.sweep,
        enabled=case.sweep_every_s > 0.0,
        first_after_s=case.sweep_every_s or 600.0,
        interval_s=case.sweep_every_s or 1800.0,
    )
    monitor = build_monitor(replace(settings.engine, sweep=sweep), settings.machine, settings.parameters, settings.calibrator)
    scenario = scenario_of(case, duration_s)
    combine = VirtualCombine(scenario, settings.machine, seed)
    records, ends = [], np.arange(EMPTY_S - 1.0, duration_s, LOAD_S)
    loads: list[float] = []
    delay_s = 0.5 * settings.machine.pattern_length_m / settings.machine.paddle_speed_m_s(scenario.elevator.speed_rpm * RPM)
    alarm = False
    for number, end_s in enumerate((*ends.tolist(), duration_s)):
        for frame in combine.frames_until(end_s):
            found = monitor.feed(frame)
            for answer in frames_in(found):
                combine.handle(answer)
            records += records_in(found)
        load, alarm = monitor.open_load, alarm or monitor.faults.is_active(FaultCode.SCALE_DISAGREES)
        if number and load is not None and load.measured_kg > 100.0:
            times = np.array([records[-round(LOAD_S)].time_s - 1.0, records[-1].time_s]) - delay_s
            if end_s - times[0] < LOAD_S + 2.0 and number <= ends.size - 1:
                true_kg = float(np.diff(combine.delivered_kg(times))[0])
                loads.append((load.measured_kg - true_kg) / load.std_dev_kg)
                if case.weighs and number == 1:
                    monitor.ticket(load.number, true_kg, 0.002 * true_kg)
        monitor.start_load()
    time_s = np.array([r.time_s for r in records])
    true = combine.delivered_kg(time_s - delay_s) - combine.delivered_kg(np.maximum(time_s - delay_s - 1.0, 0.0))
    flow, sd = (np.array([getattr(r, name) for r in records]) for name in ("mass_flow_kg_s", "std_dev_kg_s"))
    counts = (true >= LEAST_KG_S) & np.isfinite(flow) & (time_s > EMPTY_S + SETTLING_S)
    return Found(((flow - true) / sd)[counts], np.array(loads), alarm)


def row(name: str, values: NDArray[np.float64]) -> dict[str, Any]:
    """Mean, standard deviation and shares within one and two of it."""
    return {
        "of": name, "count": int(values.size), "mean": round(float(values.mean()), 2), "sd": round(float(values.std()), 2),
        "within_1": round(float(np.mean(np.abs(values) <= 1.0)), 3), "within_2": round(float(np.mean(np.abs(values) <= 2.0)), 3),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=370.0, help="of a run, s")
    parser.add_argument("--only", nargs="+", choices=[case.name for case in CASES], default=[case.name for case in CASES])
    parser.add_argument("--out", type=Path, default=FOLDER / "results.json")
    args = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    rows: list[dict[str, Any]] = []
    for case in (case for case in CASES if case.name in args.only):
        runs = [one(case, args.duration, args.first + k) for k in range(args.seeds)]
        for what in ("flow", "load"):
            rows.append({"scenario": case.name, **row(what, np.concatenate([getattr(run, what) for run in runs]))})
            print(LINE.format(**rows[-1]), flush=True)
        if case.weighs:
            rows[-1]["alarm"] = [run.alarm for run in runs]
            print(f"{case.name:>10} alarm after the first ticket: {sum(run.alarm for run in runs)} of {len(runs)}", flush=True)
    found = {"commit": commit, "first_seed": args.first, "seeds": args.seeds, "duration_s": args.duration, "rows": rows}
    args.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
