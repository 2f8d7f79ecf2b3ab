"""What `yieldmon status` shows, made once a second on the engine's thread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache

import yieldmon
from yieldmon.documents.status import (
    StatusCrop,
    StatusFault,
    StatusFigures,
    StatusLoad,
    StatusNetwork,
    StatusNow,
    StatusParameters,
    StatusStore,
    StatusSweep,
    StatusTotal,
    StatusWaveform,
    StdDevByCause,
    ValueWithStdDev,
)
from yieldmon.engine.faults import FAULTS, FaultCode
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.monitor_view import MonitorView
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.state import EngineState
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.crops import find_crop
from yieldmon.finite import finite
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.config.mapping_notes import aliasing_pct, notes
from yieldmon.service.history.journal import Journal
from yieldmon.service.logs.harvested import harvested
from yieldmon.service.storage.empty_loads import empty_loads, without_empty
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.writer import StoreHealth
from yieldmon.service.traffic.bus_traffic import BusTraffic
from yieldmon.units import crop_yield_kg_m2

_RECENT_LOADS = 10


def snapshot(
    *,
    configuration: Configuration,
    monitor: Monitor,
    record: WindowRecord | None,
    journal: Journal,
    rows: tuple[SecondRow, ...],
    traffic: BusTraffic,
    store: StoreHealth,
    store_note: str,
    reload_note: str,
    reloads: int,
    uptime_s: float,
    network: StatusNetwork,
) -> StatusFigures:
    """The state of a running daemon; every value is fit for JSON, None where it is not known."""
    totals = monitor.totals
    parameters = monitor.estimator.parameters
    engine = monitor.snapshot()
    return {
        "version": yieldmon.__version__,
        "uptime_s": round(uptime_s, 1),
        "state": (record.operating_state if record is not None else OperatingState.STARTING).name.lower(),
        "units": configuration.document.units,
        "crop": _crop(journal.crop_in_use(parameters), totals.market_moisture_pct),
        "now": _now(rows, monitor.area_unknown_because),
        "configuration": {
            "file": str(configuration.path),
            "reload": reload_note,
            "reloads": reloads,
            "notes": list(configuration.notes),
        },
        "load": _load(totals, monitor.loads, journal),
        "loads": without_empty(journal.load_table(), empty_loads(journal.loads))[-_RECENT_LOADS:],
        "total": _total(totals),
        "windows": [_window(row) for row in rows],
        "zero_waits_for": monitor.zero_waits_for or None,
        "zero_mv": engine.zero.zero_mv if engine.zero is not None else None,
        "sweep": _sweep(monitor, engine),
        "waveform": _waveform(monitor),
        "parameters": _parameters(parameters, engine),
        "faults": [_fault(monitor, code) for code in monitor.faults.active],
        "bus": traffic.status(configuration.document.bus),
        "network": network,
        "signals": {
            "rate_hz": [round(source.rate_hz, 3) for source in configuration.signals.sources.impact],
            "aliasing_std_dev_pct": aliasing_pct(configuration),
            "fixed": dict(configuration.signals.sources.fixed),
            "notes": notes(configuration),
        },
        "store": _store(configuration, store, store_note),
    }


def _crop(name: str, market_moisture_pct: float) -> StatusCrop:
    known = find_crop(name)
    return {
        "name": name, "bushel_kg": known.bushel_kg if known is not None else None, "market_moisture_pct": market_moisture_pct,
    }  # fmt: skip


def _now(rows: tuple[SecondRow, ...], area_unknown_because: str) -> StatusNow:
    """What a driver looks at: the last second's flow, moisture and speed, and the yield of the last seconds that
    have a flow; none while the last has not."""
    last = rows[-1] if rows else None
    measured = [row for row in rows if row.quality != EstimateQuality.NOT_AVAILABLE]
    area_m2 = sum(row.area_m2 or 0.0 for row in measured)
    known = last in measured and all(row.area_m2 is not None for row in rows)
    return {
        "mass_flow_kg_s": last.mass_flow_kg_s if last is not None else None,
        "std_dev_kg_s": last.std_dev_kg_s if last is not None else None,
        "quality": EstimateQuality(last.quality).name.lower() if last is not None else None,
        "yield_kg_m2": crop_yield_kg_m2(sum(row.mass_kg for row in measured), area_m2) if known else None,
        "area_missing_because": area_unknown_because or None,
        "moisture_pct": last.moisture_pct if last is not None else None,
        "ground_speed_m_s": last.ground_speed_m_s if last is not None else None,
        "plate_angle_deg": last.plate_angle_deg if last is not None else None,
        "elevator_speed_rpm": last.elevator_speed_rpm if last is not None else None,
    }


def _load(totals: Totals, loads: Sequence[LoadSummary], journal: Journal) -> StatusLoad:
    # A closed load may have been given other names than the next one is to have.
    names = None if totals.load_open else journal.loads.names(totals.load_number)
    field, crop = (journal.field, journal.crop) if names is None else names
    return {
        "number": totals.load_number,
        "open": totals.load_open,
        "field": field,
        "crop": crop,
        "mass_kg": totals.load_kg,
        "contested_mass_kg": totals.load_contested_kg,
        "std_dev_kg": finite(totals.load_budget.std_dev_kg),
        "std_dev_by_cause_kg": _by_cause(totals.load_budget),
        "dry_mass_kg": totals.known_load_dry_kg,
        "unrecorded_s": _unrecorded_s(totals, journal),
        "complete": next((load.complete for load in reversed(loads) if load.number == totals.load_number), None),
        **harvested(totals),
    }


def _unrecorded_s(totals: Totals, journal: Journal) -> float | None:
    number, seconds = journal.unrecorded or (0, 0.0)
    return round(seconds, 1) if number == totals.load_number else None


def _total(totals: Totals) -> StatusTotal:
    return {
        "mass_kg": totals.total_kg,
        "std_dev_kg": finite(totals.total_budget.std_dev_kg),
        "std_dev_by_cause_kg": _by_cause(totals.total_budget),
        "dry_mass_kg": totals.total_dry_kg,
        "contested_mass_kg": totals.total_contested_kg,
        "mass_of_unknown_moisture_kg": totals.total_unknown_moisture_kg,
    }


def _sweep(monitor: MonitorView, engine: EngineState) -> StatusSweep:
    sweep, outcome = monitor.sweep, monitor.outcome
    return {
        "state": sweep.state.name.lower(),
        "progress_pct": round(sweep.progress_pct, 1),
        "sweeps": sweep.sweep_id,
        "due_in_s": finite(engine.sweep_due_in_s) if monitor.settings.sweep.enabled else None,
        "aborted_because": sweep.abort_reason.value if sweep.abort_reason is not None else None,
        "declined": sweep.schedule.declined,
        "declined_because": sweep.schedule.declined_because or None,
        "last_update": outcome.reason if outcome is not None else None,
    }


def _parameters(parameters: ParameterSet, engine: EngineState) -> StatusParameters:
    return {
        "version": parameters.version,
        "age_s": engine.calibration_age_s,
        "estimator": parameters.curve.law.kind if parameters.curve is not None else "physical",
        "values": _values(parameters),
        "scale_error": parameters.scale_error,
        "carried_from": parameters.carried_from,
        "provenance": dict(parameters.provenance),
    }


def _fault(monitor: MonitorView, code: FaultCode) -> StatusFault:
    fault = FAULTS[code]
    return {
        "code": code.value,
        "severity": fault.severity.name.lower(),
        "since_s": finite(monitor.faults.since(code)),
        "occurrences": monitor.faults.occurrences(code),
        "detail": monitor.faults.detail(code),
        "cause": fault.cause,
        "effect": fault.effect,
        "remedy": fault.remedy,
    }


def _store(configuration: Configuration, store: StoreHealth, note: str) -> StatusStore:
    return {
        "file": str(configuration.store_path),
        "note": note or None,
        "failing": store.failing,
        "pending": store.pending,
        "waiting_s": store.waiting_s,
        "committed": store.committed,
        "records_dropped": store.records_dropped,
        "batches_refused": store.batches_refused,
        "replacements": store.replacements,
        "replaced_because": store.replaced_because,
    }


def _waveform(monitor: MonitorView) -> StatusWaveform | None:
    seen = monitor.waveform
    if seen is None:
        return None
    return {
        "published": monitor.settings.waveform.combine,
        "shape_volume_flow_m3_s": finite(seen.volume_m3_s),
        "shape_volume_std_dev_m3_s": finite(seen.volume_std_dev_m3_s),
        "shape_flow_kg_s": finite(seen.shape_kg_s),
        "shape_std_dev_kg_s": finite(seen.shape_std_dev_kg_s),
        "shape_verdict": seen.shape.name.lower(),
        "shape_missing_because": seen.shape_reason or None,
        "kernel_flow_kg_s": finite(seen.kernels_kg_s),
        "kernel_std_dev_kg_s": finite(seen.kernels_std_dev_kg_s),
        "kernel_verdict": seen.kernels.name.lower(),
        "kernel_missing_because": seen.kernels_reason or None,
        "thousand_kernel_weight_g": finite(seen.kernel_weight_g),
        "only_kernels_set_scale": monitor.only_kernels_set_scale,
        "contradiction": seen.contradiction or None,
        "stretch_by_mean_force": finite(seen.stretch),
        "kernel_bias_by_mean_force": finite(seen.bias),
    }


def _by_cause(budget: MassBudget) -> StdDevByCause:
    return {
        "noise": finite(budget.noise_kg2**0.5),
        "parameters": finite(budget.parameters_kg),
        "zero": finite(budget.zero_kg),
        "moisture": finite(budget.moisture_kg),
    }


# Nine of the ten that are shown were shown a second ago.
@lru_cache(maxsize=16)
def _window(row: SecondRow) -> dict[str, float | str | None]:
    # Not asdict, which copies each value deeply, for every window.
    window = {column.name: getattr(row, column.name) for column in fields(row)}
    window["quality"] = EstimateQuality(row.quality).name.lower()
    window["operating_state"] = OperatingState(row.operating_state).name.lower()
    return window


def _values(parameters: ParameterSet) -> dict[str, ValueWithStdDev]:
    """What gives the flow: the coefficients of a curve that has some, else the grain's parameters."""
    if parameters.curve is None:
        return {
            name: {"value": float(value), "std_dev": parameters.standard_deviation(name)}
            for name, value in parameters.values.items()
        }
    return {
        name: {"value": value, "std_dev": abs(value) * parameters.curve.relative_std_dev}
        for name, value in parameters.curve.law.coefficients.items()
    }
