"""What is on a bus: messages with rates, nodes with their NAMEs, decoded values, and what could serve which quantity."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.databases import MessageBits, SignalBits
from yieldmon.engine.sources import QUANTITIES
from yieldmon.identifiers import ADDRESS_CLAIM, EXTENDED_FLAG, GROUP_MASK, LARGEST_EXTENDED_ID, NULL_ADDRESS, group_of
from yieldmon.network import canopen
from yieldmon.network.addresses import AddressTable
from yieldmon.network.name import Name
from yieldmon.physics.numerics import Array
from yieldmon.signals.binding import IMPACT, MIN_RATE_HZ
from yieldmon.signals.extraction import Extraction, named_no_value
from yieldmon.signals.group_names import group_name
from yieldmon.signals.long_messages import LongMessages, Numbers, Whole, numbers
from yieldmon.signals.state_names import codes_by_name
from yieldmon.signals.units import factor, period_s, zero
from yieldmon.units import KG_PER_LB

_MOST_IDENTIFIERS = 10_000
"""A hostile node may send any identifier; those beyond are only counted."""
_PAST_ADDRESSES = 0xFE

_LEAST_OF_RATE = 0.95
"""A rate that is measured over a short recording may be a little low."""

_HINTS: Mapping[str, str] = {
    "impact_voltage": r"impact|sample|bridge|strain|force|load.?cell|volt|count|analog|ain",
    "impact_force": r"impact|force|load",
    "elevator_speed": r"elev|shaft|speed|rpm|rev",
    "plate_angle": r"plate|angle|tilt|incl(?!u)|actuator|position",
    "actuator_state": r"actuator.*(state|status)|plate.*(state|status)",
    "moisture": r"moist",
    "grain_temperature": r"(grain|crop).?temp",
    "test_weight": r"test.?weight|density",
    "thousand_kernel_weight": r"kernel",
    "tank_mass": r"tank|mass|weight",
    "tank_scale_status": r"(tank|scale).*(state|status)",
    "header_down": r"header",
    "work_state": r"work",
    "unloading": r"unload|auger",
    "course": r"course|bearing|heading|compass|(^|_)cog(_|$)",
    "ground_speed": r"speed|(^|_)sog(_|$)",
    "latitude": r"latitude|(^|_|gps|pos)lat(_|$)",
    "longitude": r"longitude|(^|_|gps|pos)long?(_|$)",
}
_BY_UNIT = frozenset({"elevator_speed", "plate_angle", "test_weight", "tank_mass"})
"""Quantities whose unit says enough for a guess where no name does."""
_WEAK = 0.25
"""Score of such a guess; every other one is higher."""
_PULSES = re.compile(r"pulse|hall|tooth|teeth|encoder", re.IGNORECASE)
"""Names of counters of a shaft's pulses."""
_VALID, _MOST_OF_A_FLAG = re.compile(r"(?<!in)valid", re.IGNORECASE), 2
"""Names and bits of signals that say by 1 whether others of the message are valid."""
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
    re.compile(r"impact|force|load|cell|weight|plate", re.IGNORECASE),
    re.compile(r"tank|bin|hopper|axle", re.IGNORECASE),
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
_FITS_ALIKE = 0.02
"""Scores of two signals of which nothing says which fits better: they move, or come, a little more often."""


@dataclass(frozen=True)
class SignalSeen:
    """A signal of a message that a DBC names: range of its usable values, nan without any, the last one, how many frames held it,
    and how many with each value of its multiplexer."""

    bits: SignalBits
    low: float
    high: float
    last: float
    frames: int
    pages: Mapping[int, int] = field(default_factory=dict)

    @property
    def page(self) -> tuple[int | None, int]:
        """The value of the multiplexer that came most, None without one, and how many frames held the signal with it."""
        if not self.pages:
            return None, self.frames
        mux = max(self.pages, key=lambda value: self.pages[value])
        return mux, self.pages[mux]


@dataclass
class _Identifier:
    frames: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    message: tuple[str, MessageBits] | None = None
    canopen: str | None = None
    signals: dict[str, SignalSeen] = field(default_factory=dict)

    @property
    def rate_hz(self) -> float | None:
        span_s = self.last_s - self.first_s
        return (self.frames - 1) / span_s if self.frames > 1 and span_s > 0.0 else None


