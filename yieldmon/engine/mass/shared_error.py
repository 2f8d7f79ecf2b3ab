"""The errors of parameters and model that the seconds of a load share, kept so that they can be restated.

A model error that sweeps show holds for all mass measured with the same parameters, before and after the sweep. So each load
keeps the sensitivity of its mass to an error of the force, and its standard deviation follows the knowledge of today, while the
load is open and after it was closed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot
from typing import Any

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.mass.budget import FlowBudget, MassBudget
from yieldmon.estimation.self_calibration.angle_error import NODES_RAD, AngleError, node_shares


@dataclass(frozen=True, slots=True)
class SharedError:
    """The shared error of one load.

    Attributes
    ----------
    version : int
        Of the parameters that last measured it.
    before_kg : float
        Standard deviation by all earlier parameters, kg, which no longer changes.
    own_kg : float
        Standard deviation by the covariance of the last parameters, kg.
    per_error_kg : tuple of float
        Change of its mass, kg, per relative error of the force at each node of plate angle, (nodes,).
    taken_off_kg : float
        Correction of its mass, kg, for the error of the force away from home that sweeps had shown by then.
    """

    version: int
    before_kg: float = 0.0
    own_kg: float = 0.0
    per_error_kg: tuple[float, ...] = (0.0,) * NODES_RAD.size
    taken_off_kg: float = 0.0

    def plus(self, flow: FlowBudget, seconds: float, plate_angle_rad: float) -> SharedError:
        """The sum with `seconds` more of a flow at a plate angle, rad."""
        return _made(
            self.version,
            self.before_kg,
            self.own_kg + flow.covariance_kg_s * seconds,
            _with(self.per_error_kg, flow.per_error_kg_s * seconds, plate_angle_rad),
            self.taken_off_kg + flow.taken_off * flow.per_error_kg_s * seconds,
        )

    @classmethod
    def at(cls, version: int, own_kg: float, per_error_kg: float, plate_angle_rad: float) -> SharedError:
        """The error of a load measured at one plate angle, rad; own_kg and per_error_kg as above."""
        return cls(version, 0.0, own_kg, _with((0.0,) * NODES_RAD.size, per_error_kg, plate_angle_rad))

    def parameters_kg(self, error: AngleError) -> float:
        """Standard deviation by the parameters, kg, with the model error that sweeps show now."""
        to_take_off_kg = sum(kg * away for kg, away in zip(self.per_error_kg, error.away, strict=False))
        # Mass measured before a sweep showed the error was not corrected.
        left_kg = to_take_off_kg - self.taken_off_kg
        return self.before_kg + hypot(self.own_kg, error.of_sum(self.per_error_kg, left_kg))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> SharedError:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError."""
        return cls(**{**data, "per_error_kg": tuple(map(float, data["per_error_kg"]))})


@dataclass(frozen=True, slots=True)
class ClosedLoadState:
    """State of a load over a restart, so that it can be restated and compared with a ticket.

    Attributes
    ----------
    number : int
    budget : MassBudget
        Of its mass, as last stated.
    shared : SharedError or None
        None where other parameters than those in use measured it.
    of_scale_kg : float
        Its mass measured since the scale of the crop's parameters was last set, kg.
    crop : str
        Of that scale; "" for the parameters in use.
    shown : tuple of (int, float, float)
        Number of a weighed load whose weight showed the scale to be off, the increase of the standard deviation by it, and the
        mass measured with that scale, kg.
    """

    number: int
    budget: MassBudget
    shared: SharedError | None
    of_scale_kg: float = 0.0
    crop: str = ""
    shown: tuple[tuple[int, float, float], ...] = ()

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ClosedLoadState:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError."""
        shared = None if data["shared"] is None else SharedError.from_dict(data["shared"])
        # Older states lack the mass measured with that scale.
        before = ((number, more_kg, 0.0) for number, more_kg in data.get("off_kg", ()))
        shown = tuple((int(number), float(more_kg), float(mass_kg)) for number, more_kg, mass_kg in data.get("shown", before))
        budget, of_scale_kg = MassBudget(**data["budget"]), float(data.get("of_scale_kg", 0.0))
        return cls(int(data["number"]), budget, shared, of_scale_kg, str(data.get("crop", "")), shown)


def _with(at_nodes: tuple[float, ...], more: float, plate_angle_rad: float) -> tuple[float, ...]:
    """The values at the nodes with `more` added at an angle, split between the two nodes around it."""
    first, share = node_shares(plate_angle_rad)
    row = list(at_nodes)
    row[first] += (1.0 - share) * more
    row[first + 1] += share * more
    return tuple(row)


_made = maker_of(SharedError)
