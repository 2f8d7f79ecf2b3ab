"""The demo's accuracy over many seeds.

    python -m studies.demo_seeds                          # 30 seeds of 120 s
    python -m studies.demo_seeds --first 1 --count 5      # others
    python -m studies.demo_seeds --out results.json       # kept

Exits 1 where fewer than 28 of 30 (in proportion) have a 95th percentile of at most 5 %.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

LIMIT_PCT = 5.0
NEEDED_SHARE = 28.0 / 30.0


def one(seed: int, duration_s: float) -> dict[str, float]:
    """Accuracy of one run: what `yieldmon demo --seed S --duration T --json` says."""
    from yieldmon.bus.codec import Codec
    from yieldmon.physics.machine import RPM
    from yieldmon.plant import scenario as scenarios
    from yieldmon.plant.combine import VirtualCombine
    from yieldmon.resources import shipped
    from yieldmon.service.assembly import build_monitor
    from yieldmon.service.config import configuration
    from yieldmon.trial import accuracy, lockstep

    chosen = scenarios.load(shipped("config/scenarios/demo.yaml")).model_copy(update={"duration_s": duration_s})
    settings = configuration.load(shipped("config/yieldmon.yaml"))
    monitor = build_monitor(settings.engine, settings.machine, settings.parameters, settings.calibrator)
    combine = VirtualCombine(chosen, settings.machine, seed)
    result = lockstep.run(combine, monitor, Codec())
    delay_s = 0.5 * settings.machine.pattern_length_m / settings.machine.paddle_speed_m_s(chosen.elevator.speed_rpm * RPM)
    found = accuracy.assess(result.published, combine.delivered_kg, delay_s, duration_s)
    return {
        "seed": seed, "mean_abs_pct": round(found.mean_abs_pct, 3), "p95_abs_pct": round(found.p95_abs_pct, 3),
        "mass_error_pct": round(found.mass_error_pct, 3),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=70001, help="first seed (default: %(default)s)")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--duration", type=float, default=120.0, help="simulated time, s")
    parser.add_argument("--out", type=Path, help="write the runs here as JSON")
    args = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    runs = []
    for seed in range(args.first, args.first + args.count):
        runs.append(one(seed, args.duration))
        print("seed {seed}: mean {mean_abs_pct:.2f} %, 95th percentile {p95_abs_pct:.2f} %".format(**runs[-1]), flush=True)
    good = sum(run["p95_abs_pct"] <= LIMIT_PCT for run in runs)
    print(f"{good} of {len(runs)} with a 95th percentile of at most {LIMIT_PCT:g} % (commit {commit}, {args.duration:g} s)")
    if args.out is not None:
        args.out.write_text(json.dumps({"commit": commit, "duration_s": args.duration, "runs": runs}, indent=1) + "\n")
    return 0 if good >= NEEDED_SHARE * len(runs) else 1


if __name__ == "__main__":
    sys.exit(main())
