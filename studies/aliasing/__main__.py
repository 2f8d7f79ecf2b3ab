"""How much a steady pulse train moves the one-second results, with the engine's windows and with a plain mean.

    python -m studies.aliasing [--step RPM] [--json]

Constant flow, alternating paddle spacing, no noise; each elevator speed for a dozen seconds. The figure is the peak-to-peak of
the results over their mean.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np

from yieldmon.engine.sampling.windows import WindowBuilder
from yieldmon.engine.settings import WindowSettings
from yieldmon.physics.machine import RPM, Machine

SECONDS = 12
PULSE_STD_DEV_S = 0.012


def pulse_train(machine: Machine, rpm: float, seconds: int) -> np.ndarray:
    """Samples at 1 kHz of a steady flow: one Gaussian pulse a paddle, its area the grain of the paddle's own spacing."""
    speed = machine.paddle_speed_m_s(rpm * RPM)
    place = speed * 0.001 * np.arange(1, 1000 * seconds + 1)
    wave = np.zeros_like(place)
    offset = 0.0
    for spacing in machine.paddle_spacings_m:
        offset += spacing
        distance = (place - offset + 0.5 * machine.pattern_length_m) % machine.pattern_length_m - 0.5 * machine.pattern_length_m
        wave += spacing * np.exp(-0.5 * (distance / speed / PULSE_STD_DEV_S) ** 2)
    return 1000.0 * wave


def results(machine: Machine, rpm: float) -> tuple[np.ndarray, np.ndarray]:
    """One-second results of the engine's windows and of the plain mean, the first second left out."""
    samples = pulse_train(machine, rpm, SECONDS).reshape(-1, 4)
    times = 0.004 * np.arange(1, samples.shape[0] + 1)
    rows = np.column_stack((times, np.arange(times.size) % 256, np.zeros(times.size), samples))
    builder = WindowBuilder(WindowSettings(), machine)
    weighted, plain = [], []
    for second in range(SECONDS):
        inside = (times > second + 0.002) & (times <= second + 1.002)
        builder.samples.add_block(rows[inside])
        for tenth in range(10):
            builder.speed.add(second + 0.1 * tenth + 0.05, round(rpm / 0.125) * 0.125 * RPM)
        weighted.append(builder.close(float(second), second + 1.0).mean_mv)
        plain.append(float(samples[inside].mean()))
    return np.array(weighted[1:]), np.array(plain[1:])


def peak_to_peak_pct(values: np.ndarray) -> float:
    """Range over mean, %."""
    return float(100.0 * np.ptp(values) / values.mean())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from", dest="first", type=float, default=300.0, metavar="RPM")
    parser.add_argument("--to", dest="last", type=float, default=500.0, metavar="RPM")
    parser.add_argument("--step", type=float, default=1.0, metavar="RPM")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    machine = Machine()
    rows = []
    for rpm in np.arange(args.first, args.last + 0.5 * args.step, args.step).tolist():
        weighted, plain = results(machine, rpm)
        rows.append({"rpm": rpm, "windows_pct": peak_to_peak_pct(weighted), "plain_mean_pct": peak_to_peak_pct(plain)})
    worst = {key: max(row[key] for row in rows) for key in ("windows_pct", "plain_mean_pct")}
    if args.json:
        print(json.dumps({"rows": rows, "worst": worst}, indent=1))
        return 0
    print("elevator   peak-to-peak of the 1 s results, %")
    print("     rpm      windows   plain mean")
    for row in rows:
        print(f"{row['rpm']:8.1f} {row['windows_pct']:12.4f} {row['plain_mean_pct']:12.4f}")
    print(f"   worst {worst['windows_pct']:12.4f} {worst['plain_mean_pct']:12.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
