"""The public Python interface. What is named here is versioned with the package; everything else is private.

Examples
--------
>>> from yieldmon import api
>>> model = api.ForwardModel(api.Machine())
>>> grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
>>> conditions = api.Conditions(plate_angle_rad=1.22, elevator_speed_rad_s=41.9, mass_flow_kg_s=10.0)
>>> round(float(model.force(conditions, grain)), 1)
90.0
"""

from __future__ import annotations

import warnings

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.log_files.logs import read_log
from yieldmon.discrepancy.diagnosis import Diagnosis, Options, diagnose
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import WindowResult
from yieldmon.errors import InputError
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.fitting.calibration import calibrate, default_start
from yieldmon.estimation.fitting.calibration_result import Calibration
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.open_loop import FlowEstimate, FlowStatus, OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import self_calibrate
from yieldmon.estimation.self_calibration.closed_loop_inputs import MeasuredDensity, Sweep, WeighedMass
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome
from yieldmon.files.machine_file import load as load_machine
from yieldmon.files.parameter_file import load as load_parameters
from yieldmon.files.parameter_file import save as save_parameters
from yieldmon.files.table import Table
from yieldmon.files.table import load as load_table
from yieldmon.frames import Frame
from yieldmon.physics.effects import Effect, EffectParameter
from yieldmon.physics.effects import registry as effects
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import Scenario
from yieldmon.plant.scenario import load as load_scenario
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config.configuration import ConfigurationError
from yieldmon.service.config.configuration import load as load_configuration
from yieldmon.service.logs.processing import Summary, process_logs
from yieldmon.service.logs.recorded import read_loads, read_seconds
from yieldmon.service.storage.ledger import LoadRecord
from yieldmon.service.storage.rows import SecondRow

__all__ = [
    "API_VERSION",
    "RPM",
    "Calibration",
    "ClosedLoopSettings",
    "Codec",
    "Conditions",
    "ConfigurationError",
    "Diagnosis",
    "Effect",
    "EffectParameter",
    "FlowEstimate",
    "FlowStatus",
    "ForwardModel",
    "Frame",
    "FrameError",
    "InputError",
    "LoadRecord",
    "Machine",
    "MeasuredDensity",
    "Measurements",
    "Monitor",
    "OpenLoop",
    "Options",
    "Outcome",
    "ParameterSet",
    "Scenario",
    "SecondRow",
    "Summary",
    "Sweep",
    "Table",
    "VirtualCombine",
    "WeighedMass",
    "WindowResult",
    "build_monitor",
    "calibrate",
    "default_start",
    "diagnose",
    "effects",
    "load_configuration",
    "load_machine",
    "load_parameters",
    "load_scenario",
    "load_table",
    "process_logs",
    "read_loads",
    "read_log",
    "read_seconds",
    "save_parameters",
    "self_calibrate",
    "shipped",
]

API_VERSION = 1
"""Increases when a name is removed or its meaning changes."""

_FORMER_NAMES = {"DensityAnchor": MeasuredDensity, "MassAnchor": WeighedMass}


def __getattr__(name: str) -> type:
    if name not in _FORMER_NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    present = _FORMER_NAMES[name]
    warnings.warn(f"{__name__}.{name} is now called {present.__name__}", DeprecationWarning, stacklevel=2)
    return present
