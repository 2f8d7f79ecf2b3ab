"""Reading packed Parquet files of frames; `format` says what is in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import FrameBlock
from yieldmon.bus.packed.columns import CONSTANT, Coded, Column, decode, place_fields
from yieldmon.bus.packed.format import (
    ALL_COMPRESSED,
    BEGINS,
    DATA_BITS,
    DROPPED,
    FLOAT,
    FORMAT,
    NAMES,
    PER_S,
    PLACE,
    TIME,
    VERSION,
    schema,
)  # fmt: skip
from yieldmon.bus.packed.writing import BLOCK_FRAMES
from yieldmon.errors import InputError, brief, of_the_computer, reason
from yieldmon.identifiers import CLASSIC_BYTES

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow import parquet

_WORTH_COMPILING = 16
"""Blocks of a file from which on loading compiled code pays: that takes about a second."""
_EXPECTED = "a file that `yieldmon pack` wrote"
_MOST_FRAMES = 16 * BLOCK_FRAMES
_MOST_DIGITS = 18
_SPARE_BYTES = 1 << 16
"""What a column may be larger than its numbers: its header, and a last stretch that is filled up."""
Wanted = Callable[[NDArray[np.uint32]], NDArray[np.bool_]]
"""Says of identifiers with flags, shape (n,), which of them somebody takes."""


def read_blocks(
    path: Path | str,
    wanted: Wanted | None = None,
    counted: Callable[[int, int], None] | None = None,
    part: int | None = None,
) -> Iterator[FrameBlock]:
    """The frames of a packed file, a block at a time.

    Parameters
    ----------
    path : Path or str
    wanted : callable, optional
        Of identifiers with flags, shape (n,): which of them are read; by default all.
    counted : callable, optional
        Called with each identifier of a block, with flags, and the number of its frames, read or not.
    part : int, optional
        Number from 0 of the one log that is read, of those that were packed together (`packed_logs`); by default all.

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
            version = metadata.get(FORMAT)
            if version not in (VERSION, ALL_COMPRESSED):
                raise InputError(str(path), "a Parquet file without packed CAN frames", _EXPECTED)
            begins = (*_begins(source), source.num_row_groups)
            for group in range(begins[0], begins[-1]) if part is None else range(*begins[part : part + 2]):
                table = source.read_row_group(group, use_threads=False).select(NAMES).cast(schema())
                if any(column.null_count for column in table.columns):
                    raise ValueError("a row that lacks something")
                if counted is not None:
                    _count(table, counted)
                if wanted is not None:
                    table = table.filter(pa.array(wanted(table["can_id"].to_numpy())))
                columns = table.to_pydict()
                rows = list(zip(*(columns[name] for name in NAMES), strict=True))
                compiled = source.num_row_groups >= _WORTH_COMPILING
                yield _block(rows, all_compressed=version == ALL_COMPRESSED, compiled=compiled)
    except InputError:
        # A ValueError too, which says all there is to say.
        raise
    except FileNotFoundError as error:
        raise InputError(str(path), reason(error), "a readable file of packed frames") from error
    except (pa.ArrowException, OSError, ValueError, LookupError, OverflowError) as error:
        raise InputError(str(path), _flaw(error), _EXPECTED) from error


def _flaw(error: Exception) -> str:
    return reason(error) if of_the_computer(error) is not None else f"damaged: {brief(error)}"


def packed_logs(path: Path | str) -> int:
    """How many logs were packed into a file. Raises InputError for a file of which that cannot be read."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as source:
            return len(_begins(source))
    except FileNotFoundError as error:
        raise InputError(str(path), reason(error), "a readable file of packed frames") from error
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(str(path), _flaw(error), _EXPECTED) from error


def _begins(source: parquet.ParquetFile) -> tuple[int, ...]:
    """Numbers of the blocks with which the logs begin. Raises ValueError where they are no such."""
    text = (source.metadata.metadata or {}).get(BEGINS, b"")
    numbers = [part for part in text.split(b",") if part]
    if not all(part.isdigit() and len(part) <= _MOST_DIGITS for part in numbers):
        raise ValueError(f"logs that begin with the blocks {text[:20]!r}")
    begins = (0, *map(int, numbers))
    if any(after <= before for before, after in pairwise((*begins, max(source.num_row_groups, 1)))):
        raise ValueError(f"logs that begin with the blocks {text[:20]!r} of {source.num_row_groups}")
    return begins


def dropped_by_recorder(path: Path | str) -> int:
    """Frames that the recorder of a packed log says it lost. Raises InputError for a file of which that cannot be read."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as source:
            count_text = (source.metadata.metadata or {}).get(DROPPED, b"0")
    except (pa.ArrowException, OSError) as error:
        raise InputError(str(path), _flaw(error), _EXPECTED) from error
    if not count_text.isdigit() or len(count_text) > _MOST_DIGITS:
        raise InputError(str(path), f"damaged: {count_text[:20]!r} frames lost by the recorder", _EXPECTED)
    return int(count_text)


