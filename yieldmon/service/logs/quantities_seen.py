"""The quantities of a mapping as a recording has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.documents.check_config import SeenDocument
from yieldmon.engine.duplicate_senders import DuplicateSenderWatch, SignalLimits, angle_limits, speed_limits
from yieldmon.engine.sources import QUANTITIES, SampleSource
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.numerics import Array
from yieldmon.service.config.configuration import Configuration
from yieldmon.units import S_PER_DAY

if TYPE_CHECKING:
    from yieldmon.engine.runs import FrameRun
    from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch

_FIRST = 5
_LEAST_STEPS = 200
"""Samples, or counts, whose steps say something."""
_EVEN = 0.1
"""Of a step, what the middle half of all differs by at most: a clock's are not all the same."""
_FLOOR_SHARE, _FLOOR_TIMES, _FLOOR_STEPS = 0.02, 6, 8
"""Of samples that are cut off: their least share, how often they are met for each of the next value, and steps of the range."""
_TURNS = 4
"""So often a counter turns before its ends are known."""


@dataclass(frozen=True)
class QuantitySeen:
    """A quantity in a recording, in its own unit: samples or values and how many were usable, values per second, range, the
    longest time without one, s, the first values, the range of all that was decoded, and how far one value is from the next.
    None where there is nothing to say."""

    unit: str
    values: int
    usable: int
    rate_hz: float | None
    low: float | None
    high: float | None
    largest_gap_s: float | None
    first: tuple[float, ...]
    decoded: tuple[float, float] | None
    step_share: float | None = None
    """Median difference between one value and the next over the range of most of them."""
    floor_share: float = 0.0
    """Share of the lowest value, where values below it seem to be cut off."""
    leaping_share: float = 0.0
    """Of the seconds, those whose values leap up and down as no one sender's do."""
    silences: int = 0
    """Times without a value that are longer than one holds."""
    counter_flaw: str = ""
    """Why the counter of an impact sensor counts no frames, and what to do; empty where it does."""


def seen_in(
    configuration: Configuration, log: Path | str, progress: Callable[[Stretch | EndOfLog], None] | None = None
) -> tuple[dict[str, QuantitySeen], int]:
    """Each quantity in a recording, and how many messages of several frames lack one; progress: called with each stretch that is
    read. Raises InputError for a log that cannot be read."""
    incomplete = 0
    parts: dict[str, list[tuple[Array, Array, Array]]] = {}
    counters: dict[str, list[Array]] = {}
    sources = configuration.signals.sources
    from yieldmon.bus.codec import Codec
    from yieldmon.service.logs import bulk_processing

    taking = bulk_processing.Taking(Codec(), configuration.signals, configuration.log_channels)
    for stretch in bulk_processing.stretches_of([str(log)], taking):
        if progress is not None:
            progress(stretch)
        if not isinstance(stretch, bulk_processing.EndOfLog):
            incomplete += stretch.incomplete
            for run in stretch.runs:
                _take(run, configuration, parts, counters)
    expected = [*(impact_name(k) for k in range(len(sources.impact))), *(source.quantity for source in sources.inputs)]
    inputs = configuration.engine.inputs
    holds_s = {name: float(getattr(inputs, quantity.timeout)) for name, quantity in QUANTITIES.items()}
    found = {name: _summary(name, parts.get(name, []), holds_s.get(name, np.inf)) for name in dict.fromkeys(expected)}
    for number, source in enumerate(sources.impact):
        if source.counter is not None and (name := impact_name(number)) in counters:
            found[name] = replace(found[name], counter_flaw=_counter_flaw(np.concatenate(counters[name]), source))
    for name, limits in _rival_limits(configuration.machine).items():
        if name in found and parts.get(name):
            found[name] = replace(found[name], leaping_share=_leaping_share(parts[name], *limits))
    return found, incomplete


def _rival_limits(machine: Machine) -> dict[str, tuple[SignalLimits, float]]:
    """By quantity, what one sender's values do, and the unit of these in that of the mapping."""
    return {"elevator_speed": (speed_limits(machine, np.nan), RPM), "plate_angle": (angle_limits(np.nan), radians(1.0))}


def _leaping_share(parts: list[tuple[Array, Array, Array]], limits: SignalLimits, unit: float) -> float:
    times, values, _ = (np.concatenate(column) for column in zip(*parts, strict=True))
    known = np.isfinite(values)
    times, values = times[known], values[known] * unit
    if times.size < 2 or not 1.0 < times[-1] - times[0] < S_PER_DAY:
        return 0.0
    edges = np.arange(times[0], times[-1] + 1.0)
    bounds = np.searchsorted(np.maximum.accumulate(times), edges)
    return float(np.mean(DuplicateSenderWatch(limits).take(times, values, bounds, edges) > 0))


