"""How well a signal that was seen on a bus fits a quantity: by its name, unit, rate, width and range."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from yieldmon.bus.databases import SignalBits
from yieldmon.engine.sources import QUANTITIES
from yieldmon.signals.binding import IMPACT, MIN_RATE_HZ
from yieldmon.signals.survey import MessageSeen, SignalSeen
from yieldmon.signals.units import factor, likely, period_s, zero
from yieldmon.units import KG_PER_LB

_LEAST_OF_RATE = 0.95
"""A rate that is measured over a short recording may be a little low."""

_FORCE_IN_GERMAN = r"kraft(?!stoff|maschine)|w(ae|ä)ge|wiege"
HINTS: Mapping[str, str] = {
    "impact_voltage": rf"impact|sample|bridge|strain|force|load.?cell|volt|count|analog|ain|{_FORCE_IN_GERMAN}",
    "impact_force": rf"impact|force|load|{_FORCE_IN_GERMAN}",
    "elevator_speed": r"elev|shaft|speed|rpm|rev",
    "plate_angle": r"plate|angle|tilt|incl(?!u)|actuator|position|winkel",
    "actuator_state": r"actuator.*(state|status)|plate.*(state|status)",
    "moisture": r"moist|feucht",
    "grain_temperature": r"(grain|crop).?temp",
    "test_weight": r"test.?weight|density",
    "thousand_kernel_weight": r"kernel",
    "tank_mass": r"tank|mass|weight|gewicht",
    "tank_scale_status": r"(tank|scale).*(state|status)",
    "header_down": r"header",
    "work_state": r"work",
    "unloading": r"unload|auger",
    "course": r"course|bearing|heading|compass|(^|_)cog(_|$)|kurs(?!or)",
    "ground_speed": r"speed|(^|_)sog(_|$)",
    "latitude": r"latitude|(^|_|gps|pos)lat(_|$)|breite(ngrad|$)",
    "longitude": r"longitude|(^|_|gps|pos)long?(_|$)|l(ae|ä)nge(ngrad|$)",
}
_BY_UNIT = frozenset({"elevator_speed", "plate_angle", "test_weight", "tank_mass"})
"""Quantities whose unit says enough for a guess where no name does."""
WEAK = 0.25
"""Score of such a guess; every other one is higher."""
_PULSES = re.compile(r"pulse|hall|tooth|teeth|encoder", re.IGNORECASE)
"""Names of counters of a shaft's pulses."""
_FREQUENCY = re.compile(rf"{_PULSES.pattern}|hertz|freq", re.IGNORECASE)
"""Names of their frequency."""
_LONGEST_PERIOD_S = 2.0
"""Between two pulses of an elevator's shaft."""
_MOST_TURNS_HZ = 15.0
"""More than an elevator's shaft makes."""
_BETWEEN_NAMED_AND_ELSEWHERE = 1.75
"""Score of such a counter: an engine's speed is less likely the elevator's, one that is named so is more."""
_LEAST_BITS = 8
"""Of a sample that is named so, or a counter."""
FAST_HZ, _LEAST_BITS_OF_A_NUMBER = 9.0, 10
"""Rate from which on frames of a maker's own may be an impact sensor's, and bits of a sample without a name or a unit."""
STANDS_OUT = 1.5
"""A signal that moves so many times as much as the next one is likelier the impact sensor's."""
BARE = ("", "%")
"""Units of such a sample."""
_GAUGE_HZ = 50.0
_GAUGE, _SCALE = (
    re.compile(rf"impact|force|load|cell|weight|plate|{_FORCE_IN_GERMAN}", re.IGNORECASE),
    re.compile(r"tank|bin|hopper|axle|achse", re.IGNORECASE),
)
"""A force in kg or lb: names of a gauge that sends so many values per second, and of scales, which none is."""
_NO_SAMPLES = re.compile(r"counter|status|alive|sequence|checksum|crc", re.IGNORECASE)
_COUNTER, _MOST_OF_A_COUNTER = re.compile(r"cnt|ctr|roll", re.IGNORECASE), 8
"""Names and bits of counters of messages, where longer signals with such names may be a converter's counts."""
CHANNELS = re.compile(r"(input|chan(nel)?|ch|ain|port)_?\d+", re.IGNORECASE)
"""Numbered signals of one frame that are sensors of their own, not samples of one."""
_ELEVATOR, _SHAFTS_ELSEWHERE = (
    re.compile(r"elev", re.IGNORECASE),
    re.compile(
        r"engine|pto|front|rear|feeder|tailing|return|rotor|drum|cylinder|thresh|beater|fan|blower|chopper|spreader|straw|header|reel"
        r"|knife|auger|sieve|shoe|conveyor|wheel",
        re.IGNORECASE,
    ),
)
"""Names of the elevator's shaft, and of shafts that are not that of the clean grain elevator."""
_OF_ANOTHER_ELEVATOR = re.compile(r"tailing|return", re.IGNORECASE)
_IMPACT_PLATE, _ANGLES_ELSEWHERE = (
    re.compile(r"impact", re.IGNORECASE),
    re.compile(
        r"steer|header|reel|chopper|spreader|straw|deflector|sieve|concave|hitch|spout|auger|unload|feeder|wheel|slope",
        re.IGNORECASE,
    ),
)
"""Names of the impact plate, and of parts that are none."""
_VOLTAGES_ELSEWHERE = re.compile(r"batter|supply|ignition|refer|vref|lamp|loss", re.IGNORECASE)
"""Names of voltages that are not the impact sensor's; a grain loss sensor's are much alike."""
_NAMED_BETTER = 0.2


