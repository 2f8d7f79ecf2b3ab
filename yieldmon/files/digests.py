"""SHA-256 of files, which identify what a result was made from."""

from __future__ import annotations

import hashlib
from pathlib import Path

from yieldmon.errors import reading

_CHUNK_BYTES = 1 << 20


def of_file(path: str | Path) -> str:
    """SHA-256 of a file's content, in hexadecimal digits. Raises InputError where it cannot be read."""
    digest = hashlib.sha256()
    with reading(path, "a readable file"), Path(path).open("rb") as stream:
        while chunk := stream.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()
