"""Kernel noise in discrete-element forces: impulse of a kernel by crop, load and restitution, and through cells."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.waveform.kernel_noise import KernelImpulse, KernelNoiseSettings, kernel_impulse
from yieldmon.estimation.waveform.kernel_reach import expected_impulse
from yieldmon.estimation.waveform.spectral_density import Density

Array = NDArray[np.float64]
FOLDER = Path(__file__).resolve().parent
FORCES = FOLDER / "kernel_forces.npz"
MORE_FORCES = FOLDER / "more_kernel_forces.npz"
"""Heaps of the campaigns thin-c, thin-d and dense-d."""
THIN_FORCES = FOLDER / "thin_kernel_forces.npz"
"""Heaps of the campaigns thin-e and thin-f."""
INTERVAL_S = 1e-4
QUANTUM_N_S = 2e-4
"""`pack` rounds what has arrived until each time to it: 1e-4 of the kernels' density at 800 Hz, less below; half the bytes."""
QUIET_N2_HZ = 1.33**2 * 1e-3
"""3 mV of white noise in samples of 1 kHz."""
_BINS = 700
_PADDED = 2200
_FULL_RATE_HZ = 5000.0
CELLS_S = (0.0, 0.0002, 0.001, 0.003, 0.008)


def pack(ledgers: list[Path], out: Path, *, rows_a_seed: int = 1) -> int:
    """Force on the plate at 10 kHz of each row of the campaigns' ledgers, behind those of the file; returns how many it has.

    rows_a_seed: seeds with fewer rows in a ledger are left out, such as the last of a campaign that was ended.
    """
    rows: list[dict[str, float]] = []
    forces = []
    for ledger in ledgers:
        done = [json.loads(file.read_text()) for file in sorted((ledger / "rows").glob("*.json"))]
        of_seed = Counter(row["trial"] for row in done)
        for row in done:
            if of_seed[row["trial"]] < rows_a_seed:
                continue
            plate = np.load(ledger / "throws" / row["throw_key"] / f"plate-{row['plate_angle_deg']:07.3f}.npz")
            step = float(plate["time_step_s"])
            force = plate["total_force_n"][:, 0]
            arrived = np.concatenate(([0.0], np.cumsum(force) * step))
            time = np.arange(arrived.size) * step + float(plate["start_s"])
            begin = (np.floor((float(plate["start_s"]) + np.argmax(force != 0.0) * step) / INTERVAL_S) - 1.0) * INTERVAL_S
            edges = begin + np.arange(_BINS + 1) * INTERVAL_S
            quanta = np.round(np.interp(edges, time, arrived) / QUANTUM_N_S)
            forces.append(np.diff(quanta) * (QUANTUM_N_S / INTERVAL_S))
            mean_g = 1e3 * float(plate["mass_kg"].mean())
            push = plate["grain_impulse_n_s"][:, 1]
            alone = 1e-3 * mean_g * push.sum() / plate["mass_kg"].sum()
            rows.append(
                {
                    "kernel_g": 0.4048 if mean_g < 0.6 else 0.8096, "load_kg": row["paddle_mass_kg"],
                    "restitution": row["restitution"], "angle_deg": row["plate_angle_deg"], "seed": row["trial"],
                    "impulse_n_s": float(arrived[-1]), "begin_s": begin,
                    "touching": float(np.mean(push != 0.0)), "push_ratio": float((push**2).sum() / push.sum() / alone),
                }
            )  # fmt: skip
    columns = {name: np.array([row[name] for row in rows], dtype=np.float32) for name in rows[0]}
    columns["force_n"] = np.array(forces, dtype=np.float16)
    if out.exists():
        with np.load(out) as held:
            columns = {name: np.concatenate((held[name], column)) for name, column in columns.items()}
    np.savez_compressed(out, interval_s=INTERVAL_S, **columns)  # type: ignore[arg-type]  # the stub takes a column for `allow_pickle`
    return len(columns["force_n"])


@dataclass(frozen=True)
class Heaps:
    """Pulses of all files.

    Attributes
    ----------
    keys : ndarray (n, 4)
        Kernel's mass, g; load, kg; restitution; plate angle, deg.
    seed : ndarray (n,)
        Of the heap, the same at each plate angle.
    force_n : ndarray (n, bins)
        Of `INTERVAL_S` each, time counted from one place of the paddle, the same for all.
    """

    keys: Array
    seed: NDArray[np.int64]
    force_n: Array

    def take(self, chosen: NDArray[Any]) -> Heaps:
        """Some of them."""
        return Heaps(self.keys[chosen], self.seed[chosen], self.force_n[chosen])


