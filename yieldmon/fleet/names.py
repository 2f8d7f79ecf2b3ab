"""Names of machines and days, and of the folders that stand for them in a dataset."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from urllib.parse import quote, unquote

from yieldmon.utc import EARLIEST_BUS_TIME_S

_MOST_BYTES = 200
"""Of a name as a folder's."""

_ISO_DATE = re.compile(r"((?:19|20)\d\d)-?([01]\d)-?([0-3]\d)(?!\d)")
_MOST_DAYS = 30
"""Between the date that a day is called by and its first second: a folder may hold the logs of a week, named by its end."""
LATEST_DATE_S = 4e9
"""2096; no date of a log lies behind it."""


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


def off_by_days(day: str, start_s: float | None) -> bool:
    """Whether a day that is called by a date (2026-10-01, 20261001) began at another by its log's clock.

    start_s: Unix time. False for names that do not begin with a date, and for times that count from a recorder's start.
    """
    found = _ISO_DATE.match(day)
    if found is None or start_s is None or start_s <= EARLIEST_BUS_TIME_S:
        return False
    try:
        called = datetime.fromisoformat("-".join(found.groups())).replace(tzinfo=UTC)
    except ValueError:
        return False
    return start_s > LATEST_DATE_S or abs(datetime.fromtimestamp(start_s, UTC) - called) > timedelta(days=_MOST_DAYS)
