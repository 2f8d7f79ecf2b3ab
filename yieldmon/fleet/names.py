"""Names of machines and days, and of the folders that stand for them in a dataset."""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

_MOST_BYTES = 200
"""Of a name as a folder's."""


def folder_of(name: str) -> str:
    """A machine's or day's name as a partition's folder has it: what is no letter, digit, '.', '_', '-' or '~' as %XX, as Hive,
    DuckDB and Arrow read it."""
    return quote(name, safe="")


def name_of(folder: str) -> str | None:
    """The name that `folder_of` gives that folder; None where there is none."""
    name = unquote(folder)
    return name if is_name(name) and folder_of(name) == folder else None


def is_name(text: str) -> bool:
    """Whether a machine or day can be called so."""
    plain = text[:1].isalnum() and text.isprintable() and text == text.strip() and not {"/", "\\"} & {*text}
    return plain and len(folder_of(text)) <= _MOST_BYTES


def in_order(name: str) -> tuple[list[tuple[int, str]], str]:
    """To sort names by: numbers in them as such, so that 10.log comes behind 9.log."""
    parts = [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", name)]
    return parts, name
