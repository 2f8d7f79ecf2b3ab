"""Settings of `closed_loop`, apart from the solver so that a configuration can hold them."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

FLOW_MODELS = ("constant", "linear", "process")


@dataclass(frozen=True, slots=True)
class ClosedLoopSettings:
    """Settings of `self_calibrate`.

    Parameters
    ----------
    flow : {"constant", "linear", "process"}
        How the flow may change during a sweep: not at all, with a slope, or as a random process around a constant.
    flow_slope_sd_per_s : float
        Prior standard deviation of the slope, share of the flow per second.
    flow_process_sd : float
        The likeliest standard deviation of the process before the sweep, share of the flow; its size is taken from windows at
        like angles.
    flow_process_time_s : float
        Correlation time of the process, s.
    model_error : float
        Relative standard deviation of the model's own error, one draw for each plate angle of a sweep.
    learned_information : float
        Least ratio of data to prior information along a direction of parameter space for an update along it: many smaller
        updates would add up to a certainty that the model's error does not allow.
    kept_ratio : float
        A parameter that keeps at least this share of its prior standard deviation is not updated.
    consistent_p : float
        p-value of the misfit below which a sweep updates nothing.

    Raises
    ------
    ValueError
        For another flow model, and for numbers out of their range.

    Examples
    --------
    >>> api.ClosedLoopSettings(flow="linear").flow_slope_sd_per_s
    0.005
    """

    flow: str = "constant"
    flow_slope_sd_per_s: float = 0.005
    flow_process_sd: float = 0.05
    flow_process_time_s: float = 20.0
    model_error: float = 0.0
    learned_information: float = 0.05
    kept_ratio: float = 0.99
    consistent_p: float = 1e-3

    def __post_init__(self) -> None:
        if self.flow not in FLOW_MODELS:
            raise ValueError(f"flow model {self.flow!r}; expected {', '.join(FLOW_MODELS[:-1])} or {FLOW_MODELS[-1]}")
        for name in ("flow_slope_sd_per_s", "flow_process_time_s"):
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}; expected a number above 0")
        for name in ("flow_process_sd", "model_error", "learned_information", "kept_ratio", "consistent_p"):
            if not 0.0 <= getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}; expected a number, 0 or more")
