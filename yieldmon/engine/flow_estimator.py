"""The interface of an estimator of mass flow from force, as the engine uses it."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.numerics import Array


class FlowEstimator(Protocol):
    """Force to mass flow with the parameters in use; `estimation.open_loop.OpenLoop` is one."""

    @property
    def parameters(self) -> ParameterSet:
        """The parameters in use."""

    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = ...,
        moisture_pct: ArrayLike | None = ...,
    ) -> FlowEstimate:
        """Mass flow, standard deviation and status; inputs that are nan give a status, never an exception."""

    def force_curve(self, plate_angle_rad: float, elevator_speed_rad_s: float, moisture_pct: float = ...) -> tuple[Array, Array]:
        """Force, N, and mass flow, kg/s, (g,) each, by rising flow, over the range of the estimator."""
