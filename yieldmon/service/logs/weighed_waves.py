"""Waves of weighed loads: logs put through the engine with the waveform looked at, and their tickets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.bus.codec import Codec
from yieldmon.engine.results import Result, windows_in
from yieldmon.engine.waveform.pulse_fits import law_of, pulse_model
from yieldmon.errors import InputError
from yieldmon.estimation.waveform.machine_shape import WeighedWave
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_model import PulseModel
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs.bulk_processing import process_in_bulk
from yieldmon.service.logs.log_copies import refuse_repeated_loads
from yieldmon.service.logs.measured_loads import MeasuredLoad, loads_in_log
from yieldmon.service.logs.recorded import is_store_not_log
from yieldmon.service.logs.weighed_loads import each_on_one
from yieldmon.service.storage.rows import SecondRow

_STEADY = 0.15
"""Largest relative change of the flow from one second to the next with which a second's pulses are of one load."""


@dataclass(frozen=True)
class WavedLoad:
    """A load of a log, and the waves of those of its seconds that have one."""

    load: MeasuredLoad
    waves: tuple[tuple[SecondRow, PatternWave], ...]


def looking(configured: Configuration) -> Configuration:
    """The configuration with the waveform looked at, beside a mean force that counts alone."""
    waveform = replace(configured.engine.waveform, enabled=True, combine=False)
    return replace(configured, engine=replace(configured.engine, waveform=waveform))


def read(sources: Sequence[str], configured: Configuration) -> tuple[WavedLoad, ...]:
    """The loads of logs. Raises InputError, also for a store, which holds no samples."""
    for source in sources:
        if is_store_not_log(source):
            raise InputError(source, "is a store, which holds no samples", "logs of weighed loads")
    refuse_repeated_loads(sources)
    found: list[WavedLoad] = []
    for source in sources:
        found += _of_log(source, configured, len(found))
    return tuple(found)


def _of_log(source: str, configured: Configuration, before: int) -> list[WavedLoad]:
    rows: list[SecondRow] = []
    seen: list[PatternWave | None] = []
    monitor = build_monitor(
        configured.engine, configured.machine, configured.parameters, None, configured.signals.sources, drives_plate=False
    )

    def take(results: Sequence[Result]) -> None:
        seen.extend(result.waveform.wave for result in windows_in(results))

    process_in_bulk(
        [source], monitor, Codec(), rows.append, signals=configured.signals, channels=configured.log_channels, take_results=take
    )
    waves = {row.number: wave for row, wave in zip(rows, seen, strict=True) if wave is not None}
    versions = {configured.parameters.version: configured.parameters}
    return [
        WavedLoad(load, tuple((row, waves[row.number]) for row in _steady(load.seconds) if row.number in waves))
        for load in loads_in_log(rows, source, versions, before)
    ]


def _steady(rows: Sequence[SecondRow]) -> list[SecondRow]:
    """Those whose flow is that of the second before and of the one after."""
    flows = [row.mean_force_flow_kg_s or 0.0 for row in rows]

    def alike(first: int, second: int) -> bool:
        return bool(abs(flows[first] - flows[second]) <= _STEADY * max(flows[first], flows[second]))

    return [rows[i] for i in range(1, len(rows) - 1) if flows[i] > 0.0 and alike(i, i - 1) and alike(i, i + 1)]


def pulses(configured: Configuration) -> PulseModel:
    """As the daemon would look at them."""
    waveform = configured.engine.waveform
    return pulse_model(waveform, configured.machine, configured.parameters, law_of(waveform))


@dataclass(frozen=True)
class WeighedShapes:
    """waves: of all weighed loads. scales: by load, its weighed mass over that by the mean force. biases: by load, the
    `waveform.kernel_bias` with which kernel noise gives its weighed mass."""

    waves: tuple[WeighedWave, ...]
    scales: dict[str, float]
    biases: dict[str, float]


def match(loads: Sequence[WavedLoad], tickets: Sequence[WeighedTicket], configured: Configuration) -> WeighedShapes:
    """Each ticket with the waves of its loads. Raises InputError for a ticket without a load, or with one that has another."""
    measured = [item.load for item in loads]
    by_name = {item.load.name: item for item in loads}
    density, bias = configured.parameters.values["density"], configured.engine.waveform.kernel_bias
    waves: list[WeighedWave] = []
    scales: dict[str, float] = {}
    biases: dict[str, float] = {}
    for ticket, loads_of_ticket in each_on_one(measured, tickets):
        covered = [by_name[load.name] for load in loads_of_ticket]
        name = ticket.name
        scale = scales[name] = ticket.mass_kg / sum(item.load.mass_kg for item in covered)
        seconds = [pair for item in covered for pair in item.waves]
        waves += [WeighedWave(name, wave, scale * row.mean_force_flow_kg_s / density) for row, wave in seconds]
        by_both = np.array([(r.kernel_flow_kg_s, r.mean_force_flow_kg_s) for r, _ in seconds if r.kernel_flow_kg_s is not None])
        if len(by_both):
            by_kernels, by_force = by_both.sum(axis=0)
            biases[name] = float(bias * scale * by_force / by_kernels)
    return WeighedShapes(tuple(waves), scales, biases)
