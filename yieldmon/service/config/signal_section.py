"""The section `signals` of the configuration: from YAML to a mapping, and every fault of it in one line with file and key."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from yieldmon.bus.databases import MessageBits, load_messages
from yieldmon.engine.sources import QUANTITIES
from yieldmon.errors import InputError
from yieldmon.network.name import Name, NameMatch
from yieldmon.physics.machine import Machine
from yieldmon.resources import shipped
from yieldmon.service.config.entry_check import HIGHEST_ADDRESS, address, checked, limits, whole
from yieldmon.service.config.named_file import load_named
from yieldmon.signals.binding import (
    IMPACT,
    MAX_RATE_HZ,
    MIN_RATE_HZ,
    NO_SAMPLES,
    OF_SAMPLES,
    Binding,
    Source,
    check_quantity,
)
from yieldmon.signals.mapping import SignalMap, build, default_map
from yieldmon.strict_model import StrictModel

_SHORTEST_NAME = 1 << 32
"""Any smaller number was meant to be an address: a NAME whose upper half is 0 has no function and no industry."""
_BESIDE_VALUE = ("value", "unit", "message", "signal", "signals")
"""Keys that may stand beside a constant, or whose message says more."""
_NEEDED = {"elevator_speed": "a signal or a constant", "plate_angle": "a signal, or plate.fixed_angle_deg"}

SHIPPED_DATABASES = frozenset({"j1939.dbc", "yieldmon.dbc"})


class NodeName(StrictModel, defer_build=True):
    """Fields of a J1939 NAME; those that are given must be equal."""

    identity_number: int | None = Field(None, ge=0, le=(1 << 21) - 1)
    manufacturer_code: int | None = Field(None, ge=0, le=2047)
    ecu_instance: int | None = Field(None, ge=0, le=7)
    function_instance: int | None = Field(None, ge=0, le=31)
    function: int | None = Field(None, ge=0, le=255)
    vehicle_system: int | None = Field(None, ge=0, le=127)
    vehicle_system_instance: int | None = Field(None, ge=0, le=15)
    industry_group: int | None = Field(None, ge=0, le=7)


class SignalEntry(StrictModel, defer_build=True):
    """One quantity's keys. Values become: physical value of the DBC * scale * ratio + offset, in `unit`."""

    dbc: str | None = Field(None, description="DBC file, relative to the configuration; null: the shipped one")
    message: str | None = Field(None, description="name of the message in the DBC")
    signal: str | None = Field(None, description="name of the signal")
    signals: list[str] | None = Field(None, min_length=1, max_length=64, description="impact samples of one frame, oldest first")
    scale: float = Field(1.0, description="factor on the DBC's physical value")
    offset: float = Field(0.0, description="added after that")
    ratio: float = Field(1.0, gt=0.0, description="turns of the elevator shaft per turn of the shaft that is measured")
    unit: str | None = Field(None, description="unit of the value then; null: the DBC's")
    source: Any = Field(None, description="any, an address, a NAME or fields of one; null: as the DBC's identifier says")
    mux: int | list[int] | None = Field(None, description="value of the message's multiplexer, or several as a list")
    valid: dict[str, int | list[int]] = Field(
        default_factory=dict,
        max_length=4,
        description="signal of the message: raw value, or values, with which this one is valid",
    )
    range: list[float] | None = Field(None, min_length=2, max_length=2, description="in the quantity's unit; outside: no value")
    not_available: list[int] = Field(default_factory=list, max_length=64, description="raw values that mean it")
    values: dict[int, int] = Field(default_factory=dict, description="raw value to the quantity's code")
    rate_hz: float | None = Field(None, ge=MIN_RATE_HZ, le=MAX_RATE_HZ, description="impact samples per second")
    spacing_ms: float | None = Field(
        None, ge=1000.0 / MAX_RATE_HZ, le=1000.0 / MIN_RATE_HZ, description="the same as time between samples"
    )
    counter: str | None = Field(None, description="signal that counts the frames")
    status: str | None = Field(None, description="signal: 0 good, 1 over range, 2 fault")
    pulses_per_turn: float | None = Field(None, gt=0.0, le=1e5, description="the signal counts pulses, or is their Hz, s, ms, us")
    time_constant_s: float = Field(0.0, ge=0.0, le=10.0, description="of a filter in the sensor")
    value: float | None = Field(None, description="a constant in the quantity's unit; nothing is bound")


