"""Frames of a mapping's groups out of a bus's traffic: one message at a time, or a log's block at once with the same result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.frames import NOT_AVAILABLE, Frame, Value
from yieldmon.identifiers import (
    ADDRESS_CLAIM,
    EXTENDED_FLAG,
    FORMAT_MASK,
    GROUP_MASK,
    LARGEST_EXTENDED_ID,
    LARGEST_STANDARD_ID,
    SOURCE_MASK,
    is_broadcast,
)
from yieldmon.network.addresses import AddressTable
from yieldmon.network.name import Name, NameMatch
from yieldmon.physics.numerics import Array
from yieldmon.signals.long_messages import (
    PRIORITY,
    TRANSPORT,
    TRANSPORT_MASK,
    LongMessages,
    Numbers,
    Whole,
    number,
    numbers,
)
from yieldmon.signals.mapping import Group, SignalMap, any_source
from yieldmon.signals.pulses import PulseSpeed


@dataclass(frozen=True, slots=True)
class Match:
    """Which identifiers a group takes: identifier & mask == identity; both with `EXTENDED_FLAG`. named: the source address
    must be that of a node with this NAME."""

    identity: int
    mask: int
    named: NameMatch | None

    def takes(self, whole: Whole) -> bool:
        """Whether a long message is the group's, whoever sent it."""
        mask = self.mask & ~PRIORITY if whole.by_transport else self.mask
        return whole.identifier & mask == self.identity & mask


def match_of(group: Group) -> Match:
    """The identifiers of a group's frames. With a source of its own a J1939 group is known by parameter group and source."""
    message, source = group.message, group.source
    if not message.extended:
        return Match(message.frame_id, LARGEST_STANDARD_ID | EXTENDED_FLAG, None)
    by_group = GROUP_MASK if is_broadcast(message.frame_id >> 8) else FORMAT_MASK
    if any_source(source, message) or isinstance(source, NameMatch):
        named = source if isinstance(source, NameMatch) else None
        return Match(message.frame_id & by_group | EXTENDED_FLAG, by_group | EXTENDED_FLAG, named)
    if isinstance(source, int):
        identity = message.frame_id & by_group | source
        return Match(identity | EXTENDED_FLAG, by_group | SOURCE_MASK | EXTENDED_FLAG, None)
    # The priority is no part of what J1939 knows a message by.
    mask = LARGEST_EXTENDED_ID & ~PRIORITY if message.j1939 else LARGEST_EXTENDED_ID
    return Match(message.frame_id & mask | EXTENDED_FLAG, mask | EXTENDED_FLAG, None)


@dataclass(frozen=True, slots=True)
class GroupColumns:
    """A group's frames in a block: rows (n,), rising, times (n,), and name -> values (n,), nan for what is not available."""

    name: str
    rows: NDArray[np.intp]
    time_s: Array
    signals: Mapping[str, Array]


