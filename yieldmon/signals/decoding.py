"""Frames of a mapping's groups out of a bus's traffic: one message at a time, or a log's block at once with the same result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.frames import NOT_AVAILABLE, Frame, Value
from yieldmon.network.addresses import AddressTable
from yieldmon.network.name import Name, NameMatch
from yieldmon.signals.mapping import Group, SignalMap, any_source
from yieldmon.signals.pulses import PulseSpeed

Array = NDArray[np.float64]

EXTENDED = 1 << 31
"""Marks a 29-bit identifier in `Match.identity`, as SocketCAN does."""
_ALL = 0x1FFFFFFF
_CLAIM, _CLAIM_MASK = 0x00EEFF00, 0x03FFFF00
_FIRST_BROADCAST_FORMAT = 0xF0


@dataclass(frozen=True, slots=True)
class Match:
    """Which identifiers a group takes: identifier & mask == identity; both with the `EXTENDED` flag. named: the source address
    must be that of a node with this NAME."""

    identity: int
    mask: int
    named: NameMatch | None


def match_of(group: Group) -> Match:
    """The identifiers of a group's frames. With a source of its own a J1939 group is known by parameter group and source."""
    message, source = group.message, group.source
    if not message.extended:
        return Match(message.frame_id, 0x7FF | EXTENDED, None)
    broadcast = (message.frame_id >> 16 & 0xFF) >= _FIRST_BROADCAST_FORMAT
    by_group = 0x03FFFF00 if broadcast else 0x03FF0000
    if any_source(source, message) or isinstance(source, NameMatch):
        named = source if isinstance(source, NameMatch) else None
        return Match(message.frame_id & by_group | EXTENDED, by_group | EXTENDED, named)
    if isinstance(source, int):
        identity = message.frame_id & by_group | source
        return Match(identity | EXTENDED, by_group | 0xFF | EXTENDED, None)
    return Match(message.frame_id | EXTENDED, _ALL | EXTENDED, None)


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
        self._groups = [_GroupDecoder(group) for group in signal_map.groups]
        self._table = AddressTable()
        self._by_name = any(decoder.match.named is not None for decoder in self._groups)
        self._of_identifier: dict[int, tuple[_GroupDecoder, ...]] = {}
        self.refused = 0
        """Frames of a group that were too short."""

    @property
    def matches(self) -> tuple[Match, ...]:
        """What is listened to, for filters; with a NAME, address claims too."""
        claims = (Match(_CLAIM | EXTENDED, _CLAIM_MASK | EXTENDED, None),) if self._by_name else ()
        return (*(decoder.match for decoder in self._groups), *claims)

    def decode(self, time_s: float, identifier: int, extended: bool, data: bytes) -> list[Frame]:
        """The frames that one data frame of the bus brings, usually none or one."""
        key = identifier | EXTENDED if extended else identifier
        decoders = self._of_identifier.get(key)
        if decoders is None:
            if len(self._of_identifier) >= _KEPT_IDENTIFIERS:
                self._of_identifier.clear()
            decoders = tuple(d for d in self._groups if key & d.match.mask == d.match.identity)
            self._of_identifier[key] = decoders
        if self._by_name and key & (_CLAIM_MASK | EXTENDED) == _CLAIM | EXTENDED:
            self._table.hear(identifier, data)
        found = []
        for decoder in decoders:
            named = decoder.match.named
            if named is not None and self._table.address_of(named) != identifier & 0xFF:
                continue
            if len(data) < decoder.group.message.length:
                self.refused += 1
                continue
            frame = decoder.frame(time_s, data)
            if frame is not None:
                found.append(frame)
        return found

    def decode_block(
        self, time_s: Array, identifiers: NDArray[np.uint32], lengths: NDArray[np.uint8], payloads: NDArray[np.uint64]
    ) -> tuple[list[GroupColumns], NDArray[np.intp]]:
        """Each group's frames among data frames of the bus, and the rows that were too short.

        identifiers (n,): with the `EXTENDED` flag. payloads (n,): the first eight bytes, first byte lowest.
        """
        claims = self._claims(identifiers, lengths, payloads)
        columns, refused = [], [np.empty(0, np.intp)]
        for decoder in self._groups:
            match = decoder.match
            rows = np.flatnonzero((identifiers & np.uint32(match.mask)) == np.uint32(match.identity))
            if match.named is not None:
                rows = self._from(match.named, rows, identifiers, claims)
            whole = lengths[rows] >= decoder.group.message.length
            refused.append(rows[~whole])
            found = decoder.columns(rows[whole], time_s, payloads)
            if found is not None:
                columns.append(found)
        for _, address, name in claims:
            self._table.claimed(address, name)
        wrong = np.unique(np.concatenate(refused))
        self.refused += int(wrong.size)
        return columns, wrong

    def _claims(
        self, identifiers: NDArray[np.uint32], lengths: NDArray[np.uint8], payloads: NDArray[np.uint64]
    ) -> list[tuple[int, int, Name]]:
        """(row, address, NAME) of the address claims of a block."""
        if not self._by_name:
            return []
        is_claim = (identifiers & np.uint32(_CLAIM_MASK | EXTENDED)) == np.uint32(_CLAIM | EXTENDED)
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


class _GroupDecoder:
    def __init__(self, group: Group) -> None:
        self.group = group
        self.match = match_of(group)
        self._pulses = [(pulses, PulseSpeed(pulses.pulses_per_turn, pulses.modulus)) for pulses in group.pulses]
        self._signals = tuple(group.signals.items())

    def frame(self, time_s: float, data: bytes) -> Frame | None:
        whole = data[:8].ljust(8, b"\x00")
        little, big = int.from_bytes(whole, "little"), int.from_bytes(whole, "big")
        mux = self.group.mux
        if mux is not None and mux[0].raw(little, big) != mux[1]:
            return None
        signals: dict[str, Value] = {}
        for name, extraction in self._signals:
            value = extraction.value(little, big)
            signals[name] = value if value == value else NOT_AVAILABLE  # noqa: PLR0124
        for pulses, speed in self._pulses:
            count = signals[pulses.signal]
            if isinstance(count, float):
                rpm = pulses.factor * speed.speed_rpm(time_s, int(count))
                signals[pulses.signal] = rpm if rpm == rpm else NOT_AVAILABLE  # noqa: PLR0124
        return Frame(time_s, self.group.name, signals)

    def columns(self, rows: NDArray[np.intp], time_s: Array, payloads: NDArray[np.uint64]) -> GroupColumns | None:
        little = payloads[rows]
        big = little.byteswap()
        mux = self.group.mux
        if mux is not None:
            wanted = mux[0].raws(little, big) == mux[1]
            rows, little, big = rows[wanted], little[wanted], big[wanted]
        if not rows.size:
            return None
        times = time_s[rows]
        signals = {name: extraction.values(little, big) for name, extraction in self._signals}
        for pulses, speed in self._pulses:
            counts = signals[pulses.signal]
            signals[pulses.signal] = np.array(
                [
                    pulses.factor * speed.speed_rpm(at_s, int(count)) if count == count else count  # noqa: PLR0124
                    for at_s, count in zip(times.tolist(), counts.tolist(), strict=True)
                ]
            )
        return GroupColumns(self.group.name, rows, times, signals)
