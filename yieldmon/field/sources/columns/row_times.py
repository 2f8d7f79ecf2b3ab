"""When each row was measured: from columns of times and days, else from the order of the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.field.date_order import DateOrder
from yieldmon.field.groups import first_rows
from yieldmon.field.plane import places_m
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import Array, Label
from yieldmon.field.units import FACTORS, factor, plain_unit
from yieldmon.units import S_PER_DAY

from . import clocks, written_times
from .delimited import numbers_in
from .naming import Column
from .raw_table import Raw
from .side_by_side import steps_of_sections

_LOOKED_AT = 100
_MOST_REPEAT = 0.6
_MOST_LAST = 0.9
"""Share of rows with an interval from which the others are taken to have the usual one."""
_OUT_OF_ORDER = 1.5
"""Rows lie this many times further apart than was driven between them where they are in another order."""


@dataclass(frozen=True)
class ColumnTimes:
    """What a column says of the rows' times.

    Parameters
    ----------
    time_s : array, shape (n,), or None
        As the column has them, NaN where it has none; None where no column has times.
    unix : bool
        Whether they are Unix time.
    notes : tuple of str
        What was taken for granted; without times, why there are none.
    name : str
        Of the column.
    date_order : DateOrder or None
        See `Source`.
    hour_again : bool
        Whether an hour comes twice in the column, and the times after it were counted on.
    """

    time_s: Array | None
    unix: bool
    notes: tuple[str, ...]
    name: str = ""
    date_order: DateOrder | None = None
    hour_again: bool = False


@dataclass(frozen=True)
class RowTimes:
    """When rows were measured, s, shape (n,), whether that is Unix time, and what was taken for granted."""

    time_s: Array
    unix: bool
    notes: tuple[str, ...]


def column_times(raw: Raw, options: ReadOptions, where: str) -> ColumnTimes:
    """The times in a file's columns of times and days. Raises InputError for times of which none can be read."""
    order = _date_order(raw, options)
    options = options if order is None else replace(options, day_first=order.day_first)
    column = raw.columns.get("time") or _dated_column(raw, options)
    if column is None:
        return ColumnTimes(None, unix=False, notes=("has no time",))
    found = _of_column(column, raw, options, where)
    time_s, unix, notes = found.time_s, found.unix, list(found.notes)
    order = order if unix else None
    if unix and clocks.days_only(time_s):
        return ColumnTimes(None, unix=False, notes=(f"{column.name} holds days and no times",))
    if np.isfinite(time_s).sum() > 1 and np.unique(time_s[np.isfinite(time_s)]).size == 1:
        return ColumnTimes(None, unix=False, notes=(f"{column.name} is the same in all rows",))
    lost = int(np.isnan(time_s).sum())
    if lost:
        notes.append(f"{column.name} holds no time that can be read in {lost} of {raw.count} rows")
    notes += [order.note] if order is not None and order.note else []
    return ColumnTimes(np.where(np.isfinite(time_s), time_s, np.nan), unix, tuple(notes), column.name, order)


def _date_order(raw: Raw, options: ReadOptions) -> DateOrder | None:
    """Of the column of times, or else of that of days; tables with decimal commas are of countries where the day comes first."""
    stated = True if options.day_first is None and raw.decimal_comma else options.day_first
    columns = (raw.columns.get(quantity) for quantity in ("time", "day"))
    texts = (raw.texts[column.name].names for column in columns if column is not None and column.name in raw.texts)
    orders = (written_times.order_of(names, stated=stated, first=options.first_date) for names in texts)
    return next((order for order in orders if order is not None), None)


