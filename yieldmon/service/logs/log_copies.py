"""Logs that are named twice, also under different names: what they hold would count twice."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from yieldmon.bus.log_files.gunzip import open_bytes
from yieldmon.errors import InputError
from yieldmon.files.whole_file import real_path
from yieldmon.repeats import repeated

_BEGINNING_BYTES = 1 << 16


def refuse_named_twice(logs: Sequence[str]) -> None:
    """Raises InputError for a log that is named twice, by whatever path."""
    resolved = [real_path(log) for log in logs]
    for index, path in enumerate(resolved):
        if path in resolved[:index]:
            raise InputError(logs[index], "is named twice, which would double its mass", "each log once")


def refuse_repeated_loads(sources: Sequence[str]) -> None:
    """Raises InputError for a source of --loads that is named twice, by its name or its content."""
    if twice := repeated(sources):
        raise InputError("--loads", f"names {twice[0]} twice", "each log once")
    refuse_copies(sources)


def refuse_copies(logs: Sequence[str]) -> None:
    """Raises InputError for logs of the same content, gzipped or not. Only logs that begin alike are read to their end."""
    alike: dict[str, list[str]] = {}
    for log in logs if len(logs) > 1 else []:
        beginning = _digest(log, _BEGINNING_BYTES) if Path(log).is_file() else ""
        if not beginning:
            continue
        others = alike.setdefault(beginning, [])
        for other in others:
            if _digest(other) == _digest(log):
                gzipped = ", one of them gzipped," if log.endswith(".gz") != other.endswith(".gz") else ""
                raise InputError(log, f"is the same log as {other}{gzipped} and would double its mass", "each log once")
        others.append(log)


def _digest(log: str, most: int | None = None) -> str:
    """Of a log's content behind any gzip, as far as it can be read; of its first bytes where `most` is given; "" of nothing."""
    digest, read = hashlib.sha256(), 0
    with open_bytes(Path(log), log.lower().endswith(".gz")) as stream:
        while (most is None or read < most) and (piece := stream.read(_BEGINNING_BYTES)):
            digest.update(piece)
            read += len(piece)
    return digest.hexdigest() if read else ""
