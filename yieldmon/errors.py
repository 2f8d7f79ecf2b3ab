"""Errors that a user can correct: one line that says where, what is wrong and what was expected."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""What only writing can meet, and a write's error does not name its file."""
OF_THE_MEDIUM = NO_ROOM | {errno.EROFS, errno.EACCES, errno.EPERM}
"""What a place that is to be written to answers until somebody sees to it."""
_OF_THE_NETWORK = {errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EHOSTDOWN, errno.ENOTCONN, errno.ESTALE, errno.ETIMEDOUT}
_OF_THE_COMPUTER = NO_ROOM | _OF_THE_NETWORK | {errno.EROFS, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN}
_LONGEST_PART = 500
"""Characters of a problem that are shown; a value may be a whole file."""
_LONGEST_PLACE = 1000


class InputError(ValueError):
    """A file, key, row or argument that cannot be used.

    Parameters
    ----------
    where : str
        The place: file, row, key.
    problem : str
        What is wrong with it.
    expected : str
        What would be right.

    Notes
    -----
    The text is always one line of printable characters; the command line prints it and exits with 2.

    Examples
    --------
    >>> print(api.InputError("corn.yaml: friction", "is 'high'", "a number from 0 to 1"))
    corn.yaml: friction: is 'high'; expected a number from 0 to 1
    """

    def __init__(self, where: str, problem: str, expected: str = "") -> None:
        self.where = where
        self.problem = brief(problem, _LONGEST_PART)
        self.expected = expected
        text = f"{brief(where, _LONGEST_PLACE)}: {self.problem}" + (
            f"; expected {brief(expected, _LONGEST_PLACE)}" if expected else ""
        )
        super().__init__("".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(text.split())))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        # By its text alone, as exceptions are pickled, it could not be made again in another process.
        return type(self), (self.where, self.problem, self.expected)


def brief(what: object, most: int = 160) -> str:
    """What a library or a file says, in one line of at most `most` characters; its middle is left out.

    >>> brief("File name in directory differs", most=16)
    'File n... iffers'
    """
    text = " ".join(str(what).split())
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[:half]}... {text[len(text) - half :]}"


def reason(error: BaseException) -> str:
    """What went wrong, without the name of the file that the text of an OSError begins or ends with."""
    return getattr(error, "strerror", None) or str(error)


def remedy(error: OSError) -> str:
    """What would be right where the system refuses a file; empty where its own words say all there is to say.

    >>> remedy(OSError(errno.ENOSPC, "No space left on device"))
    'room for the file: free some, or name a place on another medium'
    """
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"a file or folder that {this_user()} may use (`ls -ld` shows its owner and mode), another one, or sudo"
    return _REMEDIES.get(error.errno or 0, "")


def system_text(error: BaseException) -> str:
    """What the system refuses, in one line: the file where it is known, why, and what would be right.

    >>> system_text(OSError(errno.EROFS, "Read-only file system", "season/_run"))
    'season/_run: Read-only file system; expected a place on a medium that takes writing'
    """
    if not isinstance(error, OSError) or error.errno is None:
        return " ".join(str(error).split()) or type(error).__name__
    # A library puts words of its own around those of the system.
    why = os.strerror(error.errno) if error.errno in NO_ROOM else reason(error)
    expected = remedy(error)
    text = f"{error.filename}: {why}" if error.filename else why
    return " ".join(f"{text}; expected {expected}".split()) if expected else " ".join(text.split())


def no_room_to_unpack(path: str | os.PathLike[str], error: OSError) -> InputError:
    """What is to be said where a file is unpacked into the system's folder for temporary files, which is full."""
    import tempfile

    error.filename = tempfile.gettempdir()
    return InputError(str(path), f"no room in {error.filename} to unpack it", "room there, or another folder by TMPDIR")


def of_the_computer(error: BaseException) -> OSError | None:
    """The system's error behind one that speaks of a file, where it says nothing of that file: a full disk where it is unpacked,
    too many open files, no memory. None for all else."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _OF_THE_COMPUTER:
            return cause
        cause = cause.__cause__
    return None


def database_errno(error: BaseException) -> int:
    """The system's number for what SQLite says of a medium.

    >>> os.strerror(database_errno(ValueError("no error of a database")))
    'Input/output error'
    """
    name = getattr(error, "sqlite_errorname", "")
    return next((number for begin, number in _DATABASE_ERRORS.items() if name.startswith(begin)), errno.EIO)


def this_user() -> str:
    """Whom the system asks for permission, as a person knows it."""
    import pwd

    user = os.geteuid()
    try:
        return f"user {pwd.getpwuid(user).pw_name}"
    except KeyError:
        return f"user {user}"


_DATABASE_ERRORS = {
    "SQLITE_FULL": errno.ENOSPC,
    "SQLITE_READONLY": errno.EROFS,
    "SQLITE_PERM": errno.EACCES,
    "SQLITE_CANTOPEN": errno.EACCES,
}
_REMEDIES = {
    errno.EROFS: "a place on a medium that takes writing",
    errno.ENOSPC: "room for the file: free some, or name a place on another medium",
    errno.EDQUOT: "room for the file: free some, or name a place on another medium",
    errno.EFBIG: "a medium and a user that may have a file of this size (`ulimit -f`)",
    errno.ENOTDIR: "a path whose folders are folders: one of them is a file",
    errno.ENAMETOOLONG: "a shorter name",
    errno.ELOOP: "a path whose links do not lead back to themselves",
}


def refuse_nul(text: object) -> None:
    r"""Raises InputError for a path, or a word of a command line, that holds a NUL character: no file and no word can.

    >>> refuse_nul("drive\0.log")
    Traceback (most recent call last):
        ...
    yieldmon.errors.InputError: drive\x00.log: holds a NUL character; expected a name without one
    """
    if "\0" in str(text):
        raise InputError(str(text), "holds a NUL character", "a name without one")


@contextmanager
def reading(path: str | os.PathLike[str], expected: str) -> Iterator[None]:
    """An OSError while a file is read becomes an InputError that names the file and what was expected of it."""
    refuse_nul(path)
    try:
        yield
    except OSError as error:
        raise InputError(str(path), reason(error), expected) from error
