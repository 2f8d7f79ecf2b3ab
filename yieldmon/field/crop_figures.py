"""Bushel weights and market moistures of the crops that harvest files name.

Sources: config/crops.yaml; of oats, rye and peas USDA test weights, 7 CFR 810.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from yieldmon.files.crops import crops, shipped_name


@dataclass(frozen=True)
class CropFigures:
    """What a crop's name stands for.

    Parameters
    ----------
    name : str
        Common name in English.
    bushel_lb : float
        Weight of a standard bushel, lb.
    market_moisture_pct : float
        Moisture of dry mass, %.
    """

    name: str
    bushel_lb: float
    market_moisture_pct: float


#: Crops that are shipped: their name in harvest files -> their name in config/crops.yaml, which has their figures.
_SHIPPED = {
    "corn": "corn",
    "soybeans": "soybean",
    "wheat": "wheat",
    "barley": "barley",
    "sorghum": "sorghum",
    "canola": "rapeseed",
    "rice": "rice",
    "sunflower": "sunflower",
}
#: Name in config/crops.yaml -> name in harvest files.
_NAMES = {of: name for name, of in _SHIPPED.items()}
#: Crops that harvest files name and that no parameters are shipped for.
_FURTHER = (CropFigures("oats", 32.0, 14.0), CropFigures("rye", 56.0, 14.0), CropFigures("peas", 60.0, 14.0))


@cache
def known_crops() -> Mapping[str, CropFigures]:
    """Name -> crop."""
    figures = crops()
    found = {name: CropFigures(name, figures[of].bushel_lb, figures[of].market_moisture_pct) for name, of in _SHIPPED.items()}
    return MappingProxyType(found | {crop.name: crop for crop in _FURTHER})


#: Names in other languages of crops that are not shipped.
_ALIASES = {"roggen": "rye", "hafer": "oats"}


def crop(name: str) -> CropFigures | None:
    """The crop that a file's name means, None for one that is not known (its bushel is then not known either)."""
    plain = " ".join(name.lower().replace("_", " ").replace('"', " ").split())
    return known_crops().get(_ALIASES.get(plain, _NAMES.get(shipped_name(plain) or "", plain)))