class MapDecoder:
    """Decodes for one engine; holds what pulses and address claims need of the frames before."""

    def __init__(self, signal_map: SignalMap) -> None:
        decoders = [_GroupDecoder(group) for group in signal_map.groups]
        self._groups = [decoder for decoder in decoders if not decoder.group.message.is_long]
        self._of_long = [decoder for decoder in decoders if decoder.group.message.is_long]
        direct = [(decoder.match.identity, decoder.match.mask) for decoder in self._of_long]
        self._long = LongMessages((decoder.group.message for decoder in self._of_long), direct)
        self._table = AddressTable()
        self._by_name = any(decoder.match.named is not None for decoder in decoders)
        self._of_identifier: dict[int, tuple[tuple[_GroupDecoder, ...], bool]] = {}
        self.refused = 0
        """Frames of a group that were too short."""

    @property
    def matches(self) -> tuple[Match, ...]:
        """What is listened to, for filters; with a NAME, address claims too."""
        claims = (Match(ADDRESS_CLAIM | EXTENDED_FLAG, GROUP_MASK | EXTENDED_FLAG, None),) if self._by_name else ()
        transport = [Match(identity, TRANSPORT_MASK, None) for identity in TRANSPORT] if self._long.by_transport else []
        return (*(decoder.match for decoder in (*self._groups, *self._of_long)), *transport, *claims)

    @property
    def incomplete(self) -> int:
        """Long messages that were begun and are given up: a part is lost."""
        return self._long.incomplete

    @property
    def under_way(self) -> int:
        """Long messages of which parts are still to come."""
        return self._long.under_way

    def decode(self, time_s: float, identifier: int, extended: bool, data: bytes) -> list[Frame]:
        """The frames that one data frame of the bus brings, usually none or one."""
        key = identifier | EXTENDED_FLAG if extended else identifier
        known = self._of_identifier.get(key)
        if known is None:
            if len(self._of_identifier) >= _KEPT_IDENTIFIERS:
                self._of_identifier.clear()
            known = tuple(d for d in self._groups if key & d.match.mask == d.match.identity), self._long.takes(key)
            self._of_identifier[key] = known
        if self._by_name and key & (GROUP_MASK | EXTENDED_FLAG) == ADDRESS_CLAIM | EXTENDED_FLAG:
            self._table.receive(identifier, data)
        decoders, of_long = known
        found, too_short = self._decoded(decoders, time_s, identifier, data) if decoders else ([], False)
        whole = self._long.feed(time_s, key, data) if of_long else None
        if whole is not None:
            decoders = tuple(decoder for decoder in self._of_long if decoder.match.takes(whole))
            others, also = self._decoded(decoders, time_s, whole.identifier, whole.data)
            found, too_short = found + others, too_short or also
        # Of long messages each group wants its own bytes.
        self.refused += too_short and not (self._of_long and found)
        return found

    def _decoded(
        self, decoders: Sequence[_GroupDecoder], time_s: float, identifier: int, data: bytes
    ) -> tuple[list[Frame], bool]:
        """The frames, and whether it was too short for one."""
        found, too_short = [], False
        for decoder in decoders:
            named = decoder.match.named
            if named is not None and self._table.address_of(named) != identifier & 0xFF:
                continue
            if len(data) < decoder.needed:
                too_short = True
                continue
            frame = decoder.frame(time_s, data)
            if frame is not None:
                found.append(frame)
        return found, too_short

    def decode_block(
        self,
        time_s: Array,
        identifiers: NDArray[np.uint32],
        lengths: NDArray[np.uint8],
        payloads: NDArray[np.uint64],
        long: Mapping[int, bytes] | None = None,
    ) -> tuple[list[GroupColumns], NDArray[np.intp]]:
        """Each group's frames among data frames of the bus, and the rows that were too short.

        identifiers (n,): with `EXTENDED_FLAG`. payloads (n,): the first eight bytes, first byte lowest. long: row -> all data
        of frames that have more.
        """
        claims = self._claims(identifiers, lengths, payloads)
        columns, refused = [], [np.empty(0, np.intp)]
        for decoder in self._groups:
            match = decoder.match
            rows = np.flatnonzero((identifiers & np.uint32(match.mask)) == np.uint32(match.identity))
            if match.named is not None:
                rows = self._from(match.named, rows, identifiers, claims)
            whole = lengths[rows] >= decoder.needed
            refused.append(rows[~whole])
            rows = rows[whole]
            found = decoder.columns(rows, time_s, _first_eight(payloads[rows]))
            if found is not None:
                columns.append(found)
        if self._of_long:
            messages = self._long.feed_block(time_s, identifiers, lengths, payloads, long or {})
            for decoder in self._of_long:
                columns += self._long_columns(decoder, messages, time_s, identifiers, claims, refused)
        for _, address, name in claims:
            self._table.claimed(address, name)
        wrong = np.unique(np.concatenate(refused))
        if self._of_long:
            wrong = np.setdiff1d(wrong, np.concatenate([wrong[:0], *(one.rows for one in columns)]))
        self.refused += int(wrong.size)
        return columns, wrong

    def _long_columns(
        self,
        decoder: _GroupDecoder,
        messages: Sequence[Whole],
        time_s: Array,
        identifiers: NDArray[np.uint32],
        claims: Sequence[tuple[int, int, Name]],
        refused: list[NDArray[np.intp]],
    ) -> list[GroupColumns]:
        """Of a group of long messages; adds the rows of those that were too short to `refused`."""
        of_row = {message.row: message.data for message in messages if decoder.match.takes(message)}
        rows = np.array(list(of_row), np.intp)
        if decoder.match.named is not None:
            rows = self._from(decoder.match.named, rows, identifiers, claims)
        whole = np.array([len(of_row[row]) >= decoder.needed for row in rows.tolist()], bool)
        refused.append(rows[~whole])
        rows = rows[whole]
        if not rows.size:
            return []
        found = decoder.columns(rows, time_s, numbers([of_row[row] for row in rows.tolist()], decoder.needed))
        return [] if found is None else [found]

    def _claims(
        self, identifiers: NDArray[np.uint32], lengths: NDArray[np.uint8], payloads: NDArray[np.uint64]
    ) -> list[tuple[int, int, Name]]:
        """(row, address, NAME) of the address claims of a block."""
        if not self._by_name:
            return []
        is_claim = (identifiers & np.uint32(GROUP_MASK | EXTENDED_FLAG)) == np.uint32(ADDRESS_CLAIM | EXTENDED_FLAG)
        rows = np.flatnonzero(is_claim & (lengths == 8))
        return [(int(row), int(identifiers[row]) & 0xFF, Name.of_bytes(int(payloads[row]).to_bytes(8, "little"))) for row in rows]

    def _from(
        self,
        named: NameMatch,
        rows: NDArray[np.intp],
        identifiers: NDArray[np.uint32],
        claims: Sequence[tuple[int, int, Name]],
    ) -> NDArray[np.intp]:
        """Those of the rows that the node with this NAME sent, by the claims until each."""
        table = AddressTable()
        for address, name in self._table.items():
            table.claimed(address, name)
        starts, addresses = [-1], [table.address_of(named)]
        for row, address, name in claims:
            table.claimed(address, name)
            starts.append(row)
            addresses.append(table.address_of(named))
        holders = np.array([-1 if address is None else address for address in addresses])
        at = holders[np.searchsorted(np.array(starts), rows, side="right") - 1]
        own: NDArray[np.intp] = rows[(identifiers[rows] & np.uint32(0xFF)).astype(np.int64) == at]
        return own


