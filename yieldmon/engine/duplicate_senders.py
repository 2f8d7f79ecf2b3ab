"""Signs that two nodes send one slow input: more frames than its cycle allows, and values that leap up and down faster than the
machine can."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, radians

import numpy as np

from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.segments import Counts
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

_CROWDED_SHARE, _CROWDED_FRAMES = 0.2, 2.0
"""So many frames more than the cycle allows come late or early because of others on the bus."""
_LONGEST_LEAP_S = 0.5
"""Values further apart than this are no leap: anything may have happened between them."""
_SPEED_STEP, _SPEED_RATE_PER_S = 0.15, 1.0
"""Of the nominal elevator speed: what a reading may be off, and how fast a clutch brings the elevator there."""
_ANGLE_STEP_DEG, _ANGLE_RATE_DEG_S = 1.5, 40.0
"""The same for the plate: twice the fastest rate at which it is driven."""
_TANK_STEP_KG, _TANK_RATE_KG_S = 100.0, 300.0
"""The same for the grain tank: twice what an unloading auger takes out."""
_TANK_LONGEST_LEAP_S, _TANK_MEMORY_S = 1.5, 3.0


@dataclass(frozen=True, slots=True)
class SignalLimits:
    """What one sender of an input does: a value every interval_s (nan: not known), none further from the one before it than step
    and rate times the time between them. step, rate: in the input's unit, and that per second."""

    interval_s: float
    step: float
    rate: float


def speed_limits(machine: Machine, interval_s: float) -> SignalLimits:
    """Of the elevator's speed, rad/s."""
    nominal = machine.nominal_elevator_speed_rad_s
    return SignalLimits(interval_s, _SPEED_STEP * nominal, _SPEED_RATE_PER_S * nominal)


def angle_limits(interval_s: float) -> SignalLimits:
    """Of the plate's angle, rad."""
    return SignalLimits(interval_s, radians(_ANGLE_STEP_DEG), radians(_ANGLE_RATE_DEG_S))


class Crowding:
    """Counts frames that come closer together than one sender sends them, whatever they carry."""

    def __init__(self, share: float, frames: float, interval_s: float) -> None:
        """share, frames: so many more than the cycle allows are bunched by the bus. interval_s: the cycle; nan: not known."""
        self._share = share
        self._frames = frames
        self._interval_s = interval_s
        self._late = 0.0

    def take(self, arrived: Counts, edges_s: Array, lost: Counts | int = 0) -> Counts:
        """Frames of each window (w,) beyond what is possible. Those that the window before lacks, though none was lost, have come
        late.

        arrived (w,): frames that came. edges_s (w + 1,): the windows' edges. lost: of those due, known not to come.
        """
        if not isfinite(self._interval_s):
            return np.zeros(arrived.size, np.intp)
        due = np.diff(edges_s) / self._interval_s
        late = np.concatenate(([self._late], np.maximum(due - arrived - lost, 0.0)))
        self._late = float(late[-1])
        possible = due * (1.0 + self._share) + self._frames + late[:-1]
        return np.floor(np.maximum(arrived - possible, 0.0)).astype(np.intp)


class DuplicateSenderWatch:
    """Judges the values of one input, window by window; a leap up counts with one down in the same window or the one before."""

    def __init__(self, limits: SignalLimits) -> None:
        self._limits = limits
        self._last_time_s = self._last_value = float("nan")
        self._before = (0, 0)
        self._crowding = Crowding(_CROWDED_SHARE, _CROWDED_FRAMES, limits.interval_s)

    def take(self, times_s: Array, values: Array, bounds: Counts, edges_s: Array) -> Counts:
        """Values of each window (w,) that a second sender accounts for.

        times_s, values (n,): in the order of arrival. bounds (w + 1,): first value of each window and the end of the last.
        edges_s (w + 1,): the windows' edges.
        """
        limits = self._limits
        step_s = segments.steps(self._last_time_s, times_s)
        change = segments.steps(self._last_value, values)
        if times_s.size:
            self._last_time_s, self._last_value = float(times_s[-1]), float(values[-1])
        with np.errstate(invalid="ignore"):
            leaps = np.abs(change) > limits.step + limits.rate * np.maximum(step_s, 0.0)
            leaps &= np.abs(step_s) <= _LONGEST_LEAP_S
        crowded = self._crowding.take(np.diff(bounds), edges_s)
        if not leaps.any() and not any(self._before):
            return crowded
        ups, downs = (segments.count(leaps & (change * sign > 0.0), bounds) for sign in (1.0, -1.0))
        both = (ups + _shifted(ups, self._before[0]) > 0) & (downs + _shifted(downs, self._before[1]) > 0)
        self._before = int(ups[-1]), int(downs[-1])
        return np.maximum(np.where(both, ups + downs, 0), crowded)


def _shifted(counts: Counts, first: int) -> Counts:
    """Those of the window before each."""
    return np.concatenate(([first], counts[:-1])).astype(np.intp)


def tank_leaps(step_s: float, change_kg: float) -> bool:
    """Whether no tank gains or loses so much in this time."""
    return abs(step_s) <= _TANK_LONGEST_LEAP_S and abs(change_kg) > _TANK_STEP_KG + _TANK_RATE_KG_S * max(step_s, 0.0)


class TankWatch:
    """Judges the readings of the tank's scale one by one, which come once a second."""

    def __init__(self, last: tuple[float, float] = (float("nan"), 0.0), leaps_s: tuple[float, float] = (-inf, -inf)) -> None:
        self._last = last
        self._leaps_s = leaps_s
        self.disputed_s = -inf
        """When a reading last contradicted the one before it, both ways within a few seconds."""

    def copy(self) -> TankWatch:
        """One that goes on from here by itself."""
        other = TankWatch(self._last, self._leaps_s)
        other.disputed_s = self.disputed_s
        return other

    def take(self, time_s: float, mass_kg: float) -> None:
        """The next stable reading."""
        (last_s, last_kg), (up_s, down_s) = self._last, self._leaps_s
        self._last = time_s, mass_kg
        step_s, change_kg = time_s - last_s, mass_kg - last_kg
        if not tank_leaps(step_s, change_kg):
            return
        self._leaps_s = up_s, down_s = (time_s, down_s) if change_kg > 0.0 else (up_s, time_s)
        if abs(up_s - down_s) <= _TANK_MEMORY_S:
            self.disputed_s = time_s
