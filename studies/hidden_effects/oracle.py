"""What one who knows the generator's laws could name: a Bayes classifier on the tables of *third*.

    python -m studies.hidden_effects.oracle OUT.jsonl --records studies/hidden_effects/laws-SALT.jsonl [--lost] [--only KIND...]

Each table is made again and fitted by the generator itself, with each of its effects in turn: friction, restitution and density
free within the bounds of `diagnose`, the size up to the largest that is drawn, gravity at its one value, noise known, all rows.
-2 log evidence is chi-square with parameters integrated out (Laplace, flat priors). Within 6 of the best is tied, as in
`diagnose`. So it says what such tables show to one who knows the laws.

third: all effects. third-removed: how far the best other effect is behind the true one, by the generator's own laws. third-pair:
each alone, both, and each beside every other one.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.hidden_effects import cases, law_cases, study
from studies.hidden_effects import generator as g
from yieldmon.discrepancy.policy import DEFAULT
from yieldmon.physics.grain import GRAIN

Array = NDArray[np.float64]
BASE = ("friction", "restitution", "density")
TIE = DEFAULT.tie
"""Evidence within which effects are tied, as in `diagnose`."""
LARGEST_CLASS = 4
_ROUGH, _HOPELESS = 3, 150.0
"""Steps after which a fit is judged for the first time, and chi-square beside three times the best one's from which it ends."""
_SHARE = 1e-4
"""Step of a derivative, as a share of a parameter's range."""


COARSE = {"LAYERS": 60, "_TAU_STEPS": 120}
"""Of the generator in fits: within 5e-4 of the largest reading of what makes the tables, in a third of the time."""


