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
from yieldmon.documents.calibrations import CalibrationListDocument, CalibrationRestartDocument, CalibrationUndoDocument
from yieldmon.documents.check_config import CheckDocument
from yieldmon.documents.demo import DemoDocument
from yieldmon.documents.diagnose import DiagnosisDocument
from yieldmon.documents.estimate import EstimateDocument
from yieldmon.documents.fleet import (
    FleetCompareDocument,
    FleetDiagnosisDocument,
    FleetPriorDocument,
    FleetReportDocument,
    FleetRunDocument,
)
from yieldmon.documents.harvest_map import MapDocument
from yieldmon.documents.loads import LoadCorrectDocument, LoadListDocument, LoadStartDocument, LoadStopDocument
from yieldmon.documents.monitor import MonitorDocument
from yieldmon.documents.pack import PackDocument
from yieldmon.documents.predict import PredictionDocument
from yieldmon.documents.process import ProcessSummary, ReprocessSummary
from yieldmon.documents.replay import ReplayDocument
from yieldmon.documents.self_calibrate import SelfCalibrationDocument
from yieldmon.documents.setup import SetupDocument
from yieldmon.documents.signals import SurveyDocument
from yieldmon.documents.simulate import SimulationDocument
from yieldmon.documents.status import Status
from yieldmon.documents.tickets import TicketDocument, TicketListDocument, TicketUndoDocument
from yieldmon.documents.zero import ZeroDocument, ZeroUndoDocument

#: Name of the schema -> type.
DOCUMENTS: dict[str, Any] = {
    "setup": SetupDocument,
    "check-config": CheckDocument,
    "signals": SurveyDocument,
    "status": Status,
    "monitor": MonitorDocument,
    "zero": ZeroDocument,
    "zero-undo": ZeroUndoDocument,
    "calibrations-list": CalibrationListDocument,
    "calibrations-restart": CalibrationRestartDocument,
    "calibrations-undo": CalibrationUndoDocument,
    "process": ProcessSummary,
    "process-store": ReprocessSummary,
    "pack": PackDocument,
    "replay": ReplayDocument,
    "simulate": SimulationDocument,
    "predict": PredictionDocument,
    "estimate": EstimateDocument,
    "calibrate": CalibrationDocument,
    "calibrate-curve": CurveCalibrationDocument,
    "calibrate-loads": LoadCalibrationDocument,
    "calibrate-pulse-shape": PulseShapeDocument,
    "calibrate-taps": TapDocument,
    "self-calibrate": SelfCalibrationDocument,
    "diagnose": DiagnosisDocument,
    "map": MapDocument,
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