@dataclass(frozen=True)
class MessageSeen:
    """One identifier. dbc: the file that names it; name: of the DBC's message, else of the J1939 group; group, source: None for
    an 11-bit identifier."""

    identifier: int
    extended: bool
    frames: int
    rate_hz: float | None
    dbc: str | None
    name: str | None
    group: int | None
    source: int | None
    signals: Mapping[str, SignalSeen]


@dataclass(frozen=True)
class Candidate:
    """A signal that could serve a quantity.

    unit: as the DBC says; mux: value of the multiplexer with which it is sent most; source: of the sender where the DBC does
    not distinguish it from others; node: the sender's NAME then, where one was heard; moved: that node was heard at several
    addresses; span: lowest and highest value; not_available: raw values that the DBC's value table calls so; values: raw value
    and code of a switch whose names say that they differ; valid: the one signal of the message that says by 1 that it is; score:
    how well it fits, above 0.
    """

    quantity: str
    dbc: str
    message: str
    signal: str
    unit: str
    rate_hz: float
    mux: int | None = None
    source: int | None = None
    node: Name | None = None
    moved: bool = False
    span: tuple[float, float] = (0.0, 0.0)
    not_available: tuple[int, ...] = ()
    values: tuple[tuple[int, int], ...] = ()
    valid: str | None = None
    score: float = 1.0

    @property
    def weak(self) -> bool:
        """Whether nothing but its unit speaks for it."""
        return self.score <= _WEAK