_EXPECTED = {
    "rate_hz": f"a number from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz",
    "spacing_ms": f"a number from {1000.0 / MAX_RATE_HZ:g} to {1000.0 / MIN_RATE_HZ:g} ms",
    "dbc": "the name of a file, in quotes where it is a number",
    "message": "the name of a message in the DBC",
    "signal": "the name of one signal; impact samples of one frame are `signals`",
    "signals": "names of the impact samples of one frame, oldest first, as a list",
    "scale": "a factor, a number other than 0",
    "offset": "a number",
    "unit": "a unit such as rpm, deg or mV",
    "mux": "a whole number from 0 on, or a list of them",
    "valid": "a signal of the message and its raw value or values, such as {SpeedValid: 1}",
    "not_available": "raw values as a list, such as [255]",
    "pulses_per_turn": "a number above 0",
    "time_constant_s": "a number from 0 to 10 s",
    "value": "a number in the quantity's unit",
    "range": "two numbers, the smaller first",
    "ratio": "a number above 0",
    "values": "raw value: code, both whole numbers",
    "source": f"any, an address from 0 to {HIGHEST_ADDRESS}, a NAME such as 0xA00C810045200023, or fields of one",
}


_OFF = ("off", "no", "none")
_OF_PLATE = ("plate_angle", "actuator_state")


def signal_map(
    content: Mapping[str, Any],
    path: Path,
    machine: Machine,
    fixed_plate_deg: float | None,
    read: Callable[[str], dict[str, MessageBits]] | None = None,
) -> tuple[SignalMap, tuple[Path, ...]]:
    """The mapping that a configuration at `path` asks for, and the DBC files that it names. read: as `database_reader` has it.
    Raises InputError."""
    fixed = {} if fixed_plate_deg is None else {"plate_angle": fixed_plate_deg}
    off = {"actuator_state"} if fixed_plate_deg is not None else set()
    if not content:
        return default_map(fixed=fixed), ()
    bindings: list[Binding] = []
    for quantity, entries in content.items():
        where = f"{path}: signals.{quantity}"
        check_quantity(str(quantity), where)
        if entries is not None:
            if fixed_plate_deg is not None and quantity in _OF_PLATE:
                raise InputError(where, "is bound though plate.fixed_angle_deg is set", "one of the two")
            bindings += _bindings(str(quantity), entries, where)
        elif fixed_plate_deg is None or quantity not in _OF_PLATE:
            if quantity in IMPACT or quantity in _NEEDED:
                raise InputError(where, "null", f"{_NEEDED.get(quantity, 'a signal')}: without it nothing is measured")
            off.add(str(quantity))
    if len({binding.quantity for binding in bindings if binding.is_impact}) > 1:
        raise InputError(f"{path}: signals", "binds impact_voltage and impact_force", "one of the two")
    found = build(bindings, read or database_reader(path), machine, switched_off=sorted(off), fixed=fixed)
    _check_constants(found, path)
    names = dict.fromkeys(binding.dbc for binding in bindings if binding.dbc is not None)
    return found, tuple(database_path(name, path) for name in names)


def mistakes(content: Mapping[str, Any], path: Path, machine: Machine, fixed_plate_deg: float | None) -> list[InputError]:
    """What is wrong with a mapping that `signal_map` refuses: the first mistake of each quantity by itself, else of all
    together."""
    read, found = database_reader(path), dict[str, InputError]()
    for part in (*({quantity: entries} for quantity, entries in content.items()), content):
        try:
            if part is not content or not found:
                signal_map(part, path, machine, fixed_plate_deg, read)
        except InputError as error:
            # A file that cannot be read is said once.
            found.setdefault(str(error), error)
    return list(found.values())


def database_path(name: str, configuration: Path) -> Path:
    """The DBC file of that name: beside the configuration, else a shipped one of that bare name. "": the shipped layout."""
    beside = configuration.parent / name
    if name not in SHIPPED_DATABASES or beside.exists():
        return beside if name else shipped("dbc/yieldmon.dbc")
    return shipped(f"dbc/{name}")


def database_reader(path: Path) -> Callable[[str], dict[str, MessageBits]]:
    """What reads the messages of a DBC file that the configuration at `path` names, each file once."""

    @cache
    def read(name: str) -> dict[str, MessageBits]:
        return load_named(path, "dbc", load_messages, database_path(name, path), "j1939.dbc, or a DBC file")

    return read


def _bindings(quantity: str, entries: Any, where: str) -> list[Binding]:
    """Of one quantity, which may be a list for impact sensors."""
    if entries is False or (isinstance(entries, str) and entries.lower() in _OFF):
        raise InputError(where, repr(entries), "null to switch it off, or a mapping with dbc, message and signal")
    if not isinstance(entries, list):
        return [_binding(quantity, entries, where)]
    if quantity not in IMPACT:
        raise InputError(where, "a list", "one signal; only impact_voltage and impact_force take a list")
    if not entries:
        raise InputError(where, "an empty list", "the signal of at least one impact sensor")
    return [_binding(quantity, entry, f"{where}[{number}]") for number, entry in enumerate(entries)]


