"""Files that are often taken for another: what they are, by what they begin with."""

from __future__ import annotations

import re

HEAD_BYTES = 512
"""Of a file's start, that tell."""
SQLITE = b"SQLite format 3\0"
"""First bytes of every SQLite database (https://www.sqlite.org/fileformat2.html, section 1.3)."""
PARQUET = b"PAR1"
"""First bytes of every Parquet file (https://parquet.apache.org/docs/file-format/)."""
_BEGINNINGS = {
    b"\xd0\xcf\x11\xe0": "an old Excel file",
    b"\x1f\x8b": "compressed",
    b"Rar!": "a RAR archive",
    b"7z\xbc\xaf": "a 7z archive",
    b"PK\x03\x04": "a zip archive or workbook",
    b"PK\x05\x06": "a zip archive",
    SQLITE: "a database, as a daemon's store is",
    b"%PDF-": "a PDF",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"{\\rtf": "a text document (RTF)",
    b"version https://git-lfs": "a pointer of Git LFS in place of the file",
    b"\xff\xfe": "UTF-16 text",
    b"\xfe\xff": "UTF-16 text",
}
_OPEN_DOCUMENT = b"mimetypeapplication/vnd.oasis.opendocument"
_PAGE = re.compile(rb"(?:\xef\xbb\xbf)?\s*<(?:!doctype html|html)\b", re.IGNORECASE)
_DBASE = re.compile(rb"[\x02\x03\x83\x8b\xf5].(?:\x00|[\x01-\x0c])[\x00-\x1f].{8}", re.DOTALL)
"""Version, year, month and day of the last change, and counts: a text begins with none of these."""


def kind_of(head: bytes) -> str:
    """What a file is that begins so, as words after "is"; "" for one that may be what is expected.

    >>> kind_of(b"PK\\x03\\x04"), kind_of(b'VERSION ""')
    ('a zip archive or workbook', '')
    """
    head = head[:HEAD_BYTES]
    if _OPEN_DOCUMENT in head[:200]:
        return "an OpenDocument file"
    if _PAGE.match(head):
        return "a web page"
    named = next((kind for begin, kind in _BEGINNINGS.items() if head.startswith(begin)), "")
    return named or ("a dBase table" if _DBASE.match(head) else "")
