"""Volume flow from the shape of discrete-element pulses: load and plate angle left out, calibrated on all others."""

from __future__ import annotations

import csv
import gzip
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.dem.job import TOP_RAD, Throw
from studies.dem.script import start_angle_rad
from studies.waveform.arrival import SEVERAL_GRAINS, calibrate_arrival
from yieldmon.estimation.waveform.arrival_calibration import arrival_point, law_of
from yieldmon.estimation.waveform.arrival_law import ArrivalLaw
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_fit import PulseEstimate
from yieldmon.estimation.waveform.pulse_model import PulseModel, PulseSettings
from yieldmon.estimation.waveform.pulse_shape import estimate
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel

Array = NDArray[np.float64]
Edges = Callable[[tuple[float, float, float, float]], bool]
DATA = Path(__file__).resolve().parents[2] / "tests" / "data" / "dem_campaign_forces.csv.gz"
LOADS_KG = (0.2, 0.5, 0.9, 1.3, 1.8)
FRICTIONS = (0.3, 0.15)
TABLES = tuple((rpm, friction) for rpm in (400.0, 500.0) for friction in FRICTIONS)
FOLDER = Path(__file__).resolve().parent
EDGES = FOLDER / "edge_forces.csv.gz"
BETWEEN = FOLDER / "between_forces.csv.gz"
BETWEEN_SEED = "411"
MANY = FOLDER / "many_heaps_forces.csv.gz"
MANY_SEEDS = ("601", "602", "603", "604")
FORCES = FOLDER / "kernel_forces.npz"
OTHER_RPM = 400.0
ANGLES_DEG = (40.0, 55.0, 70.0, 80.0, 90.0)
DENSITY_KG_M3 = 710.0
SHAPE_RATIO = 2.9
HARMONICS = 12
CELL_S = 0.008
MACHINE = replace(Machine(), paddle_spacings_m=(Machine().paddle_spacing_m,))


