"""One line of a mapping: which signal brings a quantity. All that is wrong with it is said in one line that names the key."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from yieldmon.bus.databases import SOUND_MESSAGE, MessageBits, SignalBits, with_identifier
from yieldmon.engine.sources import QUANTITIES
from yieldmon.errors import InputError
from yieldmon.network.name import NameMatch
from yieldmon.signals.units import factor, period_s

IMPACT = {"impact_voltage": "mV", "impact_force": "N"}
"""The two ways in which an impact sensor speaks, and their units."""
BINDABLE = (*IMPACT, *QUANTITIES)
MIN_RATE_HZ, MAX_RATE_HZ = 10.0, 5000.0
OF_SAMPLES = ("rate_hz", "spacing_ms", "counter", "status", "time_constant_s")
"""Keys of an impact sensor's samples."""
NO_SAMPLES = "no such key here; it belongs to impact samples"
_LOOKS = 1000
"""Steps in which a range is searched for a value that can be true."""

Source = str | int | NameMatch | None
"""None: as the DBC's identifier says; "any"; an address; the NAME of a node."""
Refuse = Callable[[str, str, str], InputError]
"""Makes the error that names a key of a binding: key, problem, what was expected; see `Binding.refuse`."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of a mapping. where: its place in the configuration, for errors."""

    where: str

    def refuse(self, key: str, problem: str, expected: str) -> InputError:
        """The error that names a key of this entry; "": the entry itself."""
        return InputError(f"{self.where}.{key}" if key else self.where, problem, expected)


@dataclass(frozen=True, slots=True)
class Binding(Entry):
    """Where a quantity comes from.

    value: a constant, and nothing is bound. signals: one, or for impact
    samples several of one frame, oldest first. scale, offset: value = physical value of the DBC * scale + offset, in `unit`
    (None: the DBC's). ratio: a further factor, of speeds. source: see `Source`. mux: values of the message's multiplexer, with
    each of which it is sent; empty: it has none. valid: other signals of the message -> their raw values, without which there
    is no value. low, high: range in the quantity's unit in which a value can be true. not_available: raw values that mean it.
    values: raw value -> the quantity's code. rate_hz: impact samples per second. counter, status: signals of the same message.
    pulses_per_turn: the signal counts pulses of a turning shaft, or is their frequency or the time between two.
    time_constant_s: of a filter in the sensor.
    """

    quantity: str
    dbc: str | None = None
    message: str | None = None
    signals: tuple[str, ...] = ()
    scale: float = 1.0
    ratio: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    source: Source = None
    mux: tuple[int, ...] = ()
    valid: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    low: float | None = None
    high: float | None = None
    not_available: tuple[int, ...] = ()
    values: Mapping[int, int] = field(default_factory=dict)
    rate_hz: float | None = None
    counter: str | None = None
    status: str | None = None
    pulses_per_turn: float | None = None
    time_constant_s: float = 0.0
    value: float | None = None

    @property
    def is_impact(self) -> bool:
        """Whether these are an impact sensor's samples."""
        return self.quantity in IMPACT


def named_message(name: str, dbc: str | None, messages: Mapping[str, MessageBits], refuse: Refuse) -> MessageBits:
    """The message that a binding names. dbc: for the error; "" or None: the shipped one.

    Raises InputError where it is not among the messages, or contradicts itself.
    """
    message, named = messages.get(name), dbc or "the shipped DBC"
    if message is None:
        alike = [other.name for other in messages.values() if with_identifier(name, other.frame_id) == other.name]
        near = alike or difflib.get_close_matches(name, messages, n=3) or sorted(messages)[:5]
        raise refuse("message", f"{name} is not in {named}", f"one of its messages, such as {', '.join(near)}")
    if message.contradiction:
        raise refuse("message", f"in {named}: {message.contradiction}", SOUND_MESSAGE)
    return message


def named_signal(name: str, key: str, message: MessageBits, refuse: Refuse) -> SignalBits:
    """The signal of a message that a key of a binding names. Raises InputError where the message has none of that name."""
    signal = message.signals.get(name)
    if signal is None:
        near = difflib.get_close_matches(name, message.signals, n=3) or list(message.signals)[:5]
        raise refuse(key, f"{name} is not in {message.name}", f"one of its signals, such as {', '.join(near)}")
    return signal


def check_source(source: Source, message: MessageBits, refuse: Refuse) -> None:
    """Raises InputError for the source of a message whose identifier carries none."""
    if source is not None and not message.extended:
        raise refuse("source", f"{message.name} has an 11-bit identifier", "no source; only 29-bit identifiers carry one")


