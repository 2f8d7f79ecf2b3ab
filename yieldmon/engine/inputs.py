"""The slow inputs: the last usable value of each, and its time.

`Inputs.take` reads frame by frame, `Inputs.follow` a run, in which each input becomes a `Track` of usable values; both apply the
same rules. An `InputSnapshot` holds the inputs at one instant.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from itertools import repeat
from math import isfinite, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.duplicate_senders import TankWatch
from yieldmon.engine.runs import FrameRun, SignalRun
from yieldmon.engine.settings import InputSettings
from yieldmon.engine.sources import CONDITIONS, DEFAULT_SOURCES, PAIRS, QUANTITIES, InputSource, Sources
from yieldmon.frames import ActuatorState, Value, number
from yieldmon.physics.numerics import Array
from yieldmon.places import is_somewhere

DEGREE = pi / 180.0
MOVING = ("elevator_speed", "plate_angle")
"""Quantities that windows interpolate, instead of using only the value at their end."""
_NAN = float("nan")
_NEVER = float("-inf")
_ALWAYS = float("inf")
_NAMES = tuple(QUANTITIES)
_TANK = "tank_mass"


class Held:
    """Last usable value of an input, in the engine's unit, and the engine time it came at."""

    __slots__ = ("time_s", "value")

    def __init__(self, value: float = _NAN, time_s: float = _NEVER) -> None:
        self.value = value
        self.time_s = time_s

    def set(self, time_s: float, value: float) -> None:
        """A new value."""
        self.value = value
        self.time_s = time_s

    def within(self, now_s: float, timeout_s: float) -> float:
        """The value while it is fresh, else nan."""
        return self.value if now_s - self.time_s <= timeout_s else _NAN


class InputSnapshot(NamedTuple):
    """The inputs at an instant of engine time.

    fresh: quantity -> value in the engine's unit, nan where it is too old. speed_time_s, scale_status, tank_time_s and tank_kg
    (the last stable reading of the tank scale) may be of any age. tank_disputed: two nodes have recently sent tank readings.
    """

    time_s: float
    speed_known: bool
    speed_time_s: float
    angle_deg: float
    actuator: int
    scale_status: float
    tank_time_s: float
    tank_kg: float
    fresh: Mapping[str, float]
    tank_disputed: bool = False

    @property
    def angle_stale(self) -> bool:
        """Whether there is no recent plate angle."""
        return not isfinite(self.angle_deg)


class Track(NamedTuple):
    """Usable values (n,) of an input in a run, and their engine times (n,), rising."""

    times_s: Array
    values: Array


