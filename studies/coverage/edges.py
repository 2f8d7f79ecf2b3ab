"""Errors of seconds and mass where the flow begins and ends every few seconds.

    python -m studies.coverage.edges [--first SEED] [--runs N]

Passes of 8 to 18 kg/s of about so many seconds with pauses without grain, smoothed by the combine; the shipped configuration and
parameters, which are those of the combine. z: published less true flow over the published standard deviation, of seconds from
4 kg/s.
"""

from __future__ import annotations

import argparse
import random

import numpy as np

from yieldmon.bus.codec import Codec
from yieldmon.frames import MASS_FLOW
from yieldmon.physics.machine import RPM
from yieldmon.physics.numerics import Array
from yieldmon.plant import scenario as scenarios
from yieldmon.plant.combine import VirtualCombine
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.trial import accuracy, lockstep

CASES = ((60.0, 12.0, 0.7), (20.0, 8.0, 0.7), (60.0, 12.0, 0.2), (20.0, 8.0, 0.2), (8.0, 6.0, 0.2))
"""Of passes, pauses and smoothing, s."""
_LASTS_S, _LEAST_KG_S = 180.0, 4.0


def passes(seed: int, pass_s: float, pause_s: float, smoothing_s: float) -> scenarios.Scenario:
    """A scenario of passes and pauses, each 0.7 to 1.3 times as long as given."""
    chance = random.Random(seed)
    pieces: list[dict[str, object]] = [{"kind": "steady", "duration_s": 8.0, "flow_kg_s": 0.0}]
    end_s = 8.0
    while end_s < _LASTS_S:
        for long_s, flow_kg_s in ((pass_s, chance.uniform(8.0, 18.0)), (pause_s, 0.0)):
            lasts_s = long_s * chance.uniform(0.7, 1.3)
            pieces.append({"kind": "steady", "duration_s": lasts_s, "flow_kg_s": flow_kg_s})
            end_s += lasts_s
    flow = {"variation_pct": 1.5, "variation_time_s": 20.0, "smoothing_s": smoothing_s, "pieces": pieces}
    base = scenarios.load(shipped("config/scenarios/demo.yaml")).model_dump()
    return scenarios.from_mapping(base | {"duration_s": int(end_s) + 4, "flow": flow}, "passes")


def judged(scenario: scenarios.Scenario, seed: int) -> tuple[float, float, Array]:
    """95th percentile of the seconds' errors and the error of the mass, %, and z of the seconds (n,)."""
    loaded = configuration.load(shipped("config/yieldmon.yaml"))
    monitor = build_monitor(loaded.engine, loaded.machine, loaded.parameters, loaded.calibrator)
    combine = VirtualCombine(scenario, loaded.machine, seed)
    published = lockstep.run(combine, monitor, Codec()).published
    speed = loaded.machine.paddle_speed_m_s(scenario.elevator.speed_rpm * RPM)
    delay_s = 0.5 * loaded.machine.pattern_length_m / speed
    found = accuracy.assess(published, combine.delivered_kg, delay_s, scenario.duration_s)
    frames = [frame for frame in published if frame.message == MASS_FLOW and frame.time_s > delay_s + 1.0]
    flow, std_dev = (
        np.array([value if isinstance(value := frame.signals[name], float) else np.nan for frame in frames])
        for name in ("MassFlowRate", "MassFlowStdDev")
    )
    at_s = np.array([frame.time_s for frame in frames]) - delay_s
    true = combine.delivered_kg(at_s) - combine.delivered_kg(at_s - 1.0)
    rated = np.isfinite(flow) & np.isfinite(std_dev) & (true >= _LEAST_KG_S)
    return found.p95_abs_pct, found.mass_error_pct, ((flow - true) / std_dev)[rated]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=700, help="first seed (default: %(default)s)")
    parser.add_argument("--runs", type=int, default=6, help="of each case (default: %(default)s)")
    args = parser.parse_args()
    print("passes, pauses, smoothing, s: 95 % of seconds within, %; mass, %: mean and rms; z of seconds: sd, least")
    for case in CASES:
        runs = [judged(passes(seed, *case), seed) for seed in range(args.first, args.first + args.runs)]
        within, mass = np.array([run[:2] for run in runs]).T
        z = np.concatenate([run[2] for run in runs])
        print(
            f"{case[0]:3.0f} {case[1]:3.0f} {case[2]:.1f}: {within.mean():5.2f}; {mass.mean():+.2f}"
            f" {np.sqrt((mass**2).mean()):.2f}; {z.std():.2f} {z.min():.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