def _count(table: pa.Table, counted: Callable[[int, int], None]) -> None:
    """Each message of a block has one column of times."""
    columns = (table[name].to_pylist() for name in ("column", "can_id", "frames"))
    for name, can_id, frames in zip(*columns, strict=True):
        if name == TIME:
            counted(can_id, frames)


def _times(unit: str, values: Column) -> NDArray[np.float64]:
    if unit == FLOAT:
        return values.view(np.float64)
    return values.view(np.int64) / PER_S[unit]


@dataclass(slots=True)
class _Message:
    """The frames of one message in a block, as far as its columns have been read."""

    can_id: int
    length: int
    channel: int
    payload: Column
    unit: str
    times: Column
    places: NDArray[np.intp] | None = None


def _block(rows: Iterable[tuple[Any, ...]], *, all_compressed: bool, compiled: bool) -> FrameBlock:
    import pyarrow as pa

    codec = pa.Codec("zstd")
    channels: list[str] = []
    messages: list[_Message] = []
    last: tuple[Any, ...] | None = None
    for row in rows:
        head, (name, start, bits, coding, width, size, packed) = row[:5], row[5:]
        _, channel, can_id, length, count = head
        begins = head != last or name == TIME
        if begins and (name != TIME or length > CLASSIC_BYTES or not 1 <= count <= _MOST_FRAMES):
            raise ValueError(f"{count} frames of {length} bytes that begin with {name[:20]!r}")
        last = head
        starts = () if name in (TIME, PLACE) else _starts(start)
        numbers = count * (len(starts) or 1)
        _check(bits, starts, size, packed, numbers)
        whole = len(packed) == size and not all_compressed
        data = packed if whole else codec.decompress(packed, decompressed_size=size, asbytes=True)
        if coding == CONSTANT and len(starts) == 1:
            messages[-1].payload |= np.uint64(int.from_bytes(data, "little") << starts[0])
            continue
        column = decode(Coded(coding, width, data), numbers, bits, compiled=compiled)
        if name == TIME:
            if channel not in channels:
                channels.append(channel)
            messages.append(_Message(can_id, length, channels.index(channel), np.zeros(count, np.uint64), start, column))
        elif name == PLACE:
            messages[-1].places = column.astype(np.intp)
        else:
            place_fields(messages[-1].payload, column, starts, compiled=compiled)
    return _assembled(messages, tuple(channels))


@lru_cache(maxsize=1024)
def _starts(text: str) -> tuple[int, ...]:
    return tuple(int(at) for at in text.split(","))


def _check(bits: int, starts: tuple[int, ...], size: int, packed: bytes, numbers: int) -> None:
    """Raises ValueError for what no column says of itself, before memory is taken for it."""
    if not 1 <= bits <= DATA_BITS or len(starts) > DATA_BITS or any(not 0 <= at <= DATA_BITS - bits for at in starts):
        raise ValueError(f"numbers of {bits} bits from bit {starts[:3]}")
    if not 0 <= size <= 8 * numbers + _SPARE_BYTES or len(packed) > size + _SPARE_BYTES:
        raise ValueError(f"{size} bytes for {numbers} numbers")


def _assembled(messages: Sequence[_Message], channels: tuple[str, ...]) -> FrameBlock:
    if len({message.unit for message in messages}) > 1:
        raise ValueError("times of several units in a block")
    counts = [len(message.times) for message in messages]

    def spread(values: list[int], kind: type[np.integer[Any]]) -> NDArray[Any]:
        return np.repeat(np.array(values, kind), counts)

    times = np.concatenate([*(message.times for message in messages), np.empty(0, np.uint64)])
    payload = np.concatenate([*(message.payload for message in messages), np.empty(0, np.uint64)])
    time_s = _times(messages[0].unit, times) if messages else np.empty(0)
    if not np.isfinite(time_s).all():
        raise ValueError("a time that is not a number")
    order = np.argsort(_places(messages, times), kind="stable")
    return FrameBlock(
        time_s[order],
        spread([message.can_id for message in messages], np.uint32)[order],
        spread([message.length for message in messages], np.uint8)[order],
        payload[order],
        spread([message.channel for message in messages], np.int32)[order],
        channels,
    )


def _places(messages: Sequence[_Message], times: Column) -> Column | NDArray[np.intp]:
    """What the frames are in order of: their places in the block where the file has them, else their times."""
    places = [message.places for message in messages if message.places is not None]
    if not places:
        return times
    if len(places) < len(messages):
        raise ValueError("places of some frames of a block, and not of others")
    return np.concatenate(places)
