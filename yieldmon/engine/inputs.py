"""What the engine holds of its slow inputs: the last usable value of each and when it came.

Two ways in, one set of rules: `Inputs.take` frame by frame, `Inputs.follow` over a run, in which each input becomes a `Track` of
usable values. A `Moment` is what is held at one instant.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon import frames as bus
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.settings import InputSettings
from yieldmon.engine.windows import number
from yieldmon.frames import ActuatorState, ScaleStatus, Value
from yieldmon.physics.machine import RPM

Array = NDArray[np.float64]

DEGREE = pi / 180.0
_NAN = float("nan")
_NEVER = float("-inf")
_MAX_PLAUSIBLE_RPM = 3000.0
_MAX_PLAUSIBLE_ANGLE_DEG = 180.0
_KMH = 1.0 / 3.6


class Held:
    """Last usable value of an input and the engine time it came at."""

    __slots__ = ("time_s", "value")

    def __init__(self) -> None:
        self.value = _NAN
        self.time_s = _NEVER

    def set(self, time_s: float, value: float) -> None:
        """A new value."""
        self.value = value
        self.time_s = time_s

    def within(self, now_s: float, timeout_s: float) -> float:
        """The value while it is fresh, else nan."""
        return self.value if now_s - self.time_s <= timeout_s else _NAN


class Moment(NamedTuple):
    """What is held at an instant of engine time, nan for what is too old; speed_time_s, scale_status and the last stable reading
    of the tank scale are of any age."""

    time_s: float
    speed_known: bool
    speed_time_s: float
    angle_deg: float
    actuator: int
    moisture_pct: float
    test_weight_kg_m3: float
    header_down: float
    working: float
    ground_speed_m_s: float
    course_deg: float
    latitude_deg: float
    longitude_deg: float
    scale_status: float
    fresh_scale_status: float
    tank_time_s: float
    tank_kg: float


class Track(NamedTuple):
    """Usable values of an input over a run, by engine time, rising; both (n,)."""

    times_s: Array
    values: Array


@dataclass(frozen=True, slots=True)
class _Rule:
    """Which input a signal feeds, which of its values are usable (floats or arrays), its factor into the engine's unit."""

    held: str
    signal: str
    usable: Callable[[Any], Any]
    factor: float = 1.0


def _is_flag(value: Any) -> Any:
    return (value == 0.0) | (value == 1.0)


_RULES: Mapping[str, tuple[_Rule, ...]] = {
    bus.ELEVATOR_SPEED: (
        _Rule("speed_rad_s", "ElevatorSpeed", lambda rpm: (rpm >= 0.0) & (rpm <= _MAX_PLAUSIBLE_RPM), RPM),
    ),
    bus.GRAIN_CONDITION: (
        _Rule("moisture_pct", "Moisture", lambda moisture: (moisture >= 0.0) & (moisture < 100.0)),
        _Rule("test_weight_kg_m3", "TestWeight", lambda weight: weight > 0.0),
    ),
    bus.TANK_SCALE: (_Rule("scale_status", "TankScaleStatus", lambda status: status == status),),  # noqa: PLR0124
    bus.HARVEST_STATE: (_Rule("header_down", "HeaderDown", _is_flag), _Rule("working", "WorkState", _is_flag)),
    bus.VEHICLE_DIRECTION_SPEED: (
        _Rule("course_deg", "CompassBearing", lambda course: (course >= 0.0) & (course <= 360.0)),
        _Rule("ground_speed_m_s", "NavigationSpeed", lambda speed: speed >= 0.0, _KMH),
    ),
}
_ACTUATOR_STATES = tuple(float(state) for state in ActuatorState)


def _is_place(latitude: Any, longitude: Any) -> Any:
    return (abs(latitude) <= 90.0) & (abs(longitude) <= 180.0)


def _is_plate_angle(angle_deg: Any) -> Any:
    return (angle_deg >= 0.0) & (angle_deg <= _MAX_PLAUSIBLE_ANGLE_DEG)


def _is_weighing(status: Any, mass_kg: Any) -> Any:
    return (status == float(ScaleStatus.STABLE)) & (mass_kg == mass_kg)  # noqa: PLR0124


_HELD = (
    "speed_rad_s", "angle_deg", "moisture_pct", "test_weight_kg_m3", "scale_status", "tank_kg", "header_down", "working",
    "latitude_deg", "longitude_deg", "course_deg", "ground_speed_m_s",
)  # fmt: skip


