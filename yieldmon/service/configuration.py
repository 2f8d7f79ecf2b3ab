"""From the configuration file, and the machine and parameter files that it names, to what the daemon runs with.

Wrong files give one line for each fault: file, key, value, what was expected.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.settings import EngineSettings
from yieldmon.errors import InputError
from yieldmon.estimation.arrival_law import ArrivalLaw
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.drift_rates import DriftRates
from yieldmon.estimation.flow_curve import FlowCurve, with_curve
from yieldmon.estimation.moisture import MoistureMap
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import flow_curve_file, machine_file, moisture_file, parameter_file, pulse_shape_file, strict_yaml
from yieldmon.physics.machine import SAME_ANGLE_RAD, Machine
from yieldmon.resources import shipped
from yieldmon.service.control import LONGEST_SOCKET_BYTES
from yieldmon.service.document import ENGINE_SECTIONS, Document
from yieldmon.service.folders import runtime_folder, state_folder, where_sqlite_writes
from yieldmon.service.former_keys import with_present_keys
from yieldmon.service.output_section import output_map
from yieldmon.service.retention import Retention
from yieldmon.service.section import Section
from yieldmon.service.signal_section import signal_map
from yieldmon.signals.mapping import SignalMap
from yieldmon.signals.output_mapping import OutputMap

DEFAULT_MACHINE = "config/machines/sprocket-8.yaml"
DEFAULT_PARAMETERS = "config/parameters/corn.yaml"


class ConfigurationError(InputError):
    """A configuration that cannot be used. `problems` has a line for each fault; the text is the first of them."""

    def __init__(self, problems: list[InputError]) -> None:
        first = problems[0]
        super().__init__(first.where, first.problem, first.expected)
        self.problems = problems


@dataclass(frozen=True)
class Configuration:
    """All that the daemon runs with. Paths are absolute. calibrator is None where nothing may be learnt. notes: a sentence
    for each key that the file has under a former name, and on a curve that gives the flow."""

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
    path = Path(path).absolute()
    text = strict_yaml.read(path)
    if not text.strip():
        raise ConfigurationError([InputError(str(path), "is empty", "keys and values, or {} for all defaults")])
    content = strict_yaml.parse(text, str(path))
    return build({} if content is None else content, path, environment)


def build(content: Any, path: Path, environment: Mapping[str, str] = os.environ) -> Configuration:
    """Configuration from the content of the file at `path`, as load() does."""
    try:
        content, renamed = with_present_keys(content, str(path))
    except InputError as error:
        raise ConfigurationError([error]) from error
    try:
        document = Document.model_validate(content)
    except ValidationError as error:
        raise ConfigurationError(_problems(error, str(path))) from error
    machine_path = _beside(path, document.machine_file, DEFAULT_MACHINE)
    parameter_path = _beside(path, document.parameter_file, DEFAULT_PARAMETERS)
    machine = machine_file.load(machine_path)
    curve_path = path.parent / document.estimator_file if document.estimator_file is not None else None
    curve = flow_curve_file.load(curve_path) if curve_path is not None else None
    named = document.moisture_map_file
    moisture_map = moisture_file.load(path.parent / named) if named is not None else None
    shape = pulse_shape_file.load(_beside(path, document.pulse_shape_file, pulse_shape_file.SHIPPED))
    mapping, databases = signal_map(document.signals, path, machine, document.plate.fixed_angle_deg)
    outputs, written = output_map(
        document.outputs.signals, path, machine, mapping,
        with_shipped=document.outputs.shipped,
        network=document.network.enabled,
        fixed_plate=document.plate.fixed_angle_deg is not None,
    )  # fmt: skip
    problems = [InputError(f"{path}: {key}", *rest) for key, *rest in _contradictions(document, machine)]
    if problems:
        raise ConfigurationError(problems)
    machine = _with_fixed_plate(machine, document.plate.fixed_angle_deg)
    parameters = _in_newtons(parameter_path)
    if curve is not None:
        parameters = with_curve(parameters, curve)
        check_curve_angle(curve, machine, str(curve_path))
    prometheus = document.status.prometheus_file
    return Configuration(
        path=path,
        document=document,
        engine=_with_shape(_fitted(engine_settings(document), document, mapping), shape),
        signals=mapping,
        outputs=outputs,
        database_paths=tuple(dict.fromkeys((*databases, *written))),
        calibrator=calibrator_settings(document, moisture_map) if document.learning.enabled and curve is None else None,
        machine=machine,
        machine_path=machine_path,
        parameters=parameters,
        parameter_path=parameter_path,
        store_path=where_sqlite_writes(state_folder(environment) / document.store.path),
        retention=Retention(document.store.record_hours, document.store.size_mb, document.store.event_rows),
        socket_path=runtime_folder(environment) / document.status.socket,
        prometheus_path=runtime_folder(environment) / prometheus if prometheus is not None else None,
        notes=(*renamed, *([] if curve is None else [_on_curve(curve, Path(str(curve_path)))])),
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


def check_curve_angle(curve: FlowCurve, machine: Machine, where: str) -> None:
    """Raises InputError for a curve that was not calibrated at the plate's home angle."""
    angles = curve.law.angles_rad
    if angles[0] - SAME_ANGLE_RAD <= machine.home_plate_angle_rad <= angles[-1] + SAME_ANGLE_RAD:
        return
    known = " to ".join(f"{math.degrees(angle):g}" for angle in dict.fromkeys((angles[0], angles[-1])))
    home = f"{math.degrees(machine.home_plate_angle_rad):g} deg, the home angle of {machine.name}"
    raise InputError(f"{where}: plate_angle_deg", f"calibrated at {known} deg", home)


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


