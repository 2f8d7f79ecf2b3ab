"""A mapping held against a recording, and against the rates that it states: what `check-config` says before the harvest does."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import degrees, radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.documents.check_config import SeenDocument
from yieldmon.engine.rivals import RivalLimits, RivalWatch, angle_limits, speed_limits
from yieldmon.engine.sampling.aliasing import ALIAS_FREE_HZ, aliasing_share
from yieldmon.engine.sources import QUANTITIES, SampleSource
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.numerics import Array
from yieldmon.service.config.configuration import Configuration
from yieldmon.signals.binding import Binding
from yieldmon.signals.mapping import Group
from yieldmon.signals.packing import Packing, span
from yieldmon.signals.published import PUBLISHED
from yieldmon.signals.state_names import codes_by_name
from yieldmon.signals.units import factor
from yieldmon.units import S_PER_DAY

if TYPE_CHECKING:
    from yieldmon.engine.runs import FrameRun
    from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch


SPEEDS_RPM = (300.0, 400.0, 500.0)
RATE_TOLERANCE = 0.05
"""Relative difference of a stated sample rate from the recorded one that is a problem."""
_FIRST = 5
_ANGLE_MARGIN_DEG = 5.0
"""Beyond the machine's range, for a park position and a rough zero of the angle."""
_LEAST_MOISTURE_PCT = 1.0
"""No grain is drier."""
_WORTH_SAYING_PCT = 0.1
_SMOOTH_HZ = 400.0
"""From which on a paddle's pulse has many samples."""
_JUMPING, _LEAST_STEPS = 0.15, 200
"""Share of the range from one sample to the next that is none of a pulse's (0.1 at most), of so many samples."""
_LEAST_SHARE = 0.25
"""Of the full scale, below 0: a cell that pulls."""
_SPEED_BAND = np.linspace(0.98, 1.02, 9)
"""A loaded elevator turns up to this share off its stated speed: enough to fold a harmonic onto 0."""
_EVEN = 0.1
"""Of a step, what the middle half of all differs by at most: a clock's are not all the same."""
_TURNS = 4
"""So often a counter turns before its ends are known."""
_ALIKE = 0.02
"""Of the range of one sensor, what that of another differs by at its ends where both are one."""
_OFTEN = 3
"""Once or twice a recording may begin anew."""
_MOSTLY = 0.5
"""Of the seconds of a recording."""
_DESTINATIONS_NAMED = 3
_SHORTEST_BITS = 8
_IMPACT_SIGNAL = re.compile(r"impact(\d+)\.\d+")
_COUNTED_ANEW = "; pulses that each frame counts anew are a frequency: unit Hz, `scale` the frames per second"
_FORCES_N = np.geomspace(5.0, 500.0, 24)


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
    leaping_share: float = 0.0
    """Of the seconds, those whose values leap up and down as no one sender's do."""
    silences: int = 0
    """Times without a value that are longer than one holds."""
    counter_flaw: str = ""
    """Why the counter of an impact sensor counts no frames, and what to do; empty where it does."""


def aliasing_pct(configuration: Configuration) -> dict[str, float]:
    """Largest standard deviation of a second's flow from aliasing, %, near each elevator speed; empty where there is none."""
    sources = [source for source in configuration.signals.sources.impact if source.rate_hz < ALIAS_FREE_HZ]
    found = {f"{rpm:g}": 100.0 * _largest_share(sources, configuration.machine, rpm * RPM) for rpm in SPEEDS_RPM}
    if max(found.values()) < _WORTH_SAYING_PCT:
        return {}
    return {rpm: round(share * _flow_per_force(configuration, float(rpm) * RPM), 2) for rpm, share in found.items()}


def _largest_share(sources: Sequence[SampleSource], machine: Machine, speed_rad_s: float) -> float:
    """Of the mean force, for speeds of the band."""
    speeds = (float(speed) for speed in speed_rad_s * _SPEED_BAND)
    return max((aliasing_share(source, machine, speed) for speed in speeds for source in sources), default=0.0)