def row_times(raw: Raw, values: Mapping[str, Array], clock: ColumnTimes, where: str) -> RowTimes:
    """When each row was measured.

    Parameters
    ----------
    raw : Raw
        As read, each machine's rows under its own name.
    values : mapping of str to array, shape (n,)
        Quantity -> values in SI: longitude and latitude, interval and distance where the file has them.
    clock : ColumnTimes
        What the file's columns say.
    where : str
        Place for errors.

    Returns
    -------
    RowTimes

    Raises
    ------
    InputError
        For rows without times that are not in the order in which they were driven.
    """
    if clock.time_s is None:
        return _in_order(raw, values, where, clock.notes[0])
    notes = list(clock.notes)
    if "section" not in values and "interval" in values and not _repeats(clock.time_s, raw):
        return RowTimes(clock.time_s, clock.unix, tuple(notes))
    even_s, step_s = clock.time_s.copy(), 0.0
    for rows in _of_machines(raw):
        if "section" in values:
            even_s[rows], own_step_s = _of_steps(values, rows, clock.time_s[rows])
            step_s = max(step_s, own_step_s)
            continue
        even_s[rows], own_step_s = clocks.evened(clock.time_s[rows], _driven_m(values, rows, clock.time_s[rows]))
        step_s = max(step_s, own_step_s)
    if step_s:
        notes.append(f"{clock.name} counts in steps of {step_s:.2g} s, more coarsely than the rows follow: times are evened out")
    return RowTimes(even_s, clock.unix, tuple(notes))


def _repeats(time_s: Array, raw: Raw) -> bool:
    """Whether most rows have the time of the row before: a clock that counts more coarsely than the rows follow."""
    same = sum(int((np.diff(time_s[rows]) == 0).sum()) for rows in _of_machines(raw))
    return same > _MOST_REPEAT * len(time_s)


def _of_machines(raw: Raw) -> list[NDArray[np.intp]]:
    """The rows of each machine, in the order of the file."""
    machine = raw.machine_of_row
    return [np.flatnonzero(machine == number) for number in np.unique(machine).tolist()]


def _apart_m(values: Mapping[str, Array], rows: NDArray[np.intp] | slice = slice(None)) -> Array:
    """From each of these rows to the one before it."""
    longitude, latitude = values["longitude"][rows], values["latitude"][rows]
    x, y = places_m(longitude, latitude)
    return np.hypot(np.diff(x, prepend=np.nan), np.diff(y, prepend=np.nan))


def _of_steps(values: Mapping[str, Array], rows: NDArray[np.intp], time_s: Array) -> tuple[Array, float]:
    """Times evened out as those of the header's steps, of which each section has a row; and the clock's step, s."""
    step = steps_of_sections(time_s, np.nan_to_num(values["section"][rows]))
    first = first_rows(step, int(step.max()) + 1)
    if "interval" in values and (np.diff(time_s[first]) > 0).mean() > 1.0 - _MOST_REPEAT:
        return time_s, 0.0
    places = {name: values[name][rows] for name in ("longitude", "latitude")}
    middle = {
        name: np.bincount(step, np.nan_to_num(place)) / np.maximum(np.bincount(step, np.isfinite(place)), 1)
        for name, place in places.items()
    }
    even_s, clock_s = clocks.evened(time_s[first], _apart_m(middle))
    return even_s[step], clock_s


def _driven_m(values: Mapping[str, Array], rows: NDArray[np.intp], time_s: Array) -> Array:
    """From each row to the one before it, by the places; by its distances where places change as rarely as the clock.

    Distances of a file are those of its rows, even where rows between them have been left out.
    """
    apart_m = _apart_m(values, rows)
    at_once = apart_m[1:][np.diff(time_s) == 0]
    as_coarse = at_once.size > 0 and float(np.median(np.nan_to_num(at_once))) == 0.0
    return values["distance"][rows] if as_coarse and "distance" in values else apart_m


