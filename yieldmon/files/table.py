"""Measurement tables: a header, one row a measurement, `-`, `nan` or nothing for unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from yieldmon.arguments import require_path
from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions
from yieldmon.physics.numerics import Array
from yieldmon.units import counted

from . import delimited
from .speeds import LARGEST_SPEED_RPM, LEAST_SPEED_RPM

LOADS = ("mass_flow_kg_s", "paddle_mass_kg")
READINGS = ("force_n", "momentum_kg_m_s", "response")
_ALSO = {"paddle_momentum_kg_m_s": "momentum_kg_m_s"}
"""Columns under the names that `predict` gives them."""
_OF_PREDICT = ("force_std_dev_n",)
"""What `predict` writes beside and nothing reads: an error that all rows share, and no noise of theirs."""
_AGREE = 0.01
"""Relative difference of two columns that say the same."""
_TEXTS = ("trial", "group")
"""Columns whose cells are no numbers."""
_SHOWN_COLUMNS = 5
"""Of those that are not known."""
_LIMITS = {
    "plate_angle_deg": (0.0, 180.0, "deg"),
    "mass_flow_kg_s": (0.0, 1000.0, "kg/s"),
    "paddle_mass_kg": (0.0, 100.0, "kg"),
    "elevator_speed_rpm": (0.0, LARGEST_SPEED_RPM, "rpm"),
    "moisture_pct": (0.0, 100.0, "%"),
    "plate_position_m": (-2.0, 2.0, "m"),
    "sigma": (0.0, 1e12, "the reading's unit"),
    "time_s": (-1e12, 1e12, "s"),
}


@dataclass(frozen=True)
class Table:
    """A measurement table: columns as they stand in the file, one row a measurement.

    Parameters
    ----------
    path : str
    sha256 : str
        Of the file.
    load : {"mass_flow_kg_s", "paddle_mass_kg"} or None
        Which of them the table gives; of both, the flow. None when neither is there (open and closed loop find it).
    reading : {"force_n", "momentum_kg_m_s", "response"}
        Which of them the table gives; of force and momentum, the force.
    columns : mapping of str to ndarray
        (n,) each, by name: plate_angle_deg (deg), elevator_speed_rpm (rpm), moisture_pct (%), plate_position_m (m), time_s
        (s), load and reading; nan for unknown.
    text : mapping of str to tuple of str
        Trial, group and unknown columns.
    notes : tuple of str
        What was passed over while reading.
    lines : tuple of int
        Line of the file of each row; empty where the table is no file's.

    Examples
    --------
    See `load_table`.
    """

    path: str
    sha256: str
    load: str | None
    reading: str
    columns: Mapping[str, Array]
    text: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...] = field(default=())
    lines: tuple[int, ...] = ()

    def unread(self, rows: np.ndarray) -> str:
        """One sentence about rows that are left out.

        Parameters
        ----------
        rows : ndarray of bool
            (n,) which of them.

        Returns
        -------
        str
            "" where there is none.
        """
        return self.left_out(rows, "without a load or a reading")

    def left_out(self, rows: np.ndarray, why: str) -> str:
        """One sentence about rows that are left out.

        Parameters
        ----------
        rows : ndarray of bool
            (n,) which of them.
        why : str
            What they lack.

        Returns
        -------
        str
            "" where there is none.
        """
        count = int(np.count_nonzero(rows))
        if not count:
            return ""
        places = [self.lines[i] if self.lines else i + 1 for i in np.flatnonzero(rows)[:8]]
        more = ", ..." if count > len(places) else ""
        is_left, line = ("is left", "line") if count == 1 else ("are left", "lines")
        return f"{self.path}: {counted(count, 'row')} {why} {is_left} out ({line} {', '.join(map(str, places))}{more})"

    def __len__(self) -> int:
        return len(self.columns["plate_angle_deg"])

    def speed_rad_s(self, machine: Machine) -> Array:
        """Elevator speed of each row.

        Parameters
        ----------
        machine : Machine

        Returns
        -------
        ndarray
            (n,) rad/s; the machine's nominal one where the table does not say.
        """
        rpm = self.columns.get("elevator_speed_rpm", np.full(len(self), np.nan))
        return np.where(np.isnan(rpm), machine.nominal_elevator_speed_rad_s, rpm * RPM)

    def at_one_position(self, machine: Machine) -> Machine:
        """The machine with its plate where the whole table has it.

        Parameters
        ----------
        machine : Machine

        Returns
        -------
        Machine

        Raises
        ------
        InputError
            For a table of several positions.
        """
        places = np.unique(self.columns.get("plate_position_m", np.zeros(1)))
        if places.size > 1:
            raise InputError(f"{self.path}: plate_position_m", f"holds {places.size} positions", "one, but for `calibrate`")
        return machine.with_plate_at(float(places[0])) if places[0] else machine

    def conditions(self, machine: Machine) -> Conditions:
        """Angle, speed, load, moisture and plate position of each row.

        Parameters
        ----------
        machine : Machine

        Returns
        -------
        Conditions
            (n,) arrays.

        Raises
        ------
        InputError
            When the table gives no load, or gives load or reading twice and the two disagree.
        """
        if self.load is None:
            raise InputError(self.path, "has no load column", f"one of {', '.join(LOADS)}")
        self.check_doubled(machine)
        return Conditions(
            plate_angle_rad=np.radians(self.columns["plate_angle_deg"]),
            elevator_speed_rad_s=self.speed_rad_s(machine),
            moisture_pct=self.columns.get("moisture_pct"),
            plate_position_m=self.columns.get("plate_position_m"),
            **{self.load: self.columns[self.load]},
        )

    def check_doubled(self, machine: Machine) -> None:
        """Compare load and reading where the table gives them twice.

        Parameters
        ----------
        machine : Machine

        Raises
        ------
        InputError
            Where the two disagree on this machine by more than 1 %.
        """
        passes = machine.passes_per_s(self.speed_rad_s(machine))
        for one, other in (LOADS, READINGS[:2]):
            if one not in self.columns or other not in self.columns:
                continue
            first, second = self.columns[one], self.columns[other] * passes
            apart = np.abs(first - second) > _AGREE * np.maximum(np.abs(first), np.abs(second))
            if np.any(apart):
                i = int(np.argmax(apart))
                where = f"{self.path}: line {self.lines[i]}" if self.lines else f"{self.path}: row {i + 1}"
                raise InputError(
                    f"{where}: {other}",
                    f"is {self.columns[other][i]:g}, where {one} says {first[i] / passes[i]:.6g}",
                    f"the same, or one of the two columns ({passes[i]:.4g} paddles a second)",
                )

    def momentum(self, machine: Machine) -> Array:
        """The reading as momentum per paddle.

        Parameters
        ----------
        machine : Machine

        Returns
        -------
        ndarray
            (n,) kg m/s; for `response`, in its own unit.
        """
        values = self.columns[self.reading]
        if self.reading == "force_n":
            return values / machine.passes_per_s(self.speed_rad_s(machine))
        return values


def load(path: str | Path, *, need_load: bool = True, used: str | None = None) -> Table:
    r"""Read a measurement table: delimited text or an Excel workbook.

    Parameters
    ----------
    path : path
    need_load : bool
        Whether a mass flow or paddle mass column is required.
    used : str, optional
        A column of any name that the caller reads: no note says that it is ignored.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        Naming file, line and column, the value, and what was expected.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "bench.csv")
    ...     _ = path.write_text("plate_angle_deg,mass_flow_kg_s,force_n\n70,5,40.1\n70,10,88.2")
    ...     table = api.load_table(path)
    >>> len(table), table.momentum(api.Machine()).round(2).tolist()
    (2, [3.3, 7.25])
    """
    require_path(path)
    source = delimited.read(path)
    where = source.path
    names = {name: _ALSO.get(name, name) for name in source.header}
    if len(set(names.values())) < len(names):
        raise InputError(f"{where}: header", f"has {', '.join(_ALSO)} under both its names", "one of them")
    loads, readings = _roles(list(names.values()), where, need_load)
    numeric = {name: role for name, role in names.items() if name not in _TEXTS and (role in _LIMITS or role in READINGS)}
    columns = {role: _numbers(source, name) for name, role in numeric.items()}
    texts = {name: source.column(name) for name in names if name not in numeric}
    _check_columns(columns, source)
    ignored = _ignored([name for name in texts if name not in (*_TEXTS, *_OF_PREDICT, used)], where)
    return Table(
        where,
        source.sha256,
        _first_known(loads, columns),
        _first_known(readings, columns) or readings[0],
        columns,
        texts,
        (*source.notes, *ignored, *_at_nominal(columns, source)),
        source.lines,
    )


def _at_nominal(columns: Mapping[str, Array], source: delimited.TextTable) -> tuple[str, ...]:
    """A note on the rows without a speed in a table that has others."""
    unknown = np.isnan(columns.get("elevator_speed_rpm", np.zeros(1)))
    if not np.any(unknown) or np.all(unknown):
        return ()
    first, count = source.lines[int(np.argmax(unknown))], int(np.count_nonzero(unknown))
    rows = f"{counted(count, 'row')} {'has' if count == 1 else 'have'}"
    taken = f"no elevator_speed_rpm (line {first}{', ...' if count > 1 else ''}): the machine's nominal speed is taken there"
    return (f"{source.path}: {rows} {taken}",)


def _ignored(unknown: list[str], where: str) -> tuple[str, ...]:
    """A note on the columns that are not known, if any are."""
    if not unknown:
        return ()
    shown = ", ".join(map(repr, unknown[:_SHOWN_COLUMNS])) + (", ..." if len(unknown) > _SHOWN_COLUMNS else "")
    plural, are = ("", "is") if len(unknown) == 1 else ("s", "are")
    return (f"{where}: column{plural} {shown} {are} not known and {are} ignored",)


def _check_columns(columns: dict[str, Array], source: delimited.TextTable) -> None:
    """Raises InputError for a place that is not known, and for a column in another unit than its name says."""
    where = source.path
    missing = np.flatnonzero(np.isnan(columns["plate_angle_deg"]))
    if missing.size:
        raise InputError(source.where(int(missing[0]), "plate_angle_deg"), "is unknown", "an angle in degrees")
    places = columns.get("plate_position_m", np.zeros(1))
    if np.any(np.isnan(places)):
        raise InputError(source.where(int(np.argmax(np.isnan(places))), "plate_position_m"), "is unknown", "a position in m")
    angles = columns["plate_angle_deg"]
    if len(angles) > 1 and float(angles.max()) <= np.pi:
        raise InputError(f"{where}: plate_angle_deg", f"has nothing above {angles.max():g}", "degrees; these look like radians")
    moisture = columns.get("moisture_pct", np.full(1, np.nan))
    if np.any(moisture > 0.0) and float(np.nanmax(moisture)) < 1.0:
        raise InputError(
            f"{where}: moisture_pct", f"has nothing above {np.nanmax(moisture):g}", "per cent; these look like shares"
        )
    speeds = columns.get("elevator_speed_rpm", np.full(1, np.nan))
    if np.any(speeds < LEAST_SPEED_RPM):
        slowest = f"is {float(np.nanmin(speeds)):g}"
        raise InputError(f"{where}: elevator_speed_rpm", slowest, f"{LEAST_SPEED_RPM:g} rpm or more, of the upper shaft")


def _first_known(names: list[str], columns: Mapping[str, Array]) -> str | None:
    """The first of the columns that holds anything, else the first; None where there is no column."""
    return next((name for name in names if not np.all(np.isnan(columns[name]))), names[0] if names else None)


def _roles(header: list[str], where: str, need_load: bool) -> tuple[list[str], list[str]]:
    """The columns of loads and of readings."""
    if "plate_angle_deg" not in header:
        raise InputError(f"{where}: header", "has no plate_angle_deg", f"that column{_instead(header)}")
    loads = [name for name in LOADS if name in header]
    readings = [name for name in READINGS if name in header]
    if need_load and not loads:
        raise InputError(f"{where}: header", "has no load column", f"one of {', '.join(LOADS)}{_instead(header)}")
    if len(readings) != 1 and readings != list(READINGS[:2]):
        instead = "" if readings else _instead(header)
        raise InputError(f"{where}: header", f"has {readings or 'no reading'}", f"exactly one of {', '.join(READINGS)}{instead}")
    return loads, readings


def _instead(header: list[str]) -> str:
    """What a header has that the columns of a measurement table could be meant by."""
    others = [repr(name) for name in header if name not in _LIMITS and name not in READINGS]
    more = ", ..." if len(others) > _SHOWN_COLUMNS else ""
    return f" (it has {', '.join(others[:_SHOWN_COLUMNS])}{more})" if others else ""


def _numbers(source: delimited.TextTable, name: str) -> Array:
    low, high, unit = _LIMITS.get(name, (-1e12, 1e12, "the reading's unit"))
    cells = source.column(name)
    out = np.empty(len(cells))
    for i, cell in enumerate(cells):
        if delimited.is_unknown(cell):
            out[i] = np.nan
            continue
        try:
            out[i] = delimited.plain_number(cell)
        except ValueError:
            raise InputError(source.where(i, name), f"is {cell[:40]!r}", f"a number in {unit}") from None
        if not low <= out[i] <= high:
            raise InputError(source.where(i, name), f"is {cell[:40]}", f"{low:g} to {high:g} {unit}")
    return out
