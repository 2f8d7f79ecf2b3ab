"""Damage to a file's bytes, and to what is within a zip or a Parquet file, whose own checks would refuse any other."""

from __future__ import annotations

import io
import random
import zipfile
from collections.abc import Callable
from typing import Any

Damage = Callable[[bytes, random.Random], bytes]

#: What no column of a table should hold; which of them a column's type takes is tried.
_HOSTILE: tuple[Any, ...] = (
    *(None, 0, 1, -1, 7, 64, 255, 65535, 1 << 31, 1 << 40, (1 << 63) - 1, -(1 << 63)),
    *(0.0, -1.0, 1e308, float("nan"), float("inf")),
    *("", "time", "place", "constant", "plain", "difference", "prediction", "63,0", "-1", "x", "\x00", "9" * 400, "us"),
    *(b"", b"\x00", b"\xff" * 9, bytes(512)),
    *(True, [], {}),
)


def mutated(content: bytes, rng: random.Random) -> bytes:
    """One to eight changes."""
    out = bytearray(content)
    for _ in range(rng.randint(1, 8)):
        at, size = rng.randrange(len(out) + 1), rng.choice((1, 2, 4, 16, 512))
        kind = rng.randrange(6)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at : at + size] = rng.randbytes(size)
        elif kind == 2:
            out[at:at] = out[at : at + size] * rng.choice((1, 2, 64))
        elif kind == 3:
            del out[at : at + size]
        elif kind == 4:
            out[at:at] = rng.choice((b"9" * 400, b" " * 4000, b"\x00", b"'", b"-", b"1e999", b"\xff\xfe", b"{" * 50, b"\n"))
        else:
            del out[at:]
        if not out:
            out = bytearray(content)
    return bytes(out)


def within_zip(content: bytes, rng: random.Random) -> bytes:
    """A member changed, taken away or put in another's place; now and then the zip itself damaged."""
    if rng.random() < 0.15:
        return mutated(content, rng)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist() if info.file_size < 1 << 22}
    except Exception:  # noqa: BLE001 - a zip that was damaged before
        return mutated(content, rng)
    if not members:
        return mutated(content, rng)
    chosen, kind = rng.choice(list(members)), rng.random()
    if kind < 0.1:
        del members[chosen]
    elif kind < 0.2:
        members[chosen] = rng.choice(list(members.values()))
    else:
        members[chosen] = mutated(members[chosen], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return out.getvalue()


def within_parquet(content: bytes, rng: random.Random) -> bytes:
    """Cells, rows and columns changed, in a file that is sound otherwise; now and then the file itself damaged."""
    import pyarrow as pa
    from pyarrow import parquet

    if rng.random() < 0.3:
        return mutated(content, rng)
    try:
        table = parquet.read_table(io.BytesIO(content))
        metadata, columns = table.schema.metadata, {name: table[name].to_pylist() for name in table.column_names}
    except Exception:  # noqa: BLE001 - a file that was damaged before
        return mutated(content, rng)
    types = {field.name: field.type for field in table.schema}
    for _ in range(rng.randint(1, 4)):
        _one_change(columns, types, rng)
    out = io.BytesIO()
    try:
        arrays = {name: pa.array(values, types.get(name)) for name, values in columns.items()}
        # pyarrow takes columns of different lengths for a mistake of the caller's.
        parquet.write_table(pa.table(arrays).replace_schema_metadata(metadata), out, compression="none")
    except (pa.ArrowException, ValueError, TypeError, OverflowError):
        return mutated(content, rng)
    return out.getvalue()


def _one_change(columns: dict[str, list[Any]], types: dict[str, Any], rng: random.Random) -> None:
    if not columns:
        return
    name, kind = rng.choice(list(columns)), rng.random()
    rows = len(columns[name])
    at = rng.randrange(rows) if rows else 0
    if kind < 0.05:
        del columns[name]
    elif kind < 0.1:
        types.pop(name, None)
        columns[name] = [rng.choice(_HOSTILE)] * rows
    elif kind < 0.2:
        for values in columns.values():
            del values[at : at + 1]
    elif kind < 0.3 and rows:
        other = rng.randrange(rows)
        for values in columns.values():
            values[at], values[other] = values[other], values[at]
    elif rows:
        before = columns[name][at]
        if isinstance(before, bytes) and rng.random() < 0.7:
            columns[name][at] = mutated(before, rng)
        else:
            columns[name][at] = rng.choice([value for value in _HOSTILE if value is None or isinstance(value, type(before))])
