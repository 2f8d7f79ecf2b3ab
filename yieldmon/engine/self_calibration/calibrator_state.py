"""The state of self-calibration over a restart, beside the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from yieldmon.engine.self_calibration.earlier_parameters import EarlierParameters, Places


@dataclass(frozen=True, slots=True)
class PriorState:
    """The parameters before those of this version. values: by name; covariance: (n, n) of covariance_names; carried_from: as in
    `ParameterSet`."""

    version: int
    values: tuple[tuple[str, float], ...]
    covariance_names: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]
    carried_from: str = ""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PriorState:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError, and ValueError where names and covariance do not fit."""
        values, names = tuple((str(name), float(value)) for name, value in data["values"]), tuple(data["covariance_names"])
        covariance, carried_from = _rows(data["covariance"]), str(data.get("carried_from", ""))
        state = cls(int(data["version"]), values, names, covariance, carried_from)
        if {len(state.covariance), *map(len, state.covariance)} - {len(names)} or not set(names) <= dict(values).keys():
            raise ValueError(f"engine state: the covariance of the parameters before does not fit {list(names)}")
        return state


@dataclass(frozen=True, slots=True)
class GrainState:
    """State of a crop that is not harvested now, for its return.

    crop: its name. weighed, doubted: as in `CalibratorState`. origin: its parameters as they came from outside; left: its
    parameters after the weighed loads; None for both where weighed loads have not changed them.
    """

    crop: str
    weighed: tuple[str, ...]
    doubted: str = ""
    origin: PriorState | None = None
    left: PriorState | None = None

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> GrainState:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError, and ValueError where only one of origin and left is
        there."""
        origin, left = (_prior_or_none(data.get(name)) for name in ("origin", "left"))
        if (origin is None) != (left is None):
            raise ValueError(f"engine state: of {data['crop']} it has parameters before weighed loads or after them, not both")
        return cls(str(data["crop"]), tuple(data["weighed"]), str(data.get("doubted", "")), origin, left)


@dataclass(frozen=True, slots=True)
class CalibratorState:
    """What self-calibration knows beside the parameters.

    Attributes
    ----------
    waited_s, harvested_kg : float
        Time, s, and grain, kg, since the last update.
    moisture_pct : float or None
        Of the grain for which the parameters hold, %.
    drifting : tuple of str
        The r parameters that have a steady drift rate.
    rates : tuple of float
        (r,), per kilotonne.
    covariance : tuple of tuple of float
        (r, n + r) of the rates with the n parameters that have a variance, and with each other.
    at_s : float or None
        Bus time of the last update, s; None where not known.
    weighed : tuple of str
        Names of the weighed loads that new ones are compared with.
    doubted : str
        Name of the load that contradicts them, "" for none.
    bias : tuple of float
        Of kernel noise: value, variance, largest variance, then covariance with parameters and rates; empty where kernel noise
        has updated nothing.
    origin : PriorState or None
        The parameters before weighed loads gave a curve of their own; None where they have not.
    grains : tuple of GrainState
        Crops harvested before.
    spread : tuple of tuple of float
        Covariance that rates of unknown size may have added (`estimation.self_calibration.drift_spread`),
        (n + r + 1, n + r + 1); empty where unknown.
    past : tuple of EarlierParameters
        When parameters that were in use before were estimated.
    """

    waited_s: float
    harvested_kg: float
    moisture_pct: float | None
    drifting: tuple[str, ...]
    rates: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    at_s: float | None = None
    weighed: tuple[str, ...] = ()
    doubted: str = ""
    bias: tuple[float, ...] = ()
    origin: PriorState | None = None
    grains: tuple[GrainState, ...] = ()
    spread: tuple[tuple[float, ...], ...] = ()
    past: Places = ()

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CalibratorState:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError, and ValueError where sizes do not fit."""
        lists = {name: tuple(data.get(name, ())) for name in ("drifting", "rates", "weighed", "bias")}
        parts = {
            "grains": tuple(GrainState.from_dict(grain) for grain in data.get("grains", ())),
            "covariance": _rows(data["covariance"]),
            "origin": _prior_or_none(data.get("origin")),
            "spread": _rows(data.get("spread", ())),
            "past": tuple(EarlierParameters.from_dict(place) for place in data.get("past", ())),
        }
        state = cls(**{**data, **lists, **parts})
        count = len(state.drifting)
        if len(state.rates) != count or len(state.covariance) != count or len({len(row) for row in state.covariance}) > 1:
            raise ValueError(f"engine state: rates {state.rates} do not fit the parameters {state.drifting}")
        if any(len(row) != len(state.spread) for row in state.spread):
            raise ValueError(f"engine state: a spread of {len(state.spread)} rows is not square")
        return state


def _prior_or_none(data: Mapping[str, Any] | None) -> PriorState | None:
    return None if data is None else PriorState.from_dict(data)


def _rows(data: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in data)
