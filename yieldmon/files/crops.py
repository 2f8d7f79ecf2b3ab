"""The shipped crops: market figures, and parameters to begin with before any calibration on a machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from types import MappingProxyType

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.stages import GRAVITY_M_S2
from yieldmon.resources import shipped
from yieldmon.units import KG_PER_LB

from . import strict_yaml

_FILE = "config/crops.yaml"
#: Other spellings, and names in other languages -> name in config/crops.yaml.
_ALIASES = {
    "maize": "corn",
    "mais": "corn",
    "maiz": "corn",
    "milho": "corn",
    "yellow corn": "corn",
    "soybeans": "soybean",
    "soya": "soybean",
    "soy": "soybean",
    "soja": "soybean",
    "sb": "soybean",
    "winter wheat": "wheat",
    "spring wheat": "wheat",
    "weizen": "wheat",
    "winterweizen": "wheat",
    "trigo": "wheat",
    "gerste": "barley",
    "wintergerste": "barley",
    "milo": "sorghum",
    "canola": "rapeseed",
    "rape": "rapeseed",
    "oilseed rape": "rapeseed",
    "raps": "rapeseed",
    "sunflowers": "sunflower",
}
_SHORTEST_SLIP = 4
"""Letters; of shorter words many are another crop's."""
_HEAP_OVER_TEST_WEIGHT = 1.49
_DENSITY_SD = 0.15


@dataclass(frozen=True, slots=True)
class Crop:
    """One crop; see config/crops.yaml for meanings, units and sources. Slopes are relative, per percent of moisture."""

    name: str
    bushel_lb: float
    market_moisture_pct: float
    test_weight_kg_m3: float
    friction: float
    friction_sd: float
    restitution: float
    restitution_sd: float
    friction_per_pct: float
    density_per_pct: float
    restitution_per_pct: float
    sources: str

    @property
    def bushel_kg(self) -> float:
        """Mass of a bushel."""
        return self.bushel_lb * KG_PER_LB

    def parameters(self) -> ParameterSet:
        """Parameters with standard deviations of an uncalibrated machine and field."""
        density = _HEAP_OVER_TEST_WEIGHT * self.test_weight_kg_m3
        return ParameterSet(
            {
                "friction": self.friction,
                "density": density,
                "shape_ratio": 2.0,
                "restitution": self.restitution,
                "gravity.acceleration_m_s2": GRAVITY_M_S2,
            },
            ("friction", "density", "restitution"),
            np.diag([self.friction_sd**2, (_DENSITY_SD * density) ** 2, self.restitution_sd**2]),
            provenance={"crop": self.name, "method": "published properties", "sources": f"config/crops.yaml: {self.sources}"},
        )


@cache
def crops() -> Mapping[str, Crop]:
    """By name."""
    found = strict_yaml.load(shipped(_FILE))
    numbers = {f.name for f in fields(Crop)} - {"name", "sources"}
    return MappingProxyType({
        name: Crop(name=name, sources=str(values["sources"]), **{key: float(values[key]) for key in numbers})
        for name, values in found.items()
    })  # fmt: skip


def shipped_name(name: str) -> str | None:
    """The shipped crop that a name means, whatever its case, spelling or language: "Oilseed_Rape" is "rapeseed"; None: none."""
    plain = " ".join(name.lower().replace("_", " ").split())
    found = _ALIASES.get(plain, plain)
    return found if found in crops() else None


def misspelt(name: str) -> str | None:
    """The shipped crop from one of whose names a word is one slip of a finger away: "cron" is "corn"; None: none.

    A slip is a letter left out, added, taken for another, or changed with its neighbour.
    """
    word = name.strip().lower()
    if shipped_name(word) is not None or len(word) < _SHORTEST_SLIP or not word.isalpha():
        return None
    return next((shipped_name(known) for known in (*crops(), *_ALIASES) if _one_slip(word, known)), None)


def _one_slip(word: str, known: str) -> bool:
    same = next((at for at, (a, b) in enumerate(zip(word, known, strict=False)) if a != b), min(len(word), len(known)))
    rest, right = word[same:], known[same:]
    swapped = rest[1:2] + rest[:1] + rest[2:] == right and rest != right
    return swapped or rest[1:] == right or rest == right[1:] or rest[1:] == right[1:]


def find_crop(name: str) -> Crop | None:
    """The shipped crop that a name means, as `shipped_name` has it."""
    known = shipped_name(name)
    return None if known is None else crops()[known]


def crop(name: str) -> Crop:
    """One crop. Raises InputError for a name that is not shipped."""
    found = find_crop(name)
    if found is None:
        raise InputError("crop", repr(name), f"one of {', '.join(crops())}")
    return found
