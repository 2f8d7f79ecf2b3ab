"""Clocks of sources: seconds that start again at midnight or with the GPS week, texts with dates, clocks without a date."""

from __future__ import annotations

from datetime import UTC, date, datetime

import numpy as np
from scipy.ndimage import uniform_filter1d

from yieldmon import utc
from yieldmon.field.table import Array
from yieldmon.units import S_PER_DAY

_UNIX_S = (631_152_000.0, 4_102_444_800.0)
"""1990 and 2100."""
_WEEK_S = 7.0 * S_PER_DAY
_LATE_S = 600.0
_MOST_ROUNDS, _NIGHT_S = 40, 3600.0
"""Rounds of a harvest's clock beyond which its rows are in no order, and a pause that is no part of the work."""
_GAP_STEPS = 3.0
"""Times the usual step: a longer one is a gap."""
_LEAST_STEADY = 0.9
"""Of the steps of a log in its own order."""
_ROUNDED = 0.1
"""Standard deviation of steps from which on they count as rounded, as a share of the usual one."""
_EVENED_ROWS = 11
_LEAST_STEP_S = 0.01
"""No monitor logs more often."""
_FINEST_S = 0.002
"""Usual step below which numbers are no seconds."""
_LEAST_DIGITS, _DAY_IN_DIGITS = 100, 240_000.0
"""Different times from which on digits tell whether they are hours, minutes and seconds, and the day's end in such digits."""


def unwrapped(time_s: Array) -> tuple[Array, tuple[str, ...]]:
    """A clock of the day or the GPS week that goes on over midnight or the week's end, and a note for each time it did.

    A step back by more than half the clock's round is the round's end, and one that leads back over it within ten minutes is a
    row that came late; any other step stays.

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
        if back.sum() > _MOST_ROUNDS:
            return _in_no_order(time_s, round_s, name)
        late = (steps > round_s - _LATE_S) & (np.cumsum(back) > 0)
        rounds = np.cumsum(back.astype(int) - late)
        values = values + round_s * np.concatenate(([0.0], np.maximum(rounds, 0)))
        notes.append(f"the clock starts again at {name}, {int(back.sum() - late.sum())} times")
        break
    out[known] = values
    return out, tuple(notes)


def _in_no_order(time_s: Array, round_s: float, name: str) -> tuple[Array, tuple[str, ...]]:
    """A clock of rows in no order, which goes on from its longest pause; as it is where it has none."""
    known = np.unique(time_s[np.isfinite(time_s)])
    pauses = np.diff(known, append=known[0] + round_s)
    longest = int(np.argmax(pauses))
    if pauses[longest] < _NIGHT_S or longest == known.size - 1:
        return time_s, ()
    begins = known[longest + 1]
    pause_h = float(pauses[longest]) / 3600.0
    note = f"the rows are in no order: the clock is taken to go on over {name} from its longest pause, of {pause_h:.1f} h"
    return np.where(time_s < begins, time_s + round_s, time_s), (note,)


def of_unix(time_s: Array) -> tuple[Array, str]:
    """Numbers as large as Unix time of these decades, s to ns, in s, and what they were taken for; any others as they are.

    >>> of_unix(np.array([1.7e12, 1.700000001e12]))[0]
    array([1.7e+09, 1.7e+09])
    """
    known = time_s[np.isfinite(time_s)]
    middle = float(np.median(known)) if known.size else 0.0
    for scale, name in ((1.0, "seconds"), (1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")):
        if _UNIX_S[0] <= middle * scale < _UNIX_S[1]:
            return time_s * scale, f"Unix time in {name}"
    return time_s, ""


def is_serial_days(numbers: Array, *, in_days: bool) -> bool:
    """Whether numbers are dates of these decades as spreadsheets count days.

    They are where they are said to be days, or where steps of so many seconds would be shorter than any log's.

    >>> is_serial_days(np.array([41880.47525, 41880.47527]), in_days=False)
    True
    >>> is_serial_days(np.array([41880.0, 41881.0]), in_days=False)
    False
    """
    known = numbers[np.isfinite(numbers)]
    low, high = (utc.SERIAL_DAY_OF_1970 + edge / S_PER_DAY for edge in _UNIX_S)
    if not known.size or not low <= np.median(known) < high:
        return False
    steps = np.diff(known)
    return in_days or bool((steps > 0).any() and np.median(steps[steps > 0]) < _LEAST_STEP_S)


def is_day_fraction(numbers: Array) -> bool:
    """Whether numbers are times of the day as spreadsheets count days, without the date.

    >>> is_day_fraction(np.array([0.47525, 0.47527])), is_day_fraction(np.array([0.0, 1.0]))
    (True, False)
    """
    known = numbers[np.isfinite(numbers)]
    steps = np.diff(known)
    inside = known.size > 1 and known.min() >= 0.0 and known.max() <= 1.0
    return bool(inside and (steps > 0).any() and np.median(steps[steps > 0]) < _LEAST_STEP_S)


def too_fine_s(time_s: Array) -> float:
    """The usual step of times whose steps are shorter than any log's, s; 0 where they are not."""
    steps = np.diff(np.unique(time_s[np.isfinite(time_s)]))
    usual = float(np.median(steps)) if steps.size else 0.0
    return usual if 0.0 < usual < _FINEST_S else 0.0


