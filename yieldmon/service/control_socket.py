"""The local socket at which a daemon is asked, and the file that stands for it."""

from __future__ import annotations

import errno
import grp
import os
import socket
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from yieldmon.errors import InputError, reason
from yieldmon.service.storage.ownership import OccupiedError

_CONNECT_S = 1.0
_BACKLOG = 64
#: What only another configuration corrects; a medium that is full or a file that is in the way may pass.
_WRONG_PATH = frozenset({errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.EINVAL})


@dataclass(frozen=True)
class Listening:
    """A socket that listens at a path, and the file that stands for it there."""

    socket: socket.socket
    path: Path
    file: tuple[int, int]

    def there(self) -> bool:
        """Whether the file is still there; without it no client finds the socket."""
        with suppress(OSError):
            return _identity(self.path) == self.file
        return False


def _identity(path: Path) -> tuple[int, int]:
    found = path.lstat()
    return found.st_dev, found.st_ino


def listen(path: Path, group: str | None) -> Listening:
    """A socket that listens at a path, where what is there of an earlier run is replaced; group: may use it too.

    Raises InputError for a group that does not exist or a path that no socket can have, OSError for one that cannot be bound
    now, OccupiedError for one at which a daemon is running.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if _answers(path):
            raise OccupiedError("status.socket", f"{path}: a daemon is running there", "a socket for each daemon")
        if path.is_file() and not path.is_symlink():
            raise InputError("status.socket", f"{path}: is a file, which is not replaced", "a path for a socket")
        path.unlink(missing_ok=True)
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # The file has the socket's mode, less the umask, from the first moment on.
            os.fchmod(listening.fileno(), 0o600)
            listening.bind(str(path))
            path.chmod(0o600)
            listening.listen(_BACKLOG)
            if group is not None:
                os.chown(path, -1, grp.getgrnam(group).gr_gid)
                path.chmod(0o660)
            return Listening(listening, path, _identity(path))
        except BaseException:
            listening.close()
            raise
    except KeyError as error:
        raise InputError("status.group", repr(group), "a group of this system") from error
    except OSError as error:
        # Without a number: a path that is too long for a socket's address.
        if error.errno is None or error.errno in _WRONG_PATH:
            problem = f"{path}: {reason(error)}"
            raise InputError("status.socket", problem, "a path for a socket") from error
        if error.filename is None:
            # bind() does not say what it was asked to bind.
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def _answers(path: Path) -> bool:
    """Whether somebody listens at a socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_CONNECT_S)
        try:
            connection.connect(str(path))
        except (BlockingIOError, TimeoutError):
            # Listening, with more waiting than it has room for.
            return True
        except OSError:
            return False
    return True
