"""Frames by the million: blocks of frames as arrays, and the codec's decoding over them, equal to it bit for bit.

A block keeps frames as SocketCAN does: can_id with the extended, remote and error flags of linux/can.h, and the data as
one little-endian 64-bit number.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate

import can
import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.codec import Codec
from yieldmon.bus.layout import MessageLayout, SignalLayout
from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG, channel_name, flagged_id
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, LARGEST_EXTENDED_ID

#: SignalColumn.status
USABLE = 0
NOT_AVAILABLE = 1
ERROR = 2

_TABLED_BITS = 13
"""Signals of up to so many bits are looked up: their tables fit into the CPU's cache."""


@dataclass(frozen=True)
class FrameBlock:
    """Frames in the order of the log, one row each; all arrays of shape (n,).

    time_s: float64, seconds, the recorder's epoch. can_id: uint32 with flags. length: uint8, bytes of data (of a remote
    frame: the length asked for). payload: uint64, the first 8 bytes of data, first byte lowest, absent bytes 0 (beyond
    8 bytes those of a CAN FD frame are in `long`). channel: int32 index into `channels`. long: row -> all data, of frames that
    have more than 8 bytes.
    """

    time_s: NDArray[np.float64]
    can_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    payload: NDArray[np.uint64]
    channel: NDArray[np.int32]
    channels: tuple[str, ...]
    long: Mapping[int, bytes] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_s)

    def take(self, rows: NDArray[np.intp] | slice) -> FrameBlock:
        """The rows named, in that order."""
        return FrameBlock(
            self.time_s[rows],
            self.can_id[rows],
            self.length[rows],
            self.payload[rows],
            self.channel[rows],
            self.channels,
            self.long_of(rows) if self.long else {},
        )

    def of_channels(self, names: Container[str]) -> FrameBlock:
        """The rows of the channels named."""
        rows = np.flatnonzero(np.isin(self.channel, [number for number, name in enumerate(self.channels) if name in names]))
        return self if len(rows) == len(self) else self.take(rows)

    def after(self, time_s: float) -> FrameBlock:
        """The rows after a time."""
        later = self.time_s > time_s
        return self if later.all() else self.take(np.flatnonzero(later))

    def channels_in_use(self) -> frozenset[str]:
        """Names of the channels that have a row; "" where a log names none."""
        counts = np.bincount(self.channel, minlength=len(self.channels)).tolist()
        return frozenset(name for name, count in zip(self.channels, counts, strict=True) if count)

    def long_of(self, rows: NDArray[np.intp] | slice) -> dict[int, bytes]:
        """`long` of a block of these rows."""
        if not self.long:
            return {}
        places = np.arange(len(self))[rows].tolist()
        return {place: self.long[row] for place, row in enumerate(places) if row in self.long}


@dataclass(frozen=True)
class SignalColumn:
    """One signal over the rows of one message.

    values: float64 in the DBC's unit, NaN where unusable; for counters and codes int64, -1 where unusable. status:
    uint8, USABLE, NOT_AVAILABLE or ERROR.
    """

    values: NDArray[np.float64] | NDArray[np.int64]
    status: NDArray[np.uint8]


@dataclass(frozen=True)
class MessageColumns:
    """All frames of one message in a block. rows: their places in the block, rising; time_s beside them, shape (n,)."""

    name: str
    rows: NDArray[np.intp]
    time_s: NDArray[np.float64]
    signals: Mapping[str, SignalColumn]


@dataclass(frozen=True)
class DecodedBlock:
    """messages: those that occur. wrong_length: rows that Codec.decode() raises FrameError for, rising."""

    messages: Mapping[str, MessageColumns]
    wrong_length: NDArray[np.intp]


def decode_block(codec: Codec, block: FrameBlock, only: Container[str] | None = None) -> DecodedBlock:
    """What codec.decode() says of every row: the same values, the same rows passed over, the same rows refused.

    only: names of the messages that are wanted; None: all.
    """
    messages = {}
    refused = []
    for layout in codec.layouts.values():
        if only is not None and layout.name not in only:
            continue
        compared = np.uint32(layout.identity_mask | EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG)
        rows = np.flatnonzero((block.can_id & compared) == np.uint32(layout.identity | EXTENDED_FLAG))
        wrong = block.length[rows] != layout.length
        if wrong.any():
            refused.append(rows[wrong])
            rows = rows[~wrong]
        if len(rows):
            messages[layout.name] = _columns(layout, rows, block.time_s[rows], block.payload[rows])
    return DecodedBlock(messages, np.sort(np.concatenate(refused)) if refused else np.empty(0, np.intp))


