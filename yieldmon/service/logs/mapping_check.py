"""A mapping held against a recording: what `check-config --log` says before the harvest does."""

from __future__ import annotations

import re
from itertools import combinations
from math import degrees

from yieldmon.engine.sources import QUANTITIES
from yieldmon.physics.machine import RPM, Machine
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.config.out_of_reach import ANGLE_MARGIN_DEG
from yieldmon.service.logs.quantities_seen import QuantitySeen, impact_name
from yieldmon.service.logs.time_units import unit_slip
from yieldmon.signals.mapping import Group

RATE_TOLERANCE = 0.05
"""Relative difference of a stated sample rate from the recorded one that is a problem."""
_LEAST_MOISTURE_PCT = 1.0
"""No grain is drier."""
_SMOOTH_HZ = 400.0
"""From which on a paddle's pulse has many samples."""
_JUMPING = 0.15
"""Share of the range from one sample to the next that is none of a pulse's (0.1 at most)."""
_LEAST_PULSES_N = 0.5
"""From the lowest sample of a harvest to the highest. The mean force of 1 kg/s is 9 N, an empty elevator's noise about 1 N."""
_LEAST_SHARE = 0.25
"""Of the full scale, below 0: a cell that pulls."""
_ALIKE = 0.02
"""Of the range of one sensor, what that of another differs by at its ends where both are one."""
_OFTEN = 3
"""Once or twice a recording may begin anew."""
_MOSTLY = 0.5
"""Of the seconds of a recording."""
_DESTINATIONS_NAMED = 3
_SHORTEST_BITS = 8
_IMPACT_SIGNAL = re.compile(r"impact(\d+)\.\d+")
_ALSO = {"elevator_speed": ", ratio, pulses_per_turn"}
_INSTEAD = {"plate_angle": ", or plate.fixed_angle_deg for a plate at a fixed angle"}
"""Quantity -> what else may be wrong, or done, where its values or frames are not there."""
_COUNTED_ANEW = "; pulses counted from 0 in each frame are a frequency: unit Hz, `scale` the frames per second"


Problem = tuple[str, str, str]
"""Where, what, and what was expected: as InputError takes them."""


def problems(configuration: Configuration, seen: dict[str, QuantitySeen], log: str) -> list[Problem]:
    """How a recording contradicts the mapping.

    Parameters
    ----------
    configuration : Configuration
    seen : dict of str to QuantitySeen
        The recording's quantities.
    log : str
        The recording.
    """
    return [
        *_missing_problems(configuration, seen, log),
        *_angle_problems(configuration.machine, seen, log),
        *_leaping_problems(configuration, seen, log),
        *_sample_problems(configuration, seen, log),
    ]


def _missing_problems(configuration: Configuration, seen: dict[str, QuantitySeen], log: str) -> list[Problem]:
    """Of quantities without which nothing is measured."""
    found = []
    for name in ("impact", "elevator_speed", "plate_angle"):
        entry = seen.get(name)
        if entry is None or entry.usable:
            continue
        if entry.values:
            problem, instead = "no usable value", ""
            if entry.decoded is not None:
                instead = "it decodes to " + " to ".join(f"{end:.6g}" for end in dict.fromkeys(entry.decoded)) + f" {entry.unit}"
            expected = f"values that it can have; look at signal, unit, scale{_ALSO.get(name, '')} and range"
        else:
            problem, instead = "no frame of it", _instead(configuration, name, log) or ""
            expected = f"frames that are mapped{_INSTEAD.get(name, '')}"
        found.append((f"{log}: {name}", f"{problem}: {instead}".rstrip() if instead else problem, expected))
    return found


def _leaping_problems(configuration: Configuration, seen: dict[str, QuantitySeen], log: str) -> list[Problem]:
    """Of quantities that change between two values, as two senders make them do."""
    counted = _speed_is_counted(configuration)
    return [
        (
            f"{log}: {name}",
            f"leaps between {entry.low:.6g} and {entry.high:.6g} {entry.unit}, as if two nodes sent it",
            _one_sender(configuration, name, log) + (_COUNTED_ANEW if counted and name == "elevator_speed" else ""),
        )
        for name, entry in seen.items()
        if entry.leaping_share > _MOSTLY
    ]


