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

from yieldmon.engine.budget import FlowBudget, MassBudget
from yieldmon.engine.quick import maker_of
from yieldmon.estimation.sweep_model_error import ModelError


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
    per_error_kg : float
        Change of its mass by a relative error of 1 of the force.
    per_error_away_kg : float
        Of that what was measured with the plate away from home.
    """

    version: int
    before_kg: float = 0.0
    own_kg: float = 0.0
    per_error_kg: float = 0.0
    per_error_away_kg: float = 0.0

    def plus(self, flow: FlowBudget, seconds: float, *, at_home: bool) -> SharedError:
        """With `seconds` of a flow more."""
        changed_kg = flow.per_error_kg_s * seconds
        return _made(
            self.version,
            self.before_kg,
            self.own_kg + flow.covariance_kg_s * seconds,
            self.per_error_kg + changed_kg,
            self.per_error_away_kg + (0.0 if at_home else changed_kg),
        )

    def parameters_kg(self, error: ModelError) -> float:
        """Standard deviation by the parameters, where the model's error is as sweeps show it now."""
        return self.before_kg + hypot(self.own_kg, error.home * self.per_error_kg, error.away * self.per_error_away_kg)


@dataclass(frozen=True, slots=True)
class ClosedLoadState:
    """What of a closed load outlives a restart, so that it can be stated anew. budget: of its mass, as stated last."""

    number: int
    budget: MassBudget
    shared: SharedError

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ClosedLoadState:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError."""
        return cls(int(data["number"]), MassBudget(**data["budget"]), SharedError(**data["shared"]))


_made = maker_of(SharedError)