def heaps(*files: Path) -> Heaps:
    """Pulses of files by `pack`, which keeps each from its first strike on, moved to the paddle's own time."""
    parts = [dict(np.load(file)) for file in files]
    data = {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if name != "interval_s"}
    keys = np.stack([data[name] for name in ("kernel_g", "load_kg", "restitution", "angle_deg")], axis=1).astype(float).round(4)
    late = np.round((data["begin_s"] - data["begin_s"].min()) / INTERVAL_S).astype(int)
    force = np.zeros((len(late), _BINS + int(late.max())))
    force[np.arange(len(late))[:, None], late[:, None] + np.arange(_BINS)] = data["force_n"]
    return Heaps(keys, data["seed"].astype(np.int64), force)


def shown_through(force_n: Array, cell_s: float, every: int) -> Array:
    """Forces (n, bins) behind a cell, as means over so many bins."""
    padded = np.concatenate((force_n, np.zeros((len(force_n), _PADDED - force_n.shape[1]))), axis=1)
    if cell_s > 0.0:
        frequency = np.fft.rfftfreq(padded.shape[1], INTERVAL_S)
        wave = np.fft.rfft(padded, axis=1) / (1.0 + 2j * np.pi * frequency * cell_s) ** 2
        padded = np.fft.irfft(wave, padded.shape[1], axis=1)
    count = padded.shape[1] // every * every
    return np.asarray(padded[:, :count].reshape(len(padded), -1, every).mean(axis=2))


def measured(
    force_n: Array,
    cell_s: float,
    rate_hz: float,
    settings: KernelNoiseSettings,
    noise: np.random.Generator | None,
    *,
    fitted: bool = False,
) -> KernelImpulse:
    """Impulse of a kernel from repeated pulses (n, bins): their mean is taken off, as the daemon takes off the mean pulse.

    fitted: with each pulse's own size and time, as the daemon has to, which knows the paddle's time less well.
    """
    every = round(1.0 / rate_hz / INTERVAL_S)
    interval = every * INTERVAL_S
    shown = shown_through(force_n, cell_s, every)
    count = len(shown)
    left = (shown - shown.mean(axis=0)) * np.sqrt(count / (count - 1.0))
    if fitted:
        own = np.linalg.qr(np.stack([shown.mean(axis=0), np.gradient(shown.mean(axis=0))], axis=1))[0]
        left = left - left @ own @ own.T
    quiet = 1e-9
    if noise is not None:
        quiet = QUIET_N2_HZ
        left = left + np.sqrt(QUIET_N2_HZ / interval) * noise.standard_normal(left.shape)
    duration = shown.shape[1] * interval
    frequency = np.fft.rfftfreq(shown.shape[1], interval)[1:-1].astype(float)
    power = (np.abs(np.fft.rfft(left, axis=1)) ** 2).mean(axis=0)[1:-1].astype(float) * interval**2 / duration
    mean_force = float(force_n.sum(axis=1).mean() * INTERVAL_S / duration)
    # As in `in_pulses`: a pulse fills part of the padded stretch, and so many fewer frequencies are independent.
    mean = shown.mean(axis=0)
    crest = float((mean**2).mean() / mean.mean() ** 2)
    return kernel_impulse(
        Density(frequency, power, (count - 1.0) / crest),
        Density(frequency, np.full(frequency.size, quiet), 1e6),
        mean_force,
        cell_response_s=cell_s,
        sample_interval_s=interval,
        settings=settings,
    )


def ratios(
    pulses: Heaps, cell_s: float, rate_hz: float, settings: KernelNoiseSettings, seed: int | None, *, fitted: bool = False
) -> dict[tuple[float, ...], tuple[float, KernelImpulse]]:
    """J over (kernel mass times impulse per kilogram) for each (kernel_g, load_kg, restitution, angle_deg)."""
    out = {}
    for key in np.unique(pulses.keys, axis=0):
        force = pulses.force_n[np.all(pulses.keys == key, axis=1)]
        if len(force) < 3:
            continue
        noise = None if seed is None else np.random.default_rng([seed, *(np.asarray(key) * 1e4).astype(int)])
        found = measured(force, cell_s, rate_hz, settings, noise, fitted=fitted)
        per_kg = float(force.sum(axis=1).mean() * INTERVAL_S / key[1])
        out[tuple(float(k) for k in key)] = (found.impulse_n_s / (1e-3 * key[0] * per_kg), found)
    return out


