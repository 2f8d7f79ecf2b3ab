"""Delays with known answers (shifts added to real fields, synthetic fields, noise), and the transport inverse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from yieldmon.field import sources
from yieldmon.field.delay import Delay, estimate_delay
from yieldmon.field.pairs import opposing_pairs
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import DEFAULT_FLOW_S, HarvestTable, Source, build
from yieldmon.field.tracks import tracks
from yieldmon.field.transport import assess

SHIFTS_S = (-20, -15, -10, -5, -2, 2, 5, 10, 15, 20, 25)
EARTH_M_DEG = 111_195.0


def flow_delay(table: HarvestTable, seed: int = 1) -> Delay:
    """Of a table, with the default for what cannot be told."""
    steps = tracks(table)
    return estimate_delay(
        steps, opposing_pairs(steps), "flow", default_s=DEFAULT_FLOW_S, declared_s=None, generator=np.random.default_rng(seed)
    )


def shifted(table: HarvestTable, shift_s: int) -> HarvestTable:
    """Flow later by a time, each row taking the flow of the row measured so long before; unknown where there is none."""
    steps = tracks(table)
    found = steps.nearest(steps.time_s - shift_s, steps.stream, 0.6 * max(steps.usual_interval_s, 1.0))[steps.step_of_row]
    if len(steps) == len(table):
        row_of_step = np.empty(len(table), np.intp)
        row_of_step[steps.step_of_row] = np.arange(len(table))
        row = row_of_step[np.maximum(found, 0)]
    else:
        first = {}
        for number, (step, section) in enumerate(zip(steps.step_of_row.tolist(), table["section"].tolist(), strict=True)):
            first[step, section] = number
        row = np.array(
            [first.get((step, section), -1) for step, section in zip(found.tolist(), table["section"].tolist(), strict=True)]
        )
        found = np.where(row < 0, -1, found)
    return table.with_columns(flow_kg_s=np.where(found >= 0, table["flow_kg_s"][row], np.nan))


def real_shifts(path: Path) -> dict[str, Any]:
    """The delay of a real field, and of the same with known shifts."""
    table = sources.read(path, ReadOptions())
    here = flow_delay(table)
    rows: list[dict[str, Any]] = []
    for shift in SHIFTS_S:
        there = flow_delay(shifted(table, shift))
        rows.append(
            {
                "shift_s": shift,
                "decision": there.decision,
                "value_s": there.value_s,
                "error_s": there.value_s - here.value_s - shift,
            }
        )
    answered = [abs(row["error_s"]) for row in rows if row["decision"] == "estimated"]
    return {
        "points": len(table),
        **here.document(),
        "no_shift": here.no_shift,
        "shifted": here.shifted,
        "held_out": here.held_out,
        "answered": len(answered),
        "of": len(SHIFTS_S),
        "largest_error_s": max(answered, default=None),
        "shifts": rows if here.decision == "estimated" else [],
    }


def synthetic(rng: np.random.Generator, *, noise_only: bool = False) -> tuple[HarvestTable, float]:
    """A field of passes to and fro with a known delay.

    Patches of 6 to 30 m, noise of 5 to 40 % of a point, varied speed and width, a first-order smear of up to 3 s (its mean counts
    as delay), guidance errors.
    """
    passes, length_s, width = int(rng.integers(14, 40)), int(rng.integers(60, 160)), float(rng.uniform(4.0, 12.0))
    speed, turn_s = float(rng.uniform(1.2, 2.8)), int(rng.integers(8, 30))
    tau, dead = float(rng.uniform(0.0, 3.0)), int(rng.integers(-10, 25))
    ground = gaussian_filter(rng.normal(size=(512, 512)), float(rng.uniform(6.0, 30.0)), mode="wrap")
    ground = 1.0 + 0.25 * ground / ground.std()
    east, north, down = [], [], []
    for k in range(passes):
        pace = speed * (1 + 0.05 * np.cumsum(rng.normal(size=length_s)) / np.sqrt(length_s))
        along = np.cumsum(pace)
        along = along if k % 2 == 0 else along[-1] - along
        east += list(k * width + rng.normal(0, 0.15, length_s))
        north += list(along)
        down += [1] * length_s
        east += list(k * width + width * np.arange(1, turn_s + 1) / turn_s)
        north += list(along[-1] + np.zeros(turn_s))
        down += [0] * turn_s
    e, n, d = np.array(east), np.array(north), np.array(down, float)
    count = len(e)
    way = np.hypot(np.diff(e, prepend=e[0]), np.diff(n, prepend=n[0]))
    cut = ground[np.round(n).astype(int) % 512, np.round(e).astype(int) % 512] * width * way * d
    if noise_only:
        level = gaussian_filter(rng.normal(size=count), float(rng.uniform(0.1, 8.0)))
        flow = np.maximum(10.0 * (1 + 0.25 * level / level.std()), 0.0)
    else:
        decay = np.exp(-1.0 / tau) if tau > 0.05 else 0.0
        smeared, state = np.zeros(count), 0.0
        for k in range(count):
            state = decay * state + (1 - decay) * cut[k]
            smeared[k] = state
        flow = np.roll(smeared, dead)
        flow = np.maximum(flow * (1 + rng.uniform(0.05, 0.4) * rng.normal(size=count)), 0.0)
        dead_mean = decay / (1 - decay) if decay else 0.0
        return _table(e, n, d, flow, way, width), dead + dead_mean
    return _table(e, n, d, flow, way, width), float("nan")


def _table(e: np.ndarray, n: np.ndarray, d: np.ndarray, flow: np.ndarray, way: np.ndarray, width: float) -> HarvestTable:
    count = len(e)
    columns = {
        "time_s": np.arange(count, dtype=float),
        "longitude_deg": 10.0 + e / (EARTH_M_DEG * np.cos(np.radians(50.0))),
        "latitude_deg": 50.0 + n / EARTH_M_DEG,
        "flow_kg_s": flow,
        "interval_s": np.ones(count),
        "distance_m": way,
        "width_m": np.full(count, width),
        "header_down": d,
    }
    return build(columns, {}, Source("drawn", "study", count), unix_time=False)


def coverage(trials: int, seed: int) -> dict[str, Any]:
    """How often an interval misses the delay that a synthetic field has."""
    rng = np.random.default_rng(seed)
    answered, missed, errors = 0, 0, []
    for _ in range(trials):
        table, truth = synthetic(rng)
        found = flow_delay(table)
        if found.low_s is None or found.high_s is None:
            continue
        answered += 1
        missed += not found.low_s <= truth <= found.high_s
        errors.append(abs(found.value_s - truth))
    return {
        "trials": trials,
        "answered": answered,
        "missed": missed,
        "missed_share_of_trials": missed / trials,
        "median_error_s": float(np.median(errors)),
        "p95_error_s": float(np.percentile(errors, 95)),
    }


def shift_coverage(path: Path, trials: int, seed: int) -> dict[str, Any]:
    """The same on parts of a real field with a known shift; truth is the whole field's delay plus the shift."""
    rng = np.random.default_rng(seed)
    table = sources.read(path, ReadOptions())
    whole = flow_delay(table).value_s
    answered, missed = 0, 0
    for _ in range(trials):
        shift = int(rng.integers(-20, 26))
        start = int(rng.integers(0, int(0.6 * len(table))))
        part = shifted(table, shift).take(np.arange(start, start + int(0.4 * len(table))))
        found = flow_delay(part)
        if found.low_s is not None and found.high_s is not None:
            answered += 1
            missed += not found.low_s <= whole + shift <= found.high_s
    return {"trials": trials, "answered": answered, "missed": missed, "missed_share_of_trials": missed / trials}


def refusals(trials: int, seed: int) -> dict[str, Any]:
    """How often noise alone is given a delay."""
    rng = np.random.default_rng(seed)
    answered = sum(flow_delay(synthetic(rng, noise_only=True)[0]).decision == "estimated" for _ in range(trials))
    return {"trials": trials, "answered": answered}


def transport(path: Path) -> dict[str, Any]:
    """The inverse against its control on a real field."""
    table = sources.read(path, ReadOptions())
    steps = tracks(table)
    pairs = opposing_pairs(steps)
    found = flow_delay(table)
    value = found.value_s
    if found.decision != "estimated" and len(found.curve.shift_s):
        value = float(found.curve.shift_s[int(np.nanargmax(found.curve.correlation))])
    result = assess(steps, pairs, value, np.random.default_rng(1))
    return {
        "delay": found.decision,
        "better": result.better,
        "tau_s": result.chosen.tau_s,
        "plain": result.plain,
        "smoothed": result.smoothed,
        "inverted": result.inverted,
        "margin": result.margin,
        "margin_sd": result.margin_sd,
    }
