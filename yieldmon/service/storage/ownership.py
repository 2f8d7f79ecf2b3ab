"""One daemon for one store: two would each number the seconds by themselves, and count the same grain twice."""

from __future__ import annotations

import fcntl
import logging
import os
from pathlib import Path
from types import TracebackType

from yieldmon.errors import InputError, reason
from yieldmon.service.storage.in_the_way import make_way
from yieldmon.service.storage.store_errors import StoreError
from yieldmon.service.storage.store_names import lock_path

_log = logging.getLogger(__name__)


class OccupiedError(InputError):
    """Another daemon has what this one is configured to use, or may have it: wrong for as long as that is so."""


class Ownership:
    """Keeps other daemons off the store at a path for as long as the context lasts; a process that dies lets go of it.

    Where the lock's file cannot be made, on a medium that takes no writing, there is nothing to keep apart either.
    """

    def __init__(self, store: Path) -> None:
        self._store = store
        self._path = lock_path(store)
        self._lock: int | None = None

    def __enter__(self) -> Ownership:
        """Raises as `take`."""
        self.take()
        return self

    def take(self) -> None:
        """Begin to keep them off. Raises OccupiedError when another daemon has the store."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            make_way([self._path])
            taken = self._take()
        except OSError as error:
            _log.warning("%s: %s; another daemon on this store would not be noticed", self._path, reason(error))
            return
        if not taken:
            raise OccupiedError("store.path", f"{self._store}: another daemon is using it", "a store for each daemon")

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()

    def release(self) -> None:
        """Let go of the store."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def keep(self) -> None:
        """To be asked before each commit: a lock whose file was removed excludes no other process, and is taken anew.

        Raises StoreError when another daemon has taken it meanwhile.
        """
        if self._lock is None:
            return
        try:
            if os.path.samestat(os.fstat(self._lock), os.lstat(self._path)):
                return
        except FileNotFoundError:
            pass
        except OSError:
            return  # a medium that fails is reported by the commit
        try:
            make_way([self._path])
            taken = self._take()
        except OSError:
            return
        if not taken:
            raise StoreError(f"{self._store}: another daemon is using it, since {self._path.name} was removed")
        _log.warning("%s: removed while in use, and recreated", self._path)

    def _take(self) -> bool:
        """Whether the lock is ours now; another one that was is let go. Raises OSError."""
        lock = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            return False
        except OSError:
            os.close(lock)
            raise
        if self._lock is not None:
            os.close(self._lock)
        self._lock = lock
        return True