def pooled(
    found: dict[tuple[float, ...], tuple[float, KernelImpulse]], places: tuple[int, ...]
) -> dict[tuple[float, ...], tuple[float, float]]:
    """Mean and standard deviation of the mean over cells that share the keys at `places`.

    Weighted by their relative random error, which does not know the ratio: else cells that came out low would count more.
    """
    groups: dict[tuple[float, ...], list[tuple[float, float]]] = defaultdict(list)
    for key, (ratio, impulse) in found.items():
        if np.isfinite(ratio):
            groups[tuple(key[p] for p in places)].append((ratio, impulse.random_sd))
    out = {}
    for key, values in sorted(groups.items()):
        ratio, sd = np.array(values).T
        mean = float((sd**-2.0 * ratio).sum() / (sd**-2.0).sum())
        out[key] = mean, mean * float((sd**-2.0).sum() ** -0.5)
    return out


def balanced(found: dict[tuple[float, ...], tuple[float, KernelImpulse]], place: int) -> dict[float, tuple[float, float]]:
    """Mean ratio for each value of the key at `place`, and its deviation, over the others that all those values have.

    Each cell counts the same, however many heaps it has, so that more heaps of one load do not move what a restitution does.
    """
    values = sorted({key[place] for key in found})
    others = {key[:place] + key[place + 1 :] for key in found}
    whole = [o for o in others if all((*o[:place], value, *o[place:]) in found for value in values)]
    out = {}
    for value in values:
        cells = [found[(*o[:place], value, *o[place:])] for o in whole]
        sd = np.array([ratio * impulse.random_sd for ratio, impulse in cells])
        out[value] = float(np.mean([ratio for ratio, _ in cells])), float(np.sqrt((sd**2).sum()) / len(cells))
    return out


def by_seeds_left_out(pulses: Heaps, settings: KernelNoiseSettings) -> dict[tuple[float, ...], float]:
    """Standard deviation of each crop's and load's `pooled` ratio by leaving out one seed after another (jackknife).

    A seed's pulses share their heap over plate angles, and its packing over restitutions, which no count of pulses knows.
    """
    out: dict[tuple[float, ...], float] = {}
    for group in np.unique(pulses.keys[:, :2], axis=0):
        held = pulses.take(np.all(pulses.keys[:, :2] == group, axis=1))
        values: list[float] = []
        for seed in np.unique(held.seed):
            found = ratios(held.take(held.seed != seed), 0.0, _FULL_RATE_HZ, settings, None)
            values.extend(ratio for ratio, _ in pooled(found, (0, 1)).values())
        out[tuple(float(k) for k in group)] = float(np.sqrt((len(values) - 1.0) * np.var(values)))
    return out


def log_load(key: tuple[float, ...]) -> float:
    """What the shipped bias would be a line in."""
    return float(np.log(key[1]))


def log_layers(key: tuple[float, ...]) -> float:
    """Load over the kernels' diameter: thickness in kernels."""
    return float(np.log(key[1]) - np.log(key[0]) / 3.0)


def log_kernels(key: tuple[float, ...]) -> float:
    """Number of kernels."""
    return float(np.log(key[1]) - np.log(key[0]))


def crossed(
    by_load: dict[tuple[float, ...], tuple[float, float]],
    seeds_sd: dict[tuple[float, ...], float],
    variable: Callable[[tuple[float, ...]], float] = log_load,
) -> list[dict[str, float]]:
    """Flow of each crop and load by a bias that is a line in `variable` through the other crop's loads.

    The deviation holds that of the judged ratio and those of the ratios that the line goes through, by seeds.
    """
    rows = []
    for crop in sorted({key[0] for key in by_load}):
        other = [key for key in by_load if key[0] != crop]
        design = np.stack([np.ones(len(other)), [variable(key) for key in other]], axis=1)
        ratio, sd = np.array([by_load[key][0] for key in other]), np.array([seeds_sd[key] for key in other])
        for key in by_load:
            if key[0] == crop:
                share = np.array([1.0, variable(key)]) @ np.linalg.pinv(design)
                line, own = float(share @ ratio), by_load[key][0]
                whole = np.hypot(seeds_sd[key] / own, np.sqrt((share**2 * sd**2).sum()) / line)
                rows.append(
                    {
                        "kernel_g": crop,
                        "load_kg": key[1],
                        "flow_error_pct": round(100.0 * (line / own - 1.0), 1),
                        "sd_pct": round(100.0 * float(whole) * line / own, 1),
                    }
                )
    return rows


