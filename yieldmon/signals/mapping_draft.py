"""A mapping to start from, out of what a survey has found on a bus."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from yieldmon.engine.sources import QUANTITIES
from yieldmon.signals.binding import IMPACT
from yieldmon.signals.candidates import Candidate, candidates_of, fit_alike
from yieldmon.signals.signal_fit import (
    BARE,
    CHANNELS,
    FAST_HZ,
    STANDS_OUT,
    force_unit,
    is_makers_own,
    is_of_pulses,
    of_another_shaft,
)
from yieldmon.signals.survey import Survey
from yieldmon.signals.units import likely, period_s

_RATIO, _PULSES, _COUNTS, _EXCITATION = "ratio: 0.2", "pulses_per_turn: 1", "scale: 0.1", "scale: 5"
_DEGREES = "unit: deg"
_GUESSES = {
    _RATIO: "The ratio is a guess: turns of the elevator's upper shaft per turn of the measured one.",
    _PULSES: "pulses_per_turn is a guess: magnets or teeth of the elevator's upper shaft.",
    _COUNTS: "The scale is a guess: mV per count (if `setup` was given counts: unit: mV, no scale); `offset` if counts fall.",
    _EXCITATION: "The scale is a guess: volts that feed the bridge (if `setup` was given mV/V: unit: mV, no scale).",
    _DEGREES: "The unit is a guess: degrees (if the DBC means gradians: unit: deg, scale: 0.9).",
}
"""Keys of an entry that the bus does not show -> what is said of them."""
_NEEDED = {
    "elevator_speed": "see docs/guide/wiring.md",
    "plate_angle": "a position in other units takes `unit: deg`, `scale` and `offset`; for a plate at a fixed angle set "
    "`plate: {fixed_angle_deg: 70}`",
}
"""Quantities without which nothing is measured, beside the impact sensor's -> what to do where a bus has nothing like them."""
_MOST_CHANNELS = 8
"""Of one frame that are named."""
_MOST_ALIKE = 4
"""Signals that fit a quantity alike that are named."""
_MOST_NAMELESS = 6
"""So many frames without a DBC that may be an impact sensor's are named."""
TELLING = ("manufacturer_code", "function", "function_instance", "ecu_instance", "identity_number")
"""Fields of a NAME that identify a node, as `source` of a mapping takes them."""


def _guesses(entry: str, reported: set[str]) -> list[str]:
    """What is said of an entry's keys that the bus does not show, once each. reported: keys of which it is; those of the entry
    are added."""
    keys = [key for key in _GUESSES if key in entry and key not in reported]
    reported.update(keys)
    return [f"  # {_GUESSES[key]}" for key in keys]


def mapping_text(survey: Survey, paths: Mapping[str, str]) -> str:
    """A configuration to start from: the likeliest signal of each quantity, the others as comments. paths: of the DBC files."""
    lines = [
        "# A mapping to start from, made by `yieldmon signals`. Check every line against the machine, then run",
        "# `yieldmon check-config THIS --log RECORDING`. Quantities that are left out keep the shipped DBC's messages.",
        "signals:",
    ]
    candidates = candidates_of(survey)
    impact = sorted((name for name in IMPACT if name in candidates), key=lambda name: -candidates[name][0].score)
    wanted = [*impact[:1], *(name for name in QUANTITIES if name in candidates)]
    if not impact:
        lines += _no_impact(survey)
    used: set[tuple[str, str]] = set()
    for quantity in wanted:
        free = [c for c in candidates[quantity] if (c.message, c.signal) not in used]
        if not free:
            continue
        shown, channels = _by_frame(free)
        entries = list(dict.fromkeys(entry for one in shown for entry in _entries(one, paths, candidates)))[:4]
        reported: set[str] = set()
        first = entries.pop(0) if not free[0].weak else ""
        lines += _guesses(first, reported)
        if free[0].weak:
            how = "their rates" if quantity in IMPACT else "their units"
            lines.append(f"  # Nothing here is named like {quantity}; by {how} it could be:")
        else:
            used.update((free[0].message, signal) for signal in _samples(free[0], candidates))
            lines.append(f"  {quantity}: {first}")
        for entry in entries:
            lines += [*_guesses(entry, reported), f"  # or {quantity}: {entry}"]
        lines += [f"  # {said}" for said in _every_page(free[0], paths, candidates)]
        lines += [f"  # {said}" for said in _alike(shown, candidates)]
        lines += [f"  # {said}" for alike in channels for said in _which_channel(alike)]
    lines += [
        f"  # {name}: nothing on this bus looks like it; {mend}" for name, mend in _NEEDED.items() if name not in candidates
    ]
    return "\n".join(lines if any(line[2:3] != "#" for line in lines[3:]) else [*lines[:2], "signals: {}", *lines[3:]]) + "\n"


