"""The plate: demands of the sweep, and the commands sent."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sweeps.plate_commands import RELEASE, PlateCommander
from yieldmon.engine.sweeps.sweep import PlateSweep
from yieldmon.engine.sweeps.sweep_follower import SweepFollower
from yieldmon.engine.sweeps.sweep_inputs import PlateReading
from yieldmon.engine.sweeps.sweep_machine import SweepMachine
from yieldmon.frames import ActuatorState, CommandMode, SweepState, Value
from yieldmon.physics.machine import Machine

_plate_reading = maker_of(PlateReading)
_ENDS = frozenset({SweepState.ABORTED, SweepState.UPDATED, SweepState.NOT_LEARNED})


@dataclass(frozen=True, slots=True)
class SweepEnded:
    """A sweep is over. state: ABORTED, UPDATED or NOT_LEARNED; reason: one sentence; angles_deg: the sequence it was to visit;
    parameter_version: in use since."""

    sweep_id: int
    state: SweepState
    reason: str
    angles_deg: tuple[float, ...]
    parameter_version: int


class Plate:
    """One plate with its sweeps. driving: commands go out. driven: False in a log, whose plate follows no command."""

    def __init__(self, settings: EngineSettings, machine: Machine, *, driven: bool = True) -> None:
        kind = SweepMachine if driven else SweepFollower
        self.sweep: PlateSweep = kind(settings.sweep, settings.plate, degrees(machine.home_plate_angle_rad))
        self.driving = False
        self._commander = PlateCommander(settings.plate, machine)
        self._ended_id = 0

    def tick(self, at_s: float, angle_deg: float, actuator: ActuatorState) -> dict[str, Value] | None:
        """Advance the sweep; returns the signals of the command to send, None for none."""
        demand = self.sweep.tick(_plate_reading(at_s, angle_deg, actuator))
        if demand is None:
            if not self.driving:
                return None
            demand = RELEASE
        self.driving = demand.mode is not CommandMode.RELEASE
        return self._commander.command(demand, angle_deg)

    def ended(self, last_update: str, parameter_version: int) -> tuple[SweepEnded, ...]:
        """The end of the sweep, once for each sweep, even if the plate is driven home later. last_update: its outcome."""
        sweep = self.sweep
        if sweep.sweep_id == self._ended_id or sweep.state not in _ENDS:
            return ()
        self._ended_id = sweep.sweep_id
        aborted = sweep.abort_reason.value if sweep.abort_reason is not None else ""
        reason = aborted if sweep.state is SweepState.ABORTED else last_update
        return (SweepEnded(sweep.sweep_id, sweep.state, reason, tuple(sweep.sequence), parameter_version),)

    def restore(self, sweep_id: int, due_in_s: float, first_after_s: float) -> None:
        """Continue from a snapshot."""
        self._ended_id = sweep_id
        self.sweep.restore(sweep_id, max(first_after_s, due_in_s))
