"""The shape of the configuration file: which sections it has and which keys stand outside them."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from yieldmon.service.config.calibration_sections import (
    DriftLimit,
    DriftPerRootHour,
    DriftPerRootKilotonne,
    SelfCalibration,
    SteadyDriftPerKilotonne,
)
from yieldmon.service.config.engine_sections import EngineSections
from yieldmon.service.config.section import Section, choice, text
from yieldmon.service.config.service_sections import Bus, Diagnostics, Logging, Network, Outputs, Status, Store


class ServiceKeys(Section):
    """Keys outside sections, and the sections of the service."""

    machine_file: str | None = text(None, "machine geometry; null: the shipped 8-tooth sprocket")
    parameter_file: str | None = text(None, "grain parameters; null: the shipped corn")
    estimator_file: str | None = text(
        None,
        "curve to compute the flow with (`calibrate --estimator`); null: the model",
    )
    moisture_map_file: str | None = text(
        None, "how parameters change with moisture (`calibrate --by-moisture`); null: they do not"
    )
    pulse_shape_file: str | None = text(None, "pulse shape and its calibrated range; null: the shipped file")
    units: Literal["metric", "us"] = choice("metric", "units on screen; JSON, tables and frames stay in SI")
    bus: Bus = Bus()
    signals: dict[str, Any] = Field(
        default_factory=dict,
        description="input signal of each quantity (docs/guide/wiring.md); others: from the shipped DBC",
    )
    outputs: Outputs = Outputs()
    store: Store = Store()
    status: Status = Status()
    diagnostics: Diagnostics = Diagnostics()
    network: Network = Network()
    logging: Logging = Logging()


class Document(EngineSections, ServiceKeys):
    """The whole file, in the order of its bases and these keys. Every key may be left out; its default is shown here."""

    self_calibration: SelfCalibration = SelfCalibration()
    drift_per_root_hour: DriftPerRootHour = DriftPerRootHour()
    drift_per_root_kilotonne: DriftPerRootKilotonne = DriftPerRootKilotonne()
    steady_drift_per_kilotonne: SteadyDriftPerKilotonne = SteadyDriftPerKilotonne()
    drift_limit: DriftLimit = DriftLimit()
