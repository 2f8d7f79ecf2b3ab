"""What self-calibration keeps over a restart beside the parameters."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.engine.self_calibration.earlier_parameters import Places


@dataclass(frozen=True, slots=True)
class PriorState:
    """What was known of the parameters before those of this version: values by name; covariance: (n, n) of covariance_names;
    carried_from: as `ParameterSet` has it."""

    version: int
    values: tuple[tuple[str, float], ...]
    covariance_names: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]
    carried_from: str = ""


@dataclass(frozen=True, slots=True)
class GrainState:
    """What weighed loads have said of a crop that is not harvested now, for its return.

    crop: its name. weighed, doubted: as in `CalibratorState`. origin: its parameters as they came from outside; left: those that
    weighed loads made of them; None for both where they have made none.
    """

    crop: str
    weighed: tuple[str, ...]
    doubted: str = ""
    origin: PriorState | None = None
    left: PriorState | None = None


@dataclass(frozen=True, slots=True)
class CalibratorState:
    """What self-calibration knows beside the parameters.

    waited_s, harvested_kg: since the last update. moisture_pct: of the grain for which the parameters hold. drifting: the r
    parameters that have a steady rate; rates: (r,), per kilotonne; covariance: (r, n + r) of the rates with the n parameters that
    have a variance, and with each other. at_s: bus time of the last update, None where it is not known. weighed: names of the
    loads that a new one is held against; doubted: of the one that contradicts them, "" for none. bias: of kernel noise (value,
    variance, largest variance, then its covariance with parameters and rates), empty where it has updated nothing. origin: the
    parameters before weighed loads gave a curve of their own, None where they have not. grains: the crops before. spread: what
    rates of unknown size may have added (`estimation.self_calibration.drift_spread`), (n + r + 1, n + r + 1), empty where no
    update has said it. past: since when parameters that were in use before hold.
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
