"""What the seconds of a load share of the parameters' error and of the model's, so that it can be stated anew.

What sweeps show of the model's error holds for all that was measured with the same parameters, before a sweep as well as after
it. So each load keeps by how much an error of the force would change its mass, and its standard deviation follows what is known
now, while it is open and once it is closed.
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
    """Of one load, kg.

    Attributes
    ----------
    version : int
        Of the parameters that measure it now.
    before_kg : float
        Standard deviation by all parameters before those, which stays as it was stated.
    own_kg : float
        By the covariance of these.
    per_error_kg : tuple of float
        Change of its mass by a relative error of 1 of the force at each node of the plate's angle, (nodes,).
    taken_off_kg : float
        Of its mass, because sweeps had shown by then how far the force is off away from home.
    """

    version: int
    before_kg: float = 0.0
    own_kg: float = 0.0
    per_error_kg: tuple[float, ...] = (0.0,) * NODES_RAD.size
    taken_off_kg: float = 0.0

    def plus(self, flow: FlowBudget, seconds: float, plate_angle_rad: float) -> SharedError:
        """With `seconds` of a flow more, at a plate angle, rad."""
        return _made(
            self.version,
            self.before_kg,
            self.own_kg + flow.covariance_kg_s * seconds,
            _with(self.per_error_kg, flow.per_error_kg_s * seconds, plate_angle_rad),
            self.taken_off_kg + flow.taken_off * flow.per_error_kg_s * seconds,
        )

    @classmethod
    def at(cls, version: int, own_kg: float, per_error_kg: float, plate_angle_rad: float) -> SharedError:
        """All of it measured at one angle, rad, with parameters of a version; own_kg and per_error_kg as above."""
        return cls(version, 0.0, own_kg, _with((0.0,) * NODES_RAD.size, per_error_kg, plate_angle_rad))

    def parameters_kg(self, error: AngleError) -> float:
        """Standard deviation by the parameters, where the model's error is as sweeps show it now."""
        to_take_off_kg = sum(kg * away for kg, away in zip(self.per_error_kg, error.away, strict=False))
        # What was measured before a sweep showed it keeps its error, which is known now.
        left_kg = to_take_off_kg - self.taken_off_kg
        return self.before_kg + hypot(self.own_kg, error.of_sum(self.per_error_kg, left_kg))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> SharedError:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError."""
        return cls(**{**data, "per_error_kg": tuple(map(float, data["per_error_kg"]))})


@dataclass(frozen=True, slots=True)
class ClosedLoadState:
    """What of a load outlives a restart, so that it can be stated anew and a ticket held against it. budget: of its mass, as
    stated last. shared: None where other parameters than those in use have measured it. of_scale_kg: mass measured since the
    scale of the crop's parameters was set last; crop: "" for that of the parameters in use. shown: by the number of the load that
    was weighed, what of the deviation is there because that showed the scale to be off, and the mass of that scale, kg."""

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
        # An older state does not say how much of the load that scale has measured.
        before = ((number, more_kg, 0.0) for number, more_kg in data.get("off_kg", ()))
        shown = tuple((int(number), float(more_kg), float(mass_kg)) for number, more_kg, mass_kg in data.get("shown", before))
        budget, of_scale_kg = MassBudget(**data["budget"]), float(data.get("of_scale_kg", 0.0))
        return cls(int(data["number"]), budget, shared, of_scale_kg, str(data.get("crop", "")), shown)


def _with(at_nodes: tuple[float, ...], more: float, plate_angle_rad: float) -> tuple[float, ...]:
    """With more at an angle, shared between the nodes on both sides of it."""
    first, share = node_shares(plate_angle_rad)
    row = list(at_nodes)
    row[first] += (1.0 - share) * more
    row[first + 1] += share * more
    return tuple(row)


_made = maker_of(SharedError)
