"""What the monitor returns: a `WindowResult` for each closed window, and the plate commands between.

Events are in the order in which they happened; each is returned once, with the window or command it belongs to.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from yieldmon.engine.health import FaultEvent
from yieldmon.engine.mass.load_summary import LoadClosed, LoadOpened, LoadRestated
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.engine.sweeps.plate import SweepEnded
from yieldmon.engine.waveform.waveform_reading import NOTHING, WaveformReading
from yieldmon.frames import Frame


@dataclass(frozen=True, slots=True)
class ZeroTaken:
    """A zero-load voltage was taken: the first, or the operator's."""

    time_s: float
    zero_mv: float


Event = FaultEvent | LoadOpened | LoadClosed | LoadRestated | ParametersChanged | SweepEnded | ZeroTaken


@dataclass(frozen=True, slots=True)
class WindowResult:
    """A window has closed: its record, the frames that publish it, and what happened with it.

    Parameters
    ----------
    record : WindowRecord
        Times in s, mass flow in kg/s, masses in kg, angles in rad, speeds in rad/s; nan where there is none.
    frames : tuple of Frame
        Frames to send, in order.
    events : tuple
        In the order in which they happened: faults, loads opened and closed, parameters changed, sweeps ended, zeros taken.
    waveform : WaveformReading
        Shape and kernel noise of the window's samples; nan and None where they are not evaluated.

    Examples
    --------
    See `Monitor`.
    """

    record: WindowRecord
    frames: tuple[Frame, ...] = ()
    events: tuple[Event, ...] = ()
    waveform: WaveformReading = NOTHING


@dataclass(frozen=True, slots=True)
class PlateCommand:
    """A command to the plate, between two windows."""

    frames: tuple[Frame, ...]
    events: tuple[Event, ...] = ()


Result = WindowResult | PlateCommand


def frames_in(results: Iterable[Result]) -> list[Frame]:
    """All frames to send, in order."""
    return [frame for result in results for frame in result.frames]


def windows_in(results: Iterable[Result]) -> list[WindowResult]:
    """The windows that closed, in order."""
    return [result for result in results if isinstance(result, WindowResult)]


def records_in(results: Iterable[Result]) -> list[WindowRecord]:
    """The records of the windows that closed, in order."""
    return [result.record for result in windows_in(results)]


def events_in(results: Iterable[Result]) -> list[Event]:
    """All that happened, in order."""
    return [event for result in results for event in result.events]