def _flow_per_force(configuration: Configuration, speed_rad_s: float) -> float:
    """Largest relative change of the flow over that of the force, for any flow that the elevator can carry."""
    from yieldmon.estimation.estimators import estimator_of

    machine = configuration.machine
    estimator = estimator_of(machine, configuration.parameters)
    angles, speeds = (np.full(_FORCES_N.shape, value) for value in (machine.home_plate_angle_rad, speed_rad_s))
    flow_kg_s = estimator.estimate(_FORCES_N, angles, speeds).mass_flow_kg_s
    known = flow_kg_s > 0.0
    slopes = np.diff(np.log(flow_kg_s[known])) / np.diff(np.log(_FORCES_N[known]))
    return max(1.0, float(slopes.max(initial=1.0)))


def notes(configuration: Configuration) -> list[str]:
    """What an operator should know of a mapping before it is used, a sentence each."""
    found = []
    aliasing = aliasing_pct(configuration)
    if aliasing:
        rate_hz = min(source.rate_hz for source in configuration.signals.sources.impact)
        parts = ", ".join(f"{share:g} % at {rpm} rpm" for rpm, share in aliasing.items())
        cost = f"standard deviation of a second's flow up to {parts}"
        found.append(f"{rate_hz:g} samples per second alias the paddle passes: {cost}")
    if "impact_force" in configuration.document.signals:
        gain = configuration.machine.sensor.gain_n_per_mv
        found.append(
            f"impact_force is taken as the bus has it: gain_n_per_mv of the machine file ({gain:.4g}) does not act on it; where "
            "weights hung on the plate gave that gain, bind impact_voltage with unit: mV to the same signals"
        )
    if configuration.document.plate.fixed_angle_deg is not None:
        home = degrees(configuration.machine.home_plate_angle_rad)
        found.append(f"the plate is fixed at {home:g} deg: no feedback is wanted and no sweep runs")
    for name, value in configuration.signals.sources.fixed.items():
        if name != "plate_angle":
            found.append(f"{name} is taken to be {value:g} {QUANTITIES[name].unit} always")
    stated = {binding.quantity: binding for binding in configuration.signals.bindings}
    for taken in configuration.signals.groups:
        for name, extraction in taken.signals.items():
            if (binding := stated.get(name)) is not None and _takes_another_unit(binding, extraction.bits.unit):
                said = f"{name} is {extraction.bits.name} in {extraction.bits.unit}, taken as {binding.unit} number for number"
                found.append(f"{said}: if the DBC's unit is right, give `scale` and `offset`")
            codes = codes_by_name(name, extraction.bits) if extraction.codes is None else {}
            if codes:
                given = ", ".join(f"{raw}: {code}" for raw, code in sorted(codes.items()))
                found.append(
                    f"{name} is taken as {extraction.bits.name} has it, {QUANTITIES[name].meaning}; the DBC's names say "
                    f"otherwise: values: {{{given}}}"
                )
    for group in configuration.outputs.groups:
        when = "with each new value" if group.period_s is None else f"every {1000.0 * group.period_s:g} ms"
        source = "xx" if group.own_address else f"{group.frame_id & 0xFF:02X}"
        identifier = f"0x{group.frame_id >> 8:X}{source}" if group.extended else f"0x{group.frame_id:X}"
        for name, packing in group.quantities:
            carried = _carried(packing, PUBLISHED[name].unit)
            found.append(f"{name} goes to {group.name}.{packing.bits.name} ({identifier}), {when}{carried}")
    return found


def _takes_another_unit(binding: Binding, unit: str) -> bool:
    """Whether a binding states a unit that the DBC's does not convert to, and nothing that would convert it."""
    if binding.is_impact or binding.unit is None or binding.pulses_per_turn is not None or not unit:
        return False
    unscaled = (binding.scale, binding.offset, binding.ratio) == (1.0, 0.0, 1.0)
    return unscaled and factor(QUANTITIES[binding.quantity].unit, unit) is None


