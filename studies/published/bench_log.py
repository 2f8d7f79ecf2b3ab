"""Make tests/data/bench_log.log.gz: the published bench measurements as a test facility's CAN log.

    python -m studies.published.bench_log [--plate-angle DEG] [--out F.log.gz]

The elevator runs empty for 15 s, then each trial of tests/data/bench_table.csv at the plate angle (default 70 deg, the angle of
the published calibration) passes for 2.2 s as a train of equal paddle pulses, trial 1 of every load first, then trial 2 of every
load, and so on. Each pulse, summed over its samples, is the trial's published response.

Scale: 1 unit of response is an impulse of 0.01 N s on the plate, 0.01 / 0.4448 mV s of the sensor above its zero-load voltage, so
that `yieldmon calibrate --response-scale 100` gives parameters for this log. Paddles pass at 400 rpm at the machine's spacings.
The pulse's shape (a raised cosine of 40 ms) and the noise (1 mV, seed 20261121) are not measured: they are ours.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import sys
from pathlib import Path

import numpy as np

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.frames import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME, Frame, Value
from yieldmon.physics.machine import RPM, Machine

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "tests" / "data" / "bench_table.csv"
OUT = ROOT / "tests" / "data" / "bench_log.log.gz"
START_S = 1_000_000_000
EMPTY_S = 15.5
TRIAL_S = 2.2
SPEED_RPM = 400.0
ZERO_MV = 500.0
NOISE_MV = 1.0
RESOLUTION_MV = 0.5
PULSE_S = 0.040
IMPULSE_N_S = 0.01
SEED = 20261121


def trials(plate_angle_deg: float) -> list[tuple[float, int, float]]:
    """(paddle mass in kg, trial, response) at an angle, in the order they pass."""
    with TABLE.open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if float(row["plate_angle_deg"]) == plate_angle_deg]
    found = [(float(row["paddle_mass_kg"]), int(row["trial"]), float(row["response"])) for row in rows]
    return sorted(found, key=lambda trial: (trial[1], trial[0]))


def samples_mv(responses: list[float], machine: Machine) -> np.ndarray:
    """The sensor's samples, SAMPLE_INTERVAL_S apart, in whole steps of the frame's resolution."""
    count = round((EMPTY_S + TRIAL_S * len(responses)) / SAMPLE_INTERVAL_S)
    voltage = ZERO_MV + NOISE_MV * np.random.default_rng(SEED).standard_normal(count)
    chain_m = np.arange(0.0, count * SAMPLE_INTERVAL_S, SAMPLE_INTERVAL_S)[-1] * machine.paddle_speed_m_s(SPEED_RPM * RPM)
    repeats = int(chain_m / machine.pattern_length_m) + 1
    passes_s = np.cumsum(np.tile(machine.paddle_spacings_m, repeats)) / machine.paddle_speed_m_s(SPEED_RPM * RPM)
    half = round(0.5 * PULSE_S / SAMPLE_INTERVAL_S)
    for at_s in passes_s:
        trial = int((at_s - EMPTY_S) // TRIAL_S)
        centre = round(at_s / SAMPLE_INTERVAL_S)
        if trial < 0 or trial >= len(responses) or centre + half >= count:
            continue
        index = np.arange(centre - half, centre + half + 1)
        shape = 1.0 + np.cos(2.0 * np.pi * (index * SAMPLE_INTERVAL_S - at_s) / (PULSE_S + 2.0 * SAMPLE_INTERVAL_S))
        impulse_mv_s = responses[trial] * IMPULSE_N_S / machine.sensor.gain_n_per_mv
        voltage[index] += shape / shape.sum() * impulse_mv_s / SAMPLE_INTERVAL_S
    # The rounding error is carried on, so that sums over pulses are those of the exact values.
    return np.diff(np.rint(np.cumsum(voltage) / RESOLUTION_MV), prepend=0.0) * RESOLUTION_MV


def log_frames(responses: list[float], plate_angle_deg: float, machine: Machine) -> list[Frame]:
    """Samples with speed and angle beside them, in order of time."""
    samples = samples_mv(responses, machine).reshape(-1, SAMPLES_PER_FRAME).tolist()
    interval_s = SAMPLE_INTERVAL_S * SAMPLES_PER_FRAME
    found = []
    for number, row in enumerate(samples):
        at_s = START_S + (number + 1) * interval_s
        signals: dict[str, Value] = {f"Sample{k}": value for k, value in enumerate(row)}
        signals |= {"SampleCounter": number % 256, "SensorStatus": 0}
        found.append(Frame(at_s, frames.IMPACT_SENSOR_SAMPLES, signals))
        if number % 25 == 0:
            found.append(Frame(at_s + 0.0005, frames.ELEVATOR_SPEED, {"ElevatorSpeed": SPEED_RPM}))
        if number % 25 in (2, 14):
            feedback: dict[str, Value] = {"PlateAngle": plate_angle_deg, "ActuatorState": 0}
            found.append(Frame(at_s + 0.001, frames.PLATE_ACTUATOR_FEEDBACK, feedback))
    return found


def write(path: Path, found: list[Frame]) -> None:
    """As candump -l does, gzipped without a date so that the same log is the same file."""
    codec = Codec()
    lines = []
    for frame in found:
        message = codec.encode(frame)
        lines.append(f"({frame.time_s:.6f}) can0 {message.arbitration_id:08X}#{message.data.hex().upper()}\n")
    path.write_bytes(gzip.compress("".join(lines).encode("ascii"), mtime=0))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plate-angle", type=float, default=70.0, metavar="DEG")
    parser.add_argument("--out", type=Path, default=OUT, metavar="F")
    args = parser.parse_args()
    found = trials(args.plate_angle)
    if not found:
        print(f"python -m studies.published.bench_log: no trials at {args.plate_angle:g} deg in {TABLE}", file=sys.stderr)
        return 2
    responses = [response for _, _, response in found]
    write(args.out, log_frames(responses, args.plate_angle, Machine()))
    print(f"{args.out}: {len(found)} trials, {EMPTY_S + TRIAL_S * len(found):g} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
