"""What a sweep of the plate shows to the rest of the engine, whether it is driven or only followed in a log."""

from __future__ import annotations

from abc import ABC, abstractmethod

from yieldmon.engine.settings import PlateSettings, SweepSettings
from yieldmon.engine.sweeps.plate_commands import PlateDemand
from yieldmon.engine.sweeps.steady_home import SteadyHome
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort, SweepWindow
from yieldmon.engine.sweeps.sweep_measurement import SweepMeasurement
from yieldmon.engine.sweeps.sweep_schedule import SweepSchedule
from yieldmon.frames import SweepState

RESTING = frozenset({SweepState.IDLE, SweepState.WAITING, SweepState.ABORTED, SweepState.UPDATED, SweepState.NOT_LEARNED})
"""States in which the plate is not driven."""
VISITING = frozenset({SweepState.MOVING, SweepState.SETTLING, SweepState.MEASURING})
"""States of a sweep under way."""


def sweep_sequence(angles_deg: tuple[float, ...], home_deg: float, home_every: int) -> tuple[float, ...]:
    """Angles to visit: home first and last, and after every home_every angles."""
    sequence = [home_deg]
    for number, angle in enumerate(angles_deg, start=1):
        sequence.append(angle)
        if number % home_every == 0 or number == len(angles_deg):
            sequence.append(home_deg)
    return tuple(sequence)


class PlateSweep(ABC):
    """The sweeps of one plate. Times are engine time, s.

    Attributes
    ----------
    sequence : tuple of float
        Angles that the sweep visits, deg.
    state : SweepState
    abort_reason : SweepAbort or None
        Why the last sweep ended early; None when it did not.
    sweep_id : int
        Number of the last sweep.
    step : int
        Place in the sequence; -1 outside a sweep.
    completed : bool
        All steps are measured; the owner calls `finish`.
    not_following : bool
        The last movement did not arrive; the next one that does clears it.
    schedule : SweepSchedule
    """

    def __init__(self, settings: SweepSettings, plate: PlateSettings, home_deg: float) -> None:
        self._settings = settings
        self._plate = plate
        self._home_deg = home_deg
        self.sequence = sweep_sequence(settings.angles_deg, home_deg, settings.home_every)
        self.state = SweepState.IDLE
        self.abort_reason: SweepAbort | None = None
        self.sweep_id = 0
        self.step = -1
        self.completed = False
        self.not_following = False
        self.schedule = SweepSchedule(settings)
        self._home = SteadyHome(settings)
        self._measurement = SweepMeasurement(settings)
        self._settled_s = 0.0

    @abstractmethod
    def request(self) -> None:
        """Operator: sweep as soon as the conditions hold, due or not."""

    @abstractmethod
    def abort(self, now_s: float, reason: SweepAbort = SweepAbort.OPERATOR) -> bool:
        """End the sweep under way, if any. False where there was none."""

    @abstractmethod
    def tick(self, plate: PlateReading) -> PlateDemand | None:
        """Advance the time; returns the demand on the plate, None where it is not driven."""

    @abstractmethod
    def window(self, window: SweepWindow) -> int:
        """Take a closed window. Returns the sweep step that it counts for, or -1."""

    @property
    def lead(self) -> int:
        """How many of the newest windows would belong to a sweep that begins now."""
        return 0

    @property
    def driving(self) -> bool:
        """Whether commands go to the plate."""
        return self.state not in RESTING

    @property
    def visiting(self) -> bool:
        """Whether a sweep is under way."""
        return self.state in VISITING

    @property
    def progress_pct(self) -> float:
        """Share of the steps done, %; 0 outside a sweep and 100 after a whole one."""
        if self.state in (SweepState.UPDATED, SweepState.NOT_LEARNED):
            return 100.0
        return 100.0 * max(0, self.step) / len(self.sequence) if self.visiting else 0.0

    def is_home_again(self, step: int) -> bool:
        """Whether a step of the sweep is a visit home after one away from it."""
        return step > 0 and self.sequence[step] == self._home_deg

    def could_begin(self, now_s: float) -> bool:
        """Whether the next sweep of the schedule is due, and flow and elevator speed at home are steady."""
        return self.state in RESTING and self.schedule.is_due(now_s) and self._home.steady

    def restore(self, sweep_id: int, first_after_s: float) -> None:
        """After a restart: the last sweep's number, and the time from the first tick to the next sweep, s."""
        self.sweep_id, self.schedule.first_after_s = sweep_id, first_after_s

    def finish(self, now_s: float, updated: bool) -> None:
        """After `completed`: whether the sweep changed the parameters."""
        self.completed = False
        self.step = -1
        self.schedule.finished(now_s)
        self._enter(SweepState.UPDATED if updated else SweepState.NOT_LEARNED)

    def implausible_feedback(self) -> bool:
        """See `SweepMeasurement.implausible_feedback`."""
        return self._measurement.implausible_feedback()

    def _usable(self, window: SweepWindow) -> bool:
        """Whether a window with a flow lies wholly in a visit whose plate and signal have settled."""
        settled = self.state is SweepState.MEASURING and window.support_start_s >= self._settled_s and window.still
        return settled and not window.trend > self._settings.signal_trend

    def _enter(self, state: SweepState) -> None:
        self.state = state
