"""Text from outside made fit for terminals, spreadsheets and XML: one line, no control characters, no formula."""

from __future__ import annotations

import unicodedata

_UNFIT = frozenset({"Cc", "Cs", "Cn", "Zl", "Zp"})
_BIDI = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
_WITHOUT_ACCENT = str.maketrans({"ß": "ss", "æ": "ae", "Æ": "AE", "ø": "o", "Ø": "O", "ł": "l", "Ł": "L", "đ": "d", "Đ": "D"})
"""Letters of Latin alphabets that are no other letter with an accent."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def plain(text: str) -> str:
    """The text with each character that a terminal would obey, or XML 1.0 has no place for, as a replacement character."""
    return "".join("\ufffd" if unicodedata.category(c) in _UNFIT or c in _BIDI else c for c in text)


def quotable(text: str) -> str:
    """The text as it stands between double quotes in a file that knows no escape for them, nor letters with accents.

    >>> quotable('Große "Höhe"')
    "Grosse 'Hohe'"
    """
    letters = unicodedata.normalize("NFKD", text.translate(_WITHOUT_ACCENT))
    bare = "".join(letter for letter in letters if not unicodedata.combining(letter))
    return plain(" ".join(bare.replace('"', "'").split()))


def cell(text: str) -> str:
    """The text as a spreadsheet shows it: what would be a formula begins with an apostrophe (OWASP, "CSV Injection")."""
    fit = plain(text)
    return f"'{fit}" if fit.startswith(_FORMULA) else fit
