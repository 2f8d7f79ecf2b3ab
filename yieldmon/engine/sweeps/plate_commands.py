"""The one place where a plate command is made: range, rate and counter of PlateActuatorCommand.

No command has a target outside the machine's range, or further from the last target than the rate allows, whatever is demanded
and whatever was received before.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, isfinite

from yieldmon.engine.settings import PlateSettings
from yieldmon.frames import NOT_AVAILABLE, CommandMode, Value
from yieldmon.physics.machine import Machine


@dataclass(frozen=True, slots=True)
class PlateDemand:
    """A demand on the plate. target_deg: for GO_TO_ANGLE only."""

    mode: CommandMode
    target_deg: float | None = None


RELEASE = PlateDemand(CommandMode.RELEASE)
GO_HOME = PlateDemand(CommandMode.GO_HOME)


class PlateCommander:
    """Turns demands into command signals, one every command interval while the plate is driven."""

    def __init__(self, settings: PlateSettings, machine: Machine) -> None:
        self._step_deg = settings.max_rate_deg_s * settings.command_interval_s
        self._modulus = settings.command_counter_modulus
        self.min_deg = degrees(machine.min_plate_angle_rad)
        self.max_deg = degrees(machine.max_plate_angle_rad)
        self.home_deg = degrees(machine.home_plate_angle_rad)
        self._last_deg: float | None = None
        self._counter = 0

    def command(self, demand: PlateDemand, measured_deg: float) -> dict[str, Value]:
        """Signals of the next command. measured_deg: where the plate is (nan: unknown), from where the first target starts.

        With a target that is no number the plate goes home.
        """
        counter = self._counter
        self._counter = (counter + 1) % self._modulus
        mode = demand.mode
        if mode is CommandMode.RELEASE:
            self._last_deg = None
            return {"TargetPlateAngle": NOT_AVAILABLE, "CommandMode": int(mode), "CommandCounter": counter}
        wanted = demand.target_deg
        if mode is not CommandMode.GO_TO_ANGLE or wanted is None or not isfinite(wanted):
            mode, wanted = CommandMode.GO_HOME, self.home_deg
        start = self._last_deg if self._last_deg is not None else measured_deg
        if not isfinite(start):
            start = self.home_deg
        start = self._within_range(start)
        wanted = self._within_range(wanted)
        target = start + min(self._step_deg, max(-self._step_deg, wanted - start))
        self._last_deg = target
        return {"TargetPlateAngle": target, "CommandMode": int(mode), "CommandCounter": counter}

    def _within_range(self, angle_deg: float) -> float:
        return min(self.max_deg, max(self.min_deg, angle_deg))
