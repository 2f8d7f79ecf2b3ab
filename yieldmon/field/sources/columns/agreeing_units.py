"""Units that the names of columns do not say, from what their numbers must agree in.

A row's mass is flow times interval, and it is yield times distance times width. Each choice of units gives another ratio of the
two, so where a file has all five columns the ratio tells the units: names cut to ten characters, as in the exports of SMS, lose
them ("Crop_Flw_M" of "Crop Flw(M)(lb/s)").
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from yieldmon.field.table import Array
from yieldmon.field.units import FACTORS, plain_unit

_KINDS = {"flow": "mass_flow", "interval": "time", "yield": "mass_per_area", "distance": "length", "width": "length"}
QUANTITIES = tuple(_KINDS)
"""Of which all must be there."""
_SYSTEMS: tuple[Mapping[str, tuple[str, ...]], ...] = (
    {"flow": ("lb/s",), "interval": ("s",), "yield": ("lb/ac", "ton/ac"), "distance": ("ft",), "width": ("ft",)},
    {"flow": ("lb/s",), "interval": ("s",), "yield": ("lb/ac", "ton/ac"), "distance": ("in",), "width": ("in",)},
    {"flow": ("kg/s", "t/h"), "interval": ("s",), "yield": ("kg/ha", "t/ha"), "distance": ("m",), "width": ("m",)},
)
"""Units that go together. No two choices have ratios within a tenth of one another."""
_LEAST_ROWS = 30
_AGREE, _MOST = 0.02, 0.9
"""How near (log) a row's two masses are, and in what share of the rows."""


def agreeing_units(numbers: Mapping[str, Array], known: Mapping[str, str]) -> dict[str, str]:
    """Quantity -> unit of those that say none; empty where no choice of units, or more than one, makes the masses agree.

    Parameters
    ----------
    numbers : mapping of str to array, shape (n,)
        Each of QUANTITIES -> numbers as the file has them, NaN where not known.
    known : mapping of str to str
        Quantity -> unit, of those that say one.

    Examples
    --------
    >>> import numpy as np
    >>> way_ft, lb_ac = np.linspace(5.0, 8.0, 40), np.linspace(1500.0, 3500.0, 40)
    >>> numbers = {"flow": lb_ac * way_ft * 40.0 / 43560.0, "interval": np.ones(40), "yield": lb_ac}
    >>> numbers |= {"distance": way_ft, "width": np.full(40, 40.0)}
    >>> agreeing_units(numbers, {"interval": "s"})
    {'flow': 'lb/s', 'yield': 'lb/ac', 'distance': 'ft', 'width': 'ft'}
    """
    flow, interval, of_area, distance, width = (numbers[quantity] for quantity in QUANTITIES)
    with np.errstate(invalid="ignore"):
        both = (flow > 0) & (interval > 0) & (of_area > 0) & (distance > 0) & (width > 0)
    if both.sum() < _LEAST_ROWS:
        return {}
    ratio = np.log((flow * interval)[both] / (of_area * distance * width)[both])
    unknown = [quantity for quantity in QUANTITIES if quantity not in known]
    found: list[dict[str, str]] = []
    for system in _SYSTEMS:
        for chosen in product(*(system[quantity] for quantity in unknown)):
            units = dict(known) | dict(zip(unknown, chosen, strict=True))
            scale = {quantity: FACTORS[_KINDS[quantity]].get(plain_unit(units[quantity])) for quantity in QUANTITIES}
            if None in scale.values():
                return {}
            si = {quantity: float(np.log(factor)) for quantity, factor in scale.items() if factor}
            off = ratio + si["flow"] + si["interval"] - si["yield"] - si["distance"] - si["width"]
            if (np.abs(off) < _AGREE).mean() >= _MOST:
                found.append(dict(zip(unknown, chosen, strict=True)))
    return found[0] if len(found) == 1 else {}