def guesses(candidates: Mapping[str, Sequence[Candidate]]) -> list[str]:
    """Quantities for whose first candidate nothing but its unit or rate speaks, or beside which another fits as well."""
    found = []
    for quantity, every in candidates.items():
        shown, channels = _by_frame(every)
        if (
            every[0].weak
            or _alike(shown, candidates)
            or any(not _stands_out(alike) for alike in channels if alike[0] is every[0])
        ):
            found.append(quantity)
    return found


def _no_impact(survey: Survey) -> list[str]:
    """Comments on where an impact sensor may be: frames of no DBC and of no group of J1939 with a name of its own."""
    lines = ["  # impact_voltage: nothing on this bus looks like an impact sensor; see docs/guide/wiring.md"]
    fast = [m for m in survey.messages if m.dbc is None and (m.rate_hz or 0.0) >= FAST_HZ and is_makers_own(m.group)]
    if fast:
        fast.sort(key=lambda message: -(message.rate_hz or 0.0))
        shown = ", ".join(f"0x{m.identifier:X} ({m.rate_hz:.4g} Hz)" for m in fast[:_MOST_NAMELESS])
        lines.append(f"  # By their rate these could be one: {shown}.")
        lines.append("  # Name their signals in a DBC, such as examples/wiring/analog_module.dbc, and run this again with --dbc.")
    return lines


def _samples(found: Candidate, candidates: Mapping[str, Sequence[Candidate]]) -> list[str]:
    """The signals that are one impact sensor's samples in one frame, oldest first; for anything else the one signal."""
    numbered = re.fullmatch(r"(.*?)(\d+)", found.signal)
    if found.quantity not in IMPACT or numbered is None or CHANNELS.fullmatch(found.signal):
        return [found.signal]
    frame = (found.dbc, found.message, found.mux, found.source, found.unit)
    alike = {}
    for other in candidates[found.quantity]:
        parts = re.fullmatch(r"(.*?)(\d+)", other.signal)
        same = (other.dbc, other.message, other.mux, other.source, other.unit) == frame
        if parts is not None and same and parts[1] == numbered[1] and _overlap(found.span, other.span):
            alike[int(parts[2])] = other.signal
    return [alike[number] for number in sorted(alike)]


def _by_frame(candidates: Sequence[Candidate]) -> tuple[list[Candidate], list[list[Candidate]]]:
    """The candidates with one for each frame of numbered channels, that which fits best; and all channels of each such frame, the
    likeliest first."""
    frames: dict[tuple[object, ...], list[Candidate]] = {}
    for one in candidates:
        numbered = one.quantity in IMPACT and CHANNELS.fullmatch(one.signal) is not None
        own = () if numbered else (one.signal, one.valid)
        frames.setdefault((one.dbc, one.message, one.mux, one.source, one.node, one.unit, *own), []).append(one)
    return [alike[0] for alike in frames.values()], [alike for alike in frames.values() if len(alike) > 1]


def _which_channel(alike: Sequence[Candidate]) -> tuple[str, str]:
    """What is said of the channels of one frame, of which one is the impact sensor's. alike: the likeliest first."""
    ranges = ", ".join(f"{one.signal} {one.span[0]:.5g} to {one.span[1]:.5g}" for one in alike[:_MOST_CHANNELS])
    found = f"{alike[0].signal} moved most" if _stands_out(alike) else "all moved alike, so the first is a guess"
    unit = f" {alike[0].unit}" if alike[0].unit else ""
    return (
        f"Channels of {alike[0].message}: {ranges}{unit}; {found}.",
        "Strike the plate while recording: the channel that moves is the impact sensor's.",
    )


def _stands_out(alike: Sequence[Candidate]) -> bool:
    """Whether the first of several channels moved more than the next one."""
    first, second = (one.span[1] - one.span[0] for one in alike[:2])
    return first > STANDS_OUT * second


def _alike(shown: Sequence[Candidate], candidates: Mapping[str, Sequence[Candidate]]) -> list[str]:
    """What is said where other signals fit a quantity as well as the first. shown: one for each frame of channels."""
    named, samples = list[str](), set[tuple[object, ...]]()
    for one in shown:
        frame = one.dbc, one.message, one.mux, one.source
        if fit_alike(shown[0], one) and (*frame, one.signal) not in samples:
            named.append(_called(one))
            samples.update((*frame, signal) for signal in _samples(one, candidates))
    named = list(dict.fromkeys(named))[:_MOST_ALIKE]
    if len(named) < 2:
        return []
    said = [f"{' and '.join(named)} fit alike: the first is a guess."]
    if shown[0].quantity in IMPACT:
        said.append("Two cells under one plate: map both, in a list; they are added. One cell in two messages or pages: map one.")
    return said