_KEPT_IDENTIFIERS = 4096
"""A bus has few identifiers; a hostile node may send any."""


def _first_eight(payloads: NDArray[np.uint64]) -> Numbers:
    return lambda _byte: payloads


class _GroupDecoder:
    def __init__(self, group: Group) -> None:
        self.group = group
        self.match = match_of(group)
        bits = [extraction.bits for extraction in (*group.signals.values(), *(page for page, _ in group.pages))]
        self.needed = max((one.end for one in bits), default=0) if group.message.is_long else group.message.length
        """Bytes that a message must have. Long ones are often longer in the DBC than on the bus."""
        self._pulses = [
            (pulses, PulseSpeed(pulses.pulses_per_turn, pulses.modulus, pulses.values, pulses.longest_s))
            for pulses in group.pulses
        ]
        self._signals = tuple(group.signals.items())
        self._bytes = tuple(sorted({one.byte for one in bits}))

    def frame(self, time_s: float, data: bytes) -> Frame | None:
        at = {byte: number(data, byte) for byte in self._bytes}
        for page, values in self.group.pages:
            if page.raw(*at[page.bits.byte]) not in values:
                return None
        signals: dict[str, Value] = {}
        for name, extraction in self._signals:
            value = extraction.value(*at[extraction.bits.byte])
            signals[name] = value if value == value else NOT_AVAILABLE  # noqa: PLR0124
        for pulses, speed in self._pulses:
            count = signals[pulses.signal]
            if isinstance(count, float):
                rpm = pulses.factor * speed.speed_rpm(time_s, int(count))
                signals[pulses.signal] = rpm if rpm == rpm else NOT_AVAILABLE  # noqa: PLR0124
        return Frame(time_s, self.group.name, signals)

    def columns(self, rows: NDArray[np.intp], time_s: Array, numbers: Numbers) -> GroupColumns | None:
        at = {byte: numbers(byte) for byte in self._bytes}
        wanted = np.ones(rows.shape, bool)
        for page, values in self.group.pages:
            little = at[page.bits.byte]
            raws = page.raws(little, little.byteswap())
            wanted &= np.isin(raws, np.array(values, raws.dtype))
        if not wanted.all():
            rows, at = rows[wanted], {byte: little[wanted] for byte, little in at.items()}
        if not rows.size:
            return None
        times = time_s[rows]
        both = {byte: (little, little.byteswap()) for byte, little in at.items()}
        signals = {name: extraction.values(*both[extraction.bits.byte]) for name, extraction in self._signals}
        for pulses, speed in self._pulses:
            counts = signals[pulses.signal]
            signals[pulses.signal] = np.array(
                [
                    pulses.factor * speed.speed_rpm(at_s, int(count)) if count == count else count  # noqa: PLR0124
                    for at_s, count in zip(times.tolist(), counts.tolist(), strict=True)
                ]
            )
        return GroupColumns(self.group.name, rows, times, signals)
