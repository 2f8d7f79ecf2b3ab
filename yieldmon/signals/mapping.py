"""A mapping: bindings held against their DBC files, as the engine's sources and a decoder of the frames that they name.

Each message that is bound (with one source and one multiplexer value) is a `Group`; its frames reach the engine as a `Frame` of
the group's name whose signals are the quantities, in the quantities' own units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from yieldmon.bus.databases import MessageBits, SignalBits
from yieldmon.engine.sources import DEFAULT_SOURCES, QUANTITIES, InputSource, SampleSource, Sources
from yieldmon.errors import InputError
from yieldmon.identifiers import GROUP_MASK, IDENTITY_MASK, NULL_ADDRESS
from yieldmon.network.assembly import MAX_BYTES
from yieldmon.physics.machine import RPM, Machine
from yieldmon.signals.binding import IMPACT, Binding, Source, check, check_source, named_message, named_signal
from yieldmon.signals.extraction import Extraction, named_no_value
from yieldmon.signals.units import accepted, factor, may_be, period_s, zero

Pages = tuple[tuple[Extraction, tuple[int, ...]], ...]
Load = Callable[[str], Mapping[str, MessageBits]]
"""Reads the DBC of that name; raises InputError."""


_MOST_IN_A_FRAME = 64
_HZ = 60.0
"""Turns per minute."""
_NEEDS_SCALE = {"counts": "millivolts per count", "mV/V": "volts that feed the bridge"}


@dataclass(frozen=True, slots=True)
class Pulses:
    """A signal of a group that counts pulses, and the quantity made of it. modulus, values: where the counter turns by the DBC's
    range, and how many values it can have. longest_s: between frames; over longer times two speeds that are measured give one
    count."""

    signal: str
    pulses_per_turn: float
    factor: float
    modulus: int
    values: int
    longest_s: float


@dataclass(frozen=True)
class Group:
    """The bound signals of one message. name: of the frames that reach the engine. pages: multiplexers, and signals that say
    whether others are valid, and the values that they have in frames that are taken."""

    name: str
    message: MessageBits
    source: Source
    pages: Pages
    signals: Mapping[str, Extraction]
    pulses: tuple[Pulses, ...] = ()


@dataclass(frozen=True)
class SignalMap:
    """A mapping ready for use. sources: for the engine, with the default's for what is not mapped."""

    sources: Sources
    groups: tuple[Group, ...]
    bindings: tuple[Binding, ...] = ()

    @property
    def own_messages(self) -> frozenset[str]:
        """Messages that the engine still takes from the shipped DBC."""
        return frozenset(self.sources.messages) - {group.name for group in self.groups}


@dataclass
class _Draft:
    """A group under construction."""

    name: str
    message: MessageBits
    source: Source
    pages: Pages
    signals: dict[str, Extraction] = field(default_factory=dict)
    pulses: list[Pulses] = field(default_factory=list)


def build(
    bindings: Sequence[Binding],
    load: Load,
    machine: Machine,
    *,
    switched_off: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
) -> SignalMap:
    """The mapping of these bindings.

    Parameters
    ----------
    bindings
        A quantity each; an impact sensor may have several.
    load
        Reads a DBC by the name that the bindings give.
    machine
        For the sensor's gain: newtons become millivolts.
    switched_off
        Quantities that are not taken in at all.
    fixed
        Quantities that nothing measures, with their value.

    Raises
    ------
    InputError
        One line: the key, what is wrong, what was expected.
    """
    drafts: dict[tuple[object, ...], _Draft] = {}
    impact: list[SampleSource] = []
    inputs: list[InputSource] = []
    constants = dict(fixed or {})
    bound: list[tuple[Binding, _Draft, SignalBits]] = []
    _check_overlaps(bindings)
    for binding in bindings:
        check(binding)
        if binding.value is not None:
            constants[binding.quantity] = binding.value * _unit_factor(binding, "") + _zero(binding, "")
            continue
        messages = load(binding.dbc or "")
        message = _message(binding, messages)
        pages = _pages(binding, message)
        key = (binding.dbc or "", message.name, str(binding.source), *((page.bits.name, values) for page, values in pages))
        if key not in drafts:
            name = f"{message.name}/{len(drafts) + 1}"
            drafts[key] = _Draft(name, message, binding.source, pages)
        if binding.is_impact:
            impact.append(_impact(binding, drafts[key], len(impact), machine))
        else:
            inputs.append(_input(binding, drafts[key], machine))
        _check_bits(binding, drafts[key], bound)
    taken = {binding.quantity for binding in bindings} | set(switched_off) | set(constants)
    defaults = tuple(source for source in DEFAULT_SOURCES.inputs if source.quantity not in taken)
    sources = Sources(tuple(impact) or DEFAULT_SOURCES.impact, (*inputs, *defaults), constants)
    groups = tuple(Group(d.name, d.message, d.source, d.pages, d.signals, tuple(d.pulses)) for d in drafts.values())
    return SignalMap(sources, groups, tuple(bindings))


