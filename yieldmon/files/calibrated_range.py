"""The range that a calibration covers, as parameter files and curves hold it."""

from __future__ import annotations

from math import radians
from typing import Any

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import CalibratedRange
from yieldmon.physics.machine import RPM

from .checked import known_keys, span

_RANGES = {
    "mass_flow_kg_s": ("mass_flow_kg_s", "kg/s", 1.0, 0.0, 1e6),
    "plate_angle_deg": ("plate_angle_rad", "deg", radians(1.0), 0.0, 180.0),
    "elevator_speed_rpm": ("elevator_speed_rad_s", "rpm", RPM, 0.0, 1e6),
    "moisture_pct": ("moisture_pct", "%", 1.0, 0.0, 100.0),
}


def calibrated_range(document: Any, where: str) -> CalibratedRange:
    """The range in the mapping `calibrated_range`. Raises InputError naming key, value and unit."""
    if not isinstance(document, dict):
        raise InputError(f"{where}: calibrated_range", f"is {document!r}", "a mapping of ranges")
    known_keys(document, f"{where}: calibrated_range.", _RANGES)
    limits: dict[str, tuple[float, float]] = {}
    for key, value in document.items():
        attribute, unit, scale, least, most = _RANGES[key]
        low, high = span(value, f"{where}: calibrated_range.{key}", unit, least, most)
        limits[attribute] = (low * scale, high * scale)
    return CalibratedRange(**limits)


def calibrated_document(calibrated: CalibratedRange) -> dict[str, list[float]]:
    """The mapping that `calibrated_range` reads back to an equal range."""
    return {
        key: [float(_outward(v, scale)) for v in limits]
        for key, (attribute, _, scale, *_) in _RANGES.items()
        if (limits := getattr(calibrated, attribute)) is not None
    }


def _outward(value: float, scale: float) -> float:
    return value if scale == 1.0 else round(value / scale, 10)
