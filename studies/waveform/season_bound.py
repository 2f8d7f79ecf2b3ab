"""The best that mean force and pulse shape can do in the seasons of `daemon_season`: the posterior of density given both.

Fill and friction are taken as known, the force as without noise. Fill is flow over density, and the force at a known fill goes as
density times 1 + restitution; so each load tells ln(density) + ln(1 + restitution) exactly, and nothing of how it is shared
between the two. What is shared is left to the law of drift. The flow is fill times the density that the law expects.

    daemon          the law of the daemon's filter: density and gain walk at random, each to its own deviation at the season's end
    steady, normal  each drifts steadily by a normal deviate of that deviation
    steady, even    by anything up to 15 % either way, all alike likely
    sizes told      by 15 %, up or down: nothing but two signs is not known
    a share         the best fixed share of mean force and shape, chosen on these seasons

No season is run: what was drawn follows from the seeds, and the daemon's own errors are those of its seasons' files.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.daemon_season import CALIBRATED_SD, DRIFT, LOADS, MACHINE, TRUE
from studies.waveform.fill import FOLDER
from studies.waveform.season_causes import Draws, draws
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import Conditions, ForwardModel

Array = NDArray[np.float64]
SEASONS = ("daemon_season.json", "daemon_season_8e55c242.jsonl")
GAIN_DRIFT = DRIFT * TRUE["restitution"] / (1.0 + TRUE["restitution"])
START_SD = (CALIBRATED_SD["density"] / TRUE["density"], CALIBRATED_SD["restitution"] / (1.0 + TRUE["restitution"]))
"""Of ln(density) and ln(1 + restitution) by the season's calibration."""
PROGRESS = np.arange(LOADS) / LOADS
"""Share of the season's time that has passed before each load, by which the daemon's walks grow."""
DENSITY_SDS = (0.01, 0.02, 0.03, 0.04, 0.05, 0.08)


def posterior_of_density(law: str, told: Array) -> Array:
    """Expected change of ln(density) since the calibration at each load of a season.

    Parameters
    ----------
    law : str
        A key of `LAWS`.
    told : ndarray (LOADS,)
        Change of ln(density) + ln(1 + restitution) since the calibration, as fill and force tell it, up to that load.

    Returns
    -------
    ndarray (LOADS,)
    """
    return LAWS[law](told)


def _walks(told: Array) -> Array:
    """A Kalman filter of two walks whose sum is seen without noise."""
    mean, covariance = np.zeros(2), np.diag(np.square(START_SD))
    rates = np.array([DRIFT, GAIN_DRIFT]) ** 2
    found, before = [], 0.0
    for seen, now in zip(told, PROGRESS, strict=True):
        covariance = covariance + np.diag(rates * (now - before))
        whole = covariance.sum()
        gain = covariance.sum(axis=1) / whole
        mean = mean + gain * (seen - mean.sum())
        covariance = covariance - np.outer(gain, gain) * whole
        found.append(mean[0])
        before = now
    return np.array(found)


def _steady_normal(told: Array) -> Array:
    """Rates with the walks' deviations at the season's end, and the calibration's error of both."""
    late = np.arange(LOADS) / (LOADS - 1)
    density = START_SD[0] ** 2 + (DRIFT * late)[:, None] * (DRIFT * late)[None, :]
    gain = START_SD[1] ** 2 + (GAIN_DRIFT * late)[:, None] * (GAIN_DRIFT * late)[None, :]
    found = []
    for n in range(1, LOADS + 1):
        share = density[n - 1, :n] @ np.linalg.pinv((density + gain)[:n, :n], rcond=1e-9, hermitian=True)
        found.append(float(share @ told[:n]))
    return np.array(found)


def _steady_even(told: Array) -> Array:
    """The calibration's error is left out: the sum is then known at the season's end as at any other load."""
    late = np.arange(LOADS) / (LOADS - 1)
    low = np.maximum(-DRIFT * late, told - GAIN_DRIFT * late)
    high = np.minimum(DRIFT * late, told + GAIN_DRIFT * late)
    return np.asarray(np.clip(0.5 * (low + high), -DRIFT * late, DRIFT * late))


def _sizes_told(told: Array) -> Array:
    late = np.arange(LOADS) / (LOADS - 1)
    ways = np.array([(r, r + g) for r in (-DRIFT, DRIFT) for g in (-GAIN_DRIFT, GAIN_DRIFT)])
    nearest = np.abs(told[:, None] - late[:, None] * ways[:, 1]).argmin(axis=1)
    return np.asarray(late * ways[nearest, 0])


LAWS: dict[str, Callable[[Array], Array]] = {
    "daemon": _walks, "steady, normal": _steady_normal, "steady, even": _steady_even, "sizes told": _sizes_told,
}  # fmt: skip


