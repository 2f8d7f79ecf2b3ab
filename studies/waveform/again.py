"""Grain that strikes the plate again: what of it the samples of a fast cell could show, beside the mean force that it raises.

Half of the kernels strike once more with 0.3 of their push: 15 % more force, and a kernel's mean square impulse over its mean
9 % less. Two things could show it in what is left once the mean pulse is taken off: that noise's autocorrelation at the delay,
which is a ripple of its spectrum, and the noise over the force along the pulse, since late and weak strikes make less of it. Both
are looked at with the phase known exactly and over a whole minute, so better than a monitor could.

Trains: kernels by Poisson over a pulse of the study's own (`kernels_again`), and discrete-element heaps, whose kernels have
struck again by themselves as they do, alone and, at 0.5 kg, with a heap of 0.2 kg behind that pushes with 0.375, 15 % more
force too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from studies.waveform.kernels import FORCES, INTERVAL_S, MORE_FORCES, Heaps, heaps

Array = NDArray[np.float64]
PERIOD_S, CELL_S, SAMPLE_S = 0.082, 0.0002, 1e-3
PULSES = 730
"""A minute's."""
SHARE, PUSH, DELAY_S = 0.5, 0.3, 0.030
KERNEL_N_S, KERNELS, CONTACT_S = 3.6e-3, 620, 1e-3
LOW_HZ, HIGH_HZ = 200.0, 400.0
LAGS_S = (0.02, 0.07)
LEAST_HEAPS = 12
BODY, LATE = 0.5, 0.3
"""Of the largest force: from which on a phase is of the pulse's body, below which and behind it of its late part."""
SCATTERS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.3)
QUIET_N = 1.33