def impact_name(number: int) -> str:
    """Of an impact sensor, from 0."""
    return "impact" if number == 0 else f"impact {number + 1}"


def _take(
    run: FrameRun,
    configuration: Configuration,
    parts: dict[str, list[tuple[Array, Array, Array]]],
    counters: dict[str, list[Array]],
) -> None:
    sources = configuration.signals.sources
    for number, (source, samples) in enumerate(zip(sources.impact, run.samples, strict=True)):
        if samples.places.size:
            lags = np.arange(len(source.signals) - 1, -1, -1) * source.interval_s
            times = run.times_s[samples.places][:, None] - lags
            values = samples.rows[:, 2:].ravel()
            counters.setdefault(impact_name(number), []).append(samples.rows[:, 0])
            parts.setdefault(impact_name(number), []).append((times.ravel(), values, values))
    by_message = {part.message: part for part in run.others}
    for entry in sources.inputs:
        part = by_message.get(entry.message)
        if part is not None and entry.signal in part.signals:
            values = part.signals[entry.signal] * entry.scale + entry.offset
            usable = QUANTITIES[entry.quantity].usable(values)
            parts.setdefault(entry.quantity, []).append((part.times_s, np.where(usable, values, np.nan), values))


def _summary(name: str, parts: list[tuple[Array, Array, Array]], holds_s: float) -> QuantitySeen:
    unit = "mV" if name.startswith("impact") else QUANTITIES[name].unit
    if not parts:
        return QuantitySeen(
            unit=unit, values=0, usable=0, rate_hz=None, low=None, high=None, largest_gap_s=None, first=(), decoded=None
        )
    times, values, decoded = (np.concatenate(column) for column in zip(*parts, strict=True))
    known = np.isfinite(values)
    good, at, finite = values[known], times[known], decoded[np.isfinite(decoded)]
    span_s = float(times[-1] - times[0])
    return QuantitySeen(
        unit=unit,
        values=int(values.size),
        usable=int(good.size),
        rate_hz=(values.size - 1) / span_s if values.size > 1 and span_s > 0.0 else None,
        low=float(good.min()) if good.size else None,
        high=float(good.max()) if good.size else None,
        largest_gap_s=float(np.diff(at).max()) if good.size > 1 else None,
        first=tuple(good[:_FIRST].tolist()),
        decoded=(float(finite.min()), float(finite.max())) if finite.size else None,
        step_share=_step_share(good),
        floor_share=_floor_share(good),
        silences=int(np.count_nonzero(np.diff(at) > holds_s)),
    )


def _counter_flaw(counts: Array, source: SampleSource) -> str:
    counts = counts[np.isfinite(counts)].astype(np.int64)
    if counts.size < _LEAST_STEPS:
        return ""
    low, high = int(counts.min()), int(counts.max())
    modulus = source.counter_modulus if high < source.counter_modulus else source.counter_values
    least, step, most = np.percentile(np.diff(counts) % modulus, (25.0, 50.0, 75.0))
    if step != 1 and most - least <= _EVEN * step:
        return f"goes on by {step:.0f} from one frame to the next: it counts no frames, so leave `counter` out"
    if (low, high) == (0, modulus - 1) or counts.size < _TURNS * modulus:
        return ""
    mend = "leave `counter` out" if low else f"give it the range [0|{high}] in the DBC"
    return f"runs from {low} to {high} and not from 0 to {modulus - 1}: {mend}"


def _step_share(values: Array) -> float | None:
    if values.size < _LEAST_STEPS:
        return None
    low, high = np.percentile(values, (1.0, 99.0))
    return float(np.median(np.abs(np.diff(values))) / (high - low)) if high > low else None


def _floor_share(values: Array) -> float:
    """Of noise the lowest value is rare."""
    if values.size < _LEAST_STEPS:
        return 0.0
    low = values.min()
    above = values[values > low]
    if above.size == 0 or values.max() - low < _FLOOR_STEPS * (above.min() - low):
        return 0.0
    share = 1.0 - above.size / values.size
    often = values.size - above.size >= _FLOOR_TIMES * np.count_nonzero(above == above.min())
    return share if often and share >= _FLOOR_SHARE else 0.0


def documents(seen: Mapping[str, QuantitySeen]) -> dict[str, SeenDocument]:
    """As `yieldmon check-config --json` prints them, by name."""
    return {name: _document(entry) for name, entry in seen.items()}


def _document(entry: QuantitySeen) -> SeenDocument:
    return {
        "unit": entry.unit,
        "values": entry.values,
        "usable": entry.usable,
        "rate_hz": entry.rate_hz,
        "low": entry.low,
        "high": entry.high,
        "largest_gap_s": entry.largest_gap_s,
        "first": list(entry.first),
        "decoded": None if entry.decoded is None else list(entry.decoded),
    }