def _binding(quantity: str, entry: Any, where: str) -> Binding:
    if quantity not in IMPACT and isinstance(entry, Mapping):
        _refuse_keys_of_samples(entry, where)
    found = checked(SignalEntry, _hexadecimal(entry), where, _EXPECTED)
    beside = None if found.value is None else next((key for key in entry if key not in _BESIDE_VALUE), None)
    if beside is not None:
        expected = "no such key for a constant, which is the quantity's own value"
        raise InputError(f"{where}.{beside}", "is given together with value", expected)
    if found.signal is not None and found.signals is not None:
        raise InputError(f"{where}.signals", "is given together with signal", "one of the two")
    if found.rate_hz is not None and found.spacing_ms is not None:
        raise InputError(f"{where}.spacing_ms", "is given together with rate_hz", "one of the two")
    low, high = limits(found.range, where)
    rate_hz = 1000.0 / found.spacing_ms if found.spacing_ms is not None else found.rate_hz
    if found.ratio != 1.0 and quantity != "elevator_speed":
        raise InputError(f"{where}.ratio", f"{found.ratio:g}", "no such key here; it belongs to elevator_speed")
    return Binding(
        where=where,
        quantity=quantity,
        dbc=found.dbc,
        message=found.message,
        signals=tuple(found.signals or ([found.signal] if found.signal is not None else [])),
        scale=found.scale,
        ratio=found.ratio,
        offset=found.offset,
        unit=found.unit,
        source=_source(found.source, f"{where}.source"),
        mux=_pages(found.mux, f"{where}.mux"),
        valid={name: tuple(raw) if isinstance(raw, list) else (raw,) for name, raw in found.valid.items()},
        low=low,
        high=high,
        not_available=tuple(found.not_available),
        values=found.values,
        rate_hz=rate_hz,
        counter=found.counter,
        status=found.status,
        pulses_per_turn=found.pulses_per_turn,
        time_constant_s=found.time_constant_s,
        value=found.value,
    )


def _pages(mux: int | list[int] | None, where: str) -> tuple[int, ...]:
    """Values of the multiplexer, in order. Raises InputError where there is none in a list, or one below 0."""
    given = [] if mux is None else mux if isinstance(mux, list) else [mux]
    if mux == [] or any(value < 0 for value in given):
        raise InputError(where, f"{mux}", _EXPECTED["mux"])
    return tuple(sorted(set(given)))


def _refuse_keys_of_samples(entry: Mapping[Any, Any], where: str) -> None:
    """Before their own limits are asked for, which do not matter here."""
    for key in OF_SAMPLES:
        if entry.get(key) is not None and not (key == "time_constant_s" and entry[key] == 0):
            raise InputError(f"{where}.{key}", repr(entry[key])[:60], NO_SAMPLES)


def _hexadecimal(entry: Any) -> Any:
    """The entry with raw values and the multiplexer's as numbers, however they are written."""
    if not isinstance(entry, Mapping):
        return entry
    found = dict(entry)
    if "mux" in found:
        found["mux"] = [whole(value) for value in found["mux"]] if isinstance(found["mux"], list) else whole(found["mux"])
    if isinstance(found.get("not_available"), list):
        found["not_available"] = [whole(raw) for raw in found["not_available"]]
    if isinstance(found.get("values"), Mapping):
        found["values"] = {whole(raw): code for raw, code in found["values"].items()}
    return found


def _source(value: Any, where: str) -> Source:
    if value is None or value == "any":
        return None if value is None else "any"
    if isinstance(value, Mapping):
        fields = value.get("name", value)
        try:
            name = NodeName.model_validate({k: whole(v) for k, v in fields.items()} if isinstance(fields, Mapping) else fields)
        except ValidationError as error:
            detail = error.errors(include_url=False)[0]
            key = ".".join(str(part) for part in detail["loc"])
            expected = f"fields of a NAME in their ranges: {', '.join(NodeName.model_fields)}"
            raise InputError(f"{where}.{key}" if key else where, repr(detail["input"])[:60], expected) from error
        if not name.model_dump(exclude_none=True):
            raise InputError(where, "an empty NAME", f"at least one of {', '.join(NodeName.model_fields)}")
        return NameMatch(**name.model_dump())
    number = whole(value)
    if isinstance(number, int) and _SHORTEST_NAME <= number < 1 << 64:
        whole_name = Name.of_int(number)
        return NameMatch(**{key: getattr(whole_name, key) for key in NodeName.model_fields})
    return address(value, where, _EXPECTED["source"])


def _check_constants(found: SignalMap, path: Path) -> None:
    for name, value in found.sources.fixed.items():
        quantity = QUANTITIES[name]
        standing = name == "elevator_speed" and value == 0.0
        if standing or not (math.isfinite(value) and quantity.usable(value)):
            raise InputError(f"{path}: signals.{name}.value", f"{value:g}", f"a value that {name} can have, {quantity.unit}")
