"""Sections of the configuration file about how sweeps and weighed loads update the parameters, and how these drift between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from pydantic import create_model

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.physics.grain import GRAIN
from yieldmon.service.config.section import Section, choice, quantity

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
