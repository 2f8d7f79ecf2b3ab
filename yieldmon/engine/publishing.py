"""The frames that say what a window gave. Ranges and the moduli of counters come from the DBC, nothing is copied from it."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, isfinite

from yieldmon import frames as bus
from yieldmon.engine.faults import FAULTS
from yieldmon.engine.health import FaultBook
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.records import COLUMNS, WindowRecord
from yieldmon.engine.sweeps.sweep import PlateSweep
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import NOT_AVAILABLE, EstimateQuality, Frame, Value
from yieldmon.physics.grain import published
from yieldmon.signal_ranges import SignalRanges, signal_ranges

_NO_FAULTS: dict[str, Value] = {code.value: 0 for code in FAULTS}
_PUBLISHED = tuple((column, *column.published) for column in COLUMNS if column.published is not None)


@dataclass(frozen=True, slots=True)
class Published:
    """What the frames of a window hold beside its record. parameters: in use. calibration_age_s: None where it is not known."""

    sweep: PlateSweep
    parameters: ParameterSet
    calibration_age_s: float | None
    faults: FaultBook


class Publisher:
    """Makes the frames of a window. ranges: smallest and largest value of each signal; None: those of the shipped DBC."""

    def __init__(self, ranges: SignalRanges | None = None) -> None:
        self._ranges = signal_ranges() if ranges is None else ranges
        masses = self._ranges[bus.ACCUMULATED_MASS]
        self._masses = (
            ("LoadMass", masses["LoadMass"][1], "load start"),
            ("TotalMass", masses["TotalMass"][1], "totals archive"),
        )

    def frames(self, record: WindowRecord, beside: Published) -> tuple[Frame, ...]:
        """The frames of one window."""
        signals: dict[str, dict[str, Value]] = {
            bus.MASS_FLOW: self._mass_flow(record),
            bus.ACCUMULATED_MASS: {"LoadNumber": self._counted(bus.ACCUMULATED_MASS, "LoadNumber", record.load_number)},
            bus.SELF_CALIBRATION_STATUS: self._calibration(beside),
            bus.YIELD_MONITOR_STATUS: _status(record),
        }
        for column, message, signal in _PUBLISHED:
            (value,) = column.convert((getattr(record, column.attribute),))
            known = NOT_AVAILABLE if value is None else self._fitting(message, signal, value)
            signals.setdefault(message, {})[signal] = known
        return tuple(Frame(record.time_s, message, values) for message, values in signals.items())

    def mass_near_end(self, totals: Totals, share: float) -> str | None:
        """What is to be said of masses above this share of the largest that their signals carry; None where there is none."""
        near = [
            f"{signal} {kg:.0f} kg of at most {most_kg:.0f} kg: {command}"
            for kg, (signal, most_kg, command) in zip((totals.load_kg, totals.total_kg), self._masses, strict=True)
            if kg >= share * most_kg
        ]
        return "; ".join(near) if near else None

    def _mass_flow(self, record: WindowRecord) -> dict[str, Value]:
        known = isfinite(record.mass_flow_kg_s)
        quality = record.quality
        if not known and quality is not EstimateQuality.NOT_HARVESTING:
            quality = EstimateQuality.NOT_AVAILABLE
        message = bus.MASS_FLOW
        return {
            "MassFlowRate": self._fitting(message, "MassFlowRate", record.mass_flow_kg_s) if known else NOT_AVAILABLE,
            "MassFlowStdDev": self._fitting(message, "MassFlowStdDev", record.std_dev_kg_s) if known else NOT_AVAILABLE,
            "EstimateQuality": int(quality),
            "WindowCounter": self._counted(message, "WindowCounter", record.window),
        }

    def _calibration(self, beside: Published) -> dict[str, Value]:
        message, age_s = bus.SELF_CALIBRATION_STATUS, beside.calibration_age_s
        # A curve has neither; what its parameter set holds of them gives no flow.
        physical, of_grain = beside.parameters.curve is None, published(beside.parameters.values)
        age = NOT_AVAILABLE if age_s is None else self._fitting(message, "CalibrationAge", floor(age_s / 60.0))
        return {
            "SweepState": int(beside.sweep.state),
            "SweepProgress": beside.sweep.progress_pct,
            **{name: self._fitting(message, name, value) if physical else NOT_AVAILABLE for name, value in of_grain.items()},
            "CalibrationAge": age,
        }

    def _fitting(self, message: str, signal: str, value: float) -> Value:
        """The value where the signal can carry it; beyond that it is not available, never cut off."""
        low, high = self._ranges[message][signal]
        return value if low <= value <= high else NOT_AVAILABLE

    def _counted(self, message: str, signal: str, count: int) -> int:
        """A count in the signal's range, from which it starts anew."""
        return count % (int(self._ranges[message][signal][1]) + 1)


def _status(record: WindowRecord) -> dict[str, Value]:
    active: dict[str, Value] = {code.value: 1 for code in record.faults}
    return {"OperatingState": int(record.operating_state), **_NO_FAULTS, **active}
