"""Clocks of sources: seconds that start again at midnight or with the GPS week, texts with dates, clocks without a date."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime

import numpy as np

from yieldmon import utc
from yieldmon.field.table import Array
from yieldmon.units import S_PER_DAY

_UNIX_S = (631_152_000.0, 4_102_444_800.0)
"""1990 and 2100."""
_WEEK_S = 7.0 * S_PER_DAY


def unwrapped(time_s: Array) -> tuple[Array, tuple[str, ...]]:
    """A clock of the day or the GPS week that goes on over midnight or the week's end, and a note for each time it did.

    A step back by more than half the clock's round is the round's end; any other step stays.

    >>> unwrapped(np.array([86398.0, 86399.0, 0.0, 1.0]))[0]
    array([86398., 86399., 86400., 86401.])
    """
    known = np.isfinite(time_s)
    if known.sum() < 2 or time_s[known].min() < 0:
        return time_s, ()
    highest = float(time_s[known].max())
    if highest >= _WEEK_S:
        return time_s, ()
    out = time_s.copy()
    values = out[known]
    notes = []
    steps = np.diff(values)
    for round_s, name in ((S_PER_DAY, "midnight"), (_WEEK_S, "the end of the GPS week")):
        back = steps < -0.5 * round_s
        if highest >= round_s or not back.any():
            continue
        values = values + np.concatenate(([0.0], np.cumsum(np.where(back, round_s, 0.0))))
        notes.append(f"the clock starts again at {name}, {int(back.sum())} times")
        break
    out[known] = values
    return out, tuple(notes)


def of_unix(time_s: Array) -> tuple[Array, str]:
    """Numbers as large as Unix time of these decades, s or ms, in s, and what they were taken for; any others as they are.

    >>> of_unix(np.array([1.7e12, 1.700000001e12]))[0]
    array([1.7e+09, 1.7e+09])
    """
    known = time_s[np.isfinite(time_s)]
    middle = float(np.median(known)) if known.size else 0.0
    for scale, name in ((1.0, "seconds"), (1e-3, "milliseconds")):
        if _UNIX_S[0] <= middle * scale < _UNIX_S[1]:
            return time_s * scale, f"Unix time in {name}"
    return time_s, ""


def dated(time_s: Array, first: date) -> Array:
    """Unix time of a clock whose first point is on the day `first` (UTC); the clock's time of the day stays."""
    known = np.flatnonzero(np.isfinite(time_s))
    if not len(known):
        return time_s
    midnight = datetime(first.year, first.month, first.day, tzinfo=UTC).timestamp()
    unix: Array = time_s + midnight - np.floor(time_s[known[0]] / S_PER_DAY) * S_PER_DAY
    return unix


_COUNT = re.compile(r"[+-]?(?:\d{1,7}|\d{9,13}|\d{15,})(?:\.\d*)?|[+-]?\d+\.\d*")
"""What is no date: digits only, but for those of a day (8) and of a day with its time (14)."""
_FORMATS = (
    "%m/%d/%Y %I:%M:%S %p",
    "%m/%d/%Y %H:%M:%S",
    "%Y/%m/%d %H:%M:%S",
    "%d.%m.%Y %H:%M:%S",
    "%Y%m%d%H%M%S",
    "%m/%d/%Y %H:%M",
)


def parsed(texts: Sequence[str]) -> tuple[Array, str]:
    """Unix times of ISO 8601 or other dated texts, NaN where one cannot be read; and a note on what was taken for granted."""
    count = len(texts)
    out = np.full(count, np.nan)
    seen: dict[str, float] = {}
    zone_missing = False
    chosen: str | None = None
    for row, text in enumerate(texts):
        if text not in seen:
            moment, chosen = _moment(text, chosen)
            if moment is not None and moment.tzinfo is None:
                zone_missing, moment = True, utc.in_utc(moment)
            try:
                seen[text] = np.nan if moment is None else moment.timestamp()
            except (OverflowError, ValueError, OSError):
                seen[text] = np.nan
        out[row] = seen[text]
    notes = []
    if zone_missing:
        notes.append("times without a zone are taken as UTC")
    if chosen is not None and chosen.startswith("%m/"):
        notes.append("dates are read as month/day/year")
    return out, "; ".join(notes)


def _moment(text: str, chosen: str | None) -> tuple[datetime | None, str | None]:
    plain = text.strip()
    if _COUNT.fullmatch(plain):
        # A count of seconds also reads as year, month, day and hour without anything between them.
        return None, chosen
    try:
        return datetime.fromisoformat(plain), chosen
    except ValueError:
        pass
    for pattern in (chosen, *_FORMATS) if chosen else _FORMATS:
        try:
            return datetime.strptime(plain, str(pattern)), str(pattern)
        except ValueError:
            continue
    return None, chosen
