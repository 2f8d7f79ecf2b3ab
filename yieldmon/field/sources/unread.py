"""Files that are often taken for a harvest and cannot be read: what they are, and what would do."""

from __future__ import annotations

from yieldmon.errors import InputError
from yieldmon.files.delimited import WORKBOOK

_SHEET = f"its sheet saved as CSV or *{WORKBOOK}"
#: What a file begins with -> what it is, and what would do.
_KINDS = {
    b"\xd0\xcf\x11\xe0": ("is an old Excel file", _SHEET),
    b"\x1f\x8b": ("is compressed", "what is in it (gunzip)"),
    b"Rar!": ("is a RAR archive", "what is in it, or a zip"),
    b"7z\xbc\xaf": ("is a 7z archive", "what is in it, or a zip"),
}
_OPEN_DOCUMENT = b"mimetypeapplication/vnd.oasis.opendocument"


def require_readable(where: str, head: bytes) -> None:
    """Raises InputError for a file of such a kind. head: what it begins with."""
    if _OPEN_DOCUMENT in head[:200]:
        raise InputError(where, "is an OpenDocument file", _SHEET)
    for begin, (what, expected) in _KINDS.items():
        if head.startswith(begin):
            raise InputError(where, what, expected)