def _carried(packing: Packing, unit: str) -> str:
    if packing.counts or packing.codes is not None:
        return ""
    silent = "; without a value no frame is sent" if packing.not_available is None else ""
    ends = sorted(raw * packing.scale + packing.offset for raw in span(packing.bits))
    return f", from {max(packing.low, ends[0]):.6g} to {min(packing.high, ends[1]):.6g} {unit}{silent}"


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
    expected = [*(_impact_name(k) for k in range(len(sources.impact))), *(source.quantity for source in sources.inputs)]
    inputs = configuration.engine.inputs
    holds_s = {name: float(getattr(inputs, quantity.timeout)) for name, quantity in QUANTITIES.items()}
    found = {name: _summary(name, parts.get(name, []), holds_s.get(name, np.inf)) for name in dict.fromkeys(expected)}
    for number, source in enumerate(sources.impact):
        if source.counter is not None and (name := _impact_name(number)) in counters:
            found[name] = replace(found[name], counter_flaw=_counter_flaw(np.concatenate(counters[name]), source))
    for name, limits in _rival_limits(configuration.machine).items():
        if name in found and parts.get(name):
            found[name] = replace(found[name], leaping_share=_leaping_share(parts[name], *limits))
    return found, incomplete


def _rival_limits(machine: Machine) -> dict[str, tuple[RivalLimits, float]]:
    """By quantity, what one sender's values do, and the unit of these in that of the mapping."""
    return {"elevator_speed": (speed_limits(machine, np.nan), RPM), "plate_angle": (angle_limits(np.nan), radians(1.0))}


def _leaping_share(parts: list[tuple[Array, Array, Array]], limits: RivalLimits, unit: float) -> float:
    times, values, _ = (np.concatenate(column) for column in zip(*parts, strict=True))
    known = np.isfinite(values)
    times, values = times[known], values[known] * unit
    if times.size < 2 or not 1.0 < times[-1] - times[0] < S_PER_DAY:
        return 0.0
    edges = np.arange(times[0], times[-1] + 1.0)
    bounds = np.searchsorted(np.maximum.accumulate(times), edges)
    return float(np.mean(RivalWatch(limits).take(times, values, bounds, edges) > 0))


def _impact_name(number: int) -> str:
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
            counters.setdefault(_impact_name(number), []).append(samples.rows[:, 0])
            parts.setdefault(_impact_name(number), []).append((times.ravel(), values, values))
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


def problems(configuration: Configuration, seen: dict[str, QuantitySeen], log: str) -> list[tuple[str, str, str]]:
    """(where, problem, expected) of what the recording says against the mapping."""
    found = []
    for name in ("impact", "elevator_speed", "plate_angle"):
        entry = seen.get(name)
        if entry is not None and not entry.usable:
            what = "no usable value" if entry.values else "no frame of it"
            instead = _instead(configuration, name, log) if not entry.values else None
            if entry.values and entry.decoded is not None:
                instead = "it decodes to " + " to ".join(f"{end:.6g}" for end in dict.fromkeys(entry.decoded)) + f" {entry.unit}"
            expected = (
                "values that it can have; look at signal, unit, scale and range" if entry.values else "frames that are mapped"
            )
            found.append((f"{log}: {name}", f"{what}: {instead}".rstrip() if instead else what, expected))
    found += _angle_problems(configuration.machine, seen, log)
    counted = _speed_is_counted(configuration)
    found += [
        (
            f"{log}: {name}",
            f"leaps between {entry.low:.6g} and {entry.high:.6g} {entry.unit}, as where two nodes send it",
            _one_sender(configuration, name, log) + (_COUNTED_ANEW if counted and name == "elevator_speed" else ""),
        )
        for name, entry in seen.items()
        if entry.leaping_share > _MOSTLY
    ]
    sensor = configuration.machine.sensor
    most_mv = configuration.engine.windows.plausible_full_scales * sensor.full_scale_mv
    for number, source in enumerate(configuration.signals.sources.impact):
        rate_hz, low_mv, high_mv = (getattr(seen[_impact_name(number)], key) for key in ("rate_hz", "low", "high"))
        if low_mv is not None and not (low_mv <= most_mv and high_mv >= -most_mv):
            expected = f"samples within {most_mv:g} mV of the cell's zero; look at unit and scale"
            found.append((f"{log}: {_impact_name(number)}", f"{low_mv:.6g} to {high_mv:.6g} mV", expected))
        if rate_hz is not None and abs(rate_hz / source.rate_hz - 1.0) > RATE_TOLERANCE:
            where = f"{log}: {_impact_name(number)}"
            found.append((where, f"{rate_hz:.4g} samples per second", f"{source.rate_hz:g}, as mapped"))
    return found


