"""Writing frames as packed Parquet files; `format` says what is in them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import FrameBlock, concatenate
from yieldmon.bus.layout import MessageLayout
from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.bus.packed.columns import Column, encode
from yieldmon.bus.packed.format import BEGINS, DATA_BITS, DROPPED, FLOAT, FORMAT, NAMES, PER_S, PLACE, TIME, VERSION, schema
from yieldmon.errors import InputError
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG

#: Frames that are packed together.
BLOCK_FRAMES = 1 << 17
_PLAIN_BYTES = 128
"""Columns up to this size are kept as they are: calling the decompressor takes longer than reading them."""
_LEVEL = 12
_LARGEST_EXACT = 2.0**53


@dataclass(frozen=True)
class _Field:
    """Bits of the data: `starts` of one number, or of several that are successive samples of one signal."""

    name: str
    starts: tuple[int, ...]
    bits: int


@dataclass(frozen=True)
class Packed:
    """What was packed: frames, and bytes of the file."""

    frames: int
    size_bytes: int


def pack(
    blocks: Iterable[FrameBlock], path: Path, layouts: Mapping[str, MessageLayout], dropped: Callable[[], int] | None = None
) -> Packed:
    """As `pack_logs`, of one log."""
    return pack_logs([blocks], path, layouts, dropped)


def pack_logs(
    logs: Iterable[Iterable[FrameBlock]],
    path: Path,
    layouts: Mapping[str, MessageLayout],
    dropped: Callable[[], int] | None = None,
) -> Packed:
    """Pack logs into one file.

    Parameters
    ----------
    logs : iterable of iterable of FrameBlock
        Of each log the frames in their order, in blocks of whatever lengths. Where a log begins is kept.
    path : Path
        File to write.
    layouts : mapping of str to MessageLayout
        Messages whose signals become columns.
    dropped : callable, optional
        Asked after the last block for the frames that the recorder lost.

    Returns
    -------
    Packed

    Raises
    ------
    InputError
        The parquet extra is not installed; CAN FD frames of more than 8 bytes.
    """
    frames = 0
    with Writer(path, layouts) as writer:
        for blocks in logs:
            writer.begin_log()
            for block in _in_pieces(blocks):
                writer.write(block)
                frames += len(block)
        if dropped is not None:
            writer.dropped_by_recorder = dropped()
    return Packed(frames, path.stat().st_size)


def _in_pieces(blocks: Iterable[FrameBlock]) -> Iterator[FrameBlock]:
    """The same frames in blocks of BLOCK_FRAMES, the last one shorter."""
    waiting: list[FrameBlock] = []
    count = 0
    for block in blocks:
        waiting.append(block)
        count += len(block)
        if count >= BLOCK_FRAMES:
            whole = concatenate(waiting)
            last = count - count % BLOCK_FRAMES
            for first in range(0, last, BLOCK_FRAMES):
                yield whole.take(slice(first, first + BLOCK_FRAMES))
            waiting, count = [whole.take(slice(last, None))], count - last
    if count:
        yield concatenate(waiting)


class Writer:
    """Packs blocks of frames into one file.

    Parameters
    ----------
    path : Path
        File to write.
    layouts : mapping of str to MessageLayout
        Messages whose signals become columns; every other message is kept by its bytes.

    Raises
    ------
    ModuleNotFoundError
        The parquet extra is not installed.
    """

    def __init__(self, path: Path, layouts: Mapping[str, MessageLayout]) -> None:
        from pyarrow import parquet

        self._layouts = tuple(layouts.values())
        self._blocks = 0
        self._begins: list[int] = []
        self.dropped_by_recorder = 0
        self._schema = schema().with_metadata({FORMAT: VERSION})
        self._writer = parquet.ParquetWriter(
            path,
            self._schema,
            # Each column of frames is compressed by itself: planes of different signals have little in common.
            compression={name: "NONE" if name == "data" else "ZSTD" for name in NAMES},
            use_dictionary=[name for name in NAMES if name != "data"],
            write_statistics=False,
            write_page_checksum=True,
        )

    def begin_log(self) -> None:
        """The next block is the first of another log."""
        if self._blocks and self._begins[-1:] != [self._blocks]:
            self._begins.append(self._blocks)

    def write(self, block: FrameBlock) -> None:
        """Pack a block. Raises InputError for data of more than 8 bytes, which a block does not hold."""
        import pyarrow as pa

        if (block.length > CLASSIC_BYTES).any():
            raise InputError("pack", "CAN FD frames with more than 8 bytes of data", "classic CAN frames")
        rows = _rows(self._blocks, block, self._layouts)
        self._blocks += 1
        codec = pa.Codec("zstd", _LEVEL)
        rows = [(*row[:-1], len(row[-1]), _compressed(row[-1], codec)) for row in rows]
        columns = dict(zip(NAMES, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(NAMES, ())
        self._writer.write_table(pa.table({name: list(columns[name]) for name in NAMES}, schema=self._schema))

    def close(self) -> None:
        """Complete the file."""
        if self.dropped_by_recorder:
            self._writer.add_key_value_metadata({DROPPED.decode(): str(self.dropped_by_recorder)})
        if begins := [block for block in self._begins if block < self._blocks]:
            self._writer.add_key_value_metadata({BEGINS.decode(): ",".join(map(str, begins))})
        self._writer.close()

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _rows(number: int, block: FrameBlock, layouts: Iterable[MessageLayout]) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    unit, times = _whole_times(block.time_s)
    key = block.channel.astype(np.uint64) << np.uint64(40) | block.can_id.astype(np.uint64) << np.uint64(8)
    keys, group = np.unique(key | block.length.astype(np.uint64), return_inverse=True)
    places = [np.flatnonzero(group == index) for index in range(keys.size)]
    in_order = np.concatenate([*places, np.empty(0, np.intp)]).astype(np.intp)
    by_time = bool((in_order[np.argsort(times[in_order], kind="stable")] == np.arange(len(block))).all())
    for at in places:
        first = int(at[0])
        head = (number, block.channels[block.channel[first]], int(block.can_id[first]), int(block.length[first]), int(at.size))

        def add(name: str, start: str, values: Column, bits: int, sampled: bool = False, head: tuple[Any, ...] = head) -> None:
            coded = encode(values, bits, sampled=sampled)
            rows.append((*head, name, start, bits, coded.coding, coded.width, coded.data))

        add(TIME, unit, times[at], DATA_BITS)
        if not by_time:
            add(PLACE, "", at.astype(np.uint64), DATA_BITS)
        for field in _fields(head[2], head[3], layouts):
            parts = [block.payload[at] >> np.uint64(start) & np.uint64((1 << field.bits) - 1) for start in field.starts]
            values = np.column_stack(parts).ravel() if len(parts) > 1 else parts[0]
            add(field.name, ",".join(map(str, field.starts)), values, field.bits, len(parts) > 1)
    return rows


def _whole_times(time_s: NDArray[np.float64]) -> tuple[str, Column]:
    """Times as whole numbers from which the same floats come back, and their unit."""
    for unit, per_s in PER_S.items():
        scaled = np.rint(time_s * per_s)
        if (np.abs(scaled) < _LARGEST_EXACT).all() and (scaled / per_s == time_s).all():
            return unit, scaled.astype(np.int64).view(np.uint64)
    return FLOAT, time_s.view(np.uint64)


def _fields(can_id: int, length: int, layouts: Iterable[MessageLayout]) -> list[_Field]:
    """The data's bits as fields: signals where a layout fits, bytes for what is left."""
    fields: list[_Field] = []
    used = 0
    if can_id & (EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG) == EXTENDED_FLAG:
        for layout in layouts:
            if can_id & layout.identity_mask == layout.identity and layout.length == length:
                fields = _signal_fields(layout)
                used = sum(((1 << field.bits) - 1) << start for field in fields for start in field.starts)
                break
    for byte in range(CLASSIC_BYTES):
        start = 8 * byte
        left = [bit for bit in range(start, start + 8) if not used >> bit & 1]
        # Beyond a frame's length bytes are 0 and cost nothing.
        for first, count in _stretches_of(left):
            fields.append(_Field(f"bit{first}", (first,), count))
    return fields


def _stretches_of(bits: list[int]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for bit in bits:
        if found and bit == found[-1][0] + found[-1][1]:
            found[-1] = (found[-1][0], found[-1][1] + 1)
        else:
            found.append((bit, 1))
    return found


def _signal_fields(layout: MessageLayout) -> list[_Field]:
    """Signals whose names differ in a trailing number only are successive samples."""
    series: dict[tuple[str, int], list[int]] = {}
    for signal in layout.signals:
        stem = re.sub(r"\d+$", "", signal.name)
        series.setdefault((stem if stem != signal.name else f"{signal.name} ", signal.bits), []).append(signal.start)
    return [_Field(name.strip(), tuple(starts), bits) for (name, bits), starts in series.items()]


def _compressed(data: bytes, codec: Any) -> bytes:
    """The data compressed, or as they are; what is as long as the data is the data."""
    if len(data) <= _PLAIN_BYTES:
        return data
    found: bytes = codec.compress(data, asbytes=True)
    return found if len(found) < len(data) else data
