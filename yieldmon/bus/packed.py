"""CAN frames as Parquet: columns by message, coded exactly, compressed with zstd (the parquet extra).

The file is a table of columns. Each row holds one column of one message (channel, identifier, length) over one block of
frames: `block`, `channel`, `can_id` (with the flags of linux/can.h), `length`, `frames`, `column` (a signal's name where
the DBC has the message, otherwise a stretch of bits of the data; `time` and, where arrival order is not that of time,
`place`), `start`, `bits`, `coding`, `width`, `size` (of the data before compression), `data`. Reading gives the frames
that were packed, to the last bit and in their order.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import FrameBlock, concatenate
from yieldmon.bus.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.bus.layout import MessageLayout
from yieldmon.bus.packed_columns import CONSTANT, Coded, Column, decode, encode, place_fields
from yieldmon.errors import InputError, brief, reason
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG

if TYPE_CHECKING:
    import pyarrow as pa

#: Frames that are packed together.
BLOCK_FRAMES = 1 << 17
_FORMAT = b"yieldmon.frames"
_DROPPED = b"yieldmon.dropped_by_recorder"
"""How many frames the recorders of the logs say that they lost; absent for none."""
_VERSION = b"2"
_ALL_COMPRESSED = b"1"
"""The format before, in which no column was kept as it is."""
_PLAIN_BYTES = 128
"""Columns up to this size are kept as they are: calling the decompressor takes longer than reading them."""
_WORTH_COMPILING = 16
"""Blocks of a file from which on loading compiled code pays: that takes about a second."""
_LEVEL = 12
_EXPECTED = "a file that `yieldmon pack` wrote"
_TIME, _PLACE = "time", "place"
_MICROS, _NANOS, _FLOAT = "us", "ns", "float64"
_PER_S = {_MICROS: 1e6, _NANOS: 1e9}
_LARGEST_EXACT = 2.0**53
_DATA_BITS = 64
_MOST_FRAMES = 16 * BLOCK_FRAMES
_MOST_DIGITS = 18
_SPARE_BYTES = 1 << 16
"""What a column may be larger than its numbers: its header, and a last stretch that is filled up."""
_NAMES = ("block", "channel", "can_id", "length", "frames", "column", "start", "bits", "coding", "width", "size", "data")


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


Wanted = Callable[[NDArray[np.uint32]], NDArray[np.bool_]]
"""Says of identifiers with flags, shape (n,), which of them somebody takes."""


def pack(
    blocks: Iterable[FrameBlock], path: Path, layouts: Mapping[str, MessageLayout], dropped: Callable[[], int] | None = None
) -> Packed:
    """Pack frames into one file.

    Parameters
    ----------
    blocks : iterable of FrameBlock
        Frames in the order of the log, of whatever lengths.
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
        self.dropped_by_recorder = 0
        self._schema = _schema().with_metadata({_FORMAT: _VERSION})
        self._writer = parquet.ParquetWriter(
            path,
            self._schema,
            # Each column of frames is compressed by itself: planes of different signals have little in common.
            compression={name: "NONE" if name == "data" else "ZSTD" for name in _NAMES},
            use_dictionary=[name for name in _NAMES if name != "data"],
            write_statistics=False,
            write_page_checksum=True,
        )

    def write(self, block: FrameBlock) -> None:
        """Pack a block. Raises InputError for data of more than 8 bytes, which a block does not hold."""
        import pyarrow as pa

        if (block.length > 8).any():
            raise InputError("pack", "CAN FD frames with more than 8 bytes of data", "classic CAN frames")
        rows = _rows(self._blocks, block, self._layouts)
        self._blocks += 1
        codec = pa.Codec("zstd", _LEVEL)
        rows = [(*row[:-1], len(row[-1]), _compressed(row[-1], codec)) for row in rows]
        columns = dict(zip(_NAMES, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(_NAMES, ())
        self._writer.write_table(pa.table({name: list(columns[name]) for name in _NAMES}, schema=self._schema))

    def close(self) -> None:
        """Complete the file."""
        if self.dropped_by_recorder:
            self._writer.add_key_value_metadata({_DROPPED.decode(): str(self.dropped_by_recorder)})
        self._writer.close()

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def read_blocks(
    path: Path | str, wanted: Wanted | None = None, counted: Callable[[int, int], None] | None = None
) -> Iterator[FrameBlock]:
    """The frames of a packed file, a block at a time.

    Parameters
    ----------
    path : Path or str
    wanted : callable, optional
        Of identifiers with flags, shape (n,): which of them are read; by default all.
    counted : callable, optional
        Called with each identifier of a block, with flags, and the number of its frames, read or not.

    Yields
    ------
    FrameBlock

    Raises
    ------
    InputError
        The file is missing, damaged, or no file of packed frames.
    ModuleNotFoundError
        The parquet extra is not installed.
    """
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as source:
            metadata = source.schema_arrow.metadata or {}
            version = metadata.get(_FORMAT)
            if version not in (_VERSION, _ALL_COMPRESSED):
                raise InputError(str(path), "a Parquet file without packed CAN frames", _EXPECTED)
            for group in range(source.num_row_groups):
                table = source.read_row_group(group, use_threads=False).select(_NAMES).cast(_schema())
                if any(column.null_count for column in table.columns):
                    raise ValueError("a row that lacks something")
                if counted is not None:
                    _count(table, counted)
                if wanted is not None:
                    table = table.filter(pa.array(wanted(table["can_id"].to_numpy())))
                columns = table.to_pydict()
                rows = list(zip(*(columns[name] for name in _NAMES), strict=True))
                compiled = source.num_row_groups >= _WORTH_COMPILING
                yield _block(rows, all_compressed=version == _ALL_COMPRESSED, compiled=compiled)
    except InputError:
        # A ValueError too, which says all there is to say.
        raise
    except FileNotFoundError as error:
        raise InputError(str(path), reason(error), "a readable file of packed frames") from error
    except (pa.ArrowException, OSError, ValueError, LookupError, OverflowError) as error:
        raise InputError(str(path), f"damaged: {brief(error)}", _EXPECTED) from error


def dropped_by_recorder(path: Path | str) -> int:
    """Frames that the recorder of a packed log says it lost. Raises InputError for a file of which that cannot be read."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as source:
            count_text = (source.metadata.metadata or {}).get(_DROPPED, b"0")
    except (pa.ArrowException, OSError) as error:
        raise InputError(str(path), f"damaged: {brief(error)}", _EXPECTED) from error
    if not count_text.isdigit() or len(count_text) > _MOST_DIGITS:
        raise InputError(str(path), f"damaged: {count_text[:20]!r} frames lost by the recorder", _EXPECTED)
    return int(count_text)


def _count(table: pa.Table, counted: Callable[[int, int], None]) -> None:
    """Each message of a block has one column of times."""
    columns = (table[name].to_pylist() for name in ("column", "can_id", "frames"))
    for name, can_id, frames in zip(*columns, strict=True):
        if name == _TIME:
            counted(can_id, frames)


def _schema() -> pa.Schema:
    import pyarrow as pa

    kinds = (
        *(pa.int32(), pa.string(), pa.uint32(), pa.uint8(), pa.int32(), pa.string(), pa.string()),
        *(pa.uint8(), pa.string(), pa.uint8(), pa.int32(), pa.binary()),
    )
    return pa.schema(list(zip(_NAMES, kinds, strict=True)))


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

        add(_TIME, unit, times[at], _DATA_BITS)
        if not by_time:
            add(_PLACE, "", at.astype(np.uint64), _DATA_BITS)
        for field in _fields(head[2], head[3], layouts):
            parts = [block.payload[at] >> np.uint64(start) & np.uint64((1 << field.bits) - 1) for start in field.starts]
            values = np.column_stack(parts).ravel() if len(parts) > 1 else parts[0]
            add(field.name, ",".join(map(str, field.starts)), values, field.bits, len(parts) > 1)
    return rows


def _whole_times(time_s: NDArray[np.float64]) -> tuple[str, Column]:
    """Times as whole numbers from which the same floats come back, and their unit."""
    for unit, per_s in _PER_S.items():
        scaled = np.rint(time_s * per_s)
        if (np.abs(scaled) < _LARGEST_EXACT).all() and (scaled / per_s == time_s).all():
            return unit, scaled.astype(np.int64).view(np.uint64)
    return _FLOAT, time_s.view(np.uint64)


def _times(unit: str, values: Column) -> NDArray[np.float64]:
    if unit == _FLOAT:
        return values.view(np.float64)
    return values.view(np.int64) / _PER_S[unit]


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
    for byte in range(8):
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


def _block(rows: Iterable[tuple[Any, ...]], *, all_compressed: bool, compiled: bool) -> FrameBlock:
    import pyarrow as pa

    codec = pa.Codec("zstd")
    channels: list[str] = []
    parts: list[list[Any]] = []
    last: tuple[Any, ...] | None = None
    explicit = False
    for row in rows:
        head, (name, start, bits, coding, width, size, packed) = row[:5], row[5:]
        _, channel, can_id, length, count = head
        if head != last or name == _TIME:
            if name != _TIME or length > CLASSIC_BYTES or not 1 <= count <= _MOST_FRAMES:
                raise ValueError(f"{count} frames of {length} bytes that begin with {name[:20]!r}")
            if channel not in channels:
                channels.append(channel)
            kept: list[Any] = [np.empty(0), np.zeros(count, np.uint64), None, can_id, length, channels.index(channel), count, ""]
            parts.append(kept)
            last = head
        values = parts[-1]
        starts = () if name in (_TIME, _PLACE) else _starts(start)
        per_frame = len(starts) or 1
        _check(bits, starts, size, packed, count * per_frame)
        whole = len(packed) == size and not all_compressed
        data = packed if whole else codec.decompress(packed, decompressed_size=size, asbytes=True)
        if coding == CONSTANT and len(starts) == 1:
            values[1] |= np.uint64(int.from_bytes(data, "little") << starts[0])
            continue
        column = decode(Coded(coding, width, data), count * per_frame, bits, compiled=compiled)
        if name == _TIME:
            values[0], values[7] = column, start
        elif name == _PLACE:
            values[2], explicit = column.astype(np.intp), True
        else:
            place_fields(values[1], column, starts, compiled=compiled)
    return _assembled(parts, tuple(channels), explicit)


@lru_cache(maxsize=1024)
def _starts(text: str) -> tuple[int, ...]:
    return tuple(int(at) for at in text.split(","))


def _check(bits: int, starts: tuple[int, ...], size: int, packed: bytes, numbers: int) -> None:
    """Raises ValueError for what no column says of itself, before memory is taken for it."""
    if not 1 <= bits <= _DATA_BITS or len(starts) > _DATA_BITS or any(not 0 <= at <= _DATA_BITS - bits for at in starts):
        raise ValueError(f"numbers of {bits} bits from bit {starts[:3]}")
    if not 0 <= size <= 8 * numbers + _SPARE_BYTES or len(packed) > size + _SPARE_BYTES:
        raise ValueError(f"{size} bytes for {numbers} numbers")


def _assembled(parts: list[list[Any]], channels: tuple[str, ...], explicit: bool) -> FrameBlock:
    counts = [part[6] for part in parts]

    def spread(index: int, kind: Any) -> NDArray[Any]:
        return np.repeat(np.array([part[index] for part in parts], kind), counts)

    whole = np.concatenate([*(part[0] for part in parts), np.empty(0, np.uint64)]).astype(np.uint64)
    order = (
        np.argsort(np.concatenate([part[2] for part in parts]), kind="stable") if explicit else np.argsort(whole, kind="stable")
    )
    payload = np.concatenate([*(part[1] for part in parts), np.empty(0, np.uint64)]).astype(np.uint64)
    if len({part[7] for part in parts}) > 1:
        raise ValueError("times of several units in a block")
    time_s = _times(parts[0][7], whole) if parts else np.empty(0)
    if not np.isfinite(time_s).all():
        raise ValueError("a time that is no number")
    return FrameBlock(
        time_s[order],
        spread(3, np.uint32)[order],
        spread(4, np.uint8)[order],
        payload[order],
        spread(5, np.int16)[order],
        channels,
    )