def block_of(messages: Iterable[can.Message]) -> FrameBlock:
    """The same frames as a block."""
    messages, channels = list(messages), dict[str, int]()
    rows = [
        (
            message.timestamp,
            flagged_id(message),
            message.dlc if message.is_remote_frame else len(message.data),
            int.from_bytes(message.data[:CLASSIC_BYTES], "little"),
            channels.setdefault(channel_name(message), len(channels)),
        )
        for message in messages
    ]
    time_s, can_id, length, payload, channel = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    return FrameBlock(
        np.array(time_s, np.float64),
        np.array(can_id, np.uint32),
        np.array(length, np.uint8),
        np.array(payload, np.uint64),
        np.array(channel, np.int32),
        tuple(channels),
        {row: bytes(message.data) for row, message in enumerate(messages) if len(message.data) > CLASSIC_BYTES},
    )


def messages_of(block: FrameBlock) -> Iterator[can.Message]:
    """The rows as messages, in order: block_of() backwards.

    Parameters
    ----------
    block : FrameBlock

    Yields
    ------
    can.Message
    """
    columns = (block.time_s, block.can_id, block.length, block.payload, block.channel)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (time_s, flagged, length, payload, channel) in enumerate(rows):
        remote, error = bool(flagged & REMOTE_FLAG), bool(flagged & ERROR_FLAG)
        yield can.Message(
            timestamp=time_s,
            arbitration_id=flagged & LARGEST_EXTENDED_ID,
            is_extended_id=bool(flagged & EXTENDED_FLAG),
            is_remote_frame=remote,
            is_error_frame=error,
            is_fd=row in block.long,
            dlc=length,
            data=None if remote else block.long.get(row, payload.to_bytes(CLASSIC_BYTES, "little")[:length]),
            channel=block.channels[channel] or None,
        )


def concatenate(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """One block with the rows of all, in order; channels are merged by name."""
    names = tuple(dict.fromkeys(name for block in blocks for name in block.channels))
    place = {name: index for index, name in enumerate(names)}
    channel = [np.array([place[name] for name in block.channels], np.int32)[block.channel] for block in blocks if len(block)]
    starts = accumulate((len(block) for block in blocks), initial=0)
    long = {start + row: data for start, block in zip(starts, blocks, strict=False) for row, data in block.long.items()}
    return FrameBlock(
        np.concatenate([np.empty(0), *(block.time_s for block in blocks)]),
        np.concatenate([np.empty(0, np.uint32), *(block.can_id for block in blocks)]),
        np.concatenate([np.empty(0, np.uint8), *(block.length for block in blocks)]),
        np.concatenate([np.empty(0, np.uint64), *(block.payload for block in blocks)]),
        np.concatenate([np.empty(0, np.int32), *channel]),
        names,
        long,
    )


def _columns(
    layout: MessageLayout, rows: NDArray[np.intp], time_s: NDArray[np.float64], payload: NDArray[np.uint64]
) -> MessageColumns:
    signals = {signal.name: _column(signal, payload) for signal in layout.signals}
    return MessageColumns(layout.name, rows, time_s, signals)


def _column(signal: SignalLayout, payload: NDArray[np.uint64]) -> SignalColumn:
    raw = (payload >> np.uint64(signal.start) & np.uint64(signal.mask)).view(np.int64)
    if signal.bits > _TABLED_BITS:
        return _meaning(signal, raw)
    table = _table(signal)
    return SignalColumn(table.values.take(raw), table.status.take(raw))


@cache
def _table(signal: SignalLayout) -> SignalColumn:
    """What each raw value of a signal means."""
    return _meaning(signal, np.arange(signal.mask + 1, dtype=np.int64))


def _meaning(signal: SignalLayout, raw: NDArray[np.int64]) -> SignalColumn:
    status = np.zeros(len(raw), np.uint8)
    status[raw > signal.raw_max] = ERROR
    status[raw >= signal.raw_not_available] = NOT_AVAILABLE
    if signal.codes is not None:
        defined = np.isin(raw, np.array(sorted(signal.codes), np.int64))
        status[~defined & (raw <= signal.raw_max)] = ERROR
    values: NDArray[np.float64] | NDArray[np.int64]
    if signal.integral:
        values = np.where(status == USABLE, raw, -1)
    else:
        values = np.where(status == USABLE, raw * signal.scale + signal.offset, np.nan)
    return SignalColumn(values, status)