class Inputs:
    """The inputs of one engine. actuator: the state last reported."""

    def __init__(self, settings: InputSettings) -> None:
        self._settings = settings
        self.held = {name: Held() for name in _HELD}
        self.actuator = ActuatorState.IDLE

    def take(self, message: str, now_s: float, signals: Mapping[str, Value]) -> bool:
        """One frame at engine time now_s; whether it brought an elevator speed or a plate angle."""
        taken = False
        for rule in _RULES.get(message, ()):
            value = number(signals.get(rule.signal))
            if rule.usable(value):
                self.held[rule.held].set(now_s, value * rule.factor)
                taken = message == bus.ELEVATOR_SPEED
        if message == bus.PLATE_ACTUATOR_FEEDBACK:
            state, angle = number(signals.get("ActuatorState")), number(signals.get("PlateAngle"))
            if state in _ACTUATOR_STATES:
                self.actuator = ActuatorState(int(state))
            if _is_plate_angle(angle) and self.actuator is not ActuatorState.FAULT:
                self.held["angle_deg"].set(now_s, angle)
                taken = True
        elif message == bus.TANK_SCALE:
            mass = number(signals.get("TankMass"))
            if _is_weighing(number(signals.get("TankScaleStatus")), mass):
                self.held["tank_kg"].set(now_s, mass)
        elif message == bus.VEHICLE_POSITION:
            latitude, longitude = number(signals.get("Latitude")), number(signals.get("Longitude"))
            if _is_place(latitude, longitude):
                self.held["latitude_deg"].set(now_s, latitude)
                self.held["longitude_deg"].set(now_s, longitude)
        return taken

    def follow(self, run: FrameRun, offset_s: float) -> RunInputs:
        """The inputs over a run whose bus time plus offset_s is engine time; what is held stays as it is."""
        tracks: dict[str, Track] = {}
        for part in run.others:
            times, get = part.times_s + offset_s, part.signals.get
            unknown = np.full(times.shape, np.nan)
            for rule in _RULES.get(part.message, ()):
                values = get(rule.signal, unknown)
                tracks[rule.held] = _track(times, values * rule.factor, rule.usable(values))
            if part.message == bus.PLATE_ACTUATOR_FEEDBACK:
                states = self._states(get("ActuatorState", unknown))
                angles = get("PlateAngle", unknown)
                tracks["actuator"] = Track(times, states)
                usable = _is_plate_angle(angles) & (states != float(ActuatorState.FAULT))
                tracks["angle_deg"] = _track(times, angles, usable)
            elif part.message == bus.TANK_SCALE:
                masses = get("TankMass", unknown)
                tracks["tank_kg"] = _track(times, masses, _is_weighing(get("TankScaleStatus", unknown), masses))
            elif part.message == bus.VEHICLE_POSITION:
                latitude, longitude = get("Latitude", unknown), get("Longitude", unknown)
                usable = _is_place(latitude, longitude)
                tracks["latitude_deg"] = _track(times, latitude, usable)
                tracks["longitude_deg"] = _track(times, longitude, usable)
        return RunInputs(self, tracks)

    def moment(self, at_s: float) -> Moment:
        """What is held now, seen from engine time at_s."""
        held, settings = self.held, self._settings
        vehicle, condition = settings.vehicle_timeout_s, settings.condition_timeout_s
        speed = held["speed_rad_s"]
        return Moment(
            time_s=at_s,
            speed_known=at_s - speed.time_s <= settings.speed_timeout_s,
            speed_time_s=speed.time_s,
            angle_deg=held["angle_deg"].within(at_s, settings.feedback_timeout_s),
            actuator=int(self.actuator),
            moisture_pct=held["moisture_pct"].within(at_s, condition),
            test_weight_kg_m3=held["test_weight_kg_m3"].within(at_s, condition),
            header_down=held["header_down"].within(at_s, vehicle),
            working=held["working"].within(at_s, vehicle),
            ground_speed_m_s=held["ground_speed_m_s"].within(at_s, vehicle),
            course_deg=held["course_deg"].within(at_s, vehicle),
            latitude_deg=held["latitude_deg"].within(at_s, vehicle),
            longitude_deg=held["longitude_deg"].within(at_s, vehicle),
            scale_status=held["scale_status"].value,
            fresh_scale_status=held["scale_status"].within(at_s, settings.scale_timeout_s),
            tank_time_s=held["tank_kg"].time_s,
            tank_kg=held["tank_kg"].value,
        )

    def moments(self, tracks: Mapping[str, Track], at_s: Array) -> list[Moment]:
        """The same for several instants of a run (n,)."""
        settings = self._settings
        vehicle, condition = settings.vehicle_timeout_s, settings.condition_timeout_s

        def last(name: str) -> tuple[Array, Array]:
            held, track = self.held[name], tracks.get(name)
            if track is None:
                return np.full(at_s.shape, held.time_s), np.full(at_s.shape, held.value)
            rows = np.searchsorted(track.times_s, at_s, side="left")
            return np.append(held.time_s, track.times_s)[rows], np.append(held.value, track.values)[rows]

        def fresh(name: str, timeout_s: float) -> Array:
            times, values = last(name)
            return np.where(at_s - times <= timeout_s, values, np.nan)

        speed_times, _ = last("speed_rad_s")
        tank_times, tank = last("tank_kg")
        columns: Mapping[str, NDArray[Any]] = {
            "time_s": at_s,
            "speed_known": at_s - speed_times <= settings.speed_timeout_s,
            "speed_time_s": speed_times,
            "angle_deg": fresh("angle_deg", settings.feedback_timeout_s),
            "actuator": self._actuator_at(tracks, at_s),
            "moisture_pct": fresh("moisture_pct", condition),
            "test_weight_kg_m3": fresh("test_weight_kg_m3", condition),
            "header_down": fresh("header_down", vehicle),
            "working": fresh("working", vehicle),
            "ground_speed_m_s": fresh("ground_speed_m_s", vehicle),
            "course_deg": fresh("course_deg", vehicle),
            "latitude_deg": fresh("latitude_deg", vehicle),
            "longitude_deg": fresh("longitude_deg", vehicle),
            "scale_status": last("scale_status")[1],
            "fresh_scale_status": fresh("scale_status", settings.scale_timeout_s),
            "tank_time_s": tank_times,
            "tank_kg": tank,
        }
        return [Moment(*row) for row in zip(*(columns[name].tolist() for name in Moment._fields), strict=True)]

    def _actuator_at(self, tracks: Mapping[str, Track], at_s: Array) -> NDArray[np.intp]:
        track = tracks.get("actuator")
        if track is None:
            return np.full(at_s.shape, int(self.actuator))
        states = np.append(float(self.actuator), track.values)
        return states[np.searchsorted(track.times_s, at_s, side="left")].astype(np.intp)

    def _states(self, reported: Array) -> Array:
        """The actuator's state after each feedback frame; what is no state leaves it as it was."""
        known = np.isin(reported, _ACTUATOR_STATES)
        last = np.maximum.accumulate(np.where(known, np.arange(reported.size), -1))
        states: Array = np.append(reported, float(self.actuator))[last]
        return states