class Survey:
    """Takes a bus's frames, block by block. databases: name of a DBC file -> its messages."""

    def __init__(self, databases: Mapping[str, Mapping[str, MessageBits]]) -> None:
        self._seen: dict[int, _Identifier] = {}
        self._exact: dict[int, tuple[str, MessageBits]] = {}
        self._groups: dict[int, tuple[str, MessageBits]] = {}
        self._table = AddressTable()
        self._claims: dict[int, Name | None] = {}
        self._long = LongMessages(message for messages in databases.values() for message in messages.values())
        self.frames = 0
        for name, messages in databases.items():
            for message in messages.values():
                key = message.frame_id | EXTENDED_FLAG if message.extended else message.frame_id
                self._exact.setdefault(key, (name, message))
                if message.extended:
                    self._groups.setdefault(message.group, (name, message))

    @property
    def incomplete(self) -> int:
        """Messages of several frames, of those that a DBC names, that lack one."""
        return self._long.incomplete + self._long.under_way

    def add(
        self,
        time_s: Array,
        identifiers: NDArray[np.uint32],
        lengths: NDArray[np.uint8],
        payloads: NDArray[np.uint64],
        long: Mapping[int, bytes] | None = None,
    ) -> None:
        """Data frames, in order; identifiers with `EXTENDED_FLAG`, payloads and long as in `MapDecoder.decode_block`."""
        if not time_s.size:
            # A stretch of error frames, or of lines that are none.
            return
        self.frames += time_s.size
        is_claim = (identifiers & np.uint32(GROUP_MASK | EXTENDED_FLAG)) == np.uint32(ADDRESS_CLAIM | EXTENDED_FLAG)
        for row in np.flatnonzero(is_claim & (lengths == 8)).tolist():
            self._claimed(int(identifiers[row]) & 0xFF, Name.of_bytes(int(payloads[row]).to_bytes(8, "little")))
        order = np.argsort(identifiers, kind="stable")
        found, starts = np.unique(identifiers[order], return_index=True)
        for identifier, rows in zip(found.tolist(), np.split(order, starts[1:]), strict=True):
            self._add(int(identifier), time_s[rows], lengths[rows], payloads[rows])
        self._add_long(self._long.feed_block(time_s, identifiers, lengths, payloads, long or {}), time_s)

    def _claimed(self, address: int, name: Name) -> None:
        self._table.claimed(address, name)
        # An address that changed hands identifies no sender.
        self._claims[address] = name if self._claims.get(address, name) == name else None

    def _add(self, identifier: int, times: Array, lengths: NDArray[np.uint8], payloads: NDArray[np.uint64]) -> None:
        seen = self._counted(identifier, times)
        if seen is not None and (node := canopen.node_of_heartbeat(identifier, int(lengths.max()))) is not None:
            seen.canopen = _canopen(node, int(payloads[-1]) & 0xFF)
        if seen is None or seen.message is None or seen.message[1].is_long:
            return
        whole = payloads[lengths >= seen.message[1].length]
        if whole.size:
            _take(seen, lambda _byte: whole, whole.size, seen.message[1].length)

    def _counted(self, identifier: int, times: Array) -> _Identifier | None:
        seen = self._seen.get(identifier)
        if seen is None:
            if len(self._seen) >= _MOST_IDENTIFIERS:
                return None
            seen = self._seen[identifier] = _Identifier(first_s=float(times[0]), message=self._named(identifier))
        seen.frames += times.size
        seen.last_s = float(times[-1])
        return seen

    def _add_long(self, messages: Sequence[Whole], time_s: Array) -> None:
        """Those of the transport protocol are listed as its frames and as themselves."""
        of_identifier: dict[tuple[int, bool], list[Whole]] = {}
        for message in messages:
            of_identifier.setdefault((message.identifier, message.by_transport), []).append(message)
        for (identifier, by_transport), found in of_identifier.items():
            times = time_s[[message.row for message in found]]
            seen = self._counted(identifier, times) if by_transport else self._seen.get(identifier)
            if seen is not None and seen.message is not None:
                # What every one of them holds is looked at.
                end = min(len(message.data) for message in found)
                _take(seen, numbers([message.data for message in found], seen.message[1].length), len(found), end)

    def _named(self, identifier: int) -> tuple[str, MessageBits] | None:
        exact = self._exact.get(identifier)
        if exact is not None or not identifier & EXTENDED_FLAG:
            return exact
        return self._groups.get(group_of(identifier & LARGEST_EXTENDED_ID))

    @property
    def messages(self) -> list[MessageSeen]:
        """All identifiers, by parameter group and source; 11-bit ones first."""
        found = []
        for key, seen in self._seen.items():
            extended, identifier = bool(key & EXTENDED_FLAG), key & LARGEST_EXTENDED_ID
            group = group_of(identifier) if extended else None
            dbc, name = (None, None) if seen.message is None else (seen.message[0], seen.message[1].name)
            if name is None:
                name = group_name(group) if group is not None else seen.canopen
            found.append(
                MessageSeen(
                    identifier=identifier,
                    extended=extended,
                    frames=seen.frames,
                    rate_hz=seen.rate_hz,
                    dbc=dbc,
                    name=name,
                    group=group,
                    source=identifier & 0xFF if extended else None,
                    signals=seen.signals,
                )
            )
        return sorted(found, key=lambda m: (m.extended, m.group or 0, m.source or 0, m.identifier))

    @property
    def nodes(self) -> list[tuple[int, Name | None]]:
        """Source addresses that sent 29-bit frames, with the NAMEs that they claimed."""
        sources = {key & 0xFF for key in self._seen if key & EXTENDED_FLAG} | {address for address, _ in self._table.items()}
        return [(source, self._table.name_of(source)) for source in sorted(sources) if source < _PAST_ADDRESSES]

    @property
    def candidates(self) -> dict[str, list[Candidate]]:
        """Quantity -> the signals that could serve it, the likeliest first; quantities without any are left out."""
        found: dict[str, list[Candidate]] = {}
        messages = self.messages
        senders = Counter((message.dbc, message.name) for message in messages)
        homes = Counter(name for address, name in self._claims.items() if name is not None and address < _PAST_ADDRESSES)
        for message in messages:
            if message.dbc is None or message.rate_hz is None or message.name is None:
                continue
            multiplexers = {signal.bits.mux_by for signal in message.signals.values()}
            measured = [signal for signal in message.signals.values() if signal.bits.name not in multiplexers]
            for signal in measured:
                mux, frames = signal.page
                rate_hz = message.rate_hz * frames / message.frames
                for quantity in _HINTS:
                    score = _score(quantity, message, signal, rate_hz)
                    if score > 0.0:
                        place = message.dbc, message.name, signal.bits.name
                        several = senders[message.dbc, message.name] > 1 or self._is_elsewhere(message)
                        source = message.source if several else None
                        node = self._claims.get(source) if source is not None else None
                        candidate = Candidate(
                            quantity,
                            *place,
                            unit=signal.bits.unit,
                            rate_hz=rate_hz,
                            mux=mux,
                            source=source,
                            node=node,
                            moved=node is not None and homes[node] > 1,
                            span=(signal.low, signal.high),
                            not_available=_not_available(quantity, signal.bits),
                            values=tuple(sorted(codes_by_name(quantity, signal.bits).items())),
                            valid=_valid(message),
                            score=score,
                        )
                        found.setdefault(quantity, []).append(candidate)
        return {
            quantity: list(dict.fromkeys(sorted(scored, key=lambda candidate: -candidate.score)))
            for quantity, scored in sorted(found.items())
        }

    def _is_elsewhere(self, message: MessageSeen) -> bool:
        """Whether a message comes from another address than the one that its DBC names, or with another priority."""
        seen = self._seen[message.identifier | EXTENDED_FLAG].message if message.extended else None
        if seen is None or seen[1].frame_id & 0xFF == NULL_ADDRESS:
            return False
        return seen[1].frame_id != message.identifier


