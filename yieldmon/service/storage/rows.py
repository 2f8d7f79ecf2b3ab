"""One second's window as a flat row, for the store and for tables: units as people read them, None for "not available".

The columns are those that `engine.records.WindowRecord` declares, after the row's number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, make_dataclass
from math import nan, radians
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, ClassVar

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.records import COLUMNS, WindowRecord
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.physics.machine import RPM

if TYPE_CHECKING:

    class SecondRow:
        """A WindowRecord (see there) in deg and rpm, with codes as int, flags as 0 and 1, and faults joined with spaces.

        number: counts the rows of a store, or of an output file, up from 1 without a gap.
        """

        __dataclass_fields__: ClassVar[dict[str, Any]]
        number: int

        def __init__(self, *values: Any, **columns: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...

else:
    _KINDS = {column.name: column.kind | None if column.optional else column.kind for column in COLUMNS}
    _LATER = {column.name for column in COLUMNS if column.optional and column.since > 1}
    _FIELDS = [(name, kind, field(default=None)) if name in _LATER else (name, kind) for name, kind in _KINDS.items()]
    SecondRow = make_dataclass("SecondRow", [("number", int), *_FIELDS], frozen=True, slots=True)
    SecondRow.__module__ = __name__
    _TYPES = "".join(f"\n{column.name} : {column.kind.__name__}{' or None' if column.optional else ''}" for column in COLUMNS)
    SecondRow.__doc__ = f"""One second as stores and tables hold it; units are in the names, None is not known.

Parameters
----------
number : int
    Counts the rows of a store, or of an output file, up from 1 without a gap.{_TYPES}

Examples
--------
See `process_logs`.
"""


def _attributes(names: Sequence[str]) -> Callable[[object], tuple[Any, ...]]:
    taken = attrgetter(*names)
    return taken if len(names) > 1 else lambda record: (taken(record),)


# Columns that are converted alike are converted together.
_ALIKE = {
    convert: [place for place, column in enumerate(COLUMNS) if column.convert is convert]
    for convert in dict.fromkeys(column.convert for column in COLUMNS)
}
_CONVERTED = [(convert, _attributes([COLUMNS[place].attribute for place in places])) for convert, places in _ALIKE.items()]
_TOGETHER = [place for places in _ALIKE.values() for place in places]
_in_order = itemgetter(*(_TOGETHER.index(place) for place in range(len(COLUMNS))))
_made = maker_of(SecondRow)


def second_row(number: int, record: WindowRecord) -> SecondRow:
    """The row of a window record."""
    values: list[Any] = []
    for convert, taken in _CONVERTED:
        values += convert(taken(record))
    return _made(number, *_in_order(values))


def kept_second(row: SecondRow) -> KeptSecond:
    """What of a row it takes to measure its second again."""

    def known(value: float | None) -> float:
        return nan if value is None else value

    return KeptSecond(
        load_number=row.load_number,
        duration_s=row.duration_s,
        mass_kg=row.mass_kg,
        coverage=row.coverage,
        zero_mv=known(row.zero_mv),
        force_n=known(row.force_n),
        force_std_dev_n=known(row.force_std_dev_n),
        plate_angle_rad=radians(known(row.plate_angle_deg)),
        elevator_speed_rad_s=known(row.elevator_speed_rpm) * RPM,
        moisture_pct=known(row.moisture_pct),
        area_m2=known(row.area_m2),
        surplus_frames=row.surplus_frames,
    )
