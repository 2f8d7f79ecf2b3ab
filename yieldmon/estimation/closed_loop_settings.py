"""Settings of `closed_loop`, apart from the solver so that a configuration can hold them."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal, get_args

from yieldmon.setting_keys import choice, quantity

FlowModel = Literal["constant", "linear", "process"]
FLOW_MODELS: tuple[FlowModel, ...] = get_args(FlowModel)


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
        Relative standard deviation of the model's own error, one draw for each plate angle of all sweeps.
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

    flow: FlowModel = choice("constant", "how the flow may change during a sweep")  # noqa: RUF009 - a field
    flow_slope_sd_per_s: float = quantity(0.005, 1e-6, 1.0, "1/s", "linear: relative standard deviation of the slope")
    flow_process_sd: float = quantity(0.05, 0.0, 1.0, "1", "process: relative standard deviation of the flow")
    flow_process_time_s: float = quantity(20.0, 1.0, 3600.0, "s", "process: correlation time of the flow")
    model_error: float = quantity(0.0, 0.0, 0.5, "1", "relative error of the model at each angle of a sweep")
    learned_information: float = quantity(
        0.05, 0.0, 100.0, "1", "a sweep with less information, relative to the prior, updates nothing"
    )
    kept_ratio: float = quantity(
        0.99, 0.5, 1.0, "1", "a parameter that keeps more than this share of its standard deviation is not updated"
    )
    consistent_p: float = quantity(1e-3, 0.0, 0.5, "1", "a sweep whose misfit has a lower p-value updates nothing")

    def __post_init__(self) -> None:
        if self.flow not in FLOW_MODELS:
            raise ValueError(f"flow model {self.flow!r}; expected {', '.join(FLOW_MODELS[:-1])} or {FLOW_MODELS[-1]}")
        for name in ("flow_slope_sd_per_s", "flow_process_time_s"):
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}; expected a number above 0")
        for name in ("flow_process_sd", "model_error", "learned_information", "kept_ratio", "consistent_p"):
            if not 0.0 <= getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}; expected a number, 0 or more")
