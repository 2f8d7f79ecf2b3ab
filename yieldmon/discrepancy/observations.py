"""Measurements as inputs of the diagnosis: rows, cells of repeated conditions, and rows held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.estimation.clusters import SAME_LOAD, cluster
from yieldmon.estimation.fitting.measurements import copied_rows, rows_given_twice
from yieldmon.files.table import Table
from yieldmon.physics.machine import RPM, SAME_ANGLE_RAD, Machine
from yieldmon.physics.model import Conditions
from yieldmon.physics.numerics import Array

#: Two rows repeat one condition when they differ by less than this.
SAME_SPEED = 0.01
SAME_MOISTURE_PCT = 0.5


@dataclass(frozen=True)
class Rows:
    """Measurements, arrays of shape (rows,); SI and radians.

    load_name: mass_flow_kg_s or paddle_mass_kg. of: the measured quantity, "force" or "momentum" (per paddle). moisture_pct: nan
    if unknown. sigma: nan if the table states none. cell: number of the condition that the row repeats. order: order of
    measurement, s if `timed`, else the place in the table; None: not known.
    """

    machine: Machine
    load_name: str
    of: str
    si: bool
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    load: Array
    moisture_pct: Array
    value: Array
    sigma: Array
    trial: tuple[str, ...]
    cell: NDArray[np.int64]
    order: Array | None = None
    timed: bool = False

    def __len__(self) -> int:
        return len(self.value)

    @property
    def stated(self) -> bool:
        """Whether each row comes with its standard deviation."""
        return bool(np.all(np.isfinite(self.sigma) & (self.sigma > 0.0)))

    def take(self, chosen: NDArray[np.bool_]) -> Rows:
        """The rows where `chosen` is true, with cells numbered anew."""
        _, cell = np.unique(self.cell[chosen], return_inverse=True)
        return Rows(
            machine=self.machine,
            load_name=self.load_name,
            of=self.of,
            si=self.si,
            plate_angle_rad=self.plate_angle_rad[chosen],
            elevator_speed_rad_s=self.elevator_speed_rad_s[chosen],
            load=self.load[chosen],
            moisture_pct=self.moisture_pct[chosen],
            value=self.value[chosen],
            sigma=self.sigma[chosen],
            trial=tuple(t for t, keep in zip(self.trial, chosen, strict=True) if keep),
            cell=cell,
            order=None if self.order is None else self.order[chosen],
            timed=self.timed,
        )

    def conditions(self) -> Conditions:
        """Conditions of the rows."""
        return Conditions(
            self.plate_angle_rad, self.elevator_speed_rad_s, moisture_pct=self.moisture_pct, **{self.load_name: self.load}
        )


@dataclass(frozen=True)
class Layout:
    """Cells as a table of settings by loads, so that what depends on the setting alone is computed once.

    angle, speed and moisture have shape (settings, 1), load (settings, most loads), padded with a setting's own last load; place
    is each cell's position in the flattened (settings, most loads).
    """

    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array
    load: Array
    place: NDArray[np.int64]


@dataclass(frozen=True)
class Cells:
    """Means over repeated rows, arrays of shape (cells,); scatter is the sum of squares about the mean."""

    rows: Rows
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    load: Array
    moisture_pct: Array
    mean: Array
    count: Array
    scatter: Array
    layout: Layout

    def __len__(self) -> int:
        return len(self.mean)

    def conditions(self) -> Conditions:
        """Conditions of the cells."""
        return Conditions(
            self.plate_angle_rad,
            self.elevator_speed_rad_s,
            moisture_pct=self.moisture_pct,
            **{self.rows.load_name: self.load},
        )

    def groups(self) -> dict[str, NDArray[np.int64]]:
        """Group numbers of the cells by angle, load and speed, for leaving out one group at a time."""
        out = {}
        for name, values, width in (
            ("plate_angle", self.plate_angle_rad, SAME_ANGLE_RAD),
            ("load", np.log(np.maximum(self.load, 1e-9)), SAME_LOAD),
            ("elevator_speed", np.log(self.elevator_speed_rad_s), SAME_SPEED),
        ):
            numbers = cluster(values, width)
            if numbers.max() > 0:
                out[name] = numbers
        return out


def from_table(table: Table, machine: Machine) -> Rows:
    """Rows of a table with a load and a reading; rows where either is unknown are left out.

    Raises InputError when fewer than 8 rows remain, no reading is positive or most are negative, sigma is stated for some rows
    only, or rows are copies of others.
    """
    if table.load is None:
        raise InputError(table.path, "has no load column", "mass_flow_kg_s or paddle_mass_kg")
    columns = table.columns
    count = len(table)
    nothing = np.full(count, np.nan)
    usable = np.isfinite(columns[table.load]) & np.isfinite(columns[table.reading])
    time_s = columns.get("time_s", nothing)
    timed = bool(np.all(np.isfinite(time_s[usable])))
    if np.count_nonzero(usable) < 8:
        raise InputError(table.path, f"has {np.count_nonzero(usable)} rows with load and reading", "at least 8")
    rows = Rows(
        machine=machine,
        load_name=table.load,
        of="force" if table.reading == "force_n" else "momentum",
        si=table.reading != "response",
        plate_angle_rad=np.radians(columns["plate_angle_deg"]),
        elevator_speed_rad_s=table.speed_rad_s(machine),
        load=columns[table.load],
        moisture_pct=columns.get("moisture_pct", nothing),
        value=columns[table.reading],
        sigma=columns.get("sigma", nothing),
        trial=table.text.get("trial", ("",) * count),
        cell=np.zeros(count, dtype=np.int64),
        order=time_s if timed else np.arange(float(count)),
        timed=timed,
    ).take(usable)
    column = f"{table.path}: {table.reading}"
    stated = int(np.count_nonzero(rows.sigma > 0.0))
    if 0 < stated < len(rows):
        raise InputError(
            f"{table.path}: sigma",
            f"is stated for {stated} of {len(rows)} rows",
            "a positive value in every row, or no such column",
        )
    negative = int(np.count_nonzero(rows.value < 0.0))
    if 2 * negative > len(rows):
        raise InputError(column, f"is negative in {negative} of {len(rows)} rows", "force on the plate counted positive")
    if not np.any(rows.value > 0.0):
        raise InputError(column, "has no reading above 0", "force on the plate counted positive")
    grouped = with_cells(rows)
    copied = copied_rows(grouped.value, grouped.cell)
    if copied:
        raise InputError(
            column,
            f"repeats another reading of the same condition in every digit in {copied} of {len(rows)} rows, as copies do",
            "each measurement once",
        )
    twice = rows_given_twice(grouped.value, grouped.cell, grouped.trial)
    if twice:
        raise InputError(
            column,
            f"has {twice} of {len(rows)} rows twice: condition, trial and reading agree in every digit",
            "each measurement once, and another trial for each repetition",
        )
    return grouped


def with_cells(rows: Rows) -> Rows:
    """Rows with `cell` found from the conditions."""
    keys = [
        cluster(rows.plate_angle_rad, SAME_ANGLE_RAD),
        cluster(np.log(rows.elevator_speed_rad_s), SAME_SPEED),
        cluster(np.nan_to_num(rows.moisture_pct, nan=-1.0), SAME_MOISTURE_PCT),
    ]
    _, place = np.unique(np.stack(keys), axis=1, return_inverse=True)
    place = place.ravel()
    cell = np.zeros(len(rows), dtype=np.int64)
    following = 0
    for number in range(place.max() + 1):
        inside = place == number
        numbers = cluster(np.log(np.maximum(rows.load[inside], 1e-9)), SAME_LOAD)
        cell[inside] = following + numbers
        following += numbers.max() + 1
    return Rows(**{name: getattr(rows, name) for name in Rows.__dataclass_fields__ if name != "cell"}, cell=cell)


def cells(rows: Rows) -> Cells:
    """Means, by the rows' stated variances where they have them, and scatter of the rows that repeat one condition."""
    count: Array = np.bincount(rows.cell).astype(np.float64)
    weight = rows.sigma**-2.0 if rows.stated else np.ones(len(rows))
    total = np.bincount(rows.cell, weight)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(rows.cell, weight * values) / total)

    average = mean(rows.value)
    angle, speed, load, moisture = (
        mean(v) for v in (rows.plate_angle_rad, rows.elevator_speed_rad_s, rows.load, rows.moisture_pct)
    )
    scatter = np.asarray(np.bincount(rows.cell, (rows.value - average[rows.cell]) ** 2), dtype=np.float64)
    return Cells(
        rows=rows,
        plate_angle_rad=angle,
        elevator_speed_rad_s=speed,
        load=load,
        moisture_pct=moisture,
        mean=average,
        count=count,
        scatter=scatter,
        layout=lay_out(angle, speed, load, moisture),
    )