def _check_overlaps(bindings: Sequence[Binding]) -> None:
    """One signal of one message of one source serves one quantity."""
    seen: dict[tuple[object, ...], Binding] = {}
    for binding in bindings:
        if binding.message is None or binding.value is not None:
            continue
        beside = (binding.counter, binding.status) if binding.is_impact else ()
        for signal in (*binding.signals, *filter(None, beside)):
            key = (binding.dbc, binding.message, signal, str(binding.source), binding.mux)
            if key in seen and (signal in binding.signals or seen[key] is binding):
                raise binding.refuse("signal", f"{signal} is bound to {seen[key].quantity} as well", "a signal of its own")
            seen[key] = binding


def _check_bits(binding: Binding, draft: _Draft, bound: list[tuple[Binding, _Draft, SignalBits]]) -> None:
    """The same for frames that two DBC files name. Adds the binding's signals to those that are bound."""
    mine = [draft.message.signals[name] for name in binding.signals]
    for other, theirs, signal in bound:
        if other is binding or _frames_of(draft) != _frames_of(theirs) or _never_together(draft.pages, theirs.pages):
            continue
        same = next((one for one in mine if one.places & signal.places), None)
        if same is not None:
            problem = f"{same.name} has bits that are bound to {other.quantity} as {theirs.message.name}.{signal.name}"
            raise binding.refuse("signal", problem, "a signal of its own")
    bound += [(binding, draft, signal) for signal in mine]


def _frames_of(draft: _Draft) -> tuple[object, ...]:
    message = draft.message
    if not message.extended:
        return (message.frame_id,)
    from_all = any_source(draft.source, message)
    group = message.frame_id & (IDENTITY_MASK if draft.source is None and not from_all else GROUP_MASK)
    return group, "any" if from_all else str(draft.source)


def _never_together(pages: Pages, others: Pages) -> bool:
    values = {page.bits.places: set(wanted) for page, wanted in pages}
    return any(not values[page.bits.places] & set(wanted) for page, wanted in others if page.bits.places in values)


def _message(binding: Binding, messages: Mapping[str, MessageBits]) -> MessageBits:
    assert binding.message is not None, "checked"
    message = named_message(binding.message, binding.dbc, messages, binding.refuse)
    alike = [m.name for m in messages.values() if (m.frame_id, m.extended) == (message.frame_id, message.extended)]
    if len(alike) > 1:
        problem = f"{' and '.join(alike)} have one identifier, 0x{message.frame_id:X}"
        raise binding.refuse("message", problem, "a DBC with one message for each")
    longest, of_what = (MAX_BYTES, "the transport protocol") if message.extended else (_MOST_IN_A_FRAME, "CAN FD")
    if message.length > longest:
        problem = f"{message.name} has {message.length} bytes"
        raise binding.refuse("message", problem, f"at most {longest} bytes, as {of_what} carries them with its identifier")
    check_source(binding.source, message, binding.refuse)
    return message


def _named(binding: Binding, message: MessageBits, name: str, key: str) -> SignalBits:
    signal = named_signal(name, key, message, binding.refuse)
    if not signal.readable:
        problem = f"{name} has {signal.bits} bits from bit {signal.shift} of its first byte on"
        raise binding.refuse(key, problem, "a number that lies within eight bytes")
    return signal


def _signal(binding: Binding, message: MessageBits, name: str, key: str = "signal") -> SignalBits:
    signal = _named(binding, message, name, key)
    for flag, values in binding.valid.items():
        for raw in values:
            _raw(binding, message.signals[flag], "valid", raw)
        if flag in binding.signals:
            raise binding.refuse("valid", f"{flag} is the signal itself", "another signal of the message; for its own: range")
    taken = {page.bits.name: values for page, values in _pages(binding, message)}
    for above, values in message.pages(signal):
        wanted = set(taken.get(above.name, ()))
        if not wanted or not wanted <= set(values):
            given = any_of(binding.mux) if binding.mux else "is missing"
            several = ", or several of them as a list" if len(values) > 1 else ""
            expected = f"{any_of(values)}, the multiplexer value with which {name} is sent{several}"
            raise binding.refuse("mux", given, expected if message.multiplexer == above.name else f"{expected} ({above.name})")
    return signal