def sampled(force_n: Array, rng: np.random.Generator) -> Array:
    """A force at `INTERVAL_S` behind the cell, as means over `SAMPLE_S`, with 3 mV of noise."""
    keeps = np.exp(-INTERVAL_S / CELL_S)
    for _ in range(2):
        force_n = lfilter([1.0 - keeps], [1.0, -keeps], force_n)
    step = round(SAMPLE_S / INTERVAL_S)
    felt = force_n[: force_n.size // step * step].reshape(-1, step).mean(axis=1)
    return np.asarray(felt + QUIET_N * rng.standard_normal(felt.size))


def kernels_again(again: bool, delay_scatter: float, seed: int) -> Array:
    """A train of kernels one by one, N at `INTERVAL_S`; delay_scatter: relative, of each kernel's own delay."""
    rng = np.random.default_rng(seed)
    counts = rng.poisson(KERNELS, PULSES)
    start = np.repeat(np.arange(PULSES) * PERIOD_S, counts)
    first = start + 0.01 + rng.gamma(2.5, 4e-3, start.size)
    push = KERNEL_N_S * np.exp(0.25 * rng.standard_normal(start.size))
    when, strength = [first], [push]
    if again:
        those = rng.random(start.size) < SHARE
        delay = DELAY_S * (1.0 + delay_scatter * rng.standard_normal(int(those.sum())))
        when.append(first[those] + delay)
        strength.append(PUSH * push[those])
    force = np.zeros(round(PULSES * PERIOD_S / INTERVAL_S))
    width = round(CONTACT_S / INTERVAL_S)
    place = (np.concatenate(when) / INTERVAL_S).astype(int)
    amount = np.concatenate(strength) / CONTACT_S
    for step in range(width):
        inside = place + step < force.size
        np.add.at(force, place[inside] + step, amount[inside])
    return force


def of_heaps(pulses: Array, behind: Array | None, seed: int) -> Array:
    """A train of discrete-element pulses (n, bins), with others behind them by `DELAY_S`, N at `INTERVAL_S`."""
    rng = np.random.default_rng(seed)
    period = round(PERIOD_S / INTERVAL_S)
    force = np.zeros(PULSES * period + 3 * pulses.shape[1])
    for n, which in enumerate(rng.integers(len(pulses), size=PULSES)):
        force[n * period : n * period + pulses.shape[1]] += pulses[which]
        if behind is not None:
            start = n * period + round(DELAY_S * (1.0 + 0.1 * rng.standard_normal()) / INTERVAL_S)
            force[start : start + behind.shape[1]] += 0.375 * behind[rng.integers(len(behind))]
    return force[: PULSES * period]


def shown(force_n: Array, seed: int) -> dict[str, Any]:
    """What the noise of a train shows.

    Returns
    -------
    dict
        flow: square of the force over the noise in the band, in its own unit. autocorrelation: of the noise, its local power
        taken out, the largest over `LAGS_S`; lag_ms, where; at_the_delay: of `DELAY_S`. late_noise_over_force: behind the pulse,
        over that of its body.
    """
    samples = sampled(force_n, np.random.default_rng([seed, 3]))
    period = round(PERIOD_S / SAMPLE_S)
    folded = samples[: samples.size // period * period].reshape(-1, period)
    mean = folded.mean(axis=0)
    size = folded @ mean / (mean @ mean)
    left = (folded - size[:, None] * mean).ravel()
    frequency = np.fft.rfftfreq(left.size, SAMPLE_S)
    place = (frequency - LOW_HZ) / (HIGH_HZ - LOW_HZ)
    # A half sine over the band, whose own answer ends within the shortest lag.
    weights = np.where((place > 0.0) & (place < 1.0), np.sin(np.pi * place), 0.0)
    noise = np.fft.irfft(weights * np.fft.rfft(left), left.size)
    quiet = QUIET_N**2 * SAMPLE_S * (HIGH_HZ - LOW_HZ)
    power = _smooth((noise.reshape(-1, period) ** 2).mean(axis=0)) - quiet
    level = _smooth(mean)
    strikes = level > 0.02 * level.max()
    white = (np.where(strikes, 1.0 / np.sqrt(np.maximum(power, 0.0) + quiet), 0.0) * noise.reshape(-1, period)).ravel()
    together = np.fft.irfft(np.abs(np.fft.rfft(white, 2 * white.size)) ** 2) / float(white @ white)
    lags = np.arange(round(LAGS_S[0] / SAMPLE_S), round(LAGS_S[1] / SAMPLE_S))
    at = int(lags[np.abs(together[lags]).argmax()])
    body = level > BODY * level.max()
    behind = np.roll(np.arange(period), int(level.argmax())) < 0.6 * period
    late = strikes & behind & (level < LATE * level.max())
    of_body = float(power[body].sum() / level[body].sum())
    return {
        "flow": float(mean.sum() ** 2 / power.sum()),
        "autocorrelation": round(float(together[at]), 3), "lag_ms": at,
        "at_the_delay": round(float(together[round(DELAY_S / SAMPLE_S)]), 3),
        "late_noise_over_force": round(float(power[late].sum() / level[late].sum()) / of_body, 2),
    }  # fmt: skip


def _smooth(values: Array) -> Array:
    """Mean of five phases around each."""
    return np.convolve(np.concatenate((values[-2:], values, values[:2])), np.full(5, 0.2), "valid")


def report(seed: int) -> dict[str, Any]:
    """Kernels one by one, and heaps of each group; flow_error_pct over the same train without what is added."""
    alone = shown(kernels_again(False, 0.0, seed), seed)
    kernels = [{"train": "alone", **alone}]
    kernels += [
        {"train": f"again, delays scatter by {100.0 * scatter:g} %", **shown(kernels_again(True, scatter, seed), seed)}
        for scatter in SCATTERS
    ]
    for row in kernels:
        row["flow_error_pct"] = round(100.0 * (row.pop("flow") / alone["flow"] - 1.0), 1)
    return {"seed": seed, "kernels": kernels, "heaps": list(_of_groups(heaps(FORCES, MORE_FORCES), seed))}


def _of_groups(pulses: Heaps, seed: int) -> Iterator[dict[str, Any]]:
    for key in np.unique(pulses.keys, axis=0):
        kernel_g, load_kg, restitution, angle_deg = (float(k) for k in key)
        chosen = pulses.force_n[np.all(pulses.keys == key, axis=1)]
        if len(chosen) < LEAST_HEAPS:
            continue
        light = np.all(pulses.keys == [kernel_g, 0.2, restitution, angle_deg], axis=1)
        row: dict[str, Any] = {"kernel_g": kernel_g, "load_kg": load_kg, "restitution": restitution, "angle_deg": angle_deg}
        alone = shown(of_heaps(chosen, None, seed), seed)
        row["alone"] = {name: value for name, value in alone.items() if name != "flow"}
        if load_kg == 0.5:
            again = shown(of_heaps(chosen, pulses.force_n[light], seed), seed)
            error = round(100.0 * (again.pop("flow") / alone["flow"] - 1.0), 1)
            row["again"] = {**again, "flow_error_pct": error}
        yield row
