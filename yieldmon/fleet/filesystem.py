"""Files here or in an object store, by fsspec."""

from __future__ import annotations

import errno
import functools
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError, brief

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


class Storage:
    """A file system of fsspec's all of whose failures are OSErrors. raw: as fsspec made it."""

    def __init__(self, raw: Any) -> None:
        self.raw = raw

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.raw, name)
        if not callable(value):
            return value

        @functools.wraps(value)
        def called(*args: Any, **kwargs: Any) -> Any:
            with storage_failures():
                return value(*args, **kwargs)

        return called


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
    return Storage(files) if is_remote(address) else files, path.rstrip("/")


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