def score(quantity: str, message: MessageSeen, signal: SignalSeen, rate_hz: float) -> float:
    """How well a signal that comes at this rate fits a quantity; 0: not at all."""
    if not np.isfinite(signal.low):
        return 0.0
    hint = re.compile(HINTS[quantity], re.IGNORECASE)
    named, message_named = hint.search(signal.bits.name) is not None, hint.search(message.name or "") is not None
    if quantity in IMPACT:
        return _impact_score(quantity, message, signal, rate_hz, 1.0 * named + 0.5 * message_named)
    if quantity == "tank_mass" and _may_be_gauge(f"{message.name} {signal.bits.name}", signal.bits.unit, rate_hz):
        return 0.0
    if QUANTITIES[quantity].unit == "":
        return 2.0 if named and signal.bits.unit == "" and signal.bits.bits <= 8 else 0.0
    return _slow_score(quantity, message.name or "", rate_hz, signal, named, message_named)


def counts_pulses(bits: SignalBits) -> bool:
    """Whether a signal is named like a counter of a shaft's pulses."""
    return bits.unit == "" and bits.kind != "float" and bits.bits >= _LEAST_BITS and _PULSES.search(bits.name) is not None


def is_of_pulses(unit: str, high: float) -> bool:
    """Whether a speed with this unit and highest value is a frequency of pulses."""
    return bool(unit) and factor("rpm", unit) == factor("rpm", "Hz") and high > _MOST_TURNS_HZ


def force_unit(unit: str) -> str | None:
    """That of a force where a gauge says how much it weighs; None for a unit that is none of a mass in kg or lb."""
    of_mass = factor("kg", unit)
    return {1.0: "kgf", KG_PER_LB: "lbf"}.get(of_mass) if of_mass is not None else None


def _may_be_gauge(names: str, unit: str, rate_hz: float) -> bool:
    """Whether a mass comes too often for that of a tank."""
    return force_unit(unit) is not None and rate_hz >= _LEAST_OF_RATE * _GAUGE_HZ and _SCALE.search(names) is None


def is_makers_own(group: int | None) -> bool:
    """Whether what a group means is its maker's to say: 11-bit identifiers, Proprietary A, A2 and B."""
    return group is None or group in (0xEF00, 0x1EF00) or group & 0xFF00 == 0xFF00


def _samples(message: MessageSeen, bits: SignalBits) -> int:
    """Signals of a message that are numbered like this one, as an impact sensor's samples are."""
    stem = bits.name.rstrip("0123456789")
    if stem == bits.name or CHANNELS.fullmatch(bits.name):
        return 1
    others = (signal.bits for signal in message.signals.values())
    return sum(other.name.rstrip("0123456789") == stem and other.unit == bits.unit for other in others)