def lay_out(angle: Array, speed: Array, load: Array, moisture: Array) -> Layout:
    """Settings (equal angle, speed and moisture) by loads."""
    keys = np.round(np.stack((angle, speed, np.nan_to_num(moisture, nan=-1.0)), axis=-1), 9)
    _, first, setting = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    setting = setting.ravel()
    width = int(np.bincount(setting).max())
    table = np.empty((len(first), width))
    place = np.empty(len(load), dtype=np.int64)
    for number in range(len(first)):
        inside = np.flatnonzero(setting == number)
        table[number] = load[inside[-1]]
        table[number, : len(inside)] = load[inside]
        place[inside] = number * width + np.arange(len(inside))
    return Layout(angle[first, None], speed[first, None], moisture[first, None], table, place)


def hold_out(rows: Rows, how: str, seed: int) -> NDArray[np.bool_]:
    """Rows to hold out of the fit.

    how: "cells" (a fifth of the conditions at random), "trials" (a third of each condition's repetitions), "none", or a column
    and value such as "plate_angle_deg=70", "elevator_speed_rpm=400", "mass_flow_kg_s=5", "paddle_mass_kg=0.4", "trial=2". Raises
    InputError for anything else, or when nothing or everything would be held out.
    """
    rng = np.random.default_rng([seed, 1])
    if how == "none":
        return np.zeros(len(rows), dtype=bool)
    if how == "cells":
        count = int(rows.cell.max()) + 1
        if count < 15:
            return hold_out(rows, "trials", seed) if count < len(rows) else np.zeros(len(rows), dtype=bool)
        chosen = np.zeros(count, dtype=bool)
        chosen[rng.permutation(count)[: count // 5]] = True
        return chosen[rows.cell]
    if how == "trials":
        out = np.zeros(len(rows), dtype=bool)
        for number in range(int(rows.cell.max()) + 1):
            places = np.flatnonzero(rows.cell == number)
            if len(places) > 1:
                out[rng.permutation(places)[: max(1, len(places) // 3)]] = True
    else:
        out = _selected(rows, how)
    if not np.any(out) or np.all(out):
        raise InputError("--hold-out", f"{how!r} holds out {np.count_nonzero(out)} of {len(rows)} rows", "some, not all")
    return out


def _selected(rows: Rows, how: str) -> NDArray[np.bool_]:
    name, _, text = how.partition("=")
    columns: dict[str, Array] = {
        "plate_angle_deg": np.degrees(rows.plate_angle_rad),
        "elevator_speed_rpm": rows.elevator_speed_rad_s / RPM,
        rows.load_name: rows.load,
    }
    if name == "trial":
        return np.array([trial == text for trial in rows.trial])
    try:
        value = float(text)
        column = columns[name]
    except (ValueError, KeyError):
        expected: Sequence[str] = ("cells", "trials", "none", *(f"{c}=VALUE" for c in columns), "trial=NAME")
        raise InputError("--hold-out", f"is {how!r}", f"one of {', '.join(expected)}") from None
    return np.abs(column - value) <= 1e-3 * max(1.0, abs(value))
