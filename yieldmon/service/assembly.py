"""Putting a monitor together from a configuration's parts: the same for the daemon, for logs and for simulated seasons."""

from __future__ import annotations

from types import NoneType

from yieldmon import utc
from yieldmon.arguments import require_type
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, Sources
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.crops import find_crop
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.service.config.configuration import Configuration


def monitor_of(
    configuration: Configuration,
    parameters: ParameterSet | None = None,
    *,
    drives_plate: bool = True,
    waveform_later: bool = False,
) -> Monitor:
    """The monitor of a configuration. parameters: to start from; None: those that it names. The others: see `Monitor`."""
    return build_monitor(
        configuration.engine,
        configuration.machine,
        configuration.parameters if parameters is None else parameters,
        configuration.calibrator,
        configuration.signals.sources,
        drives_plate=drives_plate,
        waveform_later=waveform_later,
    )


def build_monitor(
    settings: EngineSettings,
    machine: Machine,
    parameters: ParameterSet,
    calibrator: CalibratorSettings | None = None,
    sources: Sources = DEFAULT_SOURCES,
    *,
    drives_plate: bool = True,
    waveform_later: bool = False,
) -> Monitor:
    """A monitor that starts from these parameters.

    Parameters
    ----------
    settings : EngineSettings
        `engine` of what `load_configuration` gives.
    machine : Machine
    parameters : ParameterSet
    calibrator : CalibratorSettings, optional
        How sweeps and weighed loads update the parameters; None: they stay.
    sources : Sources
        Which message and signal brings what; the shipped DBC by default.
    drives_plate : bool
        False for a log, see `Monitor`.
    waveform_later : bool
        See `Monitor`.

    Returns
    -------
    Monitor

    Raises
    ------
    InputError
        For an argument of another type.

    Examples
    --------
    >>> loaded = api.load_configuration(api.shipped("config/yieldmon.yaml"))
    >>> monitor = api.build_monitor(loaded.engine, loaded.machine, loaded.parameters)
    >>> monitor.totals.total_kg
    0.0
    """
    require_type("settings", settings, EngineSettings, "`engine` of what `load_configuration` gives")
    require_type("machine", machine, Machine, "a Machine")
    require_type("parameters", parameters, ParameterSet, "a ParameterSet")
    require_type(
        "calibrator", calibrator, (CalibratorSettings, NoneType), "`calibrator` of what `load_configuration` gives, or None"
    )
    estimator = estimator_of(machine, parameters)
    updatable = calibrator is not None and parameters.curve is None
    self_calibrator = (
        ClosedLoopCalibrator(ForwardModel(machine, parameters.effects), calibrator) if updatable and calibrator else None
    )
    monitor = Monitor(
        settings, machine, estimator, self_calibrator, sources=sources, drives_plate=drives_plate, waveform_later=waveform_later
    )
    set_grain(monitor, parameters.provenance.get("crop", ""))
    return monitor


def set_grain(monitor: Monitor, crop: str, entered_kernel_weight_g: float | None = None) -> None:
    """Dry mass from now on at the market moisture of a crop, "" where none is known, and the weight of its kernels.

    entered_kernel_weight_g: of a thousand kernels, g, as an operator entered it; None: as the settings have it.
    """
    known, waveform = find_crop(crop), monitor.settings.waveform
    if known is not None:
        monitor.set_market_moisture(known.market_moisture_pct)
    configured_g = waveform.thousand_kernel_weights_g.get(crop, waveform.thousand_kernel_weight_g)
    monitor.set_kernel_weight(configured_g if entered_kernel_weight_g is None else entered_kernel_weight_g)


def calibration_age_s(parameters: ParameterSet, now_s: float) -> float | None:
    """Seconds from the date in the parameters' provenance (ISO 8601; UTC where it names no zone) to Unix time now_s.

    None where there is no such date or it lies in the future.
    """
    try:
        date = utc.read(parameters.provenance["date"])
    except (KeyError, ValueError):
        return None
    age_s = now_s - date.timestamp()
    return age_s if age_s >= 0.0 else None