class Inputs:
    """The inputs of one engine, bound to signals by `sources`."""

    def __init__(self, settings: InputSettings, sources: Sources = DEFAULT_SOURCES) -> None:
        self._sources: dict[str, list[InputSource]] = {}
        for source in sources.inputs:
            self._sources.setdefault(source.message, []).append(source)
        self._bound = {source.quantity for source in sources.inputs}
        self.tank = TankWatch()
        self._timeouts = {name: float(getattr(settings, quantity.timeout)) for name, quantity in QUANTITIES.items()}
        self.held = {name: Held() for name in QUANTITIES}
        self.held["actuator_state"].value = float(ActuatorState.IDLE)
        for name, value in sources.fixed.items():
            self.held[name].set(_ALWAYS, value * QUANTITIES[name].factor)

    @property
    def actuator(self) -> ActuatorState:
        """The state that the actuator last reported."""
        return ActuatorState(int(self.held["actuator_state"].value))

    def take(self, message: str, now_s: float, signals: Mapping[str, Value]) -> Sequence[str]:
        """Take one frame at engine time now_s; returns which of the `MOVING` quantities it contained."""
        sources = self._sources.get(message)
        if sources is None:
            return ()
        values = {source.quantity: _scaled(source, number(signals.get(source.signal))) for source in sources}
        brought = []
        for name, value in values.items():
            quantity = QUANTITIES[name]
            if quantity.usable(value) and self._pair_usable(name, values) and self._condition_holds(name, values):
                self.held[name].set(now_s, value * quantity.factor)
                if name in MOVING:
                    brought.append(name)
                elif name == _TANK:
                    self.tank.take(now_s, value)
        return brought

    def follow(self, run: FrameRun, offset_s: float) -> RunInputs:
        """The inputs over a run; engine time is bus time plus offset_s. Does not change the values held."""
        found: dict[str, tuple[SignalRun, Array]] = {}
        for part in run.others:
            unknown = np.full(part.times_s.shape, np.nan)
            for source in self._sources.get(part.message, ()):
                found[source.quantity] = part, _scaled(source, part.signals.get(source.signal, unknown))
        tracks: dict[str, Track] = {}
        for name, (part, values) in found.items():
            quantity = QUANTITIES[name]
            usable = quantity.usable(values)
            pair = found.get(PAIRS.get(name, ""))
            if pair is not None and pair[0] is part:
                usable = usable & QUANTITIES[PAIRS[name]].usable(pair[1]) & is_somewhere(values, pair[1])
            if name in CONDITIONS:
                usable = usable & self._condition_holds_by_row(name, part, found)
            tracks[name] = _track(part.times_s + offset_s, values * quantity.factor, usable)
        return RunInputs(self, tracks)

    def snapshot(self, at_s: float) -> InputSnapshot:
        """The inputs held now, their ages judged at engine time at_s."""
        held, timeouts = self.held, self._timeouts
        fresh = {name: held[name].within(at_s, timeouts[name]) for name in _NAMES}
        speed, tank = held["elevator_speed"], held["tank_mass"]
        return InputSnapshot(
            time_s=at_s,
            speed_known=at_s - speed.time_s <= timeouts["elevator_speed"],
            speed_time_s=speed.time_s,
            angle_deg=fresh["plate_angle"],
            actuator=int(self.actuator),
            scale_status=held["tank_scale_status"].value,
            tank_time_s=tank.time_s,
            tank_kg=tank.value,
            fresh=fresh,
            tank_disputed=at_s - self.tank.disputed_s <= timeouts[_TANK],
        )

    def snapshots(self, tracks: Mapping[str, Track], disputes: Track, at_s: Array) -> list[InputSnapshot]:
        """The same at several instants (n,) of a run. disputes: after each tank reading, when readings were last disputed."""
        times, values = {}, {}
        for name in _NAMES:
            held, track = self.held[name], tracks.get(name)
            if track is None:
                times[name], values[name] = np.full(at_s.shape, held.time_s), np.full(at_s.shape, held.value)
            else:
                rows = np.searchsorted(track.times_s, at_s, side="left")
                times[name] = np.append(held.time_s, track.times_s)[rows]
                values[name] = np.append(held.value, track.values)[rows]
        fresh = {name: np.where(at_s - times[name] <= self._timeouts[name], values[name], np.nan) for name in _NAMES}
        columns: tuple[NDArray[Any], ...] = (
            at_s,
            at_s - times["elevator_speed"] <= self._timeouts["elevator_speed"],
            times["elevator_speed"],
            fresh["plate_angle"],
            values["actuator_state"].astype(np.intp),
            values["tank_scale_status"],
            times["tank_mass"],
            values["tank_mass"],
        )
        by_name = zip(*(column.tolist() for column in fresh.values()), strict=True)
        held_fresh = (dict(zip(names, row, strict=True)) for names, row in zip(repeat(_NAMES), by_name, strict=False))
        disputed_s = np.append(self.tank.disputed_s, disputes.values)[np.searchsorted(disputes.times_s, at_s, side="left")]
        disputed = (at_s - disputed_s <= self._timeouts[_TANK]).tolist()
        return [InputSnapshot(*row) for row in zip(*(column.tolist() for column in columns), held_fresh, disputed, strict=True)]

    def plate_at(self, held_angle: tuple[float, float], at_s: float) -> float:
        """The plate angle, deg, at engine time at_s, from a reading (time s, angle deg); nan when it is stale."""
        time_s, angle_deg = held_angle
        return angle_deg if at_s - time_s <= self._timeouts["plate_angle"] else _NAN

    def _pair_usable(self, name: str, values: Mapping[str, float]) -> bool:
        other = PAIRS.get(name, "")
        if other not in values:
            return True
        return bool(QUANTITIES[other].usable(values[other]) and is_somewhere(values[name], values[other]))

    def _condition_holds(self, name: str, values: Mapping[str, float]) -> bool:
        """Whether the quantity that this one depends on allows its use."""
        if name not in CONDITIONS:
            return True
        other, code, must_be = CONDITIONS[name]
        if other not in self._bound:
            return True
        return (values.get(other, self.held[other].value) == code) if must_be else self.held[other].value != code

    def _condition_holds_by_row(
        self, name: str, part: SignalRun, found: Mapping[str, tuple[SignalRun, Array]]
    ) -> NDArray[np.bool_]:
        """The same for each row of a run."""
        other, code, must_be = CONDITIONS[name]
        if other not in self._bound:
            return np.ones(part.times_s.shape, dtype=bool)
        if other not in found:
            return np.full(part.times_s.shape, (self.held[other].value == code) is must_be)
        source, values = found[other]
        if must_be and source is part:
            same: NDArray[np.bool_] = values == code
            return same
        usable = QUANTITIES[other].usable(values)
        known = np.append(self.held[other].value, values[usable])
        seen = known[np.searchsorted(source.places[usable], part.places, side="right")]
        agrees: NDArray[np.bool_] = (seen == code) if must_be else (seen != code)
        return agrees


