"""The token that opens the page, and the cookie that a browser has for it afterwards.

The cookie is the time at which it ends and a keyed hash of that time, so that it outlives a restart, and ends when the token is
changed.
"""

from __future__ import annotations

import hashlib
import hmac
from pathlib import Path

from yieldmon.errors import InputError, reading

LEAST_CHARACTERS = 16
COOKIE_LIFE_S = 30 * 86400
_MOST_BYTES = 4096
_MAKE = "one made by `head -c 18 /dev/urandom | base64 > FILE; chmod 600 FILE`"


def read_token(path: Path) -> str:
    """The token in a file: its one line.

    Parameters
    ----------
    path : Path
        A file that not everybody may read.

    Returns
    -------
    str
        The token, at least LEAST_CHARACTERS printable ASCII characters.

    Raises
    ------
    InputError
        For a file that is missing, that others may read, or that holds no such token.
    """
    with reading(path, f"a token, {_MAKE}"):
        if path.stat().st_mode & 0o007:
            raise InputError(str(path), "everybody on this machine may read it", f"`chmod o-rwx {path}`")
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    token = content.decode("ascii", "replace").strip()
    if (
        len(content) > _MOST_BYTES
        or len(token) < LEAST_CHARACTERS
        or not token.isascii()
        or not token.isprintable()
        or " " in token
    ):
        raise InputError(
            str(path), "holds no token", f"one line of {LEAST_CHARACTERS} to {_MOST_BYTES} ASCII characters, {_MAKE}"
        )
    return token


def same(given: str, token: str) -> bool:
    """Whether two texts are equal, in a time that does not depend on where they differ."""
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), token.encode())


def cookie(token: str, now_s: float) -> str:
    """A cookie for somebody who has shown the token. now_s: Unix time."""
    until = str(int(now_s) + COOKIE_LIFE_S)
    return f"{until}.{_signature(token, until)}"


def cookie_is_good(value: str, token: str, now_s: float) -> bool:
    """Whether `cookie` made this one with the same token, not too long ago."""
    until, _, signature = value.partition(".")
    if not until.isascii() or not until.isdecimal() or len(until) > 12 or not same(signature, _signature(token, until)):
        return False
    return now_s < int(until)


def _signature(token: str, until: str) -> str:
    return hmac.new(token.encode(), f"yieldmon page {until}".encode(), hashlib.sha256).hexdigest()
