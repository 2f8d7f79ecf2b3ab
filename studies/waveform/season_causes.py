"""What the load errors of (f) in the daemon's seasons come from: their regression on what each season drew.

No season is run: errors are those of `daemon_season_weighed_loads.json`, and what was drawn follows from the seeds. The draws are
made in the order of `daemon_season.season`; what the first weighed load and each load draw besides is passed over.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.daemon_season import CALIBRATED_SD, LOADS, WEIGHT_LOADS, WEIGHT_SD, scenario
from studies.waveform.fill import FOLDER

Array = NDArray[np.float64]
FILE = FOLDER / "daemon_season_weighed_loads.json"
CAUSES = (
    "restitution's drift", "density's drift", "kernels' weight since the calibration", "calibrated bias", *CALIBRATED_SD,
)  # fmt: skip
GOAL_PCT = 2.0


@dataclass(frozen=True)
class Draws:
    """What a season drew.

    Attributes
    ----------
    signs : ndarray (2,)
        Of the drift of restitution and of density.
    calibration : ndarray (3,)
        Of what `CALIBRATED_SD` names, in its deviations.
    weighings : list of float
        Of the kernels' weight, in its deviations, the calibration's first.
    flows_kg_s : ndarray (LOADS,)
        Of the loads.
    """

    signs: Array
    calibration: Array
    weighings: list[float]
    flows_kg_s: Array


def draws(seed: int) -> Draws:
    """What `daemon_season.season` draws from a seed."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=2)
    calibration = np.array([float(rng.standard_normal()) for _ in CALIBRATED_SD])
    weighings = [float(rng.standard_normal())]
    _load(rng)
    rng.standard_normal()
    flows = []
    for n in range(LOADS):
        if n and n % WEIGHT_LOADS == 0:
            weighings.append(float(rng.standard_normal()))
        flows.append(_load(rng))
    return Draws(signs, calibration, weighings, np.array(flows))


def _load(rng: np.random.Generator) -> float:
    """Flow of one, kg/s."""
    ground = scenario(rng, 0.5, 1000.0, 1.0, 0.0)
    rng.integers(1 << 30)
    return float(ground["flow"]["pieces"][1]["flow_kg_s"])


def report() -> dict[str, Any]:
    """Contribution of each cause, percentage points of load error, rms; how many seasons would meet the goal without some.

    "Without" takes the regression's part away: an estimate by a straight line, no season that was run.
    """
    seasons = json.loads(FILE.read_text())["seasons"]
    rows, errors = [], []
    for row in seasons:
        drawn = draws(row["seed"])
        signs, calibration, weighings = drawn.signs, drawn.calibration, drawn.weighings
        if signs.tolist() != row["signs"]:
            raise ValueError(f"seed {row['seed']}: drew {signs.tolist()}, the season has {row['signs']}")
        bias = np.log(row["kernel_bias"] * (1.0 + WEIGHT_SD * weighings[0]))
        for n, error in enumerate(row["f_pct"]):
            late, told = n / (LOADS - 1), weighings[n // WEIGHT_LOADS] - weighings[0]
            rows.append((*(late * signs), 100.0 * WEIGHT_SD * told, 100.0 * bias, *calibration))
            errors.append(error)
    design, error = np.array(rows), np.array(errors)
    design[:, 3] -= design[:, 3].mean()
    slopes = np.linalg.lstsq(np.column_stack((np.ones(len(error)), design)), error, rcond=None)[0]
    parts = dict(zip(CAUSES, (design * slopes[1:]).T, strict=True))
    left = error - slopes[0] - sum(parts.values())
    drift, weight = parts[CAUSES[0]] + parts[CAUSES[1]], parts[CAUSES[2]]
    missed = [row["seed"] for row in seasons if row["f_mean_abs_pct"] >= GOAL_PCT]
    last = slice(LOADS - WEIGHT_LOADS, LOADS)
    by_season = {name: part.reshape(-1, LOADS) for name, part in parts.items()}
    places = {row["seed"]: place for place, row in enumerate(seasons)}
    return {
        "seasons": len(seasons),
        "rms_pct": {
            **{name: _rms(part) for name, part in parts.items()}, "not explained": _rms(left), "whole error": _rms(error),
        },
        "below_2_pct": {
            "as run": _met(error), "kernels weighed to 1 %": _met(error - 0.5 * weight),
            "weighed without error": _met(error - weight),
            "without what drifts": _met(error - drift), "without both": _met(error - drift - weight),
        },
        "last_third_of_those_missed": [
            {
                "seed": seed, "error_pct": round(float(error.reshape(-1, LOADS)[places[seed], last].mean()), 1),
                **{name: round(float(part[places[seed], last].mean()), 1) for name, part in by_season.items()},
            }
            for seed in missed
        ],
    }  # fmt: skip


def _rms(part: Array) -> float:
    return round(float(np.sqrt(np.mean(part**2))), 2)


def _met(error: Array) -> int:
    return int((np.abs(error.reshape(-1, LOADS)).mean(axis=1) < GOAL_PCT).sum())