def any_of(values: Sequence[int]) -> str:
    """Whole numbers as a message lists them."""
    return " or ".join(map(str, values)) if len(values) < 5 else f"{values[0]}, {values[1]} ... or {values[-1]}"


def _pages(binding: Binding, message: MessageBits) -> Pages:
    """The multiplexer above the binding's signal with the value that is given, those above it as the DBC has them, and the
    signals that say whether it is valid."""
    return _multiplexers(binding, message) + tuple(
        (Extraction(_named(binding, message, name, "valid"), 1.0, 0.0), tuple(values)) for name, values in binding.valid.items()
    )


def _multiplexers(binding: Binding, message: MessageBits) -> Pages:
    if not binding.mux:
        return ()
    signal = message.signals.get(binding.signals[0])
    by = signal.mux_by if signal is not None and signal.mux_by is not None else message.multiplexer
    if by is None:
        raise binding.refuse("mux", any_of(binding.mux), f"no such key: {message.name} has no multiplexer")
    above = message.signals[by]
    if max(binding.mux) >= 1 << above.bits:
        raise binding.refuse("mux", f"{max(binding.mux)}", f"0 to {(1 << above.bits) - 1}, what {above.name} can say")
    pages = [(above, binding.mux), *message.pages(above)]
    return tuple((Extraction(page, 1.0, 0.0), values) for page, values in pages)


def _unit_factor(binding: Binding, unit_of_dbc: str) -> float:
    """Factor from the binding's unit into the quantity's."""
    wanted = IMPACT[binding.quantity] if binding.is_impact else QUANTITIES[binding.quantity].unit
    unit = binding.unit if binding.unit is not None else unit_of_dbc
    if unit == "" and not binding.is_impact:
        return 1.0
    if unit == "":
        raise binding.refuse("unit", "is missing, and the DBC names none", f"one of {accepted(wanted)}")
    if unit in _NEEDS_SCALE and binding.scale == 1.0:
        raise binding.refuse("scale", "is missing, or 1", f"{_NEEDS_SCALE[unit]}, with unit {unit} (where it is 1: unit mV)")
    found = factor(wanted, unit)
    if found is None and binding.unit is None and wanted == "":
        return 1.0
    if found is None:
        said = (f"{unit!r}" if binding.unit is not None else f"is {unit!r} in the DBC") + may_be(unit)
        known = (
            f"{accepted(wanted)}, or s, ms, us between two pulses" if binding.quantity == "elevator_speed" else accepted(wanted)
        )
        raise binding.refuse("unit", said, f"one of {known} for {binding.quantity}" if wanted else "no unit")
    return found


def _zero(binding: Binding, unit_of_dbc: str) -> float:
    """The quantity at 0 of the binding's unit, which differs from 0 for °F and K."""
    wanted = IMPACT[binding.quantity] if binding.is_impact else QUANTITIES[binding.quantity].unit
    return zero(wanted, binding.unit if binding.unit is not None else unit_of_dbc)


def _extraction(binding: Binding, signal: SignalBits, into: float = 1.0) -> Extraction:
    """Of a value in the quantity's unit times `into`."""
    absent = _not_available(binding, signal)
    if binding.values:
        codes = tuple((_raw(binding, signal, "values", raw), float(code)) for raw, code in binding.values.items())
        return Extraction(signal, 1.0, 0.0, not_available=absent, codes=codes)
    found = _unit_factor(binding, signal.unit) * into
    return Extraction(
        bits=signal,
        scale=signal.scale * (binding.scale * binding.ratio) * found,
        offset=(signal.offset * (binding.scale * binding.ratio) + binding.offset) * found + _zero(binding, signal.unit) * into,
        low=float("-inf") if binding.low is None else binding.low * into,
        high=float("inf") if binding.high is None else binding.high * into,
        not_available=absent,
    )


def _not_available(binding: Binding, signal: SignalBits) -> frozenset[int]:
    """Raw values that the binding says mean it and, of a measurement, those that the DBC's value table names so."""
    given = frozenset(_raw(binding, signal, "not_available", raw) for raw in binding.not_available)
    measured = binding.is_impact or QUANTITIES[binding.quantity].unit != ""
    return given | named_no_value(signal) if measured else given


def _raw(binding: Binding, signal: SignalBits, key: str, raw: int) -> int:
    """A raw value as frames give it; of a signed signal the pattern of its bits, such as 65535, means the same."""
    signed = signal.kind == "int"
    if not -(1 << signal.bits - 1) * signed <= raw < 1 << signal.bits:
        lowest = -(1 << signal.bits - 1) if signed else 0
        raise binding.refuse(key, f"{raw}", f"raw values from {lowest} to {(1 << signal.bits) - 1}, what {signal.name} can say")
    return raw - (1 << signal.bits) if signed and raw >= 1 << signal.bits - 1 else raw


