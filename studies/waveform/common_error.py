"""What mean force and kernel noise are off by alike where grain changes after a calibration: the evidence for `waveform.hit_sd`.

In discrete elements grain rebounds, strikes again, is pushed and misses the plate by itself. A machine is calibrated on the heaps
of one group, mean force and bias of kernels; then grain of another restitution, or the other crop, comes at the same load and
plate angle. Chance of a group's noise is independent of its impulse, so that the mean product of the two errors over pairs of
groups is the variance of what both share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.waveform.kernels import FORCES, INTERVAL_S, MORE_FORCES, Heaps, heaps, shown_through
from yieldmon.estimation.waveform.noise_gain import power_gain

Array = NDArray[np.float64]
CELL_S, SAMPLE_S = 0.0002, 1e-3
LOW_HZ, HIGH_HZ = 200.0, 400.0
LOCAL_EXPONENT = 0.75
"""d ln(force) / d ln(flow), by which a change of force is one of flow."""
LEAST_HEAPS, BLOCKS = 4, 20
Key = tuple[float, ...]
CHANGES: dict[str, Callable[[Key, Key], bool]] = {
    "restitution": lambda a, b: (a[0], a[1], a[3]) == (b[0], b[1], b[3]),
    "crop": lambda a, b: a[1:] == b[1:],
}


def logarithms(pulses: Heaps) -> dict[Key, tuple[float, float, int]]:
    """Logarithms of impulse per kilogram and of b by group, and how many heaps; size, time and width of each heap taken off."""
    samples = shown_through(pulses.force_n, CELL_S, round(SAMPLE_S / INTERVAL_S))
    frequency = np.asarray(np.fft.rfftfreq(samples.shape[1], SAMPLE_S), dtype=np.float64)
    band = (frequency >= LOW_HZ) & (frequency <= HIGH_HZ)
    gain, duration = power_gain(frequency[band], CELL_S, SAMPLE_S), samples.shape[1] * SAMPLE_S
    out = {}
    for key in np.unique(pulses.keys, axis=0):
        chosen = np.flatnonzero(np.all(pulses.keys == key, axis=1))
        if chosen.size < LEAST_HEAPS:
            continue
        own = samples[chosen]
        mean = own.mean(axis=0)
        slope, place = np.gradient(mean), np.arange(mean.size)
        changes = np.linalg.qr(np.stack([mean, slope, (place - (place * mean).sum() / mean.sum()) * slope], axis=1))[0]
        left = own - mean
        left = left - left @ changes @ changes.T
        power = (np.abs(np.fft.rfft(left, axis=1)) ** 2)[:, band].sum(axis=0) / (chosen.size - 1.0) * SAMPLE_S**2 / duration
        impulse = float(pulses.force_n[chosen].sum(axis=1).mean() * INTERVAL_S)
        of_a_kernel = float((power * gain).sum() / (gain * gain).sum()) / (impulse / duration)
        per_kg = impulse / float(key[1])
        out[tuple(float(k) for k in key)] = (
            float(np.log(per_kg)),
            float(np.log(of_a_kernel / (1e-3 * key[0] * per_kg))),
            chosen.size,
        )
    return out


def shared(found: dict[Key, tuple[float, float, int]], alike: Callable[[Key, Key], bool]) -> tuple[float, float, float, int]:
    """Mean product of the errors of ln(flow), and rms error of mean force and of kernels; and how many ordered pairs."""
    rows = [
        ((found[now][0] - found[then][0]) / LOCAL_EXPONENT, found[then][1] - found[now][1], 1.0 / (1.0 / n + 1.0 / m))
        for now, (_, _, n) in found.items()
        for then, (_, _, m) in found.items()
        if now != then and alike(now, then)
    ]
    force, kernels, weight = np.array(rows).T
    weight = weight / weight.sum()
    means = (float(weight @ column) for column in (force * kernels, force**2, kernels**2))
    product, of_force, of_kernels = means
    return product, of_force**0.5, of_kernels**0.5, len(rows)


def _rows(pulses: Heaps) -> Iterator[dict[str, Any]]:
    parts = np.array_split(np.unique(pulses.seed), BLOCKS)
    whole, without = logarithms(pulses), [logarithms(pulses.take(~np.isin(pulses.seed, part))) for part in parts]
    for name, alike in CHANGES.items():
        product, force, kernels, pairs = shared(whole, alike)
        sd = float(np.sqrt((BLOCKS - 1.0) * np.var([shared(found, alike)[0] for found in without])))
        yield {
            "changes": name, "pairs": pairs, "mean_force_rms_pct": round(100.0 * force, 1),
            "kernels_rms_pct": round(100.0 * kernels, 1), "shared_variance": round(product, 5), "sd": round(sd, 5),
            "shared_sd_pct": round(100.0 * max(product, 0.0) ** 0.5, 1),
            "shared_sd_at_most_pct": round(100.0 * max(product + 2.0 * sd, 0.0) ** 0.5, 1),
        }  # fmt: skip


def report() -> list[dict[str, Any]]:
    """A row for each change; sd of the variance by leaving out a twentieth of the heaps' seeds after another."""
    return list(_rows(heaps(FORCES, MORE_FORCES)))
