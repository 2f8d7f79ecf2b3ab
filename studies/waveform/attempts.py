"""What limits volume flow from discrete-element pulses: the heap's own scatter, the terms of the arrival law, or the model.

Each load and plate angle is judged by what was learnt without its load and without its angle, as in `fill`.
"""

from __future__ import annotations

import csv
import gzip
from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.dem.job import TOP_RAD, Throw
from studies.dem.script import start_angle_rad
from studies.waveform.arrival import calibrate_arrival
from studies.waveform.fill import (
    ANGLES_DEG,
    DATA,
    LOADS_KG,
    pulse_model,
    volume_flow_m3_s,
    wave,
)
from yieldmon.estimation.waveform.arrival_law import ArrivalLaw
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_model import PulseModel
from yieldmon.estimation.waveform.pulse_shape import estimate
from yieldmon.physics.machine import RPM

Array = NDArray[np.float64]
Waves = dict[tuple[float, float], PatternWave]
TABLES = ((400.0, 0.3),)


def all_waves() -> dict[tuple[float, float, int], Waves]:
    """Harmonics by (rpm, friction, seed), then (load, plate angle)."""
    rows: dict[tuple[float, ...], list[tuple[float, float]]] = defaultdict(list)
    lead = TOP_RAD - start_angle_rad(Throw(paddle_mass_kg=1.0))
    with gzip.open(DATA, "rt", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            rpm = float(row["elevator_speed_rpm"])
            cell = (float(row["paddle_mass_kg"]), float(row["plate_angle_deg"]))
            key = (rpm, float(row["friction"]), float(row["trial"]), *cell)
            rows[key].append((float(row["time_s"]) + 5e-4 - lead / (rpm * RPM), float(row["force_total_n"])))
    out: dict[tuple[float, float, int], Waves] = defaultdict(dict)
    for (rpm, friction, seed, load, angle), values in rows.items():
        out[rpm, friction, int(seed)][load, angle] = wave(np.array(values), rpm, angle)
    return out


def mean_of_seeds(first: Waves, second: Waves) -> Waves:
    """Pulses of two seeds averaged, where there are two."""
    return {
        key: replace(one, amplitudes_n=0.5 * (one.amplitudes_n + second[key].amplitudes_n)) if key in second else one
        for key, one in first.items()
    }


def _with(base: PulseModel, law: ArrivalLaw) -> PulseModel:
    return PulseModel(base.model, base.parameters, replace(base.settings, arrival=law))


def _learnt_without(waves: Waves, load: float | None, angle: float | None) -> list[tuple[float, float]]:
    return [key for key in waves if key[0] != load and key[1] != angle]


def by_law(waves: Waves, shown: Waves, rpm: float, friction: float, terms: int, *, same_angle: bool = False) -> Array:
    """Errors of ln(volume flow) of `shown` (loads, angles), by arrival laws of `waves`.

    same_angle: the calibration is of the judged angle alone, at other loads, as that of a machine at home is.
    """
    base, errors = pulse_model(friction, 0.1, indexed=True), np.full((len(LOADS_KG), len(ANGLES_DEG)), np.nan)
    for i, load in enumerate(LOADS_KG):
        for j, angle in enumerate(ANGLES_DEG):
            known = [k for k in waves if k[0] != load and k[1] == angle] if same_angle else _learnt_without(waves, load, angle)
            law = calibrate_arrival(base, [waves[k] for k in known], [volume_flow_m3_s(k[0], rpm) for k in known], terms=terms)
            if (load, angle) in shown:
                found = estimate(_with(base, law), shown[load, angle])
                errors[i, j] = np.log(found.volume_flow_m3_s / volume_flow_m3_s(load, rpm))
    return errors


def _features(load: Array | float, angle_deg: float | Array) -> Array:
    x, c = np.broadcast_arrays(np.log(np.asarray(load) / 0.8), np.cos(np.deg2rad(angle_deg)) - 0.35)
    return np.stack((np.ones_like(x), x, c, x * c, c * c, x * x), axis=-1)


def by_response(waves: Waves, rpm: float, friction: float) -> Array:
    """Errors with a common impulse response: what the fitted model leaves in each harmonic, by a law of load and angle.

    A response at each harmonic (logarithm of size and phase, three terms: 1, ln load, cos angle) is divided out, with the load
    from the estimate before, four times.
    """
    base = pulse_model(friction, 0.1, indexed=True)
    errors = np.full((len(LOADS_KG), len(ANGLES_DEG)), np.nan)
    for i, load in enumerate(LOADS_KG):
        for j, angle in enumerate(ANGLES_DEG):
            known = _learnt_without(waves, load, angle)
            flows = [volume_flow_m3_s(k[0], rpm) for k in known]
            law = calibrate_arrival(base, [waves[k] for k in known], flows, terms=5)
            pulses = _with(base, law)
            left = []
            for key, flow in zip(known, flows, strict=True):
                w = waves[key]
                model = pulses.waves(pulses.start(flow), w.elevator_speed_rad_s, w.plate_angle_rad)
                ratio = w.amplitudes_n / model
                left.append(np.log(np.abs(ratio)) + 1j * np.unwrap(np.angle(ratio)))
            table = _features(np.array([k[0] for k in known]), np.array([k[1] for k in known]))[:, :3]
            logs = np.array(left)
            logs = logs - logs[:, :1].real
            coefficients = np.linalg.lstsq(table.astype(complex), logs, rcond=None)[0]
            guess = load * 1.3
            w = waves[load, angle]
            for _ in range(4):
                response = np.exp(_features(guess, angle)[:3] @ coefficients)
                found = estimate(pulses, replace(w, amplitudes_n=w.amplitudes_n / response))
                if not np.isfinite(found.volume_flow_m3_s):
                    break
                guess = found.volume_flow_m3_s / volume_flow_m3_s(1.0, rpm)
            errors[i, j] = np.log(guess / load)
    return errors


def by_emulator(waves: Waves, terms: int) -> Array:
    """Errors without the model: harmonics (ln size, phase) as polynomials of ln load and cos angle, gain free.

    What is left by the polynomials is the error of each harmonic; the load is the one with the least chi square.
    """
    errors = np.full((len(LOADS_KG), len(ANGLES_DEG)), np.nan)
    grid = np.geomspace(0.05, 4.0, 400)
    for i, load in enumerate(LOADS_KG):
        for j, angle in enumerate(ANGLES_DEG):
            known = _learnt_without(waves, load, angle)
            table = _features(np.array([k[0] for k in known]), np.array([k[1] for k in known]))[:, :terms]
            logs = np.array([_logs(waves[k]) for k in known])
            coefficients, *_ = np.linalg.lstsq(table, logs, rcond=None)
            left = logs - table @ coefficients
            spread = left.T @ left / max(len(known) - terms, 1)
            spread += np.diag(0.02**2 + 0.5 * np.diag(spread))
            weight = np.linalg.inv(spread)
            away = _logs(waves[load, angle]) - _features(grid, angle)[:, :terms] @ coefficients
            errors[i, j] = np.log(grid[int(np.argmin(np.einsum("gi,ij,gj->g", away, weight, away)))] / load)
    return errors


def _logs(shown: PatternWave) -> Array:
    """ln size of the harmonics relative to the first, and phases, of the first eight harmonics."""
    a = shown.amplitudes_n[:8]
    phase = np.unwrap(np.angle(a))
    return np.concatenate((np.log(np.abs(a[1:]) / np.abs(a[0])), phase - 2.0 * np.pi * np.round(phase[0] / (2.0 * np.pi))))


def _row(errors: Array) -> dict[str, Any]:
    inner = np.abs(errors[1:-1, 1:-1])
    every = np.abs(errors[np.isfinite(errors)])
    return {
        "between_mean_pct": round(100.0 * float(np.nanmean(inner)), 1),
        "between_largest_pct": round(100.0 * float(np.nanmax(inner)), 1),
        "all_mean_pct": round(100.0 * float(every.mean()), 1),
        "all_largest_pct": round(100.0 * float(every.max()), 1),
        "home_mean_pct": round(100.0 * float(np.nanmean(np.abs(errors[:, 2]))), 1),
        "errors_pct": np.round(100.0 * errors, 1).tolist(),
    }


def _table(first: Waves, second: Waves, rpm: float, friction: float) -> list[dict[str, Any]]:
    both = mean_of_seeds(first, second)
    found = {
        "law of 5 terms, one heap": by_law(first, first, rpm, friction, 5),
        "law of 5 terms, mean of two heaps": by_law(both, both, rpm, friction, 5),
        "calibrated at the angle itself, load left out": by_law(both, both, rpm, friction, 2, same_angle=True),
        "with a response of each harmonic": by_response(both, rpm, friction),
        "no model, 3 terms": by_emulator(both, 3),
        "no model, 5 terms": by_emulator(both, 5),
        "no model, 6 terms": by_emulator(both, 6),
    }
    rows = [{"rpm": rpm, "friction": friction, "attempt": name, **_row(errors)} for name, errors in found.items()]
    apart = by_law(first, second, rpm, friction, 5) - found["law of 5 terms, one heap"]
    scatter = np.round(100.0 * np.sqrt(np.nanmean(apart[:3] ** 2, axis=1) / 2.0), 1).tolist()
    by_load = dict(zip(map(str, LOADS_KG[:3]), scatter, strict=True))
    return [*rows, {"rpm": rpm, "friction": friction, "attempt": "scatter of one heap", "by_load_pct": by_load}]


def report() -> list[dict[str, Any]]:
    """A row for each table and attempt, and the scatter between two heaps of one load."""
    data = all_waves()
    return [row for rpm, friction in TABLES for row in _table(data[rpm, friction, 1], data[rpm, friction, 2], rpm, friction)]
