"""Tickets of weighed loads: a table with one row for each weighing."""

from __future__ import annotations

import logging
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isfinite
from pathlib import Path

from yieldmon.errors import InputError, brief
from yieldmon.units import KG_PER_DT, KG_PER_LB, KG_PER_SHORT_TON, KG_PER_T

from . import delimited

_log = logging.getLogger(__name__)

RELATIVE_STD_DEV = 0.005
"""Standard deviation of a weighing that states none, as a share of the mass (a certified platform scale)."""
OTHER_RELATIVE_STD_DEV = 0.03
"""The same of what another combine's monitor shows (one that was calibrated this season)."""
_LOADS = ("load", "load_number", "loads", "log", "file")
_KG: Mapping[str, float] = {
    "kg": 1.0, "t": KG_PER_T, "dt": KG_PER_DT, "q": KG_PER_DT, "lb": KG_PER_LB, "short_ton": KG_PER_SHORT_TON,
}  # fmt: skip
COLUMNS = f"{', '.join(f'weighed_{unit}' for unit in list(_KG)[:-1])} or weighed_{list(_KG)[-1]}"
"""Of a mass, in words."""
_MASSES = ("weighed", "mass", "weight", "weighed_mass", "net", "net_weight", "net_mass")
_DEVIATIONS = ("std_dev", "sd", "sigma")
_OTHERS = ("other", "other_mass")
_OTHER_DEVIATIONS = ("other_std_dev", "other_sd")
_MACHINE, _PART = "machine", "part"
_DATE = re.compile(r"(\d{4}-\d\d-\d\d) 00:00:00")
"""A workbook's cell of a date, as text."""
_MIN_KG, _MAX_KG = 1.0, 1e6
_UNIT_FACTOR = 5.0
"""Between a weighed and a measured mass: machines that were never calibrated are off by half (studies/setup)."""


@dataclass(frozen=True, slots=True)
class WeighedTicket:
    """A weighed mass for the loads `first` to `last` (numbers, or the name of one load or of a log that holds one). where: for
    errors. machine: whose loads these are, where several have them. other_std_dev_kg: the part of std_dev_kg by another combine's
    monitor, the same error in all trucks that it filled too; 0 for none. part: which of several weighings of these loads, "" for
    the only one."""

    first: str
    last: str
    mass_kg: float
    std_dev_kg: float
    where: str
    machine: str = ""
    other_std_dev_kg: float = 0.0
    part: str = ""

    @property
    def name(self) -> str:
        """Of its loads, as given."""
        return self.first if self.first == self.last else f"{self.first}-{self.last}"

    @property
    def line(self) -> str:
        """Where in its file it stands."""
        return self.where.rpartition(": ")[2].partition(",")[0]


def names_log(name: str, log: str) -> bool:
    """Whether a ticket's name is that of a log, in whatever coding of Unicode: of its file, with or without its ending, or what
    stands there before the first dot.

    Examples
    --------
    >>> [names_log(name, "day/10.06.a.log.gz") for name in ("10.06.a.log.gz", "10.06.a.log", "10.06.a", "10", "10.06")]
    [True, True, True, True, False]
    """
    file = unicodedata.normalize("NFC", Path(log).name)
    whole = file[: -len(".gz")] if file.lower().endswith(".gz") else file
    return unicodedata.normalize("NFC", Path(name).name) in (
        file, whole, whole.rpartition(".")[0], file.partition(".")[0],
    )  # fmt: skip


def load(path: str | Path) -> tuple[WeighedTicket, ...]:
    """The tickets of a file with the columns `load` (7, or 7-9 for several on one ticket) and `weighed_kg` (or _t, _dt, _q,
    _lb, _short_ton), and if known `std_dev_kg`, `machine`, `part` (1, 2, ... of loads weighed in parts); `other_kg` and
    `other_std_dev_kg` as `own_part` has them. Warns of columns that are not used.

    Raises InputError naming line and column.
    """
    source = delimited.read(path)
    columns = _columns(source)
    if unused := [name for name in source.header if name.strip() and name not in columns.names]:
        are = "columns are not used" if len(unused) > 1 else "a column is not used"
        _log.warning("%s: %s: %s", source.path, are, brief(", ".join(unused)))
    return tuple(_ticket(source, row, columns) for row in range(len(source.rows)))