def _canopen(node: int, state: int) -> str | None:
    if state not in canopen.STATES:
        return None
    start = "" if canopen.sends_values(state) else f" ({canopen.how_to_start(node)})"
    return f"CANopen node {node} {canopen.STATES[state]}{start}"


def _take(seen: _Identifier, numbers: Numbers, count: int, end: int) -> None:
    """Takes the signals of `count` messages that have at least `end` bytes."""
    assert seen.message is not None, "asked before"
    message = seen.message[1]

    def raws(bits: SignalBits) -> NDArray[np.int64] | NDArray[np.uint64]:
        little = numbers(bits.byte)
        return Extraction(bits, 1.0, 0.0).raws(little, little.byteswap())

    for name, bits in message.signals.items():
        if not bits.readable or bits.end > end:
            continue
        little = numbers(bits.byte)
        values = Extraction(bits, bits.scale, bits.offset).values(little, little.byteswap())
        held = np.ones(count, bool)
        above = message.pages(bits)
        for page, wanted in above:
            held &= np.isin(raws(page), wanted)
        pages = Counter(raws(above[0][0])[held].tolist()) if above else Counter[int]()
        seen.signals[name] = _merged(bits, seen.signals.get(name), values[held], pages)


def _merged(bits: SignalBits, before: SignalSeen | None, values: Array, pages: Counter[int]) -> SignalSeen:
    """A signal after more of its values (n,), nan for unusable ones. pages: how many came with each value of the multiplexer."""
    low = high = last = float("nan")
    frames = int(values.size)
    if before is not None:
        low, high, last, frames = before.low, before.high, before.last, frames + before.frames
        pages = pages + Counter(before.pages)
    known = values[np.isfinite(values)]
    if known.size:
        low, high = float(np.fmin(known.min(), low)), float(np.fmax(known.max(), high))
        last = float(known[-1])
    return SignalSeen(bits, low, high, last, frames, pages)


def _not_available(quantity: str, bits: SignalBits) -> tuple[int, ...]:
    """Raw values that a value table calls no value, beside those that J1939 keeps. A state may well be "fault"."""
    if quantity not in IMPACT and not QUANTITIES[quantity].unit:
        return ()
    return tuple(sorted(named_no_value(bits)))


def _score(quantity: str, message: MessageSeen, signal: SignalSeen, rate_hz: float) -> float:
    """How well a signal that comes at this rate fits a quantity; 0: not at all."""
    if not np.isfinite(signal.low):
        return 0.0
    hint = re.compile(_HINTS[quantity], re.IGNORECASE)
    named, message_named = hint.search(signal.bits.name) is not None, hint.search(message.name or "") is not None
    if quantity in IMPACT:
        return _impact_score(quantity, message, signal, rate_hz, 1.0 * named + 0.5 * message_named)
    if QUANTITIES[quantity].unit == "":
        return 2.0 if named and signal.bits.unit == "" and signal.bits.bits <= 8 else 0.0
    return _slow_score(quantity, message.name or "", rate_hz, signal, named, message_named)


