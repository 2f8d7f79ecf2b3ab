"""What is sent in messages of other DBC files: bindings of published quantities held against their files, as groups of frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import degrees

from yieldmon.bus.databases import MessageBits, SignalBits
from yieldmon.identifiers import GROUP_MASK, IDENTITY_MASK, NULL_ADDRESS, SOURCE_MASK, group_of
from yieldmon.network.diagnostics import DM1
from yieldmon.network.identifier import (
    ACKNOWLEDGEMENT,
    ADDRESS_CLAIMED,
    REQUEST,
    TRANSPORT_CONNECTION,
    TRANSPORT_DATA,
)
from yieldmon.network.process_data import PROCESS_DATA
from yieldmon.physics.machine import Machine
from yieldmon.signals.binding import Entry, check_source, named_message, named_signal
from yieldmon.signals.mapping import Load, SignalMap, any_of, any_source
from yieldmon.signals.packing import Packing, encoded, span
from yieldmon.signals.published import PUBLISHED, Published
from yieldmon.signals.units import accepted, factor, may_be

OWN = "own"
MIN_PERIOD_MS, MAX_PERIOD_MS = 50.0, 10_000.0
_EXTENDED = 1 << 29
#: Groups by which nodes agree on addresses and long messages.
_OF_THE_NETWORK = {
    ACKNOWLEDGEMENT: "acknowledgement", ADDRESS_CLAIMED: "address claim", REQUEST: "request", PROCESS_DATA: "process data",
    TRANSPORT_CONNECTION: "transport protocol", TRANSPORT_DATA: "transport protocol", DM1: "DM1",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class OutputBinding(Entry):
    """Where a published quantity goes.

    scale, offset: physical value of the DBC = value in `unit` (None: the DBC's)
    * scale + offset. source: an address, "own", or None: our own in J1939 messages and under the null address, else the DBC's.
    mux: value of the message's multiplexer. low, high: range in the quantity's unit that is sent. not_available: raw value that
    means it. values: the quantity's code -> raw value. period_s: time between frames, None: with each new value. constants:
    signals of the same message that have one physical value always.
    """

    quantity: str
    dbc: str
    message: str
    signal: str
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    source: int | str | None = None
    mux: int | None = None
    low: float | None = None
    high: float | None = None
    not_available: int | None = None
    values: Mapping[int, int] = field(default_factory=dict)
    period_s: float | None = None
    constants: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputGroup:
    """Frames of one message. own_address: the identifier's lowest byte is our address. ones: bits that no signal uses are 1."""

    name: str
    frame_id: int
    extended: bool
    own_address: bool
    length: int
    ones: bool
    period_s: float | None
    fixed: tuple[tuple[SignalBits, int], ...]
    quantities: tuple[tuple[str, Packing], ...]


@dataclass(frozen=True)
class OutputMap:
    """All that is sent beside DM1 and the network's own frames. shipped: whether the messages of the shipped DBC are."""

    groups: tuple[OutputGroup, ...] = ()
    shipped: bool = True


@dataclass
class _Draft:
    first: OutputBinding
    message: MessageBits
    bindings: list[OutputBinding] = field(default_factory=list)
    packings: list[tuple[str, Packing]] = field(default_factory=list)
    taken: dict[str, str] = field(default_factory=dict)
    constants: dict[str, float] = field(default_factory=dict)


def build(
    bindings: Sequence[OutputBinding],
    load: Load,
    machine: Machine,
    inputs: SignalMap,
    *,
    shipped: bool = True,
    network: bool = True,
    fixed_plate: bool = False,
) -> OutputMap:
    """The groups of these bindings.

    Parameters
    ----------
    bindings
        A quantity each.
    load
        Reads a DBC by the name that the bindings give.
    machine
        For the range of its plate.
    inputs
        What is taken in, whose identifiers no output may use.
    shipped
        Whether the messages of the shipped DBC are sent as well.
    network
        Whether we claim an address.
    fixed_plate
        Whether the plate is bolted on, so that nothing commands it.

    Raises
    ------
    InputError
        One line: the key, what is wrong, what was expected.
    """
    drafts: dict[tuple[str, str, int | None], _Draft] = {}
    for binding in bindings:
        if fixed_plate and PUBLISHED[binding.quantity].message == PUBLISHED["plate_target_angle"].message:
            raise binding.refuse("", "is bound though plate.fixed_angle_deg is set", "one of the two")
        message = _message(binding, load(binding.dbc))
        draft = drafts.setdefault((binding.dbc, message.name, binding.mux), _Draft(binding, message))
        _agree(binding, draft)
        signal = _signal(binding, message, binding.signal)
        if binding.signal in draft.taken:
            other = draft.taken[binding.signal]
            raise binding.refuse("signal", f"{binding.signal} carries {other} as well", "a signal of its own")
        draft.taken[binding.signal] = binding.quantity
        draft.bindings.append(binding)
        draft.packings.append((binding.quantity, _packing(binding, signal, machine)))
    groups = [_group(draft, network) for draft in drafts.values()]
    _check_identifiers([*zip(drafts.values(), groups, strict=True)], inputs, load(""), shipped=shipped)
    return OutputMap(tuple(groups), shipped)


def _message(binding: OutputBinding, messages: Mapping[str, MessageBits]) -> MessageBits:
    message = named_message(binding.message, binding.dbc, messages, binding.refuse)
    if not 1 <= message.length <= 8:
        expected = "a message of one frame, 1 to 8 bytes: longer ones are not sent in parts"
        raise binding.refuse("message", f"{message.name} has {message.length} bytes", expected)
    if message.multiplexer is not None and binding.mux is None:
        raise binding.refuse("mux", "is missing", f"a value of {message.name}'s multiplexer {message.multiplexer}")
    if message.multiplexer is None and binding.mux is not None:
        raise binding.refuse("mux", f"{binding.mux}", f"no such key: {message.name} has no multiplexer")
    return message


def _signal(binding: OutputBinding, message: MessageBits, name: str, key: str = "signal") -> SignalBits:
    signal = named_signal(name, key, message, binding.refuse)
    if name == message.multiplexer:
        raise binding.refuse(key, f"{name} is the multiplexer of {message.name}", "another signal; mux gives its value")
    if signal.mux_by not in (None, message.multiplexer):
        problem = f"{name} is behind a multiplexer of its own, {signal.mux_by}"
        raise binding.refuse(key, problem, f"a signal under {message.multiplexer} alone")
    if signal.mux and binding.mux not in signal.mux:
        raise binding.refuse("mux", f"{binding.mux}", f"{any_of(signal.mux)}, the multiplexer value with which {name} is sent")
    return signal


def _agree(binding: OutputBinding, draft: _Draft) -> None:
    """Bindings of one message say the same of its frames."""
    first, name = draft.first, binding.message
    for key, mine, theirs in (("source", binding.source, first.source), ("period_ms", binding.period_s, first.period_s)):
        if mine != theirs:
            raise binding.refuse(key, f"is not that of {first.quantity} in {name}", "the same: they are one frame")
    for signal, value in binding.constants.items():
        if draft.constants.setdefault(signal, value) != value:
            expected = f"{draft.constants[signal]:g}, as another quantity of {name} has it"
            raise binding.refuse(f"constants.{signal}", f"{value:g}", expected)


def _packing(binding: OutputBinding, signal: SignalBits, machine: Machine) -> Packing:
    quantity = PUBLISHED[binding.quantity]
    not_available = binding.not_available
    if not_available is None and signal.raw_max is not None:
        not_available = (1 << signal.bits) - 1
    if not_available is not None:
        # Of a signed signal it is named by its number or by its bits, as in `signals`.
        lowest = -(1 << signal.bits - 1) if signal.kind == "int" else 0
        if not lowest <= not_available < 1 << signal.bits:
            expected = f"a raw value of {signal.bits} bits, {lowest} to {(1 << signal.bits) - 1}"
            raise binding.refuse("not_available", f"{not_available}", expected)
        not_available &= (1 << signal.bits) - 1
    if quantity.counts or quantity.codes:
        return _whole(binding, quantity, signal, not_available)
    if binding.values:
        raise binding.refuse("values", f"{dict(binding.values)}", f"no such key: {binding.quantity} has no codes")
    if binding.scale == 0.0:
        raise binding.refuse("scale", "0", "a number other than 0")
    per_unit = _factor(binding, quantity, signal)
    # value = (physical - binding.offset) / binding.scale * per_unit; physical = raw * signal.scale + signal.offset
    scale = signal.scale / binding.scale * per_unit
    offset = (signal.offset - binding.offset) / binding.scale * per_unit
    ends = sorted(raw * scale + offset for raw in span(signal))
    half = abs(scale) / 2.0 if signal.kind != "float" else 0.0
    low = max(ends[0] - half, float("-inf") if binding.low is None else binding.low)
    high = min(ends[1] + half, float("inf") if binding.high is None else binding.high)
    needed = (0.0, 0.0)
    if binding.quantity == "plate_target_angle":
        needed = (degrees(machine.min_plate_angle_rad), degrees(machine.max_plate_angle_rad))
    # The machine's range went through radians.
    if not (low <= needed[0] + 1e-9 and needed[1] - 1e-9 <= high):
        expected = f"{needed[0]:g} to {needed[1]:g} deg, the range of {machine.name}" if any(needed) else "a range with 0 in it"
        problem = f"{signal.name} carries {ends[0]:.6g} to {ends[1]:.6g} {quantity.unit}".rstrip()
        raise binding.refuse("range" if binding.low is not None else "signal", problem, expected)
    return Packing(signal, scale, offset, low, high, not_available)


def _whole(binding: OutputBinding, quantity: Published, signal: SignalBits, not_available: int | None) -> Packing:
    """Codes and counts: raw values as they are, or as `values` says."""
    if signal.kind == "float":
        raise binding.refuse("signal", f"{signal.name} is a floating-point number", "whole numbers, for codes and counts")
    for key, given, usual in (("scale", binding.scale, 1.0), ("offset", binding.offset, 0.0), ("unit", binding.unit or "", "")):
        if given != usual:
            raise binding.refuse(key, f"{given}", f"no such key: {binding.quantity} is a whole number; `values` gives raw values")
    if quantity.counts:
        return Packing(signal, 1.0, 0.0, 0.0, 0.0, not_available, counts=True)
    codes = []
    for code in quantity.codes:
        raw = binding.values.get(code, None if binding.values else code)
        if raw is None and not_available is None:
            raise binding.refuse("values", f"has no raw value for code {code}", f"one for each of {_listed(quantity.codes)}")
        if raw is not None:
            bits = encoded(signal, raw)
            if bits is None:
                expected = f"raw values of {signal.name} in values, for each of {_listed(quantity.codes)}"
                raise binding.refuse("values", f"code {code} would be raw value {raw}", expected)
            codes.append((code, bits))
    unknown = sorted(set(binding.values) - set(quantity.codes))
    if unknown:
        raise binding.refuse("values", f"code {unknown[0]}", f"codes of {binding.quantity}: {_listed(quantity.codes)}")
    return Packing(signal, 1.0, 0.0, 0.0, 0.0, not_available, tuple(codes))


def _listed(codes: Sequence[int]) -> str:
    return ", ".join(map(str, codes))


def _factor(binding: OutputBinding, quantity: Published, signal: SignalBits) -> float:
    """From the binding's unit into the quantity's."""
    unit = binding.unit if binding.unit is not None else signal.unit
    found = 1.0 if unit == "" else factor(quantity.unit, unit)
    if found is None:
        said = (f"{unit!r}" if binding.unit is not None else f"is {unit!r} in the DBC") + may_be(unit)
        expected = f"one of {accepted(quantity.unit)} for {binding.quantity}" if quantity.unit else "no unit"
        raise binding.refuse("unit", said, expected)
    return found


def _group(draft: _Draft, network: bool) -> OutputGroup:
    first, message = draft.first, draft.message
    own = first.source == OWN or (
        first.source is None and message.extended and (message.j1939 or message.frame_id & SOURCE_MASK == NULL_ADDRESS)
    )
    check_source(first.source, message, first.refuse)
    if network and isinstance(first.source, int):
        raise first.refuse("source", f"{first.source}", "own, the address that we claim, or network.enabled: false")
    frame_id = message.frame_id
    if isinstance(first.source, int):
        frame_id = frame_id & ~SOURCE_MASK | first.source
    return OutputGroup(
        name=message.name,
        frame_id=frame_id,
        extended=message.extended,
        own_address=own,
        length=message.length,
        ones=message.j1939,
        period_s=first.period_s,
        fixed=tuple(_constants(draft)),
        quantities=tuple(draft.packings),
    )


def _constants(draft: _Draft) -> list[tuple[SignalBits, int]]:
    message, found = draft.message, []
    if message.multiplexer is not None:
        assert draft.first.mux is not None, "checked"
        signal = message.signals[message.multiplexer]
        raw = encoded(signal, draft.first.mux)
        if raw is None:
            raise draft.first.refuse("mux", f"{draft.first.mux}", f"a raw value of {signal.name}")
        found.append((signal, raw))
    for binding in draft.bindings:
        for name, value in binding.constants.items():
            signal = _signal(binding, message, name, "constants")
            if name in draft.taken:
                raise binding.refuse(f"constants.{name}", f"carries {draft.taken[name]}", "a signal that no quantity is bound to")
            raw = encoded(signal, (value - signal.offset) / signal.scale)
            if raw is None:
                low, high = (end * signal.scale + signal.offset for end in span(signal))
                raise binding.refuse(f"constants.{name}", f"{value:g}", f"{low:g} to {high:g} {signal.unit}".rstrip())
            found.append((signal, raw))
    return found


def _identity(frame_id: int, *, extended: bool, own_address: bool) -> int:
    """What makes two frames the same one: all but the priority; and the group where the address is ours."""
    if not extended:
        return frame_id
    return frame_id & (GROUP_MASK if own_address else IDENTITY_MASK) | _EXTENDED


def _check_identifiers(
    pairs: Sequence[tuple[_Draft, OutputGroup]], inputs: SignalMap, ours: Mapping[str, MessageBits], *, shipped: bool
) -> None:
    """No group is an input, a frame of the network's protocols, or sent twice."""
    sent: dict[tuple[int, int | None], str] = {}
    for draft, group in pairs:
        first = draft.first
        if group.extended and group_of(group.frame_id) in _OF_THE_NETWORK:
            what = _OF_THE_NETWORK[group_of(group.frame_id)]
            raise first.refuse("message", f"{group.name} has the identifier of the {what}", "a message of its own group")
        identity = _identity(group.frame_id, extended=group.extended, own_address=group.own_address)
        for entry in inputs.groups:
            from_all = any_source(entry.source, entry.message)
            theirs = _identity(entry.message.frame_id, extended=entry.message.extended, own_address=from_all)
            same = _identity(group.frame_id, extended=group.extended, own_address=from_all) == theirs
            if same and (from_all or not group.own_address):
                problem = f"{group.name} has the identifier of the input {entry.message.name}"
                raise first.refuse("message", problem, "a message that is not taken in")
        for name, message in ours.items():
            if identity != _identity(message.frame_id, extended=True, own_address=group.own_address):
                continue
            if shipped and name in _SHIPPED:
                problem = f"{group.name} has the identifier of {name}, which is sent as shipped"
                raise first.refuse("message", problem, "outputs.shipped: false, or another message")
            if name in inputs.own_messages:
                problem = f"{group.name} has the identifier of the input {name}"
                raise first.refuse("message", problem, "a message that is not taken in")
        key = (identity, first.mux)
        if key in sent:
            raise first.refuse("message", f"{group.name} has the identifier of {sent[key]}", "one message for each identifier")
        sent[key] = group.name


_SHIPPED = frozenset(entry.message for entry in PUBLISHED.values() if entry.message)
