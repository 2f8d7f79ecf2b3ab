"""Texts of dates and times of the day, as monitors and spreadsheets of several countries write them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime
from math import isfinite, nan

import numpy as np

from yieldmon import utc
from yieldmon.field.date_order import DateOrder
from yieldmon.field.table import Array

_CLOCK = r"(\d{1,2})[:.h](\d{2})(?:[:.m](\d{2}(?:[.,]\d+)?)s?)?\s*([ap]\.?\s?m\.?)?"
_TIME = re.compile(_CLOCK, re.IGNORECASE)
_DATE = re.compile(rf"(\d{{1,2}})([/.-])(\d{{1,2}})\2(\d{{4}}|\d{{2}})(?:[ T,]+{_CLOCK})?\s*(z|utc|gmt)?", re.IGNORECASE)
_YEAR_FIRST = re.compile(rf"(\d{{4}})([/.-])(\d{{1,2}})\2(\d{{1,2}})\.?(?:[ T,]+{_CLOCK})?\s*(z|utc|gmt)?", re.IGNORECASE)
_WEEKDAY = r"(?:[^\W\d]{2,10}[.,]*\s+)?"
_NAMED = re.compile(
    rf"{_WEEKDAY}(\d{{1,2}})\.?[ /-]+([^\W\d]{{3,10}})\.?,?[ /-]+(\d{{4}}|\d{{2}})(?:[ T,]+{_CLOCK})?\s*(z|utc|gmt)?",
    re.IGNORECASE,
)
_MONTH_NAMED_FIRST = re.compile(
    rf"{_WEEKDAY}([^\W\d]{{3,10}})\.?\s+(\d{{1,2}}),?\s+(\d{{4}})(?:[ T,]+{_CLOCK})?\s*(z|utc|gmt)?", re.IGNORECASE
)
_ZONE_WORD = re.compile(r"\s*(?:utc|gmt)$", re.IGNORECASE)
_MIDNIGHT = re.compile(r"[ T]+(?:0{1,2}:00(?::00(?:\.0+)?)?|12:00(?::00)? ?AM)$", re.IGNORECASE)
_COUNT = re.compile(r"[+-]?(?:\d{1,7}|\d{9,13}|\d{15,})(?:\.\d*)?|[+-]?\d+\.\d*")
"""What is no date: digits only, but for those of a day (8) and of a day with its time (14)."""
_MONTHS = {
    "jan": 1, "ene": 1, "feb": 2, "fev": 2, "fév": 2, "mar": 3, "mär": 3, "mrz": 3, "apr": 4, "abr": 4, "avr": 4, "may": 5,
    "mai": 5, "jun": 6, "jui": 6, "jul": 7, "aug": 8, "ago": 8, "aoû": 8, "aou": 8, "sep": 9, "set": 9, "oct": 10, "okt": 10,
    "out": 10, "nov": 11, "dec": 12, "dez": 12, "dic": 12, "déc": 12,
}  # fmt: skip
"""First three letters in English, German, French, Spanish and Portuguese; of French `juillet` see _month."""


def seconds_of_day(texts: Sequence[str]) -> Array:
    """Times of the day without a date, s; NaN for any other text.

    >>> seconds_of_day(["23:50:00.5", "1:02 PM", "12:00:05 am", "2024-08-15"]).tolist()
    [85800.5, 46920.0, 5.0, nan]
    """
    return np.array([_of_day(_TIME.fullmatch(text.strip())) for text in texts], float)


def _of_day(found: re.Match[str] | None, first: int = 1) -> float:
    if found is None:
        return nan
    hour, minute, second, half = found.group(first, first + 1, first + 2, first + 3)
    hours, seconds = int(hour), float((second or "0").replace(",", "."))
    if half is not None:
        if not 1 <= hours <= 12:
            return nan
        hours = hours % 12 + (12 if half.lower().startswith("p") else 0)
    if hours > 24 or int(minute) > 59 or seconds >= 61.0:
        return nan
    return hours * 3600.0 + int(minute) * 60.0 + seconds


def without_midnight(text: str) -> str:
    """A date without the midnight that a spreadsheet writes behind it.

    >>> without_midnight("2024-08-15 00:00:00")
    '2024-08-15'
    """
    return _MIDNIGHT.sub("", text.strip())


def parsed(texts: Sequence[str], day_first: bool | None = None) -> tuple[Array, str]:
    """Unix times of ISO 8601 or other dated texts, NaN where one cannot be read; and a note on what was taken for granted.

    day_first: of dates of three numbers; None: as `order_of` has it.

    >>> parsed(["12/08/2024 23:59:59", "13/08/2024 00:00:00"])[0].tolist()
    [1723507199.0, 1723507200.0]
    """
    numbers = [_DATE.fullmatch(text.strip()) for text in texts]
    if day_first is None:
        order = order_of(texts)
        day_first = order is None or order.day_first
    out, without_zone = np.full(len(texts), np.nan), False
    for row, (text, found) in enumerate(zip(texts, numbers, strict=True)):
        if found is not None:
            first, _, second, year = found.group(1, 2, 3, 4)
            day, month = (first, second) if day_first else (second, first)
            moment = _unix(year, int(month), day, found, 5)
            without_zone |= found.group(9) is None and isfinite(moment)
        else:
            moment, zone_missing = _other(text.strip())
            without_zone |= zone_missing
        out[row] = moment
    return out, "times without a zone are taken as UTC" if without_zone else ""


def order_of(texts: Sequence[str], *, stated: bool | None = None, first: date | None = None) -> DateOrder | None:
    """Whether the day or the month comes first in dates of three numbers, the same in all of them; None without such dates.

    By a number over 12, points between the numbers, the date of the first one where it is known, or what is stated; else the
    order in which they lie closer together is likely, or the month first.

    >>> order_of(["12/08/2024", "13/08/2024"]).day_first, order_of(["03/04/2026"]).known
    (True, False)
    """
    found = [one for one in (_DATE.fullmatch(text.strip()) for text in texts) if one is not None]
    pairs = {(int(one[1]), int(one[3]), one[4]) for one in found}
    if not pairs:
        return None
    dotted = all(one[2] == "." for one in found)
    over, over_second = sum(one > 12 for one, _, _ in pairs), sum(one > 12 for _, one, _ in pairs)
    times = {days: np.array([_unix(y, b if days else a, str(a if days else b)) for a, b, y in pairs]) for days in (True, False)}
    if over != over_second:
        stated = over > over_second
    elif dotted:
        stated = True
    elif first is not None:
        said_s = datetime(first.year, first.month, first.day, tzinfo=UTC).timestamp()
        stated = next((days for days in (True, False) if np.min(times[days]) == said_s), stated)
    if stated is not None:
        return DateOrder(stated, known=True, note="" if dotted and stated else _read_as(stated))
    day_first = float(np.ptp(times[True])) < float(np.ptp(times[False]))
    if all(one == other for one, other, _ in pairs) or not np.isfinite([*times[True], *times[False]]).all():
        return DateOrder(day_first, known=False, note=_read_as(day_first))
    day, month = (datetime.fromtimestamp(float(np.min(times[days])), UTC).date() for days in (True, False))
    read, other = (day, month) if day_first else (month, day)
    doubt = f", the first as {read}; no date shows the order: if the first is {other}, give --date {other}"
    return DateOrder(day_first, known=False, note=_read_as(day_first) + doubt)


def _read_as(day_first: bool) -> str:
    return f"dates are read as {'day/month' if day_first else 'month/day'}/year"


def _other(text: str) -> tuple[float, bool]:
    """Unix time of one text that is no date of three numbers with the year last, NaN where it is none; and whether its zone is
    missing."""
    if _COUNT.fullmatch(text):
        # A count of seconds also reads as year, month, day and hour without anything between them.
        return nan, False
    named = _NAMED.fullmatch(text)
    if named is not None:
        moment = _unix(named[3], _month(named[2]), named[1], named, 4)
        return moment, named[8] is None and isfinite(moment)
    month_first = _MONTH_NAMED_FIRST.fullmatch(text)
    if month_first is not None:
        moment = _unix(month_first[3], _month(month_first[1]), month_first[2], month_first, 4)
        return moment, month_first[8] is None and isfinite(moment)
    year_first = _YEAR_FIRST.fullmatch(text)
    if year_first is not None:
        moment = _unix(year_first[1], int(year_first[3]), year_first[4], year_first, 5)
        return moment, year_first[9] is None and isfinite(moment)
    plain = _ZONE_WORD.sub("+00:00", text)
    # A time without a zone stays so: whether it has one is part of the answer.
    for read in (datetime.fromisoformat, lambda digits: datetime.strptime(digits, "%Y%m%d%H%M%S")):  # noqa: DTZ007
        try:
            moment_of = read(plain)
            return utc.in_utc(moment_of).timestamp(), moment_of.tzinfo is None
        except (ValueError, OverflowError, OSError):
            continue
    return nan, False


def _month(name: str) -> int:
    """Of a month's name, 0 for none."""
    lower = name.lower()
    return 7 if lower.startswith("juil") else _MONTHS.get(lower[:3], 0)


def _unix(year: str, month: int, day: str, found: re.Match[str] | None = None, clock: int = 0) -> float:
    """Of a day, and where there is one of its time from the group `clock` on; NaN for no date."""
    years = int(year) if len(year) == 4 else 2000 + int(year) if int(year) < 70 else 1900 + int(year)
    try:
        midnight = datetime(years, month, int(day), tzinfo=UTC)
    except ValueError:
        return nan
    if found is None or found.group(clock) is None:
        return midnight.timestamp()
    seconds = _of_day(found, clock)
    if not isfinite(seconds):
        return nan
    return midnight.timestamp() + seconds