@dataclass(frozen=True, slots=True)
class _MassColumn:
    """A column of masses. factor: kg in its unit."""

    name: str
    factor: float


@dataclass(frozen=True, slots=True)
class _Columns:
    """What a table's columns are; None for one that it lacks."""

    load: str
    mass: _MassColumn
    deviation: _MassColumn | None
    other: _MassColumn | None
    other_deviation: _MassColumn | None
    machine: str | None
    part: str | None

    @property
    def names(self) -> frozenset[str | None]:
        masses = (self.mass, self.deviation, self.other, self.other_deviation)
        return frozenset({self.load, self.machine, self.part, *(column.name for column in masses if column is not None)})


def _columns(source: delimited.TextTable) -> _Columns:
    load = _one_of(source, _LOADS, "load", "the number of a load, or the name of its log")
    mass = _with_unit(source, _MASSES, "weighed_kg")
    deviation, other, other_deviation = (_if_there(source, kinds) for kinds in (_DEVIATIONS, _OTHERS, _OTHER_DEVIATIONS))
    machine, part = (next((name for name in source.header if _plain(name) == wanted), None) for wanted in (_MACHINE, _PART))
    return _Columns(load, mass, deviation, other, other_deviation, machine, part)


def _ticket(source: delimited.TextTable, row: int, columns: _Columns) -> WeighedTicket:
    """Raises InputError naming line and column."""
    first, last = _loads(source, row, columns.load)
    kg = _number(source, row, columns.mass.name) * columns.mass.factor
    if not _MIN_KG <= kg <= _MAX_KG:
        raise InputError(source.where(row, columns.mass.name), f"is {kg:g} kg", f"a mass from {_MIN_KG:g} to {_MAX_KG:g} kg")
    sd, other_sd = RELATIVE_STD_DEV * kg, 0.0
    if columns.deviation is not None and _text(source, row, columns.deviation.name):
        sd = _number(source, row, columns.deviation.name) * columns.deviation.factor
        if not 0.0 < sd < kg:
            raise InputError(
                source.where(row, columns.deviation.name), f"is {sd:g} kg", f"above 0 and below the load's {kg:g} kg"
            )
    if columns.other is not None and _text(source, row, columns.other.name):
        of_other, weighed_sd = None, sd
        if columns.other_deviation is not None and _text(source, row, columns.other_deviation.name):
            of_other = _number(source, row, columns.other_deviation.name) * columns.other_deviation.factor
        other_kg = _number(source, row, columns.other.name) * columns.other.factor
        kg, sd = own_part(kg, sd, other_kg, of_other, source.where(row, columns.other.name))
        other_sd = (sd**2 - weighed_sd**2) ** 0.5
    machine, part = _text(source, row, columns.machine), _text(source, row, columns.part)
    return WeighedTicket(first, last, kg, sd, source.where(row, columns.load), machine, other_sd, part)


def _loads(source: delimited.TextTable, row: int, column: str) -> tuple[str, str]:
    """First and last of a ticket's loads. Raises InputError."""
    cell = source.column(column)[row]
    if not cell:
        raise InputError(source.where(row, column), "is empty", "the number of a load, or the name of its log")
    if date := _DATE.fullmatch(cell):
        expected = "the number of a load; of 3-5 a spreadsheet makes a date unless the column is formatted as text"
        raise InputError(source.where(row, column), f"is a date, {date[1]}", expected)
    # Spreadsheets and word processors make a longer dash of a hyphen between numbers.
    first, dash, last = cell.replace("\N{EN DASH}", "-").partition("-")
    spans = bool(dash) and first.strip().isdecimal() and last.strip().isdecimal()
    return (first.strip(), last.strip()) if spans else (cell, cell)


def _text(source: delimited.TextTable, row: int, column: str | None) -> str:
    """A cell; "" where the table has no such column, or where it says that nothing is known."""
    cell = "" if column is None else source.column(column)[row]
    return "" if delimited.is_unknown(cell) else cell


