"""When parameters that were in use before were estimated, so that drift counts from then once they are restored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

from yieldmon.estimation.parameters import ParameterSet

_KEPT = 16


@dataclass(frozen=True, slots=True)
class EarlierParameters:
    """values: of the parameters, by name. at_s, at_kg: bus time, s, and total, kg, at which they were estimated."""

    values: tuple[tuple[str, float], ...]
    at_s: float
    at_kg: float

    @classmethod
    def from_dict(cls, data: Mapping[str, object]) -> EarlierParameters:
        """Inverse of `dataclasses.asdict`. Raises TypeError, KeyError or ValueError."""
        values = tuple((str(name), float(value)) for name, value in data["values"])  # type: ignore[attr-defined] # from JSON
        return cls(values, float(data["at_s"]), float(data["at_kg"]))  # type: ignore[arg-type] # from JSON


Places = tuple[EarlierParameters, ...]
"""By time, the newest last."""


def remembered(places: Places, parameters: ParameterSet, at_s: float, at_kg: float) -> Places:
    """The list with these parameters added, if it is known when they were estimated."""
    if not (isfinite(at_s) and isfinite(at_kg)):
        return places
    values = tuple(sorted((name, float(value)) for name, value in parameters.values.items()))
    others = [place for place in places if place.values != values]
    return (*others[1 - _KEPT :], EarlierParameters(values, at_s, at_kg))


def place_of(places: Sequence[EarlierParameters], parameters: ParameterSet) -> EarlierParameters | None:
    """The entry of parameters with these values; None where there is none."""
    values = tuple(sorted((name, float(value)) for name, value in parameters.values.items()))
    return next((place for place in reversed(places) if place.values == values), None)


def moved(places: Places, by_kg: float) -> Places:
    """The entries after the totals have shifted by by_kg."""
    return tuple(replace(place, at_kg=place.at_kg + by_kg) for place in places)