def _called(one: Candidate) -> str:
    of = [] if one.mux is None else [f"mux {one.mux}"]
    of += [] if one.source is None else [f"source {one.source}"]
    return f"{one.message}.{one.signal}" + (f" ({', '.join(of)})" if of else "")


def _every_page(found: Candidate, paths: Mapping[str, str], candidates: Mapping[str, Sequence[Candidate]]) -> list[str]:
    """The entry of a signal that comes with several values of the multiplexer, for one sensor in all of them."""
    if not found.every_mux:
        return []
    every = _entries(found, paths, candidates, every_page=True)[0]
    values = ", ".join(map(str, found.every_mux))
    return [f"{found.signal} comes with mux {values}. A sensor each: take one. One sensor in all:", f"{found.quantity}: {every}"]


def _is_pulsed(found: Candidate) -> bool:
    """Whether a speed comes as a frequency of pulses or as the time between two."""
    return is_of_pulses(found.unit, found.span[1]) or period_s(found.unit) is not None


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two ranges are alike, as those of one sensor's samples are."""
    both = min(one[1], other[1]) - max(one[0], other[0])
    return both >= 0.5 * (max(one[1], other[1]) - min(one[0], other[0]))


def _frames(found: Candidate, *, every_page: bool) -> list[str]:
    """Keys that say which of the message's frames hold a candidate."""
    page = [] if found.mux is None else [f"mux: {list(found.every_mux) if every_page else found.mux}"]
    return page if found.valid is None else [*page, f"valid: {{{found.valid}: 1}}"]


def _entries(
    found: Candidate, paths: Mapping[str, str], candidates: Mapping[str, Sequence[Candidate]], *, every_page: bool = False
) -> list[str]:
    """What a mapping says of a candidate: its sender by address, by NAME, or both, the better one first. every_page: in all
    pages that have it, not in the one that comes most."""
    keys = [
        f"dbc: {paths[found.dbc]}",
        f"message: {found.message}",
        *_signal_keys(found, candidates, found.every_rate_hz if every_page else found.rate_hz),
        *_unit_keys(found),
        *_value_keys(found),
        *_frames(found, every_page=every_page),
    ]
    if found.quantity == "elevator_speed" and of_another_shaft(found.message, found.signal):
        keys.append(_RATIO)
    sources = [] if found.source is None or found.moved else [f"source: {found.source}"]
    if found.node is not None:
        sources.append(f"source: {{{', '.join(f'{key}: {getattr(found.node, key)}' for key in TELLING)}}}")
    return ["{" + ", ".join([*keys, source]) + "}" for source in sources] or ["{" + ", ".join(keys) + "}"]


def _signal_keys(found: Candidate, candidates: Mapping[str, Sequence[Candidate]], rate_hz: float) -> list[str]:
    """Its signal, or all samples of one frame, and how many an impact sensor sends per second. rate_hz: of the frames."""
    samples = _samples(found, candidates)
    if len(samples) > 1:
        return [f"signals: [{', '.join(samples)}]", f"rate_hz: {rate_hz * len(samples):.4g}"]
    rate = [f"rate_hz: {rate_hz:.4g}"] if found.quantity in IMPACT else []
    return [f"signal: {found.signal}", *rate]


def _unit_keys(found: Candidate) -> list[str]:
    """Its unit where the DBC's does not do, and what turns it into the quantity's."""
    keys = []
    if found.quantity in IMPACT and found.unit in BARE:
        keys += ["unit: counts", _COUNTS]
    if found.quantity in IMPACT and found.unit == "mV/V":
        keys.append(_EXCITATION)
    if found.quantity == "impact_force" and (weighs := force_unit(found.unit)) is not None:
        keys.append(f"unit: {weighs}")
    if found.quantity == "elevator_speed" and (not found.unit or _is_pulsed(found)):
        keys.append(_PULSES)
    if likely(found.unit) != found.unit:
        keys.append(f"unit: {likely(found.unit)}")
    return keys


def _value_keys(found: Candidate) -> list[str]:
    """Its raw values that are none or a code."""
    keys = [f"not_available: {list(found.not_available)}"] if found.not_available else []
    return [*keys, f"values: {{{', '.join(f'{raw}: {code}' for raw, code in found.values)}}}"] if found.values else keys
