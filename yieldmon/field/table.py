"""The harvest table: one row a point, columns in SI with their unit in the name, NaN for what is not known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.field.date_order import DateOrder

Array = NDArray[Any]
"""Numbers, float64 where nothing else is stated."""
Index = NDArray[Any]
"""Whole numbers, of rows, steps or groups."""
Flags = NDArray[Any]
"""Bools."""

#: Column -> what it is. All are float64; a flag is 0 or 1.
COLUMNS: Mapping[str, str] = {
    "time_s": "seconds on the source's clock (see Clock)",
    "longitude_deg": "WGS 84",
    "latitude_deg": "WGS 84",
    "position_sd_m": "standard deviation of the position",
    "flow_kg_s": "mass flow at the sensor, wet",
    "flow_sd_kg_s": "its standard deviation",
    "moisture_pct": "moisture of the grain, wet basis",
    "interval_s": "time that the row stands for",
    "distance_m": "distance driven in the interval",
    "width_m": "working width in use",
    "header_down": "1 harvesting, 0 header up",
    "heading_deg": "clockwise from north",
    "pass_number": "as the source counts passes",
    "section": "number of the header's section, 0 for the whole header",
    "elevation_m": "above the ellipsoid or the sea, as the source has it",
    "header_ahead_m": "from the place forward to the header's middle",
    "header_right_m": "from the place right to the header's middle",
    "cut_right_m": "from the header's middle right to that of the part of it that cuts",
}
REQUIRED = ("time_s", "longitude_deg", "latitude_deg", "flow_kg_s", "interval_s", "distance_m", "width_m")
DEFAULT_FLOW_S = 12.0
"""Delay of a combine of which nothing is known, between the 8 and 18 s of the makes (Yield Editor's manual)."""
FORAGE_FLOW_S = 2.0
"""Delay of a forage harvester of which no more is known: its moisture, measured behind the chopper, lags by 1.9 s (0.4 to 2.9) in
the task data of studies/harvests, and its flow is measured at the feed rolls, before that."""
UNKNOWN_SCALE_SD = 0.03
"""Relative standard deviation of a single load's factor about the field's, where fewer than three loads are weighed, or it was
recomputed and not weighed itself."""
#: Text columns.
LABELS = ("field", "load", "crop", "machine", "product")


@dataclass(frozen=True)
class Label:
    """A text column: `codes` (int32, one a row) into `names`."""

    codes: NDArray[np.int32]
    names: tuple[str, ...]

    @classmethod
    def constant(cls, name: str, count: int) -> Label:
        """The same name in every row."""
        return cls(np.zeros(count, np.int32), (name,))

    @classmethod
    def of(cls, values: Sequence[str]) -> Label:
        """From one text a row; names in the order of their first row."""
        names: dict[str, int] = {}
        codes = np.fromiter((names.setdefault(value, len(names)) for value in values), np.int32, len(values))
        return cls(codes, tuple(names))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Label:
        """Some rows."""
        return Label(self.codes[rows], self.names)

    def text(self) -> NDArray[np.object_]:
        """The names row by row."""
        return np.array(self.names or ("",), dtype=object)[self.codes]


@dataclass(frozen=True)
class Skipped:
    """A part of a source that was not read, and why."""

    part: str
    why: str


@dataclass(frozen=True)
class KnownLoad:
    """A load that its source has corrected. factor, factor_sd: corrected over measured mass; weighed_kg: None where it was not
    weighed itself but recomputed."""

    factor: float
    factor_sd: float
    weighed_kg: float | None
    common_sd: float = 0.0


@dataclass(frozen=True)
class Source:
    """Where rows came from.

    Parameters
    ----------
    path : str
        File.
    kind : str
        Name of the reader.
    points : int
        Rows read.
    skipped : tuple of Skipped
        What was not.
    mass_kg : float or None
        The machine's own total, where the source has one.
    area_m2 : float or None
        The machine's own harvested area.
    notes : tuple of str
        What the reader had to take for granted; a line each.
    declared_flow_s, default_flow_s
        As of a HarvestTable of this source alone.
    taken_out : bool
        Whether the source says that its delays have been taken out of its rows.
    known_loads : mapping of str to KnownLoad
        Loads by name that the source itself has corrected; its rows are as measured.
    scales : mapping of str to str
        Load -> the scale that it was measured with, where the source tells it.
    date_order : DateOrder or None
        Of dates in which day and month could be exchanged; None for none.
    """

    path: str
    kind: str
    points: int
    skipped: tuple[Skipped, ...] = ()
    mass_kg: float | None = None
    area_m2: float | None = None
    notes: tuple[str, ...] = ()
    declared_flow_s: float | None = None
    default_flow_s: float = 0.0
    taken_out: bool = False
    known_loads: Mapping[str, KnownLoad] = field(default_factory=dict)
    scales: Mapping[str, str] = field(default_factory=dict)
    date_order: DateOrder | None = None


@dataclass(frozen=True)
class HarvestTable:
    """Points of one or several sources, in the order of the files.

    Parameters
    ----------
    columns : mapping of str to array, shape (n,)
        Names of COLUMNS.
    labels : mapping of str to Label
        Names of LABELS.
    sources : tuple of Source
        In order.
    source_of_row : array of int32, shape (n,)
        Index into `sources`.
    unix_time : bool
        Whether `time_s` is Unix time (UTC); else it is a clock of the source's own, without a date.
    declared_flow_s : float or None
        Delay that the machine says it has (and has not taken out of the rows).
    default_flow_s : float
        Delay that such sources usually still have in them; kept where neither the data nor the machine give one.
    extra : mapping of str to array
        Columns that the source has and this table does not know (proprietary DDIs), raw.
    """

    columns: Mapping[str, Array]
    labels: Mapping[str, Label]
    sources: tuple[Source, ...]
    source_of_row: NDArray[np.int32]
    unix_time: bool = False
    declared_flow_s: float | None = None
    default_flow_s: float = 0.0
    extra: Mapping[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.source_of_row)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def stream(self) -> Index:
        """Number of each row's stream, shape (n,): one machine of one source."""
        machine = self.labels["machine"]
        return self.source_of_row.astype(np.intp) * len(machine.names) + machine.codes

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> HarvestTable:
        """Some rows, in the given order."""
        return replace(
            self,
            columns={name: values[rows] for name, values in self.columns.items()},
            labels={name: label.take(rows) for name, label in self.labels.items()},
            source_of_row=self.source_of_row[rows],
            extra={name: values[rows] for name, values in self.extra.items()},
        )

    def with_columns(self, **columns: Array) -> HarvestTable:
        """The same table with these columns added or replaced."""
        return replace(self, columns={**self.columns, **columns})

    def noting(self, *, notes: Sequence[str] = (), skipped: Sequence[Skipped] = ()) -> HarvestTable:
        """The same table with these notes and skipped parts added to those of its first source."""
        first, *others = self.sources
        first = replace(first, notes=(*first.notes, *notes), skipped=(*first.skipped, *skipped))
        return replace(self, sources=(first, *others))


def build(
    columns: Mapping[str, Array],
    labels: Mapping[str, Label],
    source: Source,
    *,
    unix_time: bool,
    declared_flow_s: float | None = None,
    default_flow_s: float = 0.0,
    extra: Mapping[str, Array] | None = None,
) -> HarvestTable:
    """A table of one source.

    Parameters
    ----------
    columns : mapping of str to array, shape (n,)
        Names of COLUMNS; missing ones are NaN.
    labels : mapping of str to Label
        Names of LABELS; missing ones are "".
    source : Source
    unix_time, declared_flow_s, default_flow_s, extra
        As HarvestTable has them.

    Raises
    ------
    InputError
        Where a column that every table needs is missing or never known.
    ValueError
        For a column that no table has.
    """
    count = len(next(iter(columns.values())))
    if unknown := sorted(set(columns) - set(COLUMNS)):
        raise ValueError(f"columns {', '.join(unknown)}; expected some of {', '.join(COLUMNS)}")
    for name in REQUIRED:
        if name not in columns or (count and not np.isfinite(columns[name]).any()):
            raise InputError(source.path, f"has no {name} in any row", f"{name}: {COLUMNS[name]}")
    full = {name: np.asarray(columns.get(name, np.full(count, np.nan)), float) for name in COLUMNS}
    texts = {name: labels.get(name, Label.constant("", count)) for name in LABELS}
    return HarvestTable(
        full,
        texts,
        (
            replace(
                source,
                declared_flow_s=declared_flow_s,
                default_flow_s=default_flow_s,
            ),
        ),
        np.zeros(count, np.int32),
        unix_time,
        declared_flow_s,
        default_flow_s,
        extra or {},
    )


def joined(tables: Sequence[HarvestTable]) -> HarvestTable:
    """Several tables one after another. Each source's clock stays its own; sources without a date are kept apart in time.

    Raises
    ------
    InputError
        Without tables.
    """
    if not tables:
        raise InputError("sources", "hold no point", "at least one harvest")
    if len(tables) == 1:
        return tables[0]
    labels = {}
    for name in LABELS:
        names: dict[str, int] = {}
        codes = []
        for table in tables:
            label = table.labels[name]
            places = np.array([names.setdefault(text, len(names)) for text in label.names] or [0], np.int32)
            codes.append(places[label.codes])
        labels[name] = Label(np.concatenate(codes), tuple(names))
    extra_names = sorted({name for table in tables for name in table.extra})
    first, offset = [], 0
    for table in tables:
        first.append(table.source_of_row + offset)
        offset += len(table.sources)
    return HarvestTable(
        columns={name: np.concatenate([table[name] for table in tables]) for name in COLUMNS},
        labels=labels,
        sources=tuple(source for table in tables for source in table.sources),
        source_of_row=np.concatenate(first).astype(np.int32),
        unix_time=all(table.unix_time for table in tables),
        declared_flow_s=_common([table.declared_flow_s for table in tables]),
        default_flow_s=max(table.default_flow_s for table in tables),
        extra={
            name: np.concatenate([table.extra.get(name, np.full(len(table), np.nan)) for table in tables]) for name in extra_names
        },
    )


def _common(values: Sequence[float | None]) -> float | None:
    return values[0] if len(set(values)) == 1 else None