def _speed_is_counted(configuration: Configuration) -> bool:
    """Whether the elevator's speed is made of a counter of pulses."""
    return any(group.pulses for group in configuration.signals.groups)


def _angle_problems(machine: Machine, seen: dict[str, QuantitySeen], log: str) -> list[tuple[str, str, str]]:
    """Of a plate that is never near an angle that it can have."""
    entry = seen.get("plate_angle")
    if entry is None or entry.low is None or entry.high is None:
        return []
    least, most = degrees(machine.min_plate_angle_rad), degrees(machine.max_plate_angle_rad)
    if entry.low <= most + _ANGLE_MARGIN_DEG and entry.high >= least - _ANGLE_MARGIN_DEG:
        return []
    expected = f"angles from {least:g} to {most:g} deg, as the machine file says; look at unit, scale and offset"
    return [(f"{log}: plate_angle", f"{entry.low:.6g} to {entry.high:.6g} deg", expected)]


def remarks(configuration: Configuration, seen: dict[str, QuantitySeen]) -> list[str]:
    """What is doubtful in a recording, a sentence each: it may be a recording of that kind, or a mistaken unit."""
    found, machine = _impact_remarks(configuration, seen) + _range_remarks(configuration, seen), configuration.machine
    speed, moisture = seen.get("elevator_speed"), seen.get("moisture")
    least, most = machine.min_elevator_speed_rad_s / RPM, machine.max_elevator_speed_rad_s / RPM
    if speed is not None and speed.low is not None and speed.high is not None and (speed.high < least or speed.low > most):
        found.append(
            f"elevator_speed is never between {least:.0f} and {most:.0f} rpm, where flow is measured: if the machine harvested, "
            f"look at unit, scale and ratio{_COUNTED_ANEW if _speed_is_counted(configuration) else ''}"
        )
    if moisture is not None and moisture.high is not None and moisture.high < _LEAST_MOISTURE_PCT:
        found.append(f'moisture is never above {moisture.high:.3g} %: if it comes as a share of 1, unit: "1" makes it per cent')
    found += _turns_too_soon(configuration, seen)
    for name, entry in seen.items():
        if entry.silences >= _OFTEN and name in QUANTITIES:
            found.append(
                f"{name} comes up to {entry.largest_gap_s:.3g} s apart, and a value holds for inputs.{QUANTITIES[name].timeout}: "
                "where it is sent only when it changes, make that longer, or let it be sent at an interval"
            )
    driven = seen.get("ground_speed")
    if machine.implement.working_width_m is None and driven is not None and driven.low is not None:
        found.append(
            "ground_speed is known and the header's width is not, so that area and yield stay unknown: "
            "implement: {working_width_m: 9.1} in the machine file, as wide as the header is"
        )
    return found


def _turns_too_soon(configuration: Configuration, seen: dict[str, QuantitySeen]) -> list[str]:
    """Of a counter of pulses that may turn more than once from one frame to the next."""
    found = []
    for pulses in (pulses for group in configuration.signals.groups for pulses in group.pulses):
        rate_hz = seen[pulses.signal].rate_hz
        if rate_hz is not None and rate_hz * pulses.longest_s < 1.0:
            found.append(
                f"{pulses.signal} comes {1.0 / rate_hz:.3g} s apart, in which a counter of {pulses.modulus} values may turn "
                f"twice, and is not used: {pulses.pulses_per_turn:g} pulses per turn need one every {pulses.longest_s:.2g} s, "
                "or more bits"
            )
    return found


