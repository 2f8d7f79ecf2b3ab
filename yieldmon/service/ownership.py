"""One daemon for one store: two would each number the seconds by themselves, and count the same grain twice."""

from __future__ import annotations

import fcntl
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from yieldmon.errors import InputError

_log = logging.getLogger(__name__)


class OccupiedError(InputError):
    """Another daemon has what this one is configured to use: wrong for as long as that one runs."""


@contextmanager
def owned(store: Path) -> Iterator[None]:
    """Keeps other daemons off the store at this path for as long as the context lasts; a process that dies lets go of it.

    Raises OccupiedError when another daemon has it. Where the lock's file cannot be made, on a medium that takes no writing,
    there is nothing to keep apart either.
    """
    path = store.with_name(f"{store.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        _log.warning("%s: %s; another daemon on this store would not be noticed", path, error.strerror)
        yield
        return
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OccupiedError("store.path", f"{store}: another daemon is using it", "a store for each daemon") from None
        yield
    finally:
        os.close(lock)
