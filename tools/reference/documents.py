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
from yieldmon.documents.demo import DemoDocument
from yieldmon.documents.diagnose import DiagnosisDocument
from yieldmon.documents.fleet import (
    FleetCompareDocument,
    FleetDiagnosisDocument,
    FleetPriorDocument,
    FleetReportDocument,
    FleetRunDocument,
)
from yieldmon.documents.harvest_map import MapDocument
from yieldmon.documents.loads import LoadCorrectDocument, LoadListDocument, LoadStartDocument, LoadStopDocument
from yieldmon.documents.process import ProcessSummary
from yieldmon.documents.self_calibrate import SelfCalibrationDocument
from yieldmon.documents.signals import SurveyDocument
from yieldmon.documents.status import Status
from yieldmon.documents.tickets import TicketDocument, TicketListDocument, TicketUndoDocument

#: Name of the schema -> type.
DOCUMENTS: dict[str, Any] = {
    "status": Status,
    "process": ProcessSummary,
    "calibrate": CalibrationDocument,
    "calibrate-curve": CurveCalibrationDocument,
    "calibrate-loads": LoadCalibrationDocument,
    "calibrate-pulse-shape": PulseShapeDocument,
    "calibrate-taps": TapDocument,
    "self-calibrate": SelfCalibrationDocument,
    "diagnose": DiagnosisDocument,
    "map": MapDocument,
    "signals": SurveyDocument,
    "demo": DemoDocument,
    "load-start": LoadStartDocument,
    "load-stop": LoadStopDocument,
    "load-list": LoadListDocument,
    "load-correct": LoadCorrectDocument,
    "ticket": TicketDocument,
    "ticket-list": TicketListDocument,
    "ticket-undo": TicketUndoDocument,
    "fleet-run": FleetRunDocument,
    "fleet-report": FleetReportDocument,
    "fleet-compare": FleetCompareDocument,
    "fleet-prior": FleetPriorDocument,
    "fleet-diagnose": FleetDiagnosisDocument,
}