def engine_settings(document: Document) -> EngineSettings:
    """The engine's settings that a document asks for."""
    defaults = EngineSettings()
    sections = {}
    for name in ENGINE_SECTIONS:
        values = {
            key: tuple(value) if isinstance(value, list) else value for key, value in getattr(document, name).model_dump().items()
        }
        sections[name] = dataclasses.replace(getattr(defaults, name), **values)
    return dataclasses.replace(defaults, **sections)


def _fitted(settings: EngineSettings, document: Document, mapping: SignalMap) -> EngineSettings:
    """The settings with what a bolted plate, a curve and a slow sensor ask for: no sweep, and ten frames of patience."""
    if document.plate.fixed_angle_deg is not None or document.estimator_file is not None:
        settings = _without_sweeps(settings)
    if "sensor_timeout_s" not in document.inputs.model_fields_set:
        slowest_s = max(source.interval_s * len(source.signals) for source in mapping.sources.impact)
        patience_s = max(settings.inputs.sensor_timeout_s, 10.0 * slowest_s)
        settings = dataclasses.replace(settings, inputs=dataclasses.replace(settings.inputs, sensor_timeout_s=patience_s))
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
    values = document.learning.model_dump(exclude={"enabled"})
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


def document_text() -> str:
    """The default configuration as YAML, with the meaning, range and unit of every key."""
    lines = [
        "# Configuration of yieldmon, with its defaults. Keys may be left out, files are relative to this one. Check a changed",
        "# file with `yieldmon check-config FILE`; a running service takes it with `systemctl reload yieldmon`.",
        "",
    ]
    for name, field in Document.model_fields.items():
        value = getattr(Document(), name)
        if isinstance(value, Section):
            lines += ["", f"# {_first_line(type(value))}", f"{name}:"]
            for key, inner in type(value).model_fields.items():
                lines += [f"  # {_meaning(inner)}", f"  {key}: {_yaml(getattr(value, key))}"]
        else:
            lines += [f"# {_meaning(field)}", f"{name}: {_yaml(value)}"]
    return "\n".join(lines) + "\n"


#: Of python-can, which takes a fifth of a second to ask.
_COMMON_INTERFACES = frozenset({"socketcan", "udp_multicast", "virtual", "pcan", "kvaser", "slcan"})


#: At an angle, beside the windows measured: the one that had begun before, and the edge of the first that reaches into it.
_BESIDE_WINDOWS_S = 2.0


def _beside(path: Path, name: str | None, default: str) -> Path:
    return path.parent / name if name is not None else shipped(default)


#: What the bus is opened with in any case; python-can would get them twice.
_NAMED_BUS_OPTIONS = frozenset({
    "interface", "channel", "bitrate", "can_filters", "filters", "receive_own", "receive_own_messages", "receive_buffer_bytes",
})  # fmt: skip


def _contradictions(document: Document, machine: Machine) -> Iterator[tuple[str, str, str]]:
    """(key, value, expected) where keys that are right by themselves do not go together."""
    yield from _contradictions_of_the_service(document)
    yield from _contradictions_of_the_measurement(document)
    yield from _contradictions_of_the_sweep(document, machine)


def _contradictions_of_the_service(document: Document) -> Iterator[tuple[str, str, str]]:
    if document.bus.interface not in _COMMON_INTERFACES:
        import can

        if document.bus.interface not in can.VALID_INTERFACES:
            yield "bus.interface", repr(document.bus.interface), f"one of {', '.join(sorted(can.VALID_INTERFACES))}"
    for key in sorted(_NAMED_BUS_OPTIONS & set(document.bus.options)):
        yield f"bus.options.{key}", "is set by a key of bus, or by the daemon", "options that the bus section has no key for"
    if document.network.task_controller and not document.network.enabled:
        yield "network.task_controller", "true", "network.enabled: true, without which there is no address to connect from"
    if Path(document.status.socket).is_absolute() and len(os.fsencode(document.status.socket)) > LONGEST_SOCKET_BYTES:
        problem = f"has {len(os.fsencode(document.status.socket))} bytes"
        yield "status.socket", problem, f"at most {LONGEST_SOCKET_BYTES}, which is what a socket's address has room for"


