"""The shipped crops: market figures, and parameters to begin with before any calibration on a machine."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from types import MappingProxyType

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import METHOD, PUBLISHED, ParameterSet
from yieldmon.physics.stages import GRAVITY_M_S2
from yieldmon.resources import shipped
from yieldmon.units import KG_PER_LB

from . import strict_yaml

_FILE = "config/crops.yaml"
SHIPPED_CROP = "corn"
"""Of the shipped parameter file."""
_NAMES = {
    # Corn wet: what John Deere's exports call corn for grain. All classes of corn have one bushel (7 CFR 810, subpart D).
    "corn": (
        "maize, yellow corn, corn yellow, white corn, corn white, corn wet, grain corn, corn grain, field corn, mais, "
        "körnermais, maiz, milho, majs, granturco, kukurydza, maissi"
    ),
    "soybean": (
        "soybeans, soy bean, soy beans, soya, soyabean, soyabeans, soya bean, soya beans, soy, sb, soja, sojabohne, "
        "sojabohnen, sojaböna, sojabönor, soia, feijão soja"
    ),
    "wheat": (
        "winter wheat, wheat winter, spring wheat, wheat spring, durum, durum wheat, wheat durum, hard red winter wheat, "
        "wheat hard red winter, hard red spring wheat, wheat hard red spring, soft red winter wheat, wheat soft red winter, "
        "soft white winter wheat, wheat soft white winter, weizen, winterweizen, sommerweizen, hartweizen, trigo, blé, "
        "blé tendre, blé dur, grano, frumento, vete, höstvete, vårvete, hvede, vinterhvede, vårhvede, hvete, høsthvete, "
        "vårhvete, tarwe, wintertarwe, pszenica, vehnä"
    ),
    "barley": (
        "winter barley, spring barley, malting barley, gerste, wintergerste, sommergerste, braugerste, cebada, "
        "cevada, orge, orzo, höstkorn, vårkorn, maltkorn, byg, vinterbyg, vårbyg, maltbyg, bygg, gerst, wintergerst, "
        "jęczmień, ohra"
    ),
    "rapeseed": (
        "canola, rape, oilseed rape, winter rape, raps, winterraps, sommerraps, colza, höstraps, vårraps, oljeraps, "
        "vinterraps, turnip rape, rybs, rypsi, koolzaad, rzepak, rapsi"
    ),
    "sorghum": "milo, sorgo, sorgho, durra",
    "sunflower": (
        "sunflowers, sonnenblume, sonnenblumen, girasol, girassol, girasole, tournesol, solros, solrosor, solsikke, "
        "zonnebloem, zonnebloemen, słonecznik, auringonkukka"
    ),
    "rice": "paddy, reis, arroz, riz, riso, ris, rijst, ryż, riisi",
}
"""Other spellings of the names in config/crops.yaml, and names in other languages."""
_OF_TWO_CROPS = {"korn": ("barley", "corn")}
"""A name -> the crops that it may mean: Swedish barley, and a slip of corn."""
_OTHER_CROPS = frozenset({"bete", "ruis"})
"""Names of crops that are not shipped, one slip from a name of one that is: beet, Finnish rye."""
_OTHER_LETTERS = {"ø": "o", "æ": "ae", "ł": "l", "ß": "ss"}
"""Letters that are not a letter with a mark."""
_BETWEEN_WORDS = str.maketrans(dict.fromkeys("_-,\"'", " "))
"""As in `Corn, White` and in names that a program wrote with its quotation marks."""
_SHORTEST_SLIP = 4
"""Letters; of shorter words, and one slip from shorter ones, many are another crop's."""
_HEAP_OVER_TEST_WEIGHT = 1.49
DENSITY_SD = 0.15
"""Relative, of a crop's bulk density on a paddle over varieties and years."""


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
            np.diag([self.friction_sd**2, (DENSITY_SD * density) ** 2, self.restitution_sd**2]),
            provenance={"crop": self.name, METHOD: PUBLISHED, "sources": f"config/crops.yaml: {self.sources}"},
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


def _plain(name: str) -> str:
    """A name as names are compared: small letters of the English alphabet, with one space between words."""
    small = "".join(_OTHER_LETTERS.get(letter, letter) for letter in name.casefold())
    apart = unicodedata.normalize("NFKD", small.translate(_BETWEEN_WORDS))
    return " ".join("".join(letter for letter in apart if not unicodedata.combining(letter)).split())


@cache
def _known_names() -> Mapping[str, str]:
    """Every name that is known, as `_plain` has it -> its crop."""
    return {name: name for name in crops()} | {_plain(name): crop for crop, names in _NAMES.items() for name in names.split(", ")}


def shipped_name(name: str) -> str | None:
    """The shipped crop that a name means, whatever its case, spelling or language: "Oilseed_Rape" is "rapeseed"; None: none."""
    return _known_names().get(_plain(name))


def misspelt(name: str) -> str | None:
    """The shipped crop from one of whose names a word is one slip of a finger away: "cron" is "corn"; None: none.

    A slip is a letter left out, added, taken for another, or changed with its neighbour. Of a name that may be two crops', both.
    """
    word = _plain(name)
    if shipped_name(word) is not None or len(word) < _SHORTEST_SLIP or not word.isalpha() or word in _OTHER_CROPS:
        return None
    if word in _OF_TWO_CROPS:
        return " or ".join(_OF_TWO_CROPS[word])
    return next((crop for known, crop in _known_names().items() if len(known) >= _SHORTEST_SLIP and _one_slip(word, known)), None)


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
        raise InputError("crop", repr(name), misspelt(name) or f"one of {', '.join(crops())}")
    return found
