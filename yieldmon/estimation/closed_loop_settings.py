"""How a sweep is read: the settings of `closed_loop`, which a configuration holds without the solver."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClosedLoopSettings:
    """How a sweep is read.

    flow: "constant", "linear" (a slope with prior flow_slope_sd_per_s) or "process" (a random process around a constant with
    correlation time flow_process_time_s; its size is taken from windows at like angles, flow_process_sd is the likeliest before).
    model_error: relative standard deviation of the model's own error, one draw for each plate angle of a sweep.
    """

    flow: str = "constant"
    flow_slope_sd_per_s: float = 0.005
    flow_process_sd: float = 0.05
    flow_process_time_s: float = 20.0
    model_error: float = 0.0
    learned_information: float = 0.05
    """Data over prior information along a direction of parameter space; below it nothing is taken from the data. Small scraps of
    information in every sweep would add up to certainty that is the model's error and not the grain's."""
    kept_ratio: float = 0.99
    """A parameter whose width shrinks to no less than this share of the prior's keeps its value and variance."""
    consistent_p: float = 1e-3
    """Probability of so large a misfit below which a sweep updates nothing."""

    def __post_init__(self) -> None:
        if self.flow not in ("constant", "linear", "process"):
            raise ValueError(f"flow model {self.flow!r}; expected constant, linear or process")