def own_part(
    weighed_kg: float, std_dev_kg: float, other_kg: float, other_std_dev_kg: float | None, where: str
) -> tuple[float, float]:
    """What a truck that another combine filled as well holds of this one's grain, and its standard deviation, both kg.

    Parameters
    ----------
    weighed_kg, std_dev_kg : float
        The truck's grain.
    other_kg, other_std_dev_kg : float, float or None
        Of it from the other combine, by its own monitor; None: OTHER_RELATIVE_STD_DEV.
    where : str
        Names other_kg in an error.

    Raises
    ------
    InputError
        Where nothing is left, or less than it is uncertain by.
    """
    other_sd_kg = OTHER_RELATIVE_STD_DEV * other_kg if other_std_dev_kg is None else other_std_dev_kg
    if not (other_kg >= 0.0 and other_sd_kg >= 0.0):
        raise InputError(where, f"is {other_kg:g} +- {other_sd_kg:g} kg", "masses of 0 and above")
    own_kg, own_sd_kg = weighed_kg - other_kg, hypot(std_dev_kg, other_sd_kg)
    if not own_kg > own_sd_kg:
        problem = f"leaves {own_kg:.7g} +- {own_sd_kg:.0f} kg of the {weighed_kg:.7g} kg"
        raise InputError(where, problem, "the part of another combine, and more left than it is uncertain by")
    return own_kg, own_sd_kg


def unit_slip(weighed_kg: float, measured_kg: float) -> str:
    """What is said of a weighed mass so far from the measured one that it is of another unit or load; "" where it is not."""
    if not measured_kg > 0.0 or 1.0 / _UNIT_FACTOR <= weighed_kg / measured_kg <= _UNIT_FACTOR:
        return ""
    return f"weighs {weighed_kg:.5g} kg, where {measured_kg:.5g} kg were measured"


def _plain(column: str) -> str:
    """A heading such as "Net weight [lb]" as `net_weight_lb`."""
    return re.sub(r"[\s\[\]()_-]+", "_", column).strip("_").lower()


def _named(column: str, kinds: tuple[str, ...]) -> bool:
    return any(column in _headings(kinds, unit) for unit in _KG)


def _headings(kinds: tuple[str, ...], unit: str) -> tuple[str, ...]:
    plural = "s" if unit == "short_ton" else ""
    return tuple(f"{kind}_{unit}{end}" for kind in kinds for end in dict.fromkeys(("", plural)))


def _one_of(source: delimited.TextTable, names: tuple[str, ...], expected: str, meaning: str) -> str:
    found = [name for name in source.header if _plain(name) in names]
    if len(found) != 1:
        said = " and ".join(found) or f"no column {expected}"
        raise InputError(f"{source.path}: header", f"has {said}", f"{expected}: {meaning}")
    return found[0]


def _if_there(source: delimited.TextTable, kinds: tuple[str, ...]) -> _MassColumn | None:
    """As _with_unit(), of a column that need not be there."""
    columns = [_plain(name) for name in source.header]
    return _with_unit(source, kinds, "") if any(name in kinds or _named(name, kinds) for name in columns) else None


def _with_unit(source: delimited.TextTable, kinds: tuple[str, ...], expected: str) -> _MassColumn:
    """The one column of these masses. Raises InputError for none, for several, and for one without a unit."""
    found = [name for name in source.header if _named(_plain(name), kinds)]
    if len(found) == 1:
        plain = _plain(found[0])
        return _MassColumn(found[0], next(kg for unit, kg in _KG.items() if plain in _headings(kinds, unit)))
    bare = [name for name in source.header if _plain(name) in kinds]
    if bare and not found:
        raise InputError(f"{source.path}: header", f"{bare[0]} has no unit", f"{bare[0]}_kg, {bare[0]}_t or {bare[0]}_lb")
    said = " and ".join(found) or f"no column {expected}"
    raise InputError(f"{source.path}: header", f"has {said}", f"one column such as {COLUMNS}")


def _number(source: delimited.TextTable, row: int, column: str) -> float:
    cell = source.column(column)[row]
    whole, comma, decimals = cell.partition(",")
    try:
        # `36,000` may be thirty-six or thirty-six thousand.
        value = delimited.plain_number(cell if not comma or len(decimals) == 3 else f"{whole}.{decimals}")
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise InputError(source.where(row, column), f"is {cell[:40]!r}", "a number, without unit or thousands separator")
    return value
