"""Files that are often taken for a harvest and cannot be read: what they are, and what would do."""

from __future__ import annotations

from yieldmon.errors import InputError
from yieldmon.file_kinds import kind_of
from yieldmon.files.delimited import WORKBOOK

_SHEET = f"its sheet saved as CSV or *{WORKBOOK}"
#: What a file is -> what would do.
_EXPECTED = {
    "an old Excel file": _SHEET,
    "an OpenDocument file": _SHEET,
    "compressed": "what is in it (gunzip)",
    "a RAR archive": "what is in it, or a zip",
    "a 7z archive": "what is in it, or a zip",
}


def require_readable(where: str, head: bytes) -> None:
    """Raises InputError for a file of such a kind. head: what it begins with."""
    kind = kind_of(head)
    if kind in _EXPECTED:
        raise InputError(where, f"is {kind}", _EXPECTED[kind])