def _in_order(raw: Raw, values: Mapping[str, Array], where: str, why: str) -> RowTimes:
    """A clock for each machine's rows that have none: as far apart as their intervals are long, else a second."""
    orders, followed = _of_machines(raw), "in the order of the file"
    if not _are_as_driven(values, orders):
        numbered = _by_number(raw, values, orders)
        if not numbered or not _are_as_driven(values, numbered):
            apart_m, driven_m = _usual_distances_m(values, orders)
            problem = f"{why}, and its rows are not in the order driven ({apart_m:.1f} m apart, {driven_m:.1f} m driven)"
            raise InputError(where, problem, "--column time=NAME:UNIT, or the rows as they were logged")
        orders, followed = numbered, f"in the order of {raw.columns['number'].name}"
    step, apart = np.ones(raw.count), "one second apart"
    if "interval" in values:
        with np.errstate(invalid="ignore"):
            lasting = values["interval"] > 0
        if lasting.mean() >= _MOST_LAST:
            usual_s = float(np.median(values["interval"][lasting]))
            step, apart = np.where(lasting, values["interval"], usual_s), "one after another at their intervals"
    time_s = np.zeros(raw.count)
    for rows in orders:
        time_s[rows] = np.cumsum(step[rows]) - step[rows]
    return RowTimes(time_s, unix=False, notes=(f"{why}: rows are taken as {apart}, {followed}",))


def _usual_distances_m(values: Mapping[str, Array], orders: Sequence[NDArray[np.intp]]) -> tuple[float, float]:
    """Between rows that follow one another, by their places and by their distances."""
    apart_m = np.concatenate([_apart_m(values, rows) for rows in orders])
    return float(np.nanmedian(np.append(apart_m, 0.0))), float(np.nanmedian(np.append(values["distance"], 0.0)))


def _are_as_driven(values: Mapping[str, Array], orders: Sequence[NDArray[np.intp]]) -> bool:
    """Whether rows lie as far apart as their distances are long, as far as the file tells."""
    if "distance" not in values:
        return True
    apart_m, driven_m = _usual_distances_m(values, orders)
    return not apart_m > _OUT_OF_ORDER * driven_m > 0


