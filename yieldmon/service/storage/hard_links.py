"""A store whose files have other names as well: hard links, as a backup by ``cp -al`` leaves them.

SQLite would keep a journal by each name for the one file, and the backup would change with the store.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import stat
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep

from yieldmon.errors import reason
from yieldmon.files.whole_file import sync
from yieldmon.service.storage.in_the_way import make_way
from yieldmon.service.storage.ownership import OccupiedError
from yieldmon.service.storage.store_names import file_state, kept, parts

_log = logging.getLogger(__name__)

_LOOKS, _LOOK_EVERY_S = 20, 0.1
"""A reader has a store open for moments, another daemon for as long as it runs."""
_LOCKED_FROM = 0x40000000
"""SQLite's locks of a file begin at this byte: https://www.sqlite.org/fileformat2.html, section 1.3.1."""
_FLOCK = "hhqqi"
"""struct flock of Linux, 64 bits: type, whence, start, length (0: to the end), process."""
_PIECE_BYTES = 1 << 22
_COPYING_S = 30.0
"""For all of a store: the service manager waits 90 s for a start."""


def detach_hard_links(path: Path, rest: Callable[[float], None] = sleep) -> str:
    """Give each file of a store that has other names as well a copy of its own under its name; what has the other names stays as
    it is. To be asked before the store is opened, by whom it belongs to.

    A file is copied whole and takes the name last, so a kill or a power cut in between leaves files of the same content.

    Parameters
    ----------
    path : Path
        Of the store.
    rest : callable
        Waits so many seconds.

    Returns
    -------
    str
        Why there is no copy, where the medium has no room for one or takes no writing; else empty.

    Raises
    ------
    OccupiedError
        When another process has the store open.
    """
    _remove_scratch(path)
    shared = [part for part in kept(path) if _names(part) > 1]
    index = parts(path)[2]
    if not shared and _names(index) <= 1:
        return ""
    names = max(map(_names, [*shared, index]))
    _wait_for_others(path, names, rest)
    try:
        # Whoever has closed it may have written the journal into the file.
        shared = [part for part in shared if part.exists()]
        before = [file_state(part) for part in shared]
        end_s = monotonic() + _COPYING_S
        for part in shared:
            _copy(part, end_s)
        if before != [file_state(part) for part in shared] or _holder(path) is not None:
            raise _occupied(path, names, _holder(path))
        for part in shared:
            _scratch(part).replace(part)
        if _names(index) > 1:
            # SQLite makes it from the journal.
            index.unlink()
        sync(path.parent)
    except OSError as error:
        return f"is one file under {names} names (hard links), and no copy of its own could be made: {reason(error)}"
    finally:
        _remove_scratch(path)
    _log.warning(
        "%s: was one file under %d names (hard links); has a copy of its own now, the others are as they were", path, names
    )
    return ""


def _remove_scratch(path: Path) -> None:
    for scratch in map(_scratch, kept(path)):
        with suppress(OSError):
            make_way([scratch])
            scratch.unlink(missing_ok=True)


def _names(path: Path) -> int:
    """How many names a file has; 0 where there is none."""
    try:
        found = os.lstat(path)
    except OSError:
        return 0
    return found.st_nlink if stat.S_ISREG(found.st_mode) else 0


def _scratch(part: Path) -> Path:
    return part.with_name(f"{part.name}.own-copy")


def _wait_for_others(path: Path, names: int, rest: Callable[[float], None]) -> None:
    for _ in range(_LOOKS):
        holder = _holder(path)
        if holder is None:
            return
        rest(_LOOK_EVERY_S)
    raise _occupied(path, names, holder)


def _occupied(path: Path, names: int, holder: int | None) -> OccupiedError:
    who = f"process {holder}" if holder else "another process"
    return OccupiedError(
        "store.path", f"{path}: is one file under {names} names (hard links), and {who} has it open",
        f"that process stopped, or a file of its own (cp {path} {path}.own && mv {path}.own {path})",
    )  # fmt: skip


def _holder(path: Path) -> int | None:
    """Number of a process that has the store open, by whichever name; 0 where the system does not say which, None for none."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None  # on a medium that takes no writing no process writes
    try:
        asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_FROM, 0, 0)
        kind, _, _, _, process = struct.unpack(_FLOCK, fcntl.fcntl(descriptor, fcntl.F_GETLK, asked))
    except OSError:
        return None  # where there are no locks, SQLite opens nothing either
    finally:
        os.close(descriptor)
    return None if kind == fcntl.F_UNLCK else max(0, process)


def _copy(part: Path, end_s: float) -> None:
    with part.open("rb") as source, _scratch(part).open("xb") as target:
        os.fchmod(target.fileno(), stat.S_IMODE(os.fstat(source.fileno()).st_mode))
        while piece := source.read(_PIECE_BYTES):
            target.write(piece)
            target.flush()
            os.fsync(target.fileno())
            if monotonic() > end_s:
                raise OSError(errno.ETIMEDOUT, f"copying takes longer than {_COPYING_S:.0f} s", str(part))
