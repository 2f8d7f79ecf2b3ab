"""What is on a bus: messages with rates, nodes with their NAMEs, and decoded values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.databases import MessageBits, SignalBits
from yieldmon.identifiers import ADDRESS_CLAIM, EXTENDED_FLAG, GROUP_MASK, LARGEST_EXTENDED_ID, NULL_ADDRESS, group_of
from yieldmon.network import canopen
from yieldmon.network.addresses import AddressTable
from yieldmon.network.name import Name
from yieldmon.physics.numerics import Array
from yieldmon.signals.extraction import Extraction
from yieldmon.signals.group_names import group_name
from yieldmon.signals.long_messages import LongMessages, Numbers, Whole, numbers

_MOST_IDENTIFIERS = 10_000
"""A hostile node may send any identifier; those beyond are only counted."""
PAST_ADDRESSES = 0xFE


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
        return [(source, self._table.name_of(source)) for source in sorted(sources) if source < PAST_ADDRESSES]

    @property
    def claims(self) -> Mapping[int, Name | None]:
        """Address -> the NAME that claimed it; None where several did, so that it identifies no sender."""
        return self._claims

    def is_elsewhere(self, message: MessageSeen) -> bool:
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