def histories(file: Path = DATA, seed: str = "1") -> dict[tuple[float, float, float, float], Array]:
    """Force over time (n, 2) of one seed by (rpm, friction, load, plate angle); time from the paddle's pointing up.

    file: a campaign's forces at 1 kHz: the reference campaign, or `EDGES`, loads and plate angles around it, or `BETWEEN`.
    """
    rows: dict[tuple[float, float, float, float], list[tuple[float, float]]] = defaultdict(list)
    lead = TOP_RAD - start_angle_rad(Throw(paddle_mass_kg=1.0))
    with gzip.open(file, "rt", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row["trial"] == seed:
                rpm = float(row["elevator_speed_rpm"])
                key = (rpm, float(row["friction"]), float(row["paddle_mass_kg"]), float(row["plate_angle_deg"]))
                rows[key].append((float(row["time_s"]) + 5e-4 - lead / (rpm * RPM), float(row["force_total_n"])))
    return {key: np.array(values) for key, values in rows.items()}


def wave(history: Array, rpm: float, angle_deg: float) -> PatternWave:
    """Harmonics of a steady train of one pulse, one to a mean paddle spacing, through a cell of 8 ms."""
    base = 2.0 * np.pi * MACHINE.paddle_speed_m_s(rpm * RPM) / MACHINE.pattern_length_m
    omega = base * np.arange(1, HARMONICS + 1)
    time = history[:, 0] + 2.0 * np.pi / base
    amplitude = (history[:, 1] * 1e-3 * np.exp(-1j * np.outer(omega, time))).sum(axis=1) * base / (2.0 * np.pi)
    return PatternWave(
        amplitude / (1.0 + 1j * omega * CELL_S) ** 2, np.full(HARMONICS, 0.06), 12.0, rpm * RPM, np.deg2rad(angle_deg)
    )


def volume_flow_m3_s(load_kg: float, rpm: float) -> float:
    """Of a train of loads."""
    return load_kg / DENSITY_KG_M3 * MACHINE.paddle_speed_m_s(rpm * RPM) / MACHINE.paddle_spacing_m


def pulse_model(friction: float, model_error: float, indexed: bool) -> PulseModel:
    """Of the campaign's machine and grain, straight paths."""
    grain = {
        "friction": friction, "density": DENSITY_KG_M3, "shape_ratio": SHAPE_RATIO, "restitution": 0.3,
        "gravity.acceleration_m_s2": 9.81,
    }  # fmt: skip
    sd = {**PulseSettings().sd, "log_friction": 0.03, "log_shape_ratio": 0.02, "log_cell": 0.02}
    settings = PulseSettings(
        harmonics=HARMONICS, model_error=model_error, cell_response_s=CELL_S, vibration_n=0.0, sd=sd, indexed=indexed
    )
    return PulseModel(ForwardModel(MACHINE, ("gravity",)), grain, settings)


class Judge:
    """Estimates by arrival laws that have not seen what is judged.

    pooled: one law over speeds and frictions; else one for each of them, of five terms. left_out: the judged load, the judged
    plate angle, or all pulses that have either. edges: which pulses of `EDGES` it is
    calibrated on as well, by (rpm, friction, load, plate angle); they are not judged.
    """

    def __init__(
        self, model_error: float, indexed: bool, pooled: bool, left_out: str = "both", edges: Edges | None = None
    ) -> None:
        self._pooled, self._left_out, self._indexed = pooled, left_out, indexed
        self._models = {f: pulse_model(f, model_error, indexed) for f in FRICTIONS}
        known = histories() | ({k: v for k, v in histories(EDGES).items() if edges(k)} if edges else {})
        self.waves = {key: wave(history, key[0], key[3]) for key, history in known.items()}
        self._points = {
            key: arrival_point(self._models[key[1]], shown, volume_flow_m3_s(key[2], key[0])) for key, shown in self.waves.items()
        }
        self._laws: dict[tuple[float, ...], ArrivalLaw] = {}

    def law(self, rpm: float, friction: float, load_kg: float, angle_deg: float) -> ArrivalLaw:
        """Of all pulses but those of a load or a plate angle."""
        group = () if self._pooled else (rpm, friction)
        if (*group, load_kg, angle_deg) not in self._laws:

            def unseen(key: tuple[float, ...]) -> bool:
                same = {"load": key[2] == load_kg, "angle": key[3] == angle_deg}
                return any(same.values()) if self._left_out == "both" else same[self._left_out]

            keys = [k for k in self.waves if not unseen(k) and (self._pooled or k[:2] == (rpm, friction))]
            terms = SEVERAL_GRAINS if self._pooled else 5
            self._laws[*group, load_kg, angle_deg] = law_of([self._points[k] for k in keys], terms=terms, indexed=self._indexed)
        return self._laws[*group, load_kg, angle_deg]

    def estimate(self, shown: PatternWave, rpm: float, friction: float, load_kg: float, angle_deg: float) -> PulseEstimate:
        """From a wave."""
        return estimate(self.model(friction, self.law(rpm, friction, load_kg, angle_deg)), shown)

    def model(self, friction: float, law: ArrivalLaw) -> PulseModel:
        """With an arrival law."""
        base = self._models[friction]
        return PulseModel(base.model, base.parameters, replace(base.settings, arrival=law))


def left_out(judge: Judge, rpm: float, friction: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Error of ln(volume flow), its stated standard deviation, and whether it is published, (loads, angles)."""
    errors, stated = (np.empty((len(LOADS_KG), len(ANGLES_DEG))) for _ in range(2))
    told = np.zeros(errors.shape, dtype=bool)
    for i, load in enumerate(LOADS_KG):
        for j, angle in enumerate(ANGLES_DEG):
            found = judge.estimate(judge.waves[rpm, friction, load, angle], rpm, friction, load, angle)
            errors[i, j] = np.log(found.volume_flow_m3_s / volume_flow_m3_s(load, rpm))
            stated[i, j], told[i, j] = found.relative_sd, not found.outside
    return errors, stated, told


def _row(errors: Array, stated: Array, told: NDArray[np.bool_]) -> dict[str, Any]:
    size = np.abs(errors)
    return {
        "published_pct": round(100.0 * float(told.mean())),
        "published_mean_pct": round(100.0 * float(size[told].mean()), 1) if told.any() else None,
        "published_largest_pct": round(100.0 * float(size[told].max()), 1) if told.any() else None,
        "published_rms_error_over_sd": round(float(np.sqrt(np.mean((errors / stated)[told] ** 2))), 2) if told.any() else None,
        "all_mean_pct": round(100.0 * float(np.nanmean(size)), 1),
        "all_largest_pct": round(100.0 * float(np.nanmax(size)), 1),
        "all_rms_error_over_sd": round(float(np.sqrt(np.nanmean((errors / stated) ** 2))), 2),
        "errors_pct": np.round(100.0 * errors, 1).tolist(),
        "told": told.astype(int).tolist(),
    }


def shape_law(model_error: float = 0.1) -> ArrivalLaw:
    """Of all pulses of the campaign, without an index: what `config/pulse-shape.yaml` ships."""
    models = {f: pulse_model(f, model_error, indexed=False) for f in FRICTIONS}
    waves = {key: wave(history, key[0], key[3]) for key, history in histories().items() if key[2] in LOADS_KG}
    flows = [volume_flow_m3_s(key[2], key[0]) for key in waves]
    return calibrate_arrival([models[key[1]] for key in waves], list(waves.values()), flows, terms=SEVERAL_GRAINS)


def other_grain(judge: Judge) -> list[dict[str, Any]]:
    """Pulses on which nothing was chosen (`kernel_forces.npz`): other heaps, kernels, restitutions, and a plate at 50 deg."""
    data = np.load(FORCES)
    force, interval_s = data["force_n"].astype(float), float(data["interval_s"])
    keys = np.stack([data[n] for n in ("kernel_g", "load_kg", "restitution", "angle_deg")], axis=1).astype(float).round(4)
    lead_s = (TOP_RAD - start_angle_rad(Throw(paddle_mass_kg=1.0))) / (OTHER_RPM * RPM)
    rows = []
    for key in np.unique(keys, axis=0):
        kernel_g, load, restitution, angle = (float(v) for v in key)
        chosen = np.flatnonzero(np.all(keys == key, axis=1))
        if chosen.size < 3:
            continue
        errors, told = [], []
        for n in chosen:
            time = float(data["begin_s"][n]) + interval_s * (np.arange(force.shape[1]) + 0.5) - lead_s
            shown = wave(np.stack((time, force[n] * interval_s / 1e-3), axis=1), OTHER_RPM, angle)
            found = judge.estimate(shown, OTHER_RPM, 0.3, load, angle)
            errors.append(float(np.log(found.volume_flow_m3_s / volume_flow_m3_s(load, OTHER_RPM))))
            told.append(not found.outside)
        rows.append(
            {
                "kernel_g": kernel_g, "load_kg": load, "restitution": restitution, "angle_deg": angle, "heaps": int(chosen.size),
                "mean_pct": round(100.0 * float(np.mean(errors)), 1), "heap_sd_pct": round(100.0 * float(np.std(errors)), 1),
                "published": int(np.sum(told)),
            }
        )  # fmt: skip
    return rows


def between(model_error: float = 0.1) -> dict[str, Any]:
    """Pulses of `BETWEEN`, whose loads, plate angles and heaps the reference campaign lacks, by the law of all of its own."""
    found: dict[str, Any] = {}
    for indexed in (True, False):
        judge, rows = Judge(model_error, indexed, pooled=True), []
        for (rpm, friction, load, angle), history in histories(BETWEEN, BETWEEN_SEED).items():
            seen = judge.estimate(wave(history, rpm, angle), rpm, friction, load, angle)
            error = float(np.log(seen.volume_flow_m3_s / volume_flow_m3_s(load, rpm)))
            rows.append((error, seen.relative_sd, not seen.outside, rpm, friction, load, angle))
        errors, stated, told = (np.array([row[part] for row in rows]) for part in range(3))
        found["index" if indexed else "no index"] = {
            **_row(errors, stated, told.astype(bool)),
            "pulses": [[*row[3:], round(100.0 * row[0], 1)] for row in rows],
        }
    return found


def many_heaps(model_error: float = 0.1) -> dict[str, Any]:
    """Pulses of `MANY`, heaps that the reference campaign lacks, judged by the law without their load and angle.

    A train of one heap repeats that heap's own shape for ever; a window holds some fifty paddles with a heap each. So beside each
    heap by itself the train of their mean pulse is judged.
    """
    files = {seed: histories(MANY, seed) for seed in MANY_SEEDS}
    keys = list(files[MANY_SEEDS[0]])
    found: dict[str, Any] = {"heaps": {seed: len(held) for seed, held in files.items() if held}}
    for indexed in (True, False):
        judge, rows, errors = Judge(model_error, indexed, pooled=True), [], []
        for rpm, friction, load, angle in keys:
            flow = volume_flow_m3_s(load, rpm)
            waves = [
                wave(held[rpm, friction, load, angle], rpm, angle)
                for held in files.values()
                if (rpm, friction, load, angle) in held
            ]
            mean = replace(waves[0], amplitudes_n=np.mean([w.amplitudes_n for w in waves], axis=0))
            seen = [
                judge.estimate(w, rpm, friction, load, angle) for w in (judge.waves[rpm, friction, load, angle], *waves, mean)
            ]
            off = [float(np.log(one.volume_flow_m3_s / flow)) for one in seen]
            errors.append(
                (off[0], float(np.mean(np.abs(off[1:-1]))), float(np.max(np.abs(off[1:-1]))), off[-1], seen[-1].relative_sd)
            )
            rows.append([rpm, friction, load, angle, *np.round(100.0 * np.array(off), 1).tolist(), not seen[-1].outside])
        table = np.abs(np.array(errors))
        found["index" if indexed else "no index"] = {
            "cells": len(rows),
            "reference_heap_mean_largest_pct": _mean_and_largest(table[:, 0]),
            "single_heaps_mean_largest_pct": [
                round(100.0 * float(table[:, 1].mean()), 1),
                round(100.0 * float(table[:, 2].max()), 1),
            ],
            "mean_of_heaps_mean_largest_pct": _mean_and_largest(table[:, 3]),
            "mean_of_heaps_rms_error_over_sd": round(float(np.sqrt(np.mean((table[:, 3] / table[:, 4]) ** 2))), 2),
            "pulses": rows,
        }
    return found


def _mean_and_largest(size: Array) -> list[float]:
    return [round(100.0 * float(size.mean()), 1), round(100.0 * float(size.max()), 1)]


def report(model_error: float) -> dict[str, Any]:
    """Tables by speed and friction before (a law for each, nothing refused) and after, load or angle alone left out, and the
    pulses of other grain."""
    rows = []
    for indexed in (True, False):
        for pooled, unseen in ((False, "both"), (True, "both"), (True, "load"), (True, "angle")):
            judge = Judge(model_error, indexed, pooled, unseen)
            found = [left_out(judge, rpm, friction) for rpm, friction in TABLES]
            heads: list[dict[str, Any]] = [{"rpm": rpm, "friction": friction} for rpm, friction in TABLES]
            errors, stated, told = (np.concatenate(part) for part in zip(*found, strict=True))
            for head, part in zip([*heads, {"rpm": "all"}], [*found, (errors, stated, told.astype(bool))], strict=True):
                way = {"left_out": unseen, "pooled": pooled, "indexed": indexed, "model_error": model_error}
                rows.append({**head, **way, **_row(*part)})
    return {"left_out": rows, "other_grain": other_grain(Judge(model_error, True, True))}
