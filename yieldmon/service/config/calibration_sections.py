"""Sections of the configuration file about how sweeps and weighed loads update the parameters, and how these drift between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import create_model

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.physics.grain import GRAIN
from yieldmon.service.config.section import Section, choice, keys_of, quantity

_SETTINGS = CalibratorSettings()


def _self_calibration() -> type[Section]:
    """The keys of `CalibratorSettings` and, before them, of how it reads sweeps."""
    of_sweeps = keys_of(_SETTINGS.closed_loop)
    # Beside the others its name alone would not say what of the flow it is.
    sweeps = {"flow_model": of_sweeps.pop("flow"), **of_sweeps}
    enabled = choice(True, "let sweeps and weighed loads update the parameters")
    keys: dict[str, Any] = {"enabled": (bool, enabled), **sweeps, **keys_of(_SETTINGS)}
    return create_model("SelfCalibration", __base__=Section, __doc__=CalibratorSettings.__doc__, **keys)


def _by_parameter(name: str, meaning: str, defaults: Mapping[str, float], most: float) -> type[Section]:
    """A section with one key for each grain parameter that drifts."""
    shown = {"restitution": "impact gain (1 + restitution, k1, k2)"}
    keys: dict[str, Any] = {
        key: (float, quantity(value, 0.0, most, "1", shown.get(key, GRAIN[key].label))) for key, value in defaults.items()
    }
    return create_model(name, __base__=Section, __doc__=meaning, **keys)


if TYPE_CHECKING:

    class SelfCalibration(Section):
        enabled: bool = True

    class DriftPerRootHour(Section): ...

    class DriftPerRootKilotonne(Section): ...

    class SteadyDriftPerKilotonne(Section): ...

    class DriftLimit(Section): ...

else:
    SelfCalibration = _self_calibration()
    DriftPerRootHour = _by_parameter(
        "DriftPerRootHour",
        "Growth of the parameters' uncertainty: relative standard deviation after an hour, harvesting or not.",
        _SETTINGS.drift.per_root_hour, 1.0,
    )  # fmt: skip
    DriftPerRootKilotonne = _by_parameter(
        "DriftPerRootKilotonne",
        "The same by harvested mass: after 1000 t of grain.",
        _SETTINGS.drift.per_root_kilotonne, 1.0,
    )  # fmt: skip
    SteadyDriftPerKilotonne = _by_parameter(
        "SteadyDriftPerKilotonne",
        "Steady drift: expected relative size of the estimated rate per 1000 t of grain; 0: none.",
        _SETTINGS.steady_per_kilotonne, 2.0,
    )  # fmt: skip
    DriftLimit = _by_parameter(
        "DriftLimit",
        "Limit of that growth: relative standard deviation without any calibration.",
        _SETTINGS.drift.limit, 2.0,
    )  # fmt: skip