class RunInputs:
    """The inputs over one run."""

    def __init__(self, inputs: Inputs, tracks: dict[str, Track]) -> None:
        self._inputs = inputs
        self._tracks = tracks
        self._tank = inputs.tank.copy()
        readings, disputes_s = tracks.get(_TANK, _NOTHING), []
        for time_s, mass_kg in zip(readings.times_s.tolist(), readings.values.tolist(), strict=True):
            self._tank.take(time_s, mass_kg)
            disputes_s.append(self._tank.disputed_s)
        self._disputes = Track(readings.times_s, np.array(disputes_s))
        self._plate: list[list[float]] = []

    def track(self, name: str) -> Track:
        """Usable values of an input in the run."""
        return self._tracks.get(name, _NOTHING)

    def snapshots(self, at_s: Sequence[float]) -> list[InputSnapshot]:
        """The inputs at instants (n,) of the run; frames at or after an instant do not count."""
        return self._inputs.snapshots(self._tracks, self._disputes, np.array(at_s))

    def plate_at(self, at_s: float) -> tuple[float, ActuatorState]:
        """Plate angle, deg, nan while it is stale, and the actuator's state, at any instant of the run."""
        if not self._plate:
            names = ("plate_angle", "actuator_state")
            self._plate = [column.tolist() for name in names for column in self.track(name)]
        angle_times, angles, state_times, states = self._plate
        held, state = self._inputs.held["plate_angle"], self._inputs.actuator
        reading = held.time_s, held.value
        if row := bisect_left(angle_times, at_s):
            reading = angle_times[row - 1], angles[row - 1]
        if row := bisect_left(state_times, at_s):
            state = ActuatorState(int(states[row - 1]))
        return self._inputs.plate_at(reading, at_s), state

    def finish(self) -> None:
        """The run is over: hold its last values."""
        self._inputs.tank = self._tank
        for name, track in self._tracks.items():
            if track.times_s.size:
                self._inputs.held[name].set(float(track.times_s[-1]), float(track.values[-1]))


_NOTHING = Track(np.empty(0), np.empty(0))


def _scaled(source: InputSource, value: Any) -> Any:
    """A signal's value in the quantity's unit."""
    if source.scale != 1.0:
        value = value * source.scale
    return value + source.offset if source.offset != 0.0 else value


def _track(times_s: Array, values: Array, usable: NDArray[np.bool_]) -> Track:
    return Track(times_s, values) if usable.all() else Track(times_s[usable], values[usable])