def pushes(file: Path) -> list[dict[str, float]]:
    """By crop and load: share of the grains that touch the plate, and their mean square impulse over that of kernels alone.

    The second is what J would be over (kernel mass times impulse per kilogram) if they pushed independently of one another.
    scatter_pct: of the whole pulse within a group; independent_pct: what it would then be.
    """
    data = np.load(file)
    keys = np.stack([data[name] for name in ("kernel_g", "load_kg")], axis=1).astype(float).round(4)
    places = np.stack([data["restitution"], data["angle_deg"]], axis=1)
    rows = []
    for group in np.unique(keys, axis=0):
        chosen = np.all(keys == group, axis=1)
        ratio, impulse = float(data["push_ratio"][chosen].mean()), data["impulse_n_s"][chosen]
        cells = [impulse[np.all(places[chosen] == place, axis=1)] for place in np.unique(places[chosen], axis=0)]
        rows.append(
            {
                "kernel_g": float(group[0]), "load_kg": float(group[1]), "push_ratio": round(ratio, 2),
                "touching_pct": round(100.0 * float(data["touching"][chosen].mean()), 1),
                "scatter_pct": round(100.0 * float(np.mean([c.std(ddof=1) / c.mean() for c in cells])), 2),
                "independent_pct": round(100.0 * float(np.sqrt(ratio * 1e-3 * group[0] / group[1])), 1),
            }
        )  # fmt: skip
    return rows


def other_ways(pulses: Heaps, seeds_sd: dict[tuple[float, ...], float]) -> list[dict[str, Any]]:
    """Errors by the other crop, as `crossed`: other variables, other bands, each pulse's own size and time taken off."""
    full = KernelNoiseSettings(low_hz=200.0, high_hz=800.0, response_error=0.0)
    ways: list[tuple[str, KernelNoiseSettings, bool, Callable[[tuple[float, ...]], float]]] = [
        ("thickness in kernels", full, False, log_layers),
        ("number of kernels", full, False, log_kernels),
        ("each pulse's size and time", full, True, log_load),
        ("200 to 400 Hz", replace(full, high_hz=400.0), False, log_load),
        ("400 to 1200 Hz", replace(full, low_hz=400.0, high_hz=1200.0), False, log_load),
    ]
    rows = []
    for name, settings, fitted, variable in ways:
        by_load = pooled(ratios(pulses, 0.0, _FULL_RATE_HZ, settings, None, fitted=fitted), (0, 1))
        errors = [row["flow_error_pct"] for row in crossed(by_load, seeds_sd, variable)]
        rows.append({"way": name, "flow_error_pct": errors, "ratio": [round(ratio, 3) for ratio, _ in by_load.values()]})
    return rows


def by_force(pulses: Heaps) -> list[dict[str, Any]]:
    """Noise at 200 to 400 Hz along the pulse (1 kHz behind 0.2 ms) over that of kernels in proportion to the force, by its level.

    1 throughout: `noise_by_phase` rests on it. Levels: force as the band follows it, over its largest.
    """
    interval = 1e-3
    shown = shown_through(pulses.force_n, 0.0002, round(interval / INTERVAL_S))
    frequency = np.fft.rfftfreq(shown.shape[1], interval)
    weights = np.where((frequency > 200.0) & (frequency < 400.0), np.sin(np.pi * (frequency - 200.0) / 200.0), 0.0)
    answer = np.fft.irfft(weights, shown.shape[1]) ** 2
    rows = []
    for group in np.unique(pulses.keys[:, :2], axis=0):
        power, force = np.zeros(shown.shape[1]), np.zeros(shown.shape[1])
        for key in np.unique(pulses.keys[np.all(pulses.keys[:, :2] == group, axis=1)], axis=0):
            those = shown[np.all(pulses.keys == key, axis=1)]
            if len(those) < 3:
                continue
            left = (those - those.mean(axis=0)) * np.sqrt(len(those) / (len(those) - 1.0))
            in_band = np.fft.irfft(np.fft.rfft(left, axis=1) * weights, shown.shape[1], axis=1)
            power += (in_band**2).sum(axis=0)
            force += those.sum(axis=0)
        followed = np.fft.irfft(np.fft.rfft(force) * np.fft.rfft(answer), shown.shape[1])
        followed *= power.sum() / followed.sum()
        level = followed / followed.max()
        row: dict[str, Any] = {"kernel_g": float(group[0]), "load_kg": float(group[1])}
        for low, high in ((0.0, 0.05), (0.05, 0.15), (0.15, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 1.0)):
            at = (level > low) & (level <= high)
            row[f"{low:g}_to_{high:g}"] = round(float(power[at].sum() / followed[at].sum()), 2)
        rows.append(row)
    return rows