def _contradictions_of_the_measurement(document: Document) -> Iterator[tuple[str, str, str]]:
    gate = document.gate
    if gate.grain_off_n > gate.grain_on_n:
        yield "gate.grain_off_n", f"{gate.grain_off_n:g}", f"at most gate.grain_on_n, {gate.grain_on_n:g} N"
    if gate.certain_force_n < gate.grain_on_n:
        yield "gate.certain_force_n", f"{gate.certain_force_n:g}", f"at least gate.grain_on_n, {gate.grain_on_n:g} N"
    waveform = document.waveform
    if waveform.kernel_low_hz >= waveform.kernel_high_hz:
        expected = f"below waveform.kernel_high_hz, {waveform.kernel_high_hz:g} Hz"
        yield "waveform.kernel_low_hz", f"{waveform.kernel_low_hz:g}", expected
    windows = document.windows
    if windows.min_coverage > windows.full_coverage:
        expected = f"at most windows.full_coverage, {windows.full_coverage:g}"
        yield "windows.min_coverage", f"{windows.min_coverage:g}", expected


def _contradictions_of_the_sweep(document: Document, machine: Machine) -> Iterator[tuple[str, str, str]]:
    sweep = document.sweep
    needed_s = sweep.windows_per_step + _BESIDE_WINDOWS_S
    if sweep.enabled and sweep.measure_timeout_s < needed_s:
        expected = f"at least {needed_s:g} s for sweep.windows_per_step, {sweep.windows_per_step}; no sweep would end"
        yield "sweep.measure_timeout_s", f"{sweep.measure_timeout_s:g}", expected
    low, high = (math.degrees(a) for a in (machine.min_plate_angle_rad, machine.max_plate_angle_rad))
    for index, angle in enumerate(document.sweep.angles_deg if document.sweep.enabled else ()):
        # The range went through radians and back.
        if not low - 1e-9 <= angle <= high + 1e-9:
            yield f"sweep.angles_deg[{index}]", f"{angle:g}", f"{low:g} to {high:g} deg, the range of {machine.name}"


def _problems(error: ValidationError, path: str) -> list[InputError]:
    """A line for each key that is wrong; a union that fails in several ways counts once."""
    problems: dict[str, InputError] = {}
    for detail in error.errors(include_url=False):
        keys, model, field = _place(detail["loc"])
        place = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).lstrip(".")
        where = f"{path}: {place}" if place else path
        if detail["type"] == "extra_forbidden":
            near = difflib.get_close_matches(str(keys[-1]), list(model.model_fields), n=1)
            known = near[0] if near else "one of " + ", ".join(model.model_fields)
            problems.setdefault(where, InputError(where, "unknown key", known))
        else:
            expected = _expected(model, field)
            if detail["type"] == "string_type" and isinstance(detail["input"], int | float):
                expected += " (a number in quotes)"
            problems.setdefault(where, InputError(where, _shown(detail["input"]), expected))
    return list(problems.values())


def _place(location: tuple[int | str, ...]) -> tuple[list[int | str], type[BaseModel], FieldInfo | None]:
    """The keys of an error's place, the section it lies in, and the key's description (None: the section itself)."""
    model: type[BaseModel] = Document
    field: FieldInfo | None = None
    keys: list[int | str] = []
    for part in location:
        if field is not None and not isinstance(part, int) and _origin(field.annotation) is not dict:
            break  # pydantic names the member of a union here
        keys.append(part)
        if field is not None:
            if not isinstance(part, int):
                break
            continue
        found = model.model_fields.get(str(part))
        if found is None:
            break
        if isinstance(found.annotation, type) and issubclass(found.annotation, BaseModel):
            model = found.annotation
        else:
            field = found
    return keys, model, field


def _origin(annotation: Any) -> Any:
    return get_origin(annotation) or annotation


def _kinds(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)


def _limits(field: FieldInfo) -> tuple[Any, Any]:
    low = next((m.ge for m in field.metadata if hasattr(m, "ge")), None)
    high = next((m.le for m in field.metadata if hasattr(m, "le")), None)
    return low, high


def _unit(field: FieldInfo) -> str:
    extra = field.json_schema_extra
    unit = extra.get("unit", "") if isinstance(extra, dict) else ""
    return "" if unit in ("", "1") else f" {unit}"


def _expected(model: type[BaseModel], field: FieldInfo | None) -> str:
    if field is None:
        return "keys " + ", ".join(model.model_fields)
    return " or ".join(_kind(kind, field) for kind in _kinds(field.annotation))


def _kind(kind: Any, field: FieldInfo) -> str:
    if kind in (int, float):
        low, high = _limits(field)
        span = "" if low is None else f" from {low:.10g} to {high:.10g}"
        return f"a {'whole ' if kind is int else ''}number{span}{_unit(field)}"
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(get_args(kind))
    if _origin(kind) is list:
        return f"a list of numbers, {_unit(field).strip()}"
    words = {bool: "true or false", str: "a word", types.NoneType: "null", dict: "keys with plain values"}
    return words[_origin(kind)]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").splitlines()[0]


def _meaning(field: FieldInfo) -> str:
    low, high = _limits(field)
    span = f"{low:.10g} to {high:.10g}{_unit(field)}" if low is not None else _unit(field).strip()
    return f"{field.description} [{span}]" if span else str(field.description)


def _yaml(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, float):
        return f"{value:.10g}"
    return "{}" if value == {} else str(value)
