"""Files here or in an object store, by fsspec."""

from __future__ import annotations

import errno
import functools
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar

from yieldmon.errors import InputError, brief

SLOW_S = 15.0
"""Without a first answer of a storage, after which that is said."""
_WITHOUT_THE_STORAGE = frozenset({"invalidate_cache", "unstrip_protocol"})
"""What fsspec does by itself."""
_NOT_OF_A_STORAGE = ("builtins", "yieldmon", "zlib")


@contextmanager
def storage_failures() -> Iterator[None]:
    """What the libraries below fsspec raise in classes of their own, as OSError: a storage that cannot be reached, for one."""
    try:
        yield
    except Exception as error:
        if isinstance(error, OSError) or type(error).__module__.partition(".")[0] in _NOT_OF_A_STORAGE:
            raise
        raise OSError(errno.EHOSTUNREACH, f"{type(error).__name__}: {brief(error)}") from error


@contextmanager
def slow_storage(say: Callable[[str], None]) -> Iterator[None]:
    """Have a storage named that does not answer at first; libraries try some minutes before they give up."""
    before, Storage.say_slow = Storage.say_slow, say
    try:
        yield
    finally:
        Storage.say_slow = before


class Storage:
    """A file system of fsspec's all of whose failures are OSErrors. raw: as fsspec made it; address: by which it was named.

    say_slow: for all of them, called with a line when one does not answer at first.
    """

    say_slow: ClassVar[Callable[[str], None] | None] = None

    def __init__(self, raw: Any, address: str = "") -> None:
        self.raw, self.address = raw, address
        self._answered = False

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.raw, name)
        if not callable(value):
            return value

        @functools.wraps(value)
        def called(*args: Any, **kwargs: Any) -> Any:
            with storage_failures(), self._waiting(asked=name not in _WITHOUT_THE_STORAGE):
                return value(*args, **kwargs)

        return called

    @contextmanager
    def _waiting(self, *, asked: bool) -> Iterator[None]:
        if not asked or self._answered or Storage.say_slow is None:
            yield
            return
        timer = threading.Timer(SLOW_S, Storage.say_slow, (f"{self.address}: no answer for {SLOW_S:.0f} s; still trying",))
        timer.daemon = True
        timer.start()
        try:
            yield
            self._answered = True
        finally:
            timer.cancel()


def is_remote(address: str) -> bool:
    """Whether an address names a storage (s3://bucket/name) rather than a path."""
    return "://" in address


def filesystem_of(address: str) -> tuple[Any, str]:
    """The file system of an address (of fsspec, or a Storage), and the path in it. Raises InputError for an unknown storage."""
    import fsspec

    try:
        files, path = fsspec.core.url_to_fs(address if is_remote(address) else str(Path(address).absolute()))
    except (ValueError, ImportError) as error:
        raise InputError(address, str(error), "a path, or the address of a storage that fsspec knows") from error
    return Storage(files, address) if is_remote(address) else files, path.rstrip("/")


@contextmanager
def local_copies(addresses: tuple[str, ...], folder: Path) -> Iterator[tuple[str, ...]]:
    """Paths under which the files can be read here; what is remote is fetched into the folder for as long. Of one that is not
    there the path leads to no file."""
    made = folder / "inputs"
    paths = []
    try:
        for number, address in enumerate(addresses):
            if not is_remote(address):
                paths.append(address)
                continue
            files, path = filesystem_of(address)
            target = made / str(number) / path.rpartition("/")[2]
            target.parent.mkdir(parents=True)
            with suppress(FileNotFoundError):
                files.get_file(path, str(target))
            paths.append(str(target))
        yield tuple(paths)
    finally:
        shutil.rmtree(made, ignore_errors=True)