def _sample_problems(configuration: Configuration, seen: dict[str, QuantitySeen], log: str) -> list[Problem]:
    """Of impact sensors' values and rates."""
    found = []
    most_mv = configuration.engine.windows.plausible_full_scales * configuration.machine.sensor.full_scale_mv
    for number, source in enumerate(configuration.signals.sources.impact):
        name = impact_name(number)
        where, entry = f"{log}: {name}", seen[name]
        if entry.low is not None and entry.high is not None and not (entry.low <= most_mv and entry.high >= -most_mv):
            expected = f"samples within {most_mv:g} mV of the cell's zero; look at unit and scale"
            found.append((where, f"{entry.low:.6g} to {entry.high:.6g} mV", expected))
        if entry.rate_hz is not None and abs(entry.rate_hz / source.rate_hz - 1.0) > RATE_TOLERANCE:
            slip = unit_slip(source.rate_hz, entry.rate_hz)
            expected = f"{source.rate_hz:g}, as mapped{'; ' if slip else ''}{slip}"
            found.append((where, f"{entry.rate_hz:.4g} samples per second", expected))
    return found


def _speed_is_counted(configuration: Configuration) -> bool:
    """Whether the elevator's speed is made of a counter of pulses."""
    return any(group.pulses for group in configuration.signals.groups)


def _angle_problems(machine: Machine, seen: dict[str, QuantitySeen], log: str) -> list[Problem]:
    """Of a plate that is never near an angle that it can have."""
    entry = seen.get("plate_angle")
    if entry is None or entry.low is None or entry.high is None:
        return []
    least, most = degrees(machine.min_plate_angle_rad), degrees(machine.max_plate_angle_rad)
    if entry.low <= most + ANGLE_MARGIN_DEG and entry.high >= least - ANGLE_MARGIN_DEG:
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
            f"look at unit, scale, ratio and pulses_per_turn{_COUNTED_ANEW if _speed_is_counted(configuration) else ''}"
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
            name = signal if number is None else impact_name(int(number[1]))
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
        name = impact_name(number)
        entry = seen[name]
        if entry.low is None or entry.high is None:
            continue
        if entry.high > full_mv or entry.low < -_LEAST_SHARE * full_mv:
            found.append(
                f"{name} goes from {entry.low:.6g} to {entry.high:.6g} mV; a cell of {full_mv:g} mV (full_scale_mv of the "
                "machine file) counts as saturated from there on: look at unit, scale, sign and byte order (@0 or @1 in the DBC)"
            )
        most_n = configuration.machine.sensor.gain_n_per_mv * (entry.high - entry.low)
        # A cell that says one value is told by the faults.
        if 0.0 < most_n < _LEAST_PULSES_N:
            found.append(
                f"{name} stays from {entry.low:.4g} to {entry.high:.4g} mV, {most_n:.2g} N, less than any grain's: if the "
                "machine harvested, look at unit and scale, and gain_n_per_mv of the machine file"
            )
        wide = entry.high - entry.low > 0.5 * full_mv
        if wide and source.rate_hz >= _SMOOTH_HZ and entry.step_share is not None and entry.step_share > _JUMPING:
            found.append(
                f"{name} jumps by {100.0 * entry.step_share:.0f} % of its range from one sample to the next, as no force does: "
                "look at start bit, byte order (@0 or @1 in the DBC) and sign of its signal"
            )
        if entry.floor_share > 0.0:
            found.append(
                f"{name} is at its lowest value, {entry.low:.4g} mV, in {100.0 * entry.floor_share:.0f} % of its samples: if "
                "amplifier or converter end there, they cut vibration off, and the zero is wrong; raise the zero-load voltage"
            )
        if entry.counter_flaw:
            found.append(f"{name}'s counter {entry.counter_flaw}")
    return found + _one_sensor_twice(configuration, seen)


def _one_sensor_twice(configuration: Configuration, seen: dict[str, QuantitySeen]) -> list[str]:
    """Of impact sensors that say the same."""
    found = []
    entries = [(name, seen[name]) for name in map(impact_name, range(len(configuration.signals.sources.impact)))]
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
