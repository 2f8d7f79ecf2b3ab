"""Logs of one machine that hold the same: under a second name, in another day's folder, or once plain and once compressed.

Measured twice, a copy would count its mass twice. Logs of other machines are not looked at: which of two one belongs to cannot be
reported, and `fleet report` names it.
"""

from __future__ import annotations

import gzip
import hashlib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import groupby
from typing import Any

from yieldmon.errors import of_the_computer
from yieldmon.fleet.filesystem import filesystem_of, storage_failures
from yieldmon.fleet.partition import Partition

_HEAD_BYTES = 4096
"""Of the content. Logs that differ in it are no copies; the others are read whole."""
_CHUNK_BYTES = 1 << 20


def with_copies(partitions: tuple[Partition, ...]) -> tuple[Partition, ...]:
    """The partitions, with those of their logs that repeat another of the machine as `copies`.

    The first of a machine's logs with a content, by day and by place in the day, is none. A log that cannot be read is none, and
    neither is an empty one.

    Raises
    ------
    OSError
        This computer cannot read at present (`errors.of_the_computer`): a copy that is not known to be one would count twice.
    """
    found: list[Partition] = []
    for _, days in groupby(partitions, key=lambda partition: partition.machine):
        whole = tuple(days)
        logs = [(log, partition) for partition in whole for log in partition.logs]
        alike: dict[bytes, list[str]] = {}
        for log, _ in logs:
            with _none_where_unreadable():
                alike.setdefault(_head(log), []).append(log)
        first: dict[bytes, str] = {}
        repeated: dict[str, str] = {}
        several = {log for head, group in alike.items() if head and len(group) > 1 for log in group}
        for log, _ in logs:
            if log in several:
                with _none_where_unreadable():
                    same = first.setdefault(_digest(log), log)
                    if same != log:
                        repeated[log] = same
        found += [replace(p, copies=tuple((log, repeated[log]) for log in p.logs if log in repeated)) for p in whole]
    return tuple(found)


@contextmanager
def _none_where_unreadable() -> Iterator[None]:
    try:
        with storage_failures():
            yield
    except (OSError, zlib.error, EOFError) as error:
        if of_the_computer(error) is not None:
            raise


def _head(log: str) -> bytes:
    files, path = filesystem_of(log)
    with files.open(path, "rb") as stream:
        begin: bytes = stream.read(_HEAD_BYTES)
    # 4096 compressed bytes hold no less of the content, unless that is random or shorter.
    return zlib.decompressobj(31).decompress(begin, _HEAD_BYTES // 2) if _is_compressed(log) else begin[: _HEAD_BYTES // 2]


def _digest(log: str) -> bytes:
    digest = hashlib.sha256()
    for chunk in _content(log):
        digest.update(chunk)
    return digest.digest()


def _content(log: str) -> Iterator[bytes]:
    files, path = filesystem_of(log)
    with files.open(path, "rb") as stream:
        source: Any = gzip.GzipFile(fileobj=stream) if _is_compressed(log) else stream
        while chunk := source.read(_CHUNK_BYTES):
            yield chunk


def _is_compressed(log: str) -> bool:
    return log.lower().endswith(".gz")
