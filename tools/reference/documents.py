"""Every document, by the name of its schema."""

from __future__ import annotations

from typing import Any

from yieldmon.documents.calibrate import (
    CalibrationDocument,
    CurveCalibrationDocument,
    LoadCalibrationDocument,
    PulseShapeDocument,
    TapDocument,
)
from yieldmon.documents.diagnose import DiagnosisDocument
from yieldmon.documents.harvest_map import MapDocument
from yieldmon.documents.process import ProcessSummary
from yieldmon.documents.signals import SurveyDocument
from yieldmon.documents.status import Status

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
    "map": MapDocument,
    "signals": SurveyDocument,
}