def of_digits(numbers: Array) -> Array | None:
    """Seconds of the day of times that are written as digits, such as 135012.5 for 13:50:12.5; None for any other numbers.

    >>> of_digits(np.array([135959.0, 140000.0] * 60)) is None, of_digits(np.array([85.0] * 120)) is None
    (True, True)
    """
    known = np.unique(numbers[np.isfinite(numbers)])
    if known.size < _LEAST_DIGITS or known.min() < 0 or known.max() >= _DAY_IN_DIGITS or known.max() < 1e4:
        return None
    minute, second = np.floor(numbers / 100.0) % 100.0, numbers % 100.0
    with np.errstate(invalid="ignore"):
        if (minute >= 60.0).any() or (second >= 60.0).any() or np.unique(minute[np.isfinite(minute)]).size < 2:
            return None
    of_day: Array = np.floor(numbers / 1e4) * 3600.0 + minute * 60.0 + second
    return of_day


def of_serial_days(days: Array) -> Array:
    """Unix time of dates as spreadsheets count days, to the millisecond.

    >>> of_serial_days(np.array([25569.5])).tolist()
    [43200.0]
    """
    unix: Array = np.round((days - utc.SERIAL_DAY_OF_1970) * S_PER_DAY, 3)
    return unix


def days_only(time_s: Array) -> bool:
    """Whether Unix times are days and no more: all at one time of the day, midnight of some zone mostly, and several of the same.

    >>> days_only(np.array([79200.0, 79200.0, 165600.0])), days_only(np.array([86400.0]))
    (True, False)
    """
    known = time_s[np.isfinite(time_s)]
    return bool(known.size > np.unique(known).size and np.unique(known % S_PER_DAY).size == 1)


def evened(time_s: Array, distance_m: Array) -> tuple[Array, float]:
    """Times of a clock that counts more coarsely than the log, evened out over 11 rows or its step; and that step, s.

    Steps that come of rounding differ while the distances driven in them do not; where a log's steps really differ, so do the
    distances.

    Parameters
    ----------
    time_s : array, shape (n,)
        In the order of the file.
    distance_m : array, shape (n,)
        Driven since the row before, m.

    Examples
    --------
    >>> even, step_s = evened(np.floor(np.arange(40.0) * 1.25), np.full(40, 2.0))
    >>> bool(np.ptp(np.diff(even)[5:-5]) < 0.1), step_s
    (True, 1.0)
    """
    step = np.diff(time_s, prepend=np.nan)
    positive = step[step > 0]
    if not positive.size:
        return time_s, 0.0
    usual = float(np.median(positive))
    with np.errstate(invalid="ignore"):
        steady = (step >= 0) & (step <= _GAP_STEPS * usual) & np.isfinite(distance_m)
    if np.count_nonzero(steady) < _LEAST_STEADY * len(step):
        return time_s, 0.0
    # So many rows that the clock's own steps do not show.
    over = max(_EVENED_ROWS, 2 * round(len(step) / max(int((step > 0).sum()), 1) / 2) + 1)
    off_s, off_m = (values[steady] - uniform_filter1d(values[steady], over) for values in (step, distance_m))
    speed = float(distance_m[steady].sum() / step[steady].sum())
    followed = float(off_s @ off_m) / max(float(off_s @ off_s), 1e-300)
    if float(np.std(off_s)) < _ROUNDED * usual or followed > 0.5 * speed:
        return time_s, 0.0
    out = time_s.copy()
    begins = np.flatnonzero(~steady)
    for begin, end in zip(begins.tolist(), [*begins[1:].tolist(), len(step)], strict=True):
        if end - begin > 2:
            own = time_s[begin:end]
            out[begin:end] = _between_ticks(own) if over > _EVENED_ROWS else _smoothed(own)
    return out, float(positive.min())


def _smoothed(time_s: Array) -> Array:
    line = np.linspace(time_s[0], time_s[-1], len(time_s))
    even: Array = line + uniform_filter1d(time_s - line, _EVENED_ROWS, mode="nearest")
    return even


def _between_ticks(time_s: Array) -> Array:
    """Times of a clock that many rows share: right where it ticks, even between, and before the first and after the last tick."""
    ticks = np.flatnonzero(np.diff(time_s) > 0) + 1
    if len(ticks) < 2:
        return time_s
    rows = np.arange(len(time_s))
    even: Array = np.interp(rows, ticks, time_s[ticks])
    step_s = float(time_s[ticks[-1]] - time_s[ticks[0]]) / float(ticks[-1] - ticks[0])
    outside = np.minimum(rows - ticks[0], 0) + np.maximum(rows - ticks[-1], 0)
    even += step_s * outside
    return even


def dated(time_s: Array, first: date) -> Array:
    """Unix time of a clock whose first point is on the day `first` (UTC); the clock's time of the day stays."""
    known = np.flatnonzero(np.isfinite(time_s))
    if not len(known):
        return time_s
    midnight = datetime(first.year, first.month, first.day, tzinfo=UTC).timestamp()
    unix: Array = time_s + midnight - np.floor(time_s[known[0]] / S_PER_DAY) * S_PER_DAY
    return unix