def _impact_score(quantity: str, message: MessageSeen, signal: SignalSeen, rate_hz: float, named: float) -> float:
    bits = signal.bits
    if (
        rate_hz * _samples(message, bits) < _LEAST_OF_RATE * MIN_RATE_HZ
        or bits.bits < _LEAST_BITS
        or _NO_SAMPLES.search(bits.name)
        or (bits.bits <= _MOST_OF_A_COUNTER and _COUNTER.search(bits.name))
        or counts_pulses(bits)
    ):
        return 0.0
    fits, names = bits.unit != "" and factor(IMPACT[quantity], bits.unit) is not None, f"{message.name} {bits.name}"
    if quantity == "impact_force" and _may_be_gauge(names, bits.unit, rate_hz):
        if _GAUGE.search(names) is None:
            return WEAK
        fits = True
    plain = bits.unit == "" and quantity == "impact_voltage" and named > 0.0
    # Grain makes an impact sensor's signal move more than any other.
    moves = (signal.high - signal.low) / max(abs(signal.high), abs(signal.low), 1e-9)
    bare = bits.unit in BARE and quantity == "impact_voltage" and bits.bits >= _LEAST_BITS_OF_A_NUMBER
    if bare and not plain and rate_hz >= FAST_HZ and is_makers_own(message.group) and signal.high > signal.low:
        return WEAK * (0.9 + 0.1 * min(moves, 1.0))
    if not (fits or plain):
        return 0.0
    if _VOLTAGES_ELSEWHERE.search(bits.name):
        return WEAK * 0.5
    return 2.0 * fits + named + 0.25 * (moves > 0.0) + 0.01 * moves + rate_hz * 1e-6


def _slow_score(quantity: str, message: str, rate_hz: float, signal: SignalSeen, named: bool, message_named: bool) -> float:
    speed = quantity == "elevator_speed"
    if speed and (of_pulses := _pulses_score(signal)) is not None:
        return of_pulses
    own, unit = QUANTITIES[quantity].unit, likely(signal.bits.unit)
    found = factor(own, unit) if unit else None
    if found is None or not QUANTITIES[quantity].usable(signal.last * found + zero(own, unit)):
        return 0.0
    others = [other for other in HINTS if other != quantity and re.search(HINTS[other], signal.bits.name, re.IGNORECASE)]
    elsewhere = bool(others)
    if not named and any(other not in IMPACT and QUANTITIES[other].unit == QUANTITIES[quantity].unit for other in others):
        # As the latitude in a message VehiclePosition is no position of the plate.
        return 0.0
    if not (named or message_named):
        # Of two, what is measured with comes more often.
        return WEAK * (0.9 + 0.001 * min(rate_hz, 100.0)) if quantity in _BY_UNIT and not elsewhere else 0.0
    if quantity == "plate_angle" and _names(_ANGLES_ELSEWHERE, _IMPACT_PLATE, message, signal.bits.name):
        return WEAK
    shaft = speed and of_another_shaft(message, signal.bits.name)
    part = {"elevator_speed": _ELEVATOR, "plate_angle": _IMPACT_PLATE}.get(quantity)
    better = part is not None and not shaft and part.search(f"{message} {signal.bits.name}") is not None
    return 1.0 + named - 0.5 * shaft + _NAMED_BETTER * better + min(rate_hz, 100.0) * 1e-6


def _pulses_score(signal: SignalSeen) -> float | None:
    """Of a count, a frequency or a period of a shaft's pulses; None for a signal that is none of these."""
    bits = signal.bits
    if counts_pulses(bits):
        return _BETWEEN_NAMED_AND_ELSEWHERE if signal.high > signal.low else 0.0
    if is_of_pulses(bits.unit, signal.high):
        return _BETWEEN_NAMED_AND_ELSEWHERE if _FREQUENCY.search(bits.name) else WEAK
    if (unit_s := period_s(bits.unit)) is None:
        return None
    named = _PULSES.search(bits.name) is not None or _ELEVATOR.search(bits.name) is not None
    return _BETWEEN_NAMED_AND_ELSEWHERE if named and 0.0 < signal.last * unit_s < _LONGEST_PERIOD_S else 0.0


def of_another_shaft(message: str, signal: str) -> bool:
    """Whether a speed is named like that of a shaft which is not the clean grain elevator's.

    >>> [of_another_shaft(*names) for names in (("Speeds", "TailingsElevatorSpeed"), ("Rotor", "Speed"), ("Speeds", "Shaft"))]
    [True, True, False]
    """
    if _OF_ANOTHER_ELEVATOR.search(signal):
        return True
    return _names(_SHAFTS_ELSEWHERE, _ELEVATOR, message, signal)


def _names(others: re.Pattern[str], own: re.Pattern[str], message: str, signal: str) -> bool:
    """Whether a signal, or else its message, is named like one of another part of the machine, and not as what is looked for."""
    if own.search(signal):
        return False
    return others.search(signal) is not None or (others.search(message) is not None and not own.search(message))
