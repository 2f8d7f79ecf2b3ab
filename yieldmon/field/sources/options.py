"""What a person may say about a source that the file does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date


@dataclass(frozen=True)
class ReadOptions:
    """What a person says about a source.

    Parameters
    ----------
    columns : mapping of str to (str, str)
        Quantity -> name of the file's column and its unit ("" where the file says it).
    width_m : float or None
        Working width where the file has none.
    crop : str
        Name of the crop where the file has none or one that is wrong, see crop_names; bushels need one.
    field : str
        Name of the field, where the file has none.
    first_date : date or None
        Date of the first point, where the file's clock has none or its dates do not tell day from month.
    crs : str
        Coordinate reference system where the file has none.
    day_first : bool or None
        Whether the day comes before the month in dates that do not tell; None: not known.
    """

    columns: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    width_m: float | None = None
    crop: str = ""
    field: str = ""
    first_date: date | None = None
    crs: str = ""
    day_first: bool | None = None
