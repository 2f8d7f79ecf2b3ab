"""How well published mass flow and mass agree with the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.documents.demo import DemoDocument
from yieldmon.frames import ACCUMULATED_MASS, MASS_FLOW, SELF_CALIBRATION_STATUS, EstimateQuality, Frame, SweepState, Value
from yieldmon.physics.numerics import Array

BANDS_KG_S = ((0.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 16.0), (16.0, 25.0))
RATED_FROM_KG_S = 4.0
"""Relative errors are quoted from this flow up; below it a percentage says little."""


@dataclass(frozen=True, slots=True)
class Band:
    """Errors of the 1 Hz flow in one band of true flow; nan where the band is empty. missing: windows without a number."""

    low_kg_s: float
    high_kg_s: float
    windows: int
    missing: int
    bias_kg_s: float
    rms_kg_s: float
    mean_abs_pct: float
    p95_abs_pct: float


@dataclass(frozen=True)
class Accuracy:
    """Errors of a whole run. Flow errors are relative, over windows whose true flow is RATED_FROM_KG_S or more."""

    windows: int
    rated_windows: int
    missing_rated_windows: int
    mean_abs_pct: float
    p95_abs_pct: float
    true_mass_kg: float
    measured_mass_kg: float
    sweeps: int
    bands: tuple[Band, ...]
    time_s: Array
    true_kg_s: Array
    measured_kg_s: Array
    std_dev_kg_s: Array

    @property
    def mass_error_pct(self) -> float:
        """Accumulated mass against the truth, signed."""
        return 100.0 * (self.measured_mass_kg - self.true_mass_kg) / self.true_mass_kg if self.true_mass_kg else float("nan")

    def to_json(self) -> DemoDocument:
        """The document of `demo --json`."""
        return {
            "flow_error_pct": {"mean_abs": _rounded(self.mean_abs_pct), "p95_abs": _rounded(self.p95_abs_pct)},
            "mass_error_pct": _rounded(self.mass_error_pct),
            "windows": self.windows,
            "sweeps": self.sweeps,
            "rated_windows": self.rated_windows,
            "missing_rated_windows": self.missing_rated_windows,
            "true_mass_kg": _rounded(self.true_mass_kg),
            "measured_mass_kg": _rounded(self.measured_mass_kg),
            "bands": [
                {
                    "true_flow_kg_s": [b.low_kg_s, b.high_kg_s],
                    "windows": b.windows,
                    "missing": b.missing,
                    "bias_kg_s": _rounded(b.bias_kg_s),
                    "rms_kg_s": _rounded(b.rms_kg_s),
                    "mean_abs_pct": _rounded(b.mean_abs_pct),
                    "p95_abs_pct": _rounded(b.p95_abs_pct),
                }
                for b in self.bands
            ],
        }


def assess(published: Sequence[Frame], delivered_kg: Callable[[Array], Array], delay_s: float, end_s: float) -> Accuracy:
    """Compare MassFlow and AccumulatedMass frames with the truth.

    delivered_kg: true mass past the plate by each of an array of times (s), kg. delay_s: how long before a MassFlow frame the
    second that it speaks of has ended (half a paddle pattern: frames.md). end_s: end of the run; mass is compared at its
    last MassFlow frame. A window in which the monitor says that nothing is harvested counts as a flow of 0 only where the
    true flow is below the first band's end;
    elsewhere as missing. Raises ValueError when no MassFlow frame lies in the run.
    """
    frames = [f for f in published if f.message == MASS_FLOW and delay_s + 1.0 <= f.time_s <= end_s]
    if not frames:
        raise ValueError("no MassFlow frame lies in the run")
    time_s = np.array([f.time_s for f in frames])
    true = delivered_kg(time_s - delay_s) - delivered_kg(time_s - delay_s - 1.0)
    measured = np.array([_number(f.signals["MassFlowRate"]) for f in frames])
    spread_kg_s = np.array([_number(f.signals["MassFlowStdDev"]) for f in frames])
    idle = np.array([f.signals["EstimateQuality"] == EstimateQuality.NOT_HARVESTING for f in frames])
    measured = np.where(idle & (true < BANDS_KG_S[0][1]), 0.0, measured)
    rated = true >= RATED_FROM_KG_S
    known = np.isfinite(measured)
    relative = 100.0 * np.abs(measured - true)[rated & known] / true[rated & known]
    return Accuracy(
        windows=len(frames),
        rated_windows=int(np.sum(rated)),
        missing_rated_windows=int(np.sum(rated & ~known)),
        mean_abs_pct=float(np.mean(relative)) if relative.size else float("nan"),
        p95_abs_pct=float(np.percentile(relative, 95.0)) if relative.size else float("nan"),
        true_mass_kg=float(delivered_kg(time_s[-1:] - delay_s)[0]),
        measured_mass_kg=_last_mass(published),
        sweeps=_finished_sweeps(published),
        bands=tuple(_band(low, high, true, measured) for low, high in BANDS_KG_S),
        time_s=time_s,
        true_kg_s=true,
        measured_kg_s=measured,
        std_dev_kg_s=spread_kg_s,
    )


def _band(low: float, high: float, true: Array, measured: Array) -> Band:
    inside = (true >= low) & ((true < high) | ((high == BANDS_KG_S[-1][1]) & (true >= high)))
    known = inside & np.isfinite(measured)
    error = measured[known] - true[known]
    nan = float("nan")
    if not error.size:
        return Band(
            low_kg_s=low,
            high_kg_s=high,
            windows=int(np.sum(inside)),
            missing=int(np.sum(inside)),
            bias_kg_s=nan,
            rms_kg_s=nan,
            mean_abs_pct=nan,
            p95_abs_pct=nan,
        )
    positive = true[known] > 0.0
    relative = 100.0 * np.abs(error[positive]) / true[known][positive] if low >= 2.0 else np.empty(0)
    return Band(
        low_kg_s=low,
        high_kg_s=high,
        windows=int(np.sum(inside)),
        missing=int(np.sum(inside) - error.size),
        bias_kg_s=float(np.mean(error)),
        rms_kg_s=float(np.sqrt(np.mean(error**2))),
        mean_abs_pct=float(np.mean(relative)) if relative.size else nan,
        p95_abs_pct=float(np.percentile(relative, 95.0)) if relative.size else nan,
    )


def _number(value: Value) -> float:
    return float(value) if isinstance(value, (int, float)) else float("nan")


def _last_mass(published: Sequence[Frame]) -> float:
    for frame in reversed(published):
        if frame.message == ACCUMULATED_MASS:
            mass = frame.signals["TotalMass"]
            if isinstance(mass, (int, float)):
                return float(mass)
    return float("nan")


def _finished_sweeps(published: Sequence[Frame]) -> int:
    ended = (SweepState.UPDATED, SweepState.NOT_LEARNED)
    count, before = 0, None
    for frame in published:
        if frame.message == SELF_CALIBRATION_STATUS:
            state = frame.signals["SweepState"]
            if state in ended and before not in ended:
                count += 1
            before = state
    return count


def _rounded(value: float) -> float | None:
    return None if not np.isfinite(value) else round(value, 4)
