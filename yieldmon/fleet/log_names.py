"""Which files of a folder are CAN logs, by their names, and which are logs under a name that is not read."""

from __future__ import annotations

import re

from yieldmon.bus.log_files.logs import SUFFIXES
from yieldmon.errors import InputError

TEXT = re.compile(r".*\.txt([.-]\d+)?(\.[a-z0-9]+)*")
"""A log, as it is named or also rotated, compressed or being copied; or anybody's notes."""
ARCHIVES = (".zip", ".7z", ".rar", ".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2", ".tar.zst")
_UNREAD_COMPRESSIONS = (".zst", ".bz2", ".xz", ".lz4", ".7z", ".zip")
_BEING_COPIED = (".part", ".partial", ".filepart", ".crdownload", ".download", ".tmp", ".temp")
"""What programs that copy or fetch a file put behind its name until it is whole."""
_OF_OTHERS_TOO = (".csv", ".db", ".parquet")
_ROTATED = re.compile(r"(.+)[.-]\d+(\.gz)?")
"""As `logrotate` names what it moves away: candump.log.1, candump.log-20261001.gz."""
_NO_LOGS = ("thumbs.db",)
"""Files that file managers leave and that end as a log may."""


def is_log(name: str) -> bool:
    lower = name.lower().removesuffix(".gz")
    return lower.endswith(SUFFIXES)


def is_surely_log(name: str) -> bool:
    """Not a table or database as other programs write them too."""
    return _is_rotated(name) or (is_log(name) and not name.lower().removesuffix(".gz").endswith(_OF_OTHERS_TOO))


def is_left_behind(name: str) -> bool:
    """By a file manager or editor."""
    return name.startswith(".") or name.lower() in _NO_LOGS


def misnamed(path: str, name: str) -> InputError | None:
    """Why a log is not read under its name; None for one that is, and for all else."""
    if _is_rotated(name):
        return InputError(path, "is a log under a name that is not read", "one that ends in .log, .asc or the like")
    if other := _unread_compression(name):
        return InputError(path, f"is compressed as {other}, which is not read", "the log as it is, or as .gz")
    if _is_being_copied(name):
        return InputError(path, "is a log that is not whole yet, by its name", "the log under its own name")
    return None


def _is_rotated(name: str) -> bool:
    found = _ROTATED.fullmatch(name.lower())
    return found is not None and found[1].endswith(SUFFIXES)


def _unread_compression(name: str) -> str:
    """Of a log; "" for all else."""
    stem, dot, suffix = name.lower().rpartition(".")
    return dot + suffix if dot + suffix in _UNREAD_COMPRESSIONS and stem.endswith(SUFFIXES) else ""


def _is_being_copied(name: str) -> bool:
    """A log under the name of a copy that is not complete."""
    stem, dot, suffix = name.lower().rpartition(".")
    return dot + suffix in _BEING_COPIED and is_log(stem)
