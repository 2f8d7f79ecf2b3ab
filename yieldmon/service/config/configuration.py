"""From the configuration file, and the machine and parameter files that it names, to what the daemon runs with.

Wrong files give one line for each fault: file, key, value, what was expected.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from yieldmon.arguments import require_path
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.settings import EngineSettings
from yieldmon.errors import InputError
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.flow_curve import FlowCurve, with_curve
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.estimation.self_calibration.moisture import MoistureMap
from yieldmon.estimation.waveform.arrival_law import ArrivalLaw
from yieldmon.files import (
    calibrated_machine,
    flow_curve_file,
    machine_file,
    moisture_file,
    parameter_file,
    pulse_shape_file,
    strict_yaml,
)
from yieldmon.physics.machine import SAME_ANGLE_RAD, Machine
from yieldmon.resources import shipped
from yieldmon.service.answering import answer_or
from yieldmon.service.config.contradictions import contradictions
from yieldmon.service.config.document import Document
from yieldmon.service.config.document_text import problems_of
from yieldmon.service.config.engine_sections import engine_settings
from yieldmon.service.config.former_keys import with_present_keys
from yieldmon.service.config.named_file import load_named
from yieldmon.service.config.out_of_reach import out_of_reach
from yieldmon.service.config.output_section import output_map
from yieldmon.service.config.own_files import file_conflicts, no_files
from yieldmon.service.config.signal_section import mistakes, signal_map
from yieldmon.service.folders import runtime_folder, state_folder, where_sqlite_writes
from yieldmon.service.storage.retention import Retention
from yieldmon.signals.mapping import SignalMap
from yieldmon.signals.output_mapping import OutputMap


class ConfigurationError(InputError):
    """A configuration that cannot be used.

    Parameters
    ----------
    problems : list of InputError
        All faults, one or more; the text of the error is that of the first.

    Examples
    --------
    >>> faults = [api.InputError("machine", "is missing", "a file"), api.InputError("crop", "is 3", "a name")]
    >>> error = api.ConfigurationError(faults)
    >>> print(error, len(error.problems))
    machine: is missing; expected a file 2
    """

    def __init__(self, problems: list[InputError]) -> None:
        first = problems[0]
        super().__init__(first.where, first.problem, first.expected)
        self.problems = problems

    def __reduce__(self) -> tuple[type[ConfigurationError], tuple[list[InputError]]]:  # type: ignore[override]
        return type(self), (self.problems,)


@dataclass(frozen=True)
class Configuration:
    """All that the daemon runs with.

    Paths are absolute. calibrator: None where parameters are never updated. notes: a sentence on each key that the file has under
    a former name, and on a curve that gives the flow.
    """

    path: Path
    document: Document
    engine: EngineSettings
    signals: SignalMap
    outputs: OutputMap
    database_paths: tuple[Path, ...]
    calibrator: CalibratorSettings | None
    machine: Machine
    machine_path: Path
    parameters: ParameterSet
    parameter_path: Path
    store_path: Path
    retention: Retention
    socket_path: Path
    prometheus_path: Path | None
    notes: tuple[str, ...] = ()

    @property
    def log_channels(self) -> tuple[str, ...]:
        """Channels of which the frames of recordings are taken; empty: all."""
        return tuple(self.document.bus.log_channels)


def load(path: Path | str, environment: Mapping[str, str] = os.environ) -> Configuration:
    """Configuration from a YAML file; keys that it leaves out have their defaults.

    Parameters
    ----------
    path : path
    environment : mapping of str to str
        Gives the service manager's folders.

    Returns
    -------
    Configuration
        `document` (the file's keys), `engine`, `machine`, `parameters`, `calibrator`, `signals` and the paths that it names.

    Raises
    ------
    ConfigurationError
        For each key that is wrong, and for a file without a single character: a power cut or a full disk leaves such files, and
        the defaults may be another machine's.
    InputError
        From the machine, parameter or moisture map file.

    Examples
    --------
    >>> api.load_configuration(api.shipped("config/yieldmon.yaml")).document.store.path
    'yieldmon.sqlite'
    """
    require_path(path)
    path = Path(path).absolute()
    text = strict_yaml.read(path)
    if not text.strip():
        raise ConfigurationError([InputError(str(path), "is empty", "keys and values, or {} for all defaults")])
    content = strict_yaml.parse(text, str(path))
    return build({} if content is None else content, path, environment)


def build(content: Any, path: Path, environment: Mapping[str, str] = os.environ) -> Configuration:
    """Configuration from the content of the file at `path`, as load() does. Raises ConfigurationError."""
    document, renamed = _validated(content, path)
    named = _named_files(document, path)
    machine, curve = named.machine, named.curve
    engine = engine_settings(document)
    fixed_angle_deg = engine.plate.fixed_angle_deg
    mapping, databases = _mapped_signals(document, path, machine, fixed_angle_deg)
    outputs, output_databases = output_map(
        document.outputs.signals, path, machine, mapping,
        with_shipped=document.outputs.shipped,
        network=document.network.enabled,
        fixed_plate=fixed_angle_deg is not None,
    )  # fmt: skip
    written = _written_files(document, path, environment)
    read = (path, *named.paths, *databases, *output_databases)
    conflicts = file_conflicts(written.store, written.socket, written.prometheus, read)
    problems = [InputError(f"{path}: {key}", *rest) for key, *rest in (*contradictions(document, engine, machine), *conflicts)]
    problems += out_of_reach(mapping, engine, machine)
    if problems:
        raise ConfigurationError(problems)
    machine = _with_fixed_plate(machine, fixed_angle_deg)
    parameters = parameter_file.on_a_machine(load_named(path, "parameter_file", _in_newtons, named.parameter_path), machine)
    if curve is not None:
        parameters = with_curve(parameters, curve)
        check_curve_angle(curve, machine, str(named.curve_path))
    # A curve has no parameters of the model to update.
    updates = document.self_calibration.enabled and curve is None
    return Configuration(
        path=path,
        document=document,
        engine=_with_shape(_fitted(engine, document, mapping), named.shape),
        signals=mapping,
        outputs=outputs,
        database_paths=tuple(dict.fromkeys((*databases, *output_databases))),
        calibrator=calibrator_settings(document, named.moisture_map) if updates else None,
        machine=machine,
        machine_path=named.machine_path,
        parameters=parameters,
        parameter_path=named.parameter_path,
        store_path=written.store,
        retention=Retention(document.store.record_hours, document.store.size_mb, document.store.event_rows),
        socket_path=written.socket,
        prometheus_path=written.prometheus,
        notes=(*renamed, *_on_parameters(parameters, machine, named.parameter_path, curve, named.curve_path)),
    )


def _validated(content: Any, path: Path) -> tuple[Document, tuple[str, ...]]:
    """The file's keys, and a note on each that it has under a former name. Raises ConfigurationError."""
    try:
        content, renamed = with_present_keys(content, str(path))
    except InputError as error:
        raise ConfigurationError([error]) from error
    try:
        return Document.model_validate(content), renamed
    except ValidationError as error:
        raise ConfigurationError(problems_of(error, str(path))) from error


def _mapped_signals(
    document: Document, path: Path, machine: Machine, fixed_angle_deg: float | None
) -> tuple[SignalMap, tuple[Path, ...]]:
    """The mapping of the engine's inputs, and the DBC files that it names. Raises ConfigurationError with all mistakes."""
    asked = (document.signals, path, machine, fixed_angle_deg)
    try:
        mapping, databases = signal_map(*asked)
    except InputError as error:
        raise ConfigurationError(mistakes(*asked) or [error]) from error
    return mapping, tuple(databases)


@dataclass(frozen=True)
class _WrittenFiles:
    """Paths that the service makes."""

    store: Path
    socket: Path
    prometheus: Path | None


def _written_files(document: Document, path: Path, environment: Mapping[str, str]) -> _WrittenFiles:
    """Raises ConfigurationError for names that no file has."""
    store, status = document.store, document.status
    names = {"store.path": store.path, "status.socket": status.socket, "status.prometheus_file": status.prometheus_file}
    if nameless := no_files(names):
        raise ConfigurationError([InputError(f"{path}: {key}", *rest) for key, *rest in nameless])
    named_store = state_folder(environment) / document.store.path
    runtime, prometheus = runtime_folder(environment), document.status.prometheus_file
    return _WrittenFiles(
        store=answer_or(lambda: where_sqlite_writes(named_store), lambda: named_store),
        socket=runtime / document.status.socket,
        prometheus=runtime / prometheus if prometheus is not None else None,
    )


@dataclass(frozen=True)
class _NamedFiles:
    """Files that a configuration names, but for the parameters and databases. paths: of those and the parameters."""

    machine: Machine
    machine_path: Path
    parameter_path: Path
    curve: FlowCurve | None
    curve_path: Path | None
    moisture_map: MoistureMap | None
    shape: ArrivalLaw
    paths: tuple[Path, ...]


def _named_files(document: Document, path: Path) -> _NamedFiles:
    """Raises InputError for the first that cannot be used."""
    machine_path = _beside(path, document.machine_file, machine_file.DEFAULT)
    parameter_path = _beside(path, document.parameter_file, parameter_file.DEFAULT)
    curve_path, moisture_path = (
        None if name is None else path.parent / name for name in (document.estimator_file, document.moisture_map_file)
    )
    shape_path = _beside(path, document.pulse_shape_file, pulse_shape_file.SHIPPED)
    paths = (machine_path, parameter_path, shape_path, curve_path, moisture_path)
    return _NamedFiles(
        machine=load_named(path, "machine_file", machine_file.load, machine_path),
        machine_path=machine_path,
        parameter_path=parameter_path,
        curve=None if curve_path is None else load_named(path, "estimator_file", flow_curve_file.load, curve_path),
        curve_path=curve_path,
        moisture_map=None if moisture_path is None else load_named(path, "moisture_map_file", moisture_file.load, moisture_path),
        shape=load_named(path, "pulse_shape_file", pulse_shape_file.load, shape_path),
        paths=tuple(read for read in paths if read is not None),
    )


def with_estimator(configuration: Configuration, path: Path | str) -> Configuration:
    """The configuration with the flow from the curve in the file at `path`. Raises InputError."""
    curve = flow_curve_file.load(path)
    check_curve_angle(curve, configuration.machine, str(path))
    return dataclasses.replace(
        configuration,
        engine=_without_sweeps(configuration.engine),
        calibrator=None,
        parameters=with_curve(configuration.parameters, curve),
    )


def with_log_channels(configuration: Configuration, channels: Sequence[str]) -> Configuration:
    """The configuration that takes these channels of recordings, as if its file named them."""
    bus = configuration.document.bus.model_copy(update={"log_channels": list(channels)})
    return dataclasses.replace(configuration, document=configuration.document.model_copy(update={"bus": bus}))


def check_curve_angle(curve: FlowCurve, machine: Machine, where: str) -> None:
    """Raises InputError for a curve that was not calibrated at the plate's home angle."""
    angles = curve.law.angles_rad
    if angles[0] - SAME_ANGLE_RAD <= machine.home_plate_angle_rad <= angles[-1] + SAME_ANGLE_RAD:
        return
    known = " to ".join(f"{math.degrees(angle):g}" for angle in dict.fromkeys((angles[0], angles[-1])))
    home = f"{math.degrees(machine.home_plate_angle_rad):g} deg, the home angle of {machine.name}"
    raise InputError(f"{where}: plate_angle_deg", f"calibrated at {known} deg", home)


def _on_parameters(
    parameters: ParameterSet, machine: Machine, path: Path, curve: FlowCurve | None, curve_path: Path | None
) -> tuple[str, ...]:
    if curve is not None:
        return (_on_curve(curve, Path(str(curve_path))),)
    if not (difference := calibrated_machine.difference(parameters, machine)):
        return ()
    return (
        f"{path.name} was made for another machine ({difference}): its angle offset and scale hold there; use this machine's own "
        "parameter_file, or calibrate (`yieldmon calibrate --loads`)",
    )


def _on_curve(curve: FlowCurve, path: Path) -> str:
    return (
        f"the flow comes from {path.name} ({curve.law.kind}, standard deviation {100.0 * curve.relative_std_dev:.2g} %): "
        "no sweep runs and weighed loads change nothing"
    )


def _in_newtons(path: Path) -> ParameterSet:
    """The parameters of a file. Raises InputError where they were fitted to a reading in a unit of its own."""
    parameters = parameter_file.load(path)
    if parameters.response_unit != "N":
        raise InputError(
            f"{path}: response_unit",
            f"is {parameters.response_unit!r}",
            "'N' (calibrated on forces or momenta); these give no flow from a force",
        )
    return parameters


def _fitted(settings: EngineSettings, document: Document, mapping: SignalMap) -> EngineSettings:
    """The settings with what a bolted plate, a curve and a slow sensor ask for: no sweep, and ten frames of patience."""
    if settings.plate.fixed_angle_deg is not None or document.estimator_file is not None:
        settings = _without_sweeps(settings)
    if "sensor_timeout_s" not in document.inputs.model_fields_set:
        slowest_s = max(source.interval_s * len(source.signals) for source in mapping.sources.impact)
        timeout_s = max(settings.inputs.sensor_timeout_s, 10.0 * slowest_s)
        settings = dataclasses.replace(settings, inputs=dataclasses.replace(settings.inputs, sensor_timeout_s=timeout_s))
    return settings


def _with_shape(settings: EngineSettings, shape: ArrivalLaw) -> EngineSettings:
    return dataclasses.replace(settings, waveform=dataclasses.replace(settings.waveform, shape=shape))


def _without_sweeps(settings: EngineSettings) -> EngineSettings:
    return dataclasses.replace(settings, sweep=dataclasses.replace(settings.sweep, enabled=False))


def _with_fixed_plate(machine: Machine, angle_deg: float | None) -> Machine:
    """The machine with its plate bolted on: that angle is home, and the only one."""
    if angle_deg is None:
        return machine
    angle_rad = math.radians(angle_deg)
    return dataclasses.replace(
        machine,
        home_plate_angle_rad=angle_rad,
        min_plate_angle_rad=min(angle_rad, machine.min_plate_angle_rad),
        max_plate_angle_rad=max(angle_rad, machine.max_plate_angle_rad),
    )


def calibrator_settings(document: Document, moisture_map: MoistureMap | None = None) -> CalibratorSettings:
    """The self-calibration's settings that a document asks for."""
    values = document.self_calibration.model_dump(exclude={"enabled"})
    values["flow"] = values.pop("flow_model")
    inner = {field.name: values.pop(field.name) for field in dataclasses.fields(ClosedLoopSettings)}
    drift = DriftRates(
        per_root_hour=document.drift_per_root_hour.model_dump(),
        per_root_kilotonne=document.drift_per_root_kilotonne.model_dump(),
        limit=document.drift_limit.model_dump(),
    )
    steady = document.steady_drift_per_kilotonne.model_dump()
    return CalibratorSettings(
        closed_loop=ClosedLoopSettings(**inner), drift=drift, steady_per_kilotonne=steady, moisture_map=moisture_map, **values
    )


def _beside(path: Path, name: str | None, default: str) -> Path:
    return path.parent / name if name is not None else shipped(default)