def _impact(binding: Binding, draft: _Draft, number: int, machine: Machine) -> SampleSource:
    assert binding.rate_hz is not None, "checked"
    into_mv = 1.0 / machine.sensor.gain_n_per_mv if binding.quantity == "impact_force" else 1.0
    names = []
    for index, name in enumerate(binding.signals):
        signal = _signal(binding, draft.message, name, "signals" if len(binding.signals) > 1 else "signal")
        names.append(f"impact{number}.{index}")
        draft.signals[names[-1]] = _extraction(binding, signal, into_mv)
    counter = status = None
    modulus = values = 256
    if binding.counter is not None:
        found = _signal(binding, draft.message, binding.counter, "counter")
        counter, modulus, values = f"impact{number}.counter", found.turns_at, 1 << found.bits
        draft.signals[counter] = Extraction(replace(found, raw_max=None), 1.0, 0.0)
    if binding.status is not None:
        found = _signal(binding, draft.message, binding.status, "status")
        status = f"impact{number}.status"
        draft.signals[status] = Extraction(found, 1.0, 0.0)
    return SampleSource(
        message=draft.name,
        signals=tuple(names),
        interval_s=1.0 / binding.rate_hz,
        counter=counter,
        counter_modulus=modulus,
        counter_values=values,
        status=status,
        time_constant_s=binding.time_constant_s,
    )


def _input(binding: Binding, draft: _Draft, machine: Machine) -> InputSource:
    signal = _signal(binding, draft.message, binding.signals[0])
    unit = signal.unit if binding.unit is None else binding.unit
    of_speed = factor("rpm", unit)
    if binding.quantity == "elevator_speed" and (second := period_s(unit)) is not None:
        extraction = _of_period(binding, signal, second)
    elif binding.pulses_per_turn is None:
        extraction = _extraction(binding, signal)
    elif of_speed == _HZ:
        extraction = _extraction(binding, signal, 1.0 / binding.pulses_per_turn)
    elif of_speed is not None and binding.unit is None:
        raise binding.refuse("pulses_per_turn", f"{signal.name} is in {unit}", "no such key for a speed")
    else:
        extraction = _count(binding, signal, draft, binding.pulses_per_turn, machine)
    draft.signals[binding.quantity] = extraction
    return InputSource(binding.quantity, draft.name, binding.quantity)


def _of_period(binding: Binding, signal: SignalBits, second: float) -> Extraction:
    """Of a signal that is the time between two pulses. second: seconds of its unit."""
    pulses_per_turn = 1.0 if binding.pulses_per_turn is None else binding.pulses_per_turn
    return Extraction(
        bits=signal,
        scale=signal.scale * binding.scale * second,
        offset=(signal.offset * binding.scale + binding.offset) * second,
        low=float("-inf") if binding.low is None else binding.low,
        high=float("inf") if binding.high is None else binding.high,
        not_available=_not_available(binding, signal),
        over=_HZ / pulses_per_turn * binding.ratio,
    )


def _count(binding: Binding, signal: SignalBits, draft: _Draft, pulses_per_turn: float, machine: Machine) -> Extraction:
    """Of a signal that counts pulses; its DBC may give it a factor."""
    if signal.kind == "float":
        raise binding.refuse("signal", f"{signal.name} is a floating-point number", "a counter of pulses")
    into = binding.scale * binding.ratio * signal.scale
    measured_rpm = (machine.max_elevator_speed_rad_s - machine.min_elevator_speed_rad_s) / RPM
    longest_s = signal.turns_at * _HZ * abs(into) / (measured_rpm * pulses_per_turn)
    draft.pulses.append(Pulses(binding.quantity, pulses_per_turn, into, signal.turns_at, 1 << signal.bits, longest_s))
    absent = _not_available(binding, signal)
    return Extraction(replace(signal, raw_max=None), 1.0, 0.0, not_available=absent)


def default_map(*, fixed: Mapping[str, float] | None = None) -> SignalMap:
    """The shipped DBC's own messages. fixed: quantities that nothing measures."""
    constants = dict(fixed or {})
    inputs = tuple(source for source in DEFAULT_SOURCES.inputs if source.quantity not in constants)
    return SignalMap(Sources(DEFAULT_SOURCES.impact, inputs, constants), ())


def any_source(source: Source, message: MessageBits) -> bool:
    """Whether every node may send a group's frames."""
    return source == "any" or (source is None and message.extended and message.frame_id & 0xFF == NULL_ADDRESS)


__all__ = ["Group", "InputError", "Load", "Pulses", "SignalMap", "any_of", "any_source", "build", "default_map"]
