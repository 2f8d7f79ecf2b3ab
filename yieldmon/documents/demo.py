"""What `yieldmon demo --json` prints."""

from __future__ import annotations

from typing import TypedDict

from .common import Number


class FlowError(TypedDict):
    """Relative error of the 1 Hz flow, %, of windows whose true flow is 4 kg/s or more: mean, and 95th percentile."""

    mean_abs: Number
    p95_abs: Number


class BandDocument(TypedDict):
    """Windows by true flow, lowest and highest. missing: those without a number; null where there is none with one."""

    true_flow_kg_s: list[float]
    windows: int
    missing: int
    bias_kg_s: Number
    rms_kg_s: Number
    mean_abs_pct: Number
    p95_abs_pct: Number


class DemoDocument(TypedDict):
    """`yieldmon demo --json`. mass_error_pct: measured less true mass; rated_windows: those that flow_error_pct counts, with the
    missing ones."""

    flow_error_pct: FlowError
    mass_error_pct: Number
    windows: int
    sweeps: int
    rated_windows: int
    missing_rated_windows: int
    true_mass_kg: Number
    measured_mass_kg: Number
    bands: list[BandDocument]