def _by_number(raw: Raw, values: Mapping[str, Array], orders: Sequence[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """The rows of each machine, one dataset after another, by a column of running numbers; none where it tells no order."""
    column = raw.columns.get("dataset")
    label = None if column is None else raw.texts.get(column.name)
    dataset = np.zeros(raw.count, np.int32) if label is None else label.codes
    number = values.get("number", np.full(raw.count, np.nan))
    distinct = np.unique(np.stack([raw.machine_of_row, dataset, number]), axis=1).shape[1]
    if not np.isfinite(number).all() or distinct < raw.count:
        return []
    return [rows[np.lexsort((number[rows], dataset[rows]))] for rows in orders]


def _of_column(column: Column, raw: Raw, options: ReadOptions, where: str) -> RowTimes:
    place = f"{where}: {column.name}"
    midnight_s, day_note = _midnights(column, raw, options)
    if column.name in raw.texts:
        label = raw.texts[column.name]
        dated, note = _dated(label, raw, options)
        numbers = numbers_in(label.names)[label.codes]
        # Of counts of seconds some read as dates.
        counted = plain_unit(column.unit) in FACTORS["time"] or (np.isfinite(numbers).all() and not np.isfinite(dated).all())
        if np.isfinite(dated).any() and not counted:
            return RowTimes(dated, unix=True, notes=(note,) if note else ())
        of_day = written_times.seconds_of_day(label.names)[label.codes]
        if not counted and np.isfinite(of_day).sum() > np.isfinite(numbers).sum():
            return _of_day(of_day, midnight_s, raw, options, [day_note])
        if not np.isfinite(numbers).any():
            raise InputError(place, f"is {label.names[0][:40]!r}", "ISO 8601 times, or seconds")
    else:
        numbers = raw.numbers[column.name]
    return _of_numbers(column, numbers, midnight_s, raw, options, [day_note], place)


def _of_numbers(
    column: Column, numbers: Array, midnight_s: Array | None, raw: Raw, options: ReadOptions, notes: list[str], place: str
) -> RowTimes:
    s_per_unit = factor(column.unit, "time", place) if column.unit else 1.0
    if clocks.is_serial_days(numbers, in_days=s_per_unit == S_PER_DAY):
        note = f"{column.name} is taken as a spreadsheet's days, 1 for 1 January 1900"
        return RowTimes(clocks.of_serial_days(numbers), unix=True, notes=(note,))
    if not column.unit and clocks.is_day_fraction(numbers):
        note = f"{column.name} is taken as a spreadsheet's time of the day, 0.5 for noon"
        return _of_day(np.round(numbers * S_PER_DAY, 3), midnight_s, raw, options, [note, *notes])
    digits = None if column.unit else clocks.of_digits(numbers)
    if digits is not None:
        note = f"{column.name} is taken as hours, minutes and seconds in digits, 135012 for 13:50:12"
        return _of_day(digits, midnight_s, raw, options, [note, *notes])
    numbers, time_unit = clocks.of_unix(numbers * s_per_unit)
    if (step := clocks.too_fine_s(numbers)) > 0:
        raise InputError(place, f"has steps of {step:.2g} s", f"--column time={column.name}:UNIT, one of s, ms, min, h, d")
    unix = bool(time_unit) or "unix" in column.name.lower()
    taken_as = [] if column.unit else [f"{column.name} is taken as {time_unit or 'seconds'}"]
    if unix:
        return RowTimes(numbers, unix=True, notes=tuple(taken_as))
    return _of_day(numbers, midnight_s, raw, options, [*notes, *taken_as])


def _of_day(clock_s: Array, midnight_s: Array | None, raw: Raw, options: ReadOptions, notes: list[str]) -> RowTimes:
    """A clock without a date, with the day of each row or else going on over midnight, each machine's for itself."""
    known = clock_s[np.isfinite(clock_s)]
    if midnight_s is not None and known.size and known.min() >= 0.0 and known.max() <= S_PER_DAY:
        return RowTimes(midnight_s + clock_s, unix=True, notes=tuple(note for note in notes if note))
    out = clock_s.copy()
    for rows in _of_machines(raw):
        out[rows], more = clocks.unwrapped(clock_s[rows])
        notes = [*notes, *(note for note in more if note not in notes)]
        if options.first_date is not None:
            out[rows] = clocks.dated(out[rows], options.first_date)
    return RowTimes(out, unix=options.first_date is not None, notes=tuple(note for note in notes if note))


def _midnights(column: Column, raw: Raw, options: ReadOptions) -> tuple[Array | None, str]:
    """Where each row's day begins, Unix time, and what was taken for granted; None without a column of days beside the times."""
    day = raw.columns.get("day")
    if day is None or day.name == column.name:
        return None, ""
    if day.name in raw.texts:
        label = raw.texts[day.name]
        found, note = written_times.parsed([written_times.without_midnight(name) for name in label.names], options.day_first)
        days_s = found[label.codes]
    else:
        days_s, note = (raw.numbers[day.name] if day.unit == "s" else np.array([np.nan])), ""
    if not np.isfinite(days_s).all() or (days_s % S_PER_DAY != 0).any():
        return None, ""
    return days_s, note


def _dated(label: Label, raw: Raw, options: ReadOptions) -> tuple[Array, str]:
    """Times with their date, or with the day that stands in a column of its own; NaN where they have none."""
    times, note = written_times.parsed(label.names, options.day_first)
    if np.isfinite(times).any():
        return times[label.codes], note
    day = raw.columns.get("day")
    if day is None or day.name not in raw.texts or raw.texts[day.name] is label:
        return times[label.codes], note
    dates = raw.texts[day.name].text().tolist()
    both = Label.of([f"{written_times.without_midnight(a)} {b}" for a, b in zip(dates, label.text().tolist(), strict=True)])
    times, note = written_times.parsed(both.names, options.day_first)
    return times[both.codes], note


def _dated_column(raw: Raw, options: ReadOptions) -> Column | None:
    """The column of days, where it holds the time as well."""
    day = raw.columns.get("day")
    if day is None or day.name not in raw.texts:
        return None
    times, _ = written_times.parsed(raw.texts[day.name].names[:_LOOKED_AT], options.day_first)
    return day if (times[np.isfinite(times)] % S_PER_DAY != 0).any() else None