class RunInputs:
    """The inputs over one run."""

    def __init__(self, inputs: Inputs, tracks: dict[str, Track]) -> None:
        self._inputs = inputs
        self._tracks = tracks
        self._plate: list[list[float]] = []

    def track(self, name: str) -> Track:
        """Usable values of an input in the run."""
        return self._tracks.get(name, _NOTHING)

    def moments(self, at_s: Sequence[float]) -> list[Moment]:
        """What is held at instants of the run; frames of that very time or later have not come."""
        return self._inputs.moments(self._tracks, np.array(at_s))

    def plate_at(self, at_s: float) -> tuple[float, ActuatorState]:
        """Plate angle, deg, nan while it is stale, and the actuator's state, at any instant of the run."""
        if not self._plate:
            self._plate = [column.tolist() for name in ("angle_deg", "actuator") for column in self.track(name)]
        angle_times, angles, state_times, states = self._plate
        held, state = self._inputs.held["angle_deg"], self._inputs.actuator
        time_s, value = held.time_s, held.value
        if row := bisect_left(angle_times, at_s):
            time_s, value = angle_times[row - 1], angles[row - 1]
        if row := bisect_left(state_times, at_s):
            state = ActuatorState(int(states[row - 1]))
        return value if at_s - time_s <= self._inputs._settings.feedback_timeout_s else _NAN, state

    def finish(self) -> None:
        """The run is over: hold what came last."""
        for name, track in self._tracks.items():
            if not track.times_s.size:
                continue
            if name == "actuator":
                self._inputs.actuator = ActuatorState(int(track.values[-1]))
            else:
                self._inputs.held[name].set(float(track.times_s[-1]), float(track.values[-1]))


_NOTHING = Track(np.empty(0), np.empty(0))


def _track(times_s: Array, values: Array, usable: NDArray[np.bool_]) -> Track:
    return Track(times_s, values) if usable.all() else Track(times_s[usable], values[usable])