def coverage(pulses: Heaps, seed: int) -> list[dict[str, Any]]:
    """Flow by the shipped bias and band in each group of pulses, through cells: error over the deviation stated with it."""
    rows = []
    for rate, bias, bias_sd in ((1000.0, 1.2, 0.15), (5000.0, 0.95, 0.12)):
        settings = KernelNoiseSettings(bias=bias, bias_sd=bias_sd)
        for cell in CELLS_S:
            found = ratios(pulses, cell, rate, settings, seed)
            said = [(ratio, impulse) for ratio, impulse in found.values() if impulse.usable]
            error = np.log([bias / ratio for ratio, _ in said])
            stated = np.array([np.hypot(impulse.relative_sd, bias_sd / bias) for _, impulse in said])
            row: dict[str, Any] = {"rate_hz": rate, "cell_ms": 1e3 * cell, "groups": len(found), "with_a_flow": len(said)}
            if said:
                row |= {
                    "mean_error_pct": round(100.0 * float(error.mean()), 1),
                    "mean_abs_error_pct": round(100.0 * float(np.abs(error).mean()), 1),
                    "largest_error_pct": round(100.0 * float(np.abs(error).max()), 1),
                    "mean_stated_pct": round(100.0 * float(stated.mean()), 1),
                    "within_one_deviation": int((np.abs(error) <= stated).sum()),
                    "within_two_deviations": int((np.abs(error) <= 2.0 * stated).sum()),
                    "rms_error_over_deviation": round(float(np.sqrt(np.mean((error / stated) ** 2))), 2),
                }
            row["verdicts"] = dict(Counter(impulse.verdict.name.lower() for _, impulse in found.values()))
            rows.append(row)
    return rows


def report(seed: int) -> dict[str, Any]:
    """Tables: bias by crop and load, by restitution and angle; calibrated on the other crop; through cells."""
    pulses = heaps(FORCES, MORE_FORCES, THIN_FORCES)
    full = KernelNoiseSettings(low_hz=200.0, high_hz=800.0, response_error=0.0)
    found = ratios(pulses, 0.0, _FULL_RATE_HZ, full, None)
    by_load, seeds_sd = pooled(found, (0, 1)), by_seeds_left_out(pulses, full)
    # The season's sensor: 1 kHz behind 0.2 ms.
    slow = ratios(pulses, 0.0002, 1000.0, KernelNoiseSettings(low_hz=200.0, high_hz=800.0), None)
    cells = []
    for rate in (1000.0, 5000.0):
        band = KernelNoiseSettings(low_hz=200.0, high_hz=800.0)
        for cell in CELLS_S:
            # 60 s of harvest at 8 kg/s: mean force 73 N, a kernel's impulse 3.6 mN s.
            reach = expected_impulse(
                mean_force_n=73.0,
                impulse_n_s=3.6e-3,
                quiet_n2_hz=QUIET_N2_HZ,
                cell_response_s=cell,
                sample_interval_s=1.0 / rate,
                duration_s=60.0,
                settings=band,
            )
            values = [r for r, i in ratios(pulses, cell, rate, band, seed).values() if np.isfinite(r)]
            cells.append(
                {
                    "rate_hz": rate, "cell_ms": 1e3 * cell, "ratio": round(float(np.median(values)), 3) if values else None,
                    "expected_random_pct": round(100.0 * reach.random_sd, 1),
                    "expected_lasting_pct": round(100.0 * reach.lasting_sd, 1),
                    "usable": reach.usable, "reason": reach.reason,
                }
            )  # fmt: skip
    return {
        "rows": len(pulses.seed),
        "by_crop_and_load": [
            {
                "kernel_g": k[0], "load_kg": k[1], "heaps": int(np.all(pulses.keys[:, :2] == k, axis=1).sum()),
                "ratio": round(r, 3), "sd": round(s, 3), "sd_by_seeds": round(seeds_sd[k], 3),
            }
            for k, (r, s) in by_load.items()
        ],
        "by_restitution": [
            {"restitution": k, "ratio": round(r, 3), "sd": round(s, 3)} for k, (r, s) in balanced(found, 2).items()
        ],
        "by_restitution_at_1_khz": [
            {"restitution": k, "ratio": round(r, 3), "sd": round(s, 3)} for k, (r, s) in balanced(slow, 2).items()
        ],
        "by_angle": [{"angle_deg": k, "ratio": round(r, 3), "sd": round(s, 3)} for k, (r, s) in balanced(found, 3).items()],
        "calibrated_on_the_other_crop": crossed(by_load, seeds_sd),
        "other_ways": other_ways(pulses, seeds_sd),
        "pushes": pushes(MORE_FORCES),
        "through_cells": cells,
        "coverage": coverage(pulses, seed),
    }  # fmt: skip