@contextmanager
def coarse() -> Iterator[None]:
    """The generator with fewer layers and steps."""
    before = {name: getattr(g, name) for name in COARSE}
    try:
        for name, value in COARSE.items():
            setattr(g, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(g, name, value)


@dataclass(frozen=True)
class Table:
    """Means of each condition's repetitions and their sd, N, (cells,), and the conditions, radians and SI."""

    angle: Array
    speed: Array
    flow: Array
    moisture: Array
    mean: Array
    sd: Array


def table_of(kind: str, name: str, number: int, salt: int) -> tuple[Table, dict[str, float]]:
    """A case's table, made again, and its grain."""
    key = f"{kind}/{name}/{number}"
    rows, _, grain = law_cases.rows_of(kind, name, np.random.default_rng([zlib.crc32(key.encode()), salt]))
    columns = np.stack((rows.plate_angle_rad, rows.elevator_speed_rad_s, rows.load, rows.moisture_pct))
    condition, number_of = np.unique(columns, axis=1, return_inverse=True)
    count = np.bincount(number_of.ravel())
    mean = np.bincount(number_of.ravel(), rows.value) / count
    sd = 0.01 * np.hypot(mean, 0.15 * float(mean.max())) / np.sqrt(count)
    angle, speed, flow, moisture = condition
    return Table(angle, speed, flow, moisture, mean, sd), grain


@dataclass(frozen=True)
class Explained:
    """Effects fitted to a table: chi-square, -2 log evidence and the parameters."""

    effects: tuple[str, ...]
    chi2: float
    evidence: float
    values: tuple[float, ...]


def bounds(effects: Sequence[str]) -> tuple[Array, Array, list[str]]:
    """Of the free parameters, and their names; an effect of one size has none."""
    low, high, names = [], [], list[str]()
    for name in BASE:
        one, other = GRAIN[name].search
        low.append(one)
        high.append(other)
        names.append(name)
    for name in effects:
        smallest, largest = (-0.3, 0.6) if name == "heap_shape" else cases.SIZES[name]
        if smallest != largest:
            low.append(smallest)
            high.append(largest)
            names.append(name)
    return np.array(low), np.array(high), names


class Question:
    """Effects on one table: residuals by the generator, in shares of each free parameter's range."""

    def __init__(self, table: Table, effects: Sequence[str]) -> None:
        self.table, self.effects = table, tuple(effects)
        self.low, self.high, self.names = bounds(effects)
        self._fixed = {name: cases.SIZES[name][1] for name in effects if name not in self.names}

    def residual(self, x: Array) -> Array:
        """(prediction - mean) / sd, (cells,)."""
        known = dict(zip(self.names, x.tolist(), strict=True))
        table, grain = self.table, g.Grain(known["friction"], known["restitution"], known["density"])
        sizes = {name: known[name] for name in self.effects if name in known} | self._fixed
        by = g.force(table.angle, table.speed, table.flow, table.moisture, grain, sizes, third_laws=True)
        return np.asarray((by - table.mean) / table.sd)

    def begun(self, grain: Array) -> tuple[float, Array, Array] | None:
        """A few steps from each sense of the sizes, the best; grain: what to begin with, (3,)."""
        signed, largest = self.low[len(BASE) :] < 0.0, self.high[len(BASE) :]
        found = []
        for share in (0.2, -0.2) if np.any(signed) else (0.2,):
            x = np.clip(np.concatenate((grain, np.where(signed, share, 0.2) * largest)), self.low, self.high)
            found.append(_least_squares(self.residual, x, self.low, self.high, _ROUGH))
        return min((f for f in found if f is not None), key=lambda f: f[0], default=None)

    def ended(self, begun: tuple[float, Array, Array]) -> Explained:
        """From there to the end."""
        found = _least_squares(self.residual, begun[1], self.low, self.high)
        chi2, x, slope = found if found is not None else begun
        # Flat priors over the bounds; slopes are per range, so that the volume is a share of it. No parameter is known worse.
        volume = float(np.linalg.slogdet(slope.T @ slope + np.eye(len(x)))[1]) - len(x) * float(np.log(2.0 * np.pi))
        return Explained(self.effects, chi2, chi2 + volume, tuple(float(v) for v in x))


def explained(table: Table, tried: Sequence[Sequence[str]], grain: Array) -> list[Explained]:
    """What each set of effects leaves, best first; those that a few steps leave far behind are not taken to the end."""
    asked = [Question(table, effects) for effects in tried]
    rough = [(q, begun) for q in asked if (begun := q.begun(grain)) is not None]
    least = min(begun[0] for _, begun in rough)
    return sorted((q.ended(begun) for q, begun in rough if begun[0] <= 3.0 * least + _HOPELESS), key=lambda f: f.evidence)


def _least_squares(residual: Any, x: Array, low: Array, high: Array, most: int = 12) -> tuple[float, Array, Array] | None:
    """Levenberg-Marquardt in shares of the range: chi-square, the point, and slopes per range."""
    span = high - low
    r = residual(x)
    if not np.all(np.isfinite(r)):
        return None
    damping, slope = 1e-2, np.zeros((len(r), len(x)))
    for _ in range(most):
        slope = np.zeros((len(r), len(x)))
        for i in range(len(x)):
            moved = x.copy()
            step = _SHARE * span[i] * (1.0 if x[i] < high[i] - 2.0 * _SHARE * span[i] else -1.0)
            moved[i] += step
            slope[:, i] = np.nan_to_num((residual(moved) - r) / step * span[i])
        square, along, before = slope.T @ slope, slope.T @ r, float(r @ r)
        free = ~(((x <= low) & (along > 0.0)) | ((x >= high) & (along < 0.0)))
        for _ in range(6):
            step = np.zeros(len(x))
            inner = square[np.ix_(free, free)]
            step[free] = -np.linalg.solve(inner + damping * np.diag(np.diag(inner) + 1e-9), along[free])
            trial = np.clip(x + step * span, low, high)
            there = residual(trial)
            if np.all(np.isfinite(there)) and there @ there < before:
                damping *= 0.1
                break
            damping = max(damping, 1e-3) * 10.0
        else:
            break
        x, r = trial, there
        if before - float(r @ r) < 0.05:
            break
    return float(r @ r), x, slope


def judge(kind: str, name: str, number: int, salt: int) -> dict[str, Any]:
    """What the generator's own laws say of a case."""
    began = time.process_time()
    table, grain = table_of(kind, name, number, salt)
    start = np.array([grain[k] for k in BASE])
    truth = tuple(name.split("+"))
    tried: list[tuple[str, ...]] = [(e,) for e in law_cases.THIRD]
    if kind == "third-pair":
        tried = (
            [(e,) for e in truth] + [truth] + [tuple(sorted((t, e))) for t in truth for e in law_cases.THIRD if e not in truth]
        )
    with coarse(), np.errstate(divide="ignore", invalid="ignore"):
        found = explained(table, tried, start)
    return {
        "case": f"{kind}/{name}/{number}", "generator": kind, "salt": salt, "hidden": list(truth), "commit": study.commit(),
        "cells": len(table.mean), "found": [[list(f.effects), f.chi2, f.evidence] for f in found[:12]],
        "true": next(([f.chi2, f.evidence] for f in found if set(f.effects) == set(truth)), None),
        "cpu_s": time.process_time() - began,
    }  # fmt: skip


def run(out: Path, records: Sequence[dict[str, Any]]) -> None:
    """Append the cases that are not in `out` yet, one line each; safe to stop and start again."""
    done = {(r["case"], r["salt"]) for r in study.read(out)} if out.exists() else set()
    with open(out, "a", encoding="utf-8") as file:
        for r in records:
            kind, name, number = r["case"].split("/")
            if (r["case"], r["salt"]) not in done:
                kept = {k: r[k] for k in ("verdict", "classes", "visible_sd")}
                file.write(json.dumps(judge(kind, name, int(number), r["salt"]) | {"search": kept}) + "\n")
                file.flush()


def _as_it_should_be(r: dict[str, Any]) -> bool:
    """Whether a single effect is named, or tied with the name, in a class that counts, or nothing where it was removed."""
    if r["generator"].endswith("removed"):
        return bool(r["verdict"] != "effect")
    return r["verdict"] == "effect" and r["hidden"][0] in r["classes"][0] and len(r["classes"][0]) <= LARGEST_CLASS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--records", type=Path, nargs="+", default=[], help="records of `law_cases`")
    parser.add_argument("--only", nargs="+", default=["third"], help="third, third-removed, third-pair")
    parser.add_argument("--lost", action="store_true", help="effects that the search did not name, and removed ones that it did")
    args = parser.parse_args()
    every = [r for path in args.records for r in study.read(path) if r["visible_sd"] >= law_cases.VISIBLE]
    for kind in args.only:
        run(args.out, [r for r in every if r["generator"] == kind and not (args.lost and _as_it_should_be(r))])
    return 0


if __name__ == "__main__":
    sys.exit(main())
