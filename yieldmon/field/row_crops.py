"""Which crop the grain of each row is, and its bushel."""

from __future__ import annotations

import numpy as np

from yieldmon.units import KG_PER_LB

from .crop_figures import crop
from .table import Array, HarvestTable, Label


def row_crops(table: HarvestTable) -> Label:
    """The crop of each row; "" where it is not known.

    Parameters
    ----------
    table : HarvestTable
        Rows that name no crop are of the one crop that others of their field name, if it is one.

    Returns
    -------
    Label
    """
    field, label = table.labels["field"].codes, table.labels["crop"]
    named = np.array([bool(name) for name in label.names], dtype=bool)[label.codes]
    codes = label.codes.copy()
    for one in np.unique(field):
        here = field == one
        crops = np.unique(label.codes[here & named])
        if len(crops) == 1:
            codes[here & ~named] = crops[0]
    return Label(codes, label.names)


def row_bushels_kg(crops: Label) -> Array:
    """Mass of a bushel of each row's crop, kg; nan where it is not known."""
    facts = [crop(name) for name in crops.names]
    bushels_kg = np.array([np.nan if one is None else one.bushel_lb * KG_PER_LB for one in facts], dtype=float)
    return np.asarray(bushels_kg[crops.codes])


def common_bushel_kg(bushels_kg: Array) -> float | None:
    """The bushel of rows that all have the same one, kg; None where one is not known, bushels differ or there is no row."""
    found = np.unique(bushels_kg)
    return float(found[0]) if len(found) == 1 and np.isfinite(found[0]) else None
