"""What `yieldmon calibrations ACTION --json` prints."""

from __future__ import annotations

from typing import Literal, TypedDict

from .common import Answered
from .undo import CalibrationUndone

CalibrationState = Literal["in use", "undone", ""]


class CalibrationRow(TypedDict):
    """A change of parameters, or an operator's zero, which has no version. time_s: Unix time; who: the user, "" for the monitor
    itself; origin: what brought it; what: the reason; state: "in use", "undone" or ""; crop: whose parameters they are, "" where
    nothing says so."""

    kind: Literal["parameters", "zero"]
    version: int | None
    time_s: float
    who: str
    origin: str
    what: str
    effects: list[str]
    state: CalibrationState
    crop: str


class Calibrations(TypedDict):
    """All calibrations, in order."""

    calibrations: list[CalibrationRow]


class CalibrationListDocument(Calibrations, Answered):
    """`yieldmon calibrations list --json`."""


class CalibrationsRestarted(TypedDict):
    """Calibration that began anew. version, before: of the parameters now and before; crop: of both, "" where none was named;
    load: that began, null where none was open; tickets: that counted until now; std_dev_pct: of the flow, until a load is
    weighed."""

    version: int
    before: int
    crop: str
    load: int | None
    tickets: list[int]
    std_dev_pct: float


class CalibrationRestartDocument(CalibrationsRestarted, Answered):
    """`yieldmon calibrations restart --json`."""


class CalibrationUndoDocument(CalibrationUndone, Answered):
    """`yieldmon calibrations undo --json`."""
