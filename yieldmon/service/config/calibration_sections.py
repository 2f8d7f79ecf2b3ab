"""Sections of the configuration file about how the machine calibrates itself: plate, sweeps, reference masses, learning, drift.

The defaults are the engine's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, create_model

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.settings import EngineSettings
from yieldmon.physics.grain import GRAIN
from yieldmon.service.config.section import Section, choice, quantity

_ENGINE = EngineSettings()
_P = _ENGINE.plate


class Plate(Section):
    """Limits of plate commands, inside the range of the machine file."""

    fixed_angle_deg: float | None = quantity(
        _P.fixed_angle_deg, 10.0, 170.0, "deg", "angle of a fixed plate: no feedback needed, no sweeps; null: the plate moves"
    )
    max_rate_deg_s: float = quantity(_P.max_rate_deg_s, 0.5, 90.0, "deg/s", "fastest change of the target")
    command_interval_s: float = quantity(_P.command_interval_s, 0.02, 1.0, "s", "interval of commands while the plate moves")
    at_target_tolerance_deg: float = quantity(
        _P.at_target_tolerance_deg, 0.05, 5.0, "deg", "largest difference from the target angle that counts as reached"
    )


_S = _ENGINE.sweep


class Sweep(Section):
    """Self-calibration sweeps of the plate."""

    enabled: bool = choice(_S.enabled, "allow sweeps; false: the plate never moves")
    when: Literal["interval", "information"] = choice(
        _S.when, "sweep after each interval, or only if it improves the flow more than harvesting on"
    )
    worth_ratio: float = quantity(
        _S.worth_ratio, 1.0, 10.0, "1", "information: least ratio of the flow's standard deviation without to that with a sweep"
    )
    interval_s: float = quantity(_S.interval_s, 60.0, 1e6, "s", "interval of sweeps")
    first_after_s: float = quantity(_S.first_after_s, 0.0, 1e6, "s", "harvesting time before the first sweep")
    angles_deg: list[float] = Field(
        default=list(_S.angles_deg), min_length=1, max_length=50, description="angles to visit, in the machine's range",
        json_schema_extra={"unit": "deg"},
    )  # fmt: skip
    home_every: int = quantity(_S.home_every, 1, 50, "angles", "the plate returns home after this many")
    windows_per_step: int = quantity(_S.windows_per_step, 1, 60, "s", "seconds measured at each angle")
    min_flow_kg_s: float = quantity(_S.min_flow_kg_s, 0.1, 25.0, "kg/s", "minimum flow for a sweep")
    steady_windows: int = quantity(_S.steady_windows, 2, 600, "s", "seconds of steady flow before a sweep")
    steady_cv: float = quantity(_S.steady_cv, 0.001, 1.0, "1", "largest standard deviation over mean in these seconds")
    flow_change: float = quantity(_S.flow_change, 0.01, 1.0, "1", "change of flow at home that ends a sweep")
    flow_change_away: float = quantity(_S.flow_change_away, 0.01, 10.0, "1", "the same at other angles")
    speed_change: float = quantity(_S.speed_change, 0.001, 1.0, "1", "change of elevator speed that ends a sweep")
    move_margin_s: float = quantity(_S.move_margin_s, 0.1, 60.0, "s", "time beyond travel / rate that sets PlateNotFollowing")
    settle_s: float = quantity(_S.settle_s, 0.0, 60.0, "s", "time on target before measuring")
    settle_timeout_s: float = quantity(_S.settle_timeout_s, 0.5, 120.0, "s", "longest wait for the plate to settle")
    measure_timeout_s: float = quantity(_S.measure_timeout_s, 1.0, 600.0, "s", "longest time at one angle")
    signal_trend: float = quantity(
        _S.signal_trend, 0.5, 100.0, "standard errors", "difference between a window's halves that means not settled"
    )
    return_timeout_s: float = quantity(_S.return_timeout_s, 0.5, 120.0, "s", "longest time for the return home")
    home_rest_s: float = quantity(_S.home_rest_s, 0.0, 600.0, "s", "rest away from home before the plate is driven home")
    home_retry_s: float = quantity(_S.home_retry_s, 1.0, 1e5, "s", "wait before the plate is driven home again after a failure")
    backoff_s: float = quantity(_S.backoff_s, 1.0, 1e5, "s", "wait after an aborted sweep; doubles up to the interval")
    feedback_plausibility_flow_spread: float = quantity(
        _S.feedback_plausibility_flow_spread,
        0.0,
        5.0,
        "1",
        "spread of ln(flow) over a sweep from which the angle feedback is checked",
    )
    feedback_plausibility_force_ratio: float = quantity(
        _S.feedback_plausibility_force_ratio,
        0.0,
        1.0,
        "1",
        "the plate did not move if the spread of force is below this share of it",
    )
    max_std_dev_factor: float = quantity(
        _S.max_std_dev_factor, 1.0, 10.0, "1", "factor on the flow's standard deviation away from home"
    )


_A = _ENGINE.reference_masses


class ReferenceMasses(Section):
    """Reference masses from a tank scale."""

    min_increment_kg: float = quantity(_A.min_increment_kg, 10.0, 1e5, "kg", "smallest gain of tank mass that is a reference")
    scale_std_dev_kg: float = quantity(_A.scale_std_dev_kg, 0.1, 1e4, "kg", "standard deviation of the scale")
    unloading_kg: float = quantity(_A.unloading_kg, 1.0, 1e4, "kg", "fall of the tank mass that means unloading")
    keep: int = quantity(_A.keep, 1, 10_000, "references", "number of newest references to keep")


_D = _ENGINE.disagreement


class Disagreement(Section):
    """The fault ModelDisagrees: residuals of several sweeps show that the model lacks an effect."""

    keep_sweeps: int = quantity(_D.keep_sweeps, 2, 200, "sweeps", "number of newest sweeps to test together")
    least_sweeps: int = quantity(_D.least_sweeps, 2, 200, "sweeps", "minimum number of sweeps for a verdict")
    tolerance: float = quantity(_D.tolerance, 0.0, 0.5, "1", "tolerated relative model error at a plate angle")
    begin_p: float = quantity(_D.begin_p, 0.0, 0.5, "1", "p-value below which the fault begins")
    end_p: float = quantity(_D.end_p, 0.0, 1.0, "1", "p-value above which the fault ends")


_L = CalibratorSettings()
_K = _L.closed_loop


class Learning(Section):
    """How sweeps and weighed loads update the parameters."""

    enabled: bool = choice(True, "let sweeps and weighed loads update the parameters")
    flow_model: Literal["constant", "linear", "process"] = choice(_K.flow, "how the flow may change during a sweep")
    flow_slope_sd_per_s: float = quantity(
        _K.flow_slope_sd_per_s, 1e-6, 1.0, "1/s", "linear: relative standard deviation of the slope"
    )
    flow_process_sd: float = quantity(_K.flow_process_sd, 0.0, 1.0, "1", "process: relative standard deviation of the flow")
    flow_process_time_s: float = quantity(_K.flow_process_time_s, 1.0, 3600.0, "s", "process: correlation time of the flow")
    model_error: float = quantity(_K.model_error, 0.0, 0.5, "1", "relative error of the model at each angle of a sweep")
    learned_information: float = quantity(
        _K.learned_information, 0.0, 100.0, "1", "a sweep with less information, relative to the prior, updates nothing"
    )
    kept_ratio: float = quantity(
        _K.kept_ratio, 0.5, 1.0, "1", "a parameter that keeps more than this share of its standard deviation is not updated"
    )
    consistent_p: float = quantity(_K.consistent_p, 0.0, 0.5, "1", "a sweep whose misfit has a lower p-value updates nothing")
    steady_drift_memory_kt: float = quantity(
        _L.steady_drift_memory_kt, 0.01, 1e6, "kt", "harvested mass after which a steady drift rate has decayed to 1/e"
    )
    pattern_sd: float = quantity(
        _L.pattern_sd,
        0.0,
        0.2,
        "1",
        "relative model error away from home that sweeps separate from the grain parameters; 0: none",
    )
    reference_error: float = quantity(
        _L.reference_error, 0.0, 0.5, "1", "relative error of a weighed load in addition to the scale's own"
    )
    density_ratio: float | None = quantity(
        _L.density_ratio, 0.1, 10.0, "1", "density in the paddles over test weight, if known; null: test weight is not used"
    )
    density_ratio_std_dev: float = quantity(_L.density_ratio_std_dev, 0.0, 10.0, "1", "standard deviation of that ratio")
    test_weight_std_dev_kg_m3: float = quantity(
        _L.test_weight_std_dev_kg_m3, 0.1, 500.0, "kg/m3", "standard deviation of the test weight"
    )


_R = _L.drift


def _by_parameter(name: str, meaning: str, defaults: Mapping[str, float], most: float) -> type[Section]:
    """A section with one key for each grain parameter that drifts."""
    shown = {"restitution": "impact gain (1 + restitution, k1, k2)"}
    keys: dict[str, Any] = {
        key: (float, quantity(value, 0.0, most, "1", shown.get(key, GRAIN[key].label))) for key, value in defaults.items()
    }
    return create_model(name, __base__=Section, __doc__=meaning, **keys)


if TYPE_CHECKING:

    class DriftPerRootHour(Section): ...

    class DriftPerRootKilotonne(Section): ...

    class SteadyDriftPerKilotonne(Section): ...

    class DriftLimit(Section): ...

else:
    DriftPerRootHour = _by_parameter(
        "DriftPerRootHour",
        "Growth of the parameters' uncertainty: relative standard deviation after an hour, harvesting or not.",
        _R.per_root_hour, 1.0,
    )  # fmt: skip
    DriftPerRootKilotonne = _by_parameter(
        "DriftPerRootKilotonne",
        "The same by harvested mass: after 1000 t of grain.",
        _R.per_root_kilotonne, 1.0,
    )  # fmt: skip
    SteadyDriftPerKilotonne = _by_parameter(
        "SteadyDriftPerKilotonne",
        "Steady drift: expected relative size of the estimated rate per 1000 t of grain; 0: none.",
        _L.steady_per_kilotonne, 2.0,
    )  # fmt: skip
    DriftLimit = _by_parameter(
        "DriftLimit",
        "Limit of that growth: relative standard deviation without any calibration.",
        _R.limit, 2.0,
    )  # fmt: skip