def _season(drawn: Draws) -> dict[str, Array]:
    """Logarithmic errors of each load: of mean force, of shape, and of each law's posterior."""
    late = np.arange(LOADS) / (LOADS - 1)
    density = TRUE["density"] * (1.0 + DRIFT * drawn.signs[1] * late)
    restitution = TRUE["restitution"] * (1.0 + DRIFT * drawn.signs[0] * late)
    known = {name: TRUE[name] + sd * float(z) for (name, sd), z in zip(CALIBRATED_SD.items(), drawn.calibration, strict=True)}
    known["friction"] = TRUE["friction"]
    model = ForwardModel(MACHINE, ("gravity",))
    speed, angle = 400.0 * RPM, float(np.deg2rad(70.0))
    at = Conditions(angle, speed, paddle_mass_kg=drawn.flows_kg_s / MACHINE.passes_per_s(speed))
    force = model.paddle_momentum(at, {**TRUE, "density": density, "restitution": restitution}) * MACHINE.passes_per_s(speed)
    parameters = ParameterSet({**TRUE, **known}, (), np.zeros((0, 0)))
    mean_force = OpenLoop(model, parameters).estimate(np.asarray(force), angle, speed).mass_flow_kg_s
    denser = np.log(density / known["density"])
    told = denser + np.log((1.0 + restitution) / (1.0 + known["restitution"]))
    errors = {"mean force": np.log(mean_force / drawn.flows_kg_s), "shape": -denser}
    return errors | {law: posterior_of_density(law, told) - denser for law in LAWS} | {"_told": told}


def _pct(errors: Array) -> Array:
    """(seasons,): mean absolute error of the loads, %."""
    return np.asarray(100.0 * np.abs(np.expm1(errors)).mean(axis=1))


def _with_density(found: dict[str, Array], sd: float, rng: np.random.Generator) -> Array:
    """Errors of the daemon's law where each load's density is told beside, with an error of its own."""
    denser = -found["shape"]
    out = np.empty_like(denser)
    for row, (told, true) in enumerate(zip(found["_told"], denser, strict=True)):
        seen = true + sd * rng.standard_normal(LOADS)
        mean, covariance, before = np.zeros(2), np.diag(np.square(START_SD)), 0.0
        for n, now in enumerate(PROGRESS):
            covariance = covariance + np.diag(np.array([DRIFT, GAIN_DRIFT]) ** 2 * (now - before))
            for direction, value, noise in ((np.ones(2), told[n], 0.0), (np.array([1.0, 0.0]), seen[n], sd)):
                whole = direction @ covariance @ direction + noise**2
                gain = covariance @ direction / whole
                mean = mean + gain * (value - direction @ mean)
                covariance = covariance - np.outer(gain, gain) * whole
            out[row, n], before = mean[0] - true[n], now
    return out


def of_daemon(file: Path) -> dict[int, dict[str, float]]:
    """Mean absolute load error of (b) and (e), %, by seed, of a file of seasons."""
    text = file.read_text()
    rows = [json.loads(line) for line in text.splitlines()] if file.suffix == ".jsonl" else json.loads(text)["seasons"]
    return {row["seed"]: {name: row[f"{name}_mean_abs_pct"] for name in "be"} for row in rows}


def _row(errors: Array, alike: NDArray[np.bool_], against: Array) -> dict[str, Any]:
    """against: what is to be halved, by season."""
    return {
        "mean_pct": round(float(errors.mean()), 2), "largest_pct": round(float(errors.max()), 2),
        "alike_pct": round(float(errors[alike].mean()), 2), "against_pct": round(float(errors[~alike].mean()), 2),
        "over_b": round(float(errors.mean() / against.mean()), 2),
        "seasons_halved": int((errors <= 0.5 * against).sum()), "of_them_alike": int((errors <= 0.5 * against)[alike].sum()),
    }  # fmt: skip


def report(seeds: int = 30, first: int = 17001) -> dict[str, Any]:
    """Bounds over the seeds' drift paths and loads, beside what the daemon's seasons gave."""
    drawn = [draws(seed) for seed in range(first, first + seeds)]
    seasons = [_season(d) for d in drawn]
    found = {name: np.array([s[name] for s in seasons]) for name in seasons[0]}
    alike = np.array([d.signs[0] == d.signs[1] for d in drawn])
    b = _pct(found["mean force"])
    shares = np.linspace(0.0, 1.0, 101)
    mixed = [_pct((1.0 - share) * found["mean force"] + share * found["shape"]) for share in shares]
    best = int(np.argmin([m.mean() for m in mixed]))
    bounds = {"mean force": _row(b, alike, b), **{law: _row(_pct(found[law]), alike, b) for law in LAWS}}
    bounds["a share"] = {"share": round(float(shares[best]), 2), **_row(mixed[best], alike, b)}
    rng = np.random.default_rng(first)
    daemon = {}
    for name in SEASONS:
        rows = of_daemon(FOLDER / name)
        chosen = np.array([first + i in rows for i in range(seeds)])
        own = {key: np.array([rows[first + i][key] for i in range(seeds) if chosen[i]]) for key in "be"}
        of_bound = _pct(found["daemon"])[chosen]
        daemon[name] = {
            "seasons": int(chosen.sum()),
            "b": _row(own["b"], alike[chosen], own["b"]),
            "e": _row(own["e"], alike[chosen], own["b"]),
            "bound": {law: _row(_pct(found[law])[chosen], alike[chosen], own["b"]) for law in LAWS},
            "correlation_with_bound": round(float(np.corrcoef(own["e"], of_bound)[0, 1]), 2),
        }  # fmt: skip
    return {
        "seeds": [first, first + seeds - 1], "seasons_alike": int(alike.sum()), "bounds": bounds,
        "daemon_law_with_density_told": {
            f"{100.0 * sd:g} %": _row(_pct(_with_density(found, sd, rng)), alike, b) for sd in DENSITY_SDS
        },
        "daemon": daemon,
    }  # fmt: skip
