"""Whether the machine is harvesting. Not harvesting is a state of its own and never a flow of 0.

Grain decides, and the header only confirms: grain goes on arriving for seconds after the header went up, and it counts.
"""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.engine.settings import GateSettings


@dataclass(frozen=True, slots=True)
class GateInputs:
    """One window as input of the gate.

    force_n: mean above the zero (nan: unknown). pulses: this window has paddle pulses beyond vibration. looks_empty,
    looks_loaded: verdicts on the windows before; this window's own pulses overrule looks_empty. speed_in_range: the elevator
    turns at a speed at which grain is measured. idle_s: how long header, work state or ground speed have indicated that no crop
    is taken in (0: they do not, or are not fitted).
    """

    force_n: float
    pulses: bool
    looks_empty: bool
    looks_loaded: bool
    speed_in_range: bool
    idle_s: float = 0.0


class HarvestGate:
    """Opens with the first window that holds grain, closes after several without."""

    def __init__(self, settings: GateSettings) -> None:
        self._settings = settings
        self.harvesting = False
        self._without = 0

    def grain(self, inputs: GateInputs) -> bool:
        """Whether a window holds grain."""
        if inputs.looks_empty and not inputs.pulses:
            return False
        if inputs.force_n > self._settings.certain_force_n:
            return True
        if self.harvesting:
            return inputs.force_n > self._settings.grain_off_n
        return inputs.force_n > self._settings.grain_on_n and (inputs.pulses or inputs.looks_loaded)

    def see(self, inputs: GateInputs) -> bool:
        """Update the state with one window; returns whether the machine is harvesting."""
        emptied = inputs.idle_s >= self._settings.emptying_s and not inputs.force_n > self._settings.certain_force_n
        if emptied or not inputs.speed_in_range:
            self.harvesting = False
        elif self.grain(inputs):
            self.harvesting = True
            self._without = 0
        elif self.harvesting:
            self._without += 1
            self.harvesting = self._without < self._settings.off_windows
        if not self.harvesting:
            self._without = 0
        return self.harvesting
