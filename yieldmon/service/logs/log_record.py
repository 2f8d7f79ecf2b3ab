"""Logs that are one record, measured by a configuration: what `process` and `fleet run` both do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from yieldmon.bus.codec import Codec
from yieldmon.documents.process import ProcessSummary
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result
from yieldmon.engine.sampling.zero import ZeroState
from yieldmon.finite import finite
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch, process_in_bulk
from yieldmon.service.logs.harvested import harvested
from yieldmon.service.logs.processing import Summary
from yieldmon.service.storage.rows import SecondRow

Progress = Callable[[Stretch | EndOfLog], None]


def measure(
    logs: Sequence[str],
    configured: Configuration,
    take_row: Callable[[SecondRow], None],
    *,
    zero_mv: float | None = None,
    reads_ahead: bool = False,
    progress: Progress | None = None,
    take_results: Callable[[Sequence[Result]], None] | None = None,
) -> tuple[Summary, Monitor]:
    """Put the logs, one after the other, through one monitor.

    Parameters
    ----------
    logs : sequence of str
        Paths.
    configured : Configuration
    take_row : callable
        Called with each second's row, in order.
    zero_mv : float, optional
        Zero-load voltage that is known beforehand, mV.
    reads_ahead : bool
        Read and decode in a second process.
    progress : callable, optional
        Called with each stretch that is done.
    take_results : callable, optional
        Called with what the monitor handed back, events included, before its rows.

    Returns
    -------
    Summary
        What was met in the logs.
    Monitor
        As it is at their end.

    Raises
    ------
    InputError
        A log cannot be read, or there is nothing in all of them that the engine takes.
    """
    monitor = monitor_of(configured, drives_plate=False)
    if zero_mv is not None:
        known = ZeroState(
            zero_mv, zero_mv, configured.machine.nominal_elevator_speed_rad_s, configured.engine.zero.first_pulse_limit_mv
        )
        monitor.restore(replace(monitor.snapshot(), zero=known))
    summary = process_in_bulk(
        logs, monitor, Codec(), take_row,
        signals=configured.signals, channels=configured.log_channels,
        reads_ahead=reads_ahead, progress=progress, take_results=take_results,
    )  # fmt: skip
    return summary, monitor


def document(summary: Summary, monitor: Monitor) -> ProcessSummary:
    """The record in short, as `process --json` prints it."""
    totals, land = monitor.totals, harvested(monitor.totals)
    found: ProcessSummary = {
        "frames": summary.frames,
        "frames_of_ours": summary.ours,
        "frames_malformed": summary.malformed,
        "messages_incomplete": summary.incomplete,
        "windows": summary.windows,
        "total_mass_kg": totals.total_kg,
        "total_std_dev_kg": finite(totals.total_budget.std_dev_kg),
        "dry_mass_kg": totals.known_total_dry_kg,
        "area_m2": land["area_m2"],
        "mass_of_unknown_area_kg": land["mass_of_unknown_area_kg"],
        "yield_kg_m2": land["yield_kg_m2"],
        "dry_yield_kg_m2": land["dry_yield_kg_m2"],
        "faults": {code.value: count for code in FaultCode if (count := monitor.faults.occurrences(code))},
        "damages": summary.damages,
        "zero_known": monitor.snapshot().zero is not None,
    }
    if totals.total_contested_kg > 0.0:
        found["contested_kg"] = totals.total_contested_kg
    return found
