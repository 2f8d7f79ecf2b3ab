"""The section `outputs` of the configuration: from YAML to what is sent, and every fault of it in one line with file and key."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from yieldmon.errors import InputError
from yieldmon.physics.machine import Machine
from yieldmon.service.config.entry_check import HIGHEST_ADDRESS, address, checked, limits
from yieldmon.service.config.signal_section import database_path, database_reader
from yieldmon.signals.mapping import SignalMap
from yieldmon.signals.output_mapping import MAX_PERIOD_MS, MIN_PERIOD_MS, OWN, OutputBinding, OutputMap, build
from yieldmon.signals.published import PUBLISHED
from yieldmon.strict_model import StrictModel

_PERIOD = f"{MIN_PERIOD_MS:g} to {MAX_PERIOD_MS:g} ms; null: with each new value"


class OutputEntry(StrictModel, defer_build=True):
    """One quantity's keys. What is sent: value in `unit` * scale + offset, as the DBC's physical value."""

    dbc: str = Field(description="a DBC file, relative to the configuration")
    message: str = Field(description="name of a message in the DBC")
    signal: str = Field(description="name of a signal of that message")
    scale: float = Field(1.0, description="a factor on the value")
    offset: float = Field(0.0, description="a number added after that")
    unit: str | None = Field(None, description="unit of the value; null: the DBC's")
    source: Any = Field(None, description="own, or an address; null: own in J1939 messages, else the DBC's")
    mux: int | None = Field(None, ge=0, description="value of the message's multiplexer")
    range: list[float] | None = Field(None, min_length=2, max_length=2, description="two numbers in the quantity's unit")
    not_available: int | None = Field(None, description="the raw value that means it; null: J1939's, else nothing is sent")
    values: dict[int, int] = Field(default_factory=dict, description="the quantity's code: raw value, both whole numbers")
    period_ms: float | None = Field(None, ge=MIN_PERIOD_MS, le=MAX_PERIOD_MS, description=_PERIOD)
    constants: dict[str, float] = Field(default_factory=dict, description="signals of the same message: physical value")


def output_map(
    entries: Mapping[str, Any],
    path: Path,
    machine: Machine,
    inputs: SignalMap,
    *,
    with_shipped: bool,
    network: bool,
    fixed_plate: bool,
) -> tuple[OutputMap, tuple[Path, ...]]:
    """What a configuration at `path` has sent, and the DBC files that it names. Raises InputError."""
    bindings = [_binding(str(quantity), entry, f"{path}: outputs.signals.{quantity}") for quantity, entry in entries.items()]
    if not bindings:
        return OutputMap(shipped=with_shipped), ()

    read = database_reader(path)
    found = build(bindings, read, machine, inputs, shipped=with_shipped, network=network, fixed_plate=fixed_plate)
    return found, tuple(database_path(name, path) for name in dict.fromkeys(binding.dbc for binding in bindings))


def _binding(quantity: str, entry: Any, where: str) -> OutputBinding:
    if quantity not in PUBLISHED:
        near = difflib.get_close_matches(quantity, PUBLISHED, n=1)
        raise InputError(where, "unknown quantity", near[0] if near else f"one of {', '.join(PUBLISHED)}")
    found = checked(OutputEntry, entry, where, {})
    low, high = limits(found.range, where)
    return OutputBinding(
        where=where,
        quantity=quantity,
        dbc=found.dbc,
        message=found.message,
        signal=found.signal,
        scale=found.scale,
        offset=found.offset,
        unit=found.unit,
        source=_source(found.source, f"{where}.source"),
        mux=found.mux,
        low=low,
        high=high,
        not_available=found.not_available,
        values=found.values,
        period_s=None if found.period_ms is None else found.period_ms / 1000.0,
        constants=found.constants,
    )


def _source(value: Any, where: str) -> int | str | None:
    if value is None or value == OWN:
        return None if value is None else OWN
    return address(value, where, f"own, or an address from 0 to {HIGHEST_ADDRESS}")