def _valid(message: MessageSeen) -> str | None:
    """The signal that says whether the others of a message are valid, where there is one."""
    of_all = [signal.bits for signal in message.signals.values() if signal.bits.mux_by is None]
    flags = [bits.name for bits in of_all if bits.bits <= _MOST_OF_A_FLAG and _VALID.search(bits.name)]
    return flags[0] if len(flags) == 1 else None


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


def _is_gauge(names: str, rate_hz: float) -> bool:
    return rate_hz >= _LEAST_OF_RATE * _GAUGE_HZ and _GAUGE.search(names) is not None and _SCALE.search(names) is None


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
    fits = bits.unit != "" and factor(IMPACT[quantity], bits.unit) is not None
    fits = fits or (
        quantity == "impact_force" and force_unit(bits.unit) is not None and _is_gauge(f"{message.name} {bits.name}", rate_hz)
    )
    plain = bits.unit == "" and quantity == "impact_voltage" and named > 0.0
    # Grain makes an impact sensor's signal move more than any other.
    moves = (signal.high - signal.low) / max(abs(signal.high), abs(signal.low), 1e-9)
    bare = bits.unit in BARE and quantity == "impact_voltage" and bits.bits >= _LEAST_BITS_OF_A_NUMBER
    if bare and not plain and rate_hz >= FAST_HZ and is_makers_own(message.group) and signal.high > signal.low:
        return _WEAK * (0.9 + 0.1 * min(moves, 1.0))
    if not (fits or plain):
        return 0.0
    if _VOLTAGES_ELSEWHERE.search(bits.name):
        return _WEAK * 0.5
    return 2.0 * fits + named + 0.25 * (moves > 0.0) + 0.01 * moves + rate_hz * 1e-6


def _slow_score(quantity: str, message: str, rate_hz: float, signal: SignalSeen, named: bool, message_named: bool) -> float:
    speed = quantity == "elevator_speed"
    if speed and (of_pulses := _pulses_score(signal)) is not None:
        return of_pulses
    found = factor(QUANTITIES[quantity].unit, signal.bits.unit) if signal.bits.unit else None
    if found is None or not QUANTITIES[quantity].usable(signal.last * found + zero(QUANTITIES[quantity].unit, signal.bits.unit)):
        return 0.0
    others = [other for other in _HINTS if other != quantity and re.search(_HINTS[other], signal.bits.name, re.IGNORECASE)]
    elsewhere = bool(others)
    if not named and any(other not in IMPACT and QUANTITIES[other].unit == QUANTITIES[quantity].unit for other in others):
        # As the latitude in a message VehiclePosition is no position of the plate.
        return 0.0
    if not (named or message_named):
        return _WEAK if quantity in _BY_UNIT and not elsewhere else 0.0
    if quantity == "plate_angle" and _names(_ANGLES_ELSEWHERE, _IMPACT_PLATE, message, signal.bits.name):
        return _WEAK
    shaft = speed and of_another_shaft(message, signal.bits.name)
    own = {"elevator_speed": _ELEVATOR, "plate_angle": _IMPACT_PLATE}.get(quantity)
    better = own is not None and not shaft and own.search(f"{message} {signal.bits.name}") is not None
    return 1.0 + named - 0.5 * shaft + _NAMED_BETTER * better + min(rate_hz, 100.0) * 1e-6


def _pulses_score(signal: SignalSeen) -> float | None:
    """Of a count, a frequency or a period of a shaft's pulses; None for a signal that is none of these."""
    bits = signal.bits
    if counts_pulses(bits):
        return _BETWEEN_NAMED_AND_ELSEWHERE if signal.high > signal.low else 0.0
    if is_of_pulses(bits.unit, signal.high):
        return _BETWEEN_NAMED_AND_ELSEWHERE if _FREQUENCY.search(bits.name) else _WEAK
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


def fit_alike(one: Candidate, other: Candidate) -> bool:
    """Whether nothing says which of two candidates for a quantity is the likelier, the first or the other."""
    if one.weak or other.weak or one.score - other.score > _FITS_ALIKE:
        return False
    if one.quantity not in IMPACT:
        return True
    moved, less = (candidate.span[1] - candidate.span[0] for candidate in (one, other))
    return moved < STANDS_OUT * less
