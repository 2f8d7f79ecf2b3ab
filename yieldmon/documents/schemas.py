"""Every document, by the name of its schema."""

from __future__ import annotations

from typing import Any

from .calibrate import CalibrationDocument, CurveCalibrationDocument, LoadCalibrationDocument, PulseShapeDocument, TapDocument
from .diagnose import DiagnosisDocument
from .process import ProcessSummary
from .status import Status

#: Name of the schema -> type.
DOCUMENTS: dict[str, Any] = {
    "status": Status,
    "process": ProcessSummary,
    "calibrate": CalibrationDocument,
    "calibrate-curve": CurveCalibrationDocument,
    "calibrate-loads": LoadCalibrationDocument,
    "calibrate-pulse-shape": PulseShapeDocument,
    "calibrate-taps": TapDocument,
    "diagnose": DiagnosisDocument,
}