def _range_remarks(configuration: Configuration, seen: dict[str, QuantitySeen]) -> list[str]:
    """Of values beyond the range that the DBC gives a signal: often they are raw values for "error" or "not available"."""
    found: dict[str, str] = {}
    for group in configuration.signals.groups:
        counted = {pulses.signal for pulses in group.pulses}
        for signal, extraction in group.signals.items():
            number = _IMPACT_SIGNAL.fullmatch(signal)
            name = signal if number is None else _impact_name(int(number[1]))
            entry, bits = seen.get(name), extraction.bits
            number_of = bits.kind == "uint" and signal not in counted and extraction.codes is None and not extraction.over
            if entry is None or entry.decoded is None or entry.unit == "" or not number_of:
                continue
            largest = (1 << bits.bits) - 1
            raws = sorted((end - extraction.offset) / extraction.scale for end in entry.decoded)
            if raws[1] > largest - 0.5 and bits.bits >= _SHORTEST_BITS:
                found[name] = (
                    f"{name} comes with {bits.name} at its largest raw value, {largest}, which is {entry.decoded[1]:.6g} "
                    f"{entry.unit}: where that means no value, not_available: [{largest}]"
                )
            elif raws[1] > bits.turns_at - 0.5:
                last = (bits.turns_at - 1) * extraction.scale + extraction.offset
                found[name] = (
                    f"{name} goes from {entry.decoded[0]:.6g} to {entry.decoded[1]:.6g} {entry.unit}, beyond {last:.6g} where "
                    f"the DBC's range of {bits.name} ends: raw values that mean none are `not_available`, or outside `range`"
                )
    return list(found.values())


def _impact_remarks(configuration: Configuration, seen: dict[str, QuantitySeen]) -> list[str]:
    found, full_mv = [], configuration.machine.sensor.full_scale_mv
    for number, source in enumerate(configuration.signals.sources.impact):
        name = _impact_name(number)
        entry = seen[name]
        if entry.low is None or entry.high is None:
            continue
        if entry.high > full_mv or entry.low < -_LEAST_SHARE * full_mv:
            found.append(
                f"{name} goes from {entry.low:.6g} to {entry.high:.6g} mV; a cell of {full_mv:g} mV (full_scale_mv of the "
                "machine file) counts as saturated from there on: look at unit, scale, sign and byte order (@0 or @1 in the DBC)"
            )
        wide = entry.high - entry.low > 0.5 * full_mv
        if wide and source.rate_hz >= _SMOOTH_HZ and entry.step_share is not None and entry.step_share > _JUMPING:
            found.append(
                f"{name} jumps by {100.0 * entry.step_share:.0f} % of its range from one sample to the next, as no force does: "
                "look at start bit, byte order (@0 or @1 in the DBC) and sign of its signal"
            )
        if entry.counter_flaw:
            found.append(f"{name}'s counter {entry.counter_flaw}")
    return found + _one_sensor_twice(configuration, seen)


def _one_sensor_twice(configuration: Configuration, seen: dict[str, QuantitySeen]) -> list[str]:
    """Of impact sensors that say the same."""
    found = []
    entries = [(name, seen[name]) for name in map(_impact_name, range(len(configuration.signals.sources.impact)))]
    for (name, one), (other_name, other) in combinations(entries, 2):
        if one.low is None or one.high is None or other.low is None or other.high is None or one.unit != other.unit:
            continue
        apart = max(abs(one.low - other.low), abs(one.high - other.high))
        if apart < _ALIKE * (one.high - one.low):
            found.append(
                f"{name} and {other_name} have the same range, and their forces add up: where they are samples of one sensor in "
                "two messages, bind one message, at its own rate_hz"
            )
    return found


def _instead(configuration: Configuration, name: str, log: str) -> str | None:
    """What a recording has in place of a mapped quantity's frames."""
    from yieldmon.service.logs.silent_inputs import Traffic

    group = _group(configuration, name)
    return Traffic(log).instead_of(group) if group is not None else None


def _one_sender(configuration: Configuration, name: str, log: str) -> str:
    """What to do about a quantity that several senders seem to send."""
    from yieldmon.service.logs.silent_inputs import Traffic

    group = _group(configuration, name)
    if group is not None and (taken := Traffic(log).several_destinations(group)):
        identifiers = " or ".join(f"0x{identifier:08X}" for identifier in taken[:_DESTINATIONS_NAMED])
        return f"the values for one address: {identifiers} as the message's identifier in the DBC, without `source`"
    return "the values of one node: name it by `source`"


def _group(configuration: Configuration, name: str) -> Group | None:
    sources = configuration.signals.sources
    message = sources.impact[0].message if name == "impact" else {s.quantity: s.message for s in sources.inputs}.get(name)
    return next((group for group in configuration.signals.groups if group.name == message), None)


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