def check_quantity(name: str, where: str) -> None:
    """Raises InputError for a quantity that is not known."""
    if name not in BINDABLE:
        # `speed` is nearer to elevator_speed than to speed_group, which has fewer other letters.
        near = [known for known in BINDABLE if known.endswith(f"_{name}")] or difflib.get_close_matches(name, BINDABLE, n=1)
        raise InputError(where, "unknown quantity", " or ".join(near) or f"one of {', '.join(BINDABLE)}")


def check(binding: Binding) -> None:
    """Raises InputError for keys that do not go together."""
    if binding.value is not None:
        _check_constant(binding, f"{binding.value:g}")
        return
    if binding.message is None:
        raise binding.refuse("message", "is missing", "the name of a message in the DBC, or a constant `value`")
    if not binding.signals:
        raise binding.refuse("signal", "is missing", "the name of a signal of that message")
    if binding.is_impact:
        _check_rate(binding)
    else:
        _check_no_samples(binding)
    if binding.scale == 0.0:
        raise binding.refuse("scale", "0", "a factor other than 0")
    if binding.pulses_per_turn is not None:
        _check_no_effect_on_pulses(binding)
    _check_values(binding)
    if binding.low is not None and binding.high is not None and not binding.is_impact:
        _check_range(binding, binding.low, binding.high)
    if binding.pulses_per_turn is not None and binding.quantity != "elevator_speed":
        raise binding.refuse("pulses_per_turn", f"{binding.pulses_per_turn:g}", "no such key here; it belongs to elevator_speed")


def _check_rate(binding: Binding) -> None:
    if binding.rate_hz is None:
        raise binding.refuse("rate_hz", "is missing", f"samples per second, {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz")
    if not MIN_RATE_HZ <= binding.rate_hz <= MAX_RATE_HZ:
        expected = f"{MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz: no other rate serves an impact sensor"
        raise binding.refuse("rate_hz", f"{binding.rate_hz:g} Hz", expected)


def _check_no_samples(binding: Binding) -> None:
    """No key of an impact sensor's samples."""
    if len(binding.signals) > 1:
        raise binding.refuse("signals", f"{len(binding.signals)} signals", "one `signal`; only impact samples have several")
    of_samples = {key: getattr(binding, key) for key in ("rate_hz", "counter", "status")}
    of_samples["time_constant_s"] = binding.time_constant_s or None
    for key, given in of_samples.items():
        if given is not None:
            raise binding.refuse(key, repr(given), NO_SAMPLES)


def _check_constant(binding: Binding, value: str) -> None:
    if binding.is_impact:
        raise binding.refuse("value", value, "samples: an impact sensor cannot be a constant")
    if binding.quantity == "plate_angle":
        raise binding.refuse("value", value, "a signal; the angle of a bolted plate is plate.fixed_angle_deg")
    if binding.message is not None or binding.signals:
        raise binding.refuse("value", value, "either a constant value or a message and signal")


def _check_no_effect_on_pulses(binding: Binding) -> None:
    """Pulses become rpm and nothing else."""
    refused = {"offset": binding.offset != 0.0, "range": binding.low is not None, "values": bool(binding.values)}
    for key, present in refused.items():
        if present:
            raise binding.refuse(key, "is given together with pulses_per_turn", "no such key for a counter of pulses")
    if binding.unit is not None and factor("rpm", binding.unit) not in (1.0, 60.0) and period_s(binding.unit) is None:
        expected = "no unit or rpm, which a counter of pulses becomes; Hz of a frequency; s, ms or us of the time between two"
        raise binding.refuse("unit", repr(binding.unit), expected)


def _check_values(binding: Binding) -> None:
    """Codes are for states alone, and are those that the state has."""
    if not binding.values:
        return
    quantity = None if binding.is_impact else QUANTITIES[binding.quantity]
    if quantity is None or quantity.unit:
        raise binding.refuse("values", repr(dict(binding.values))[:60], "no such key here; it belongs to states")
    for code in binding.values.values():
        if not quantity.usable(float(code)):
            raise binding.refuse("values", f"the code {code}", f"codes of {binding.quantity}: {quantity.meaning}")


def _check_range(binding: Binding, low: float, high: float) -> None:
    """Some value of the range is one that the quantity can have."""
    quantity = QUANTITIES[binding.quantity]
    share = (high - low) / _LOOKS
    if not any(quantity.usable(low + share * step) for step in range(_LOOKS + 1)):
        given = f"[{low:g}, {high:g}]"
        raise binding.refuse("range", given, f"values that {binding.quantity} can have, {quantity.unit}".rstrip(" ,"))
