"""What the engine takes in, as data: the quantities that it knows, and which message and signal of a bus brings each.

A quantity has one unit, one range in which a value can be true, and one time for which a value holds. A source binds it to a
signal. `DEFAULT_SOURCES` is the layout of the shipped DBC; another layout is another `Sources`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any

from yieldmon import frames as bus
from yieldmon.frames import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME, ActuatorState, ScaleStatus
from yieldmon.physics.machine import RPM
from yieldmon.units import M_S_PER_KMH

_MAX_PLAUSIBLE_RPM = 3000.0
_MAX_PLAUSIBLE_ANGLE_DEG = 180.0
_MAX_PLAUSIBLE_KG_S = 200.0
_MAX_PLAUSIBLE_KM_H = 300.0
_PLAUSIBLE_DEGC = (-50.0, 100.0)
THOUSAND_KERNELS_G = (1.0, 2000.0)
"""Mass of a thousand kernels, from small seeds to large beans; below, it is that of one kernel, or in another unit."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One slow input.

    unit: of the values that sources give. usable: which of them can be true (floats or arrays). factor: into the engine's unit.
    timeout: the `InputSettings` attribute that says how long a value holds. meaning: for people.
    """

    name: str
    unit: str
    usable: Callable[[Any], Any]
    timeout: str
    meaning: str
    factor: float = 1.0


def _is_flag(value: Any) -> Any:
    return (value == 0.0) | (value == 1.0)


def _is_number(value: Any) -> Any:
    return abs(value) < inf


def _within(low: float, high: float) -> Callable[[Any], Any]:
    return lambda value: (value >= low) & (value <= high)


def _is_mass(value: Any) -> Any:
    return (value > 0.0) & (value < inf)


_ACTUATOR_STATES = tuple(float(state) for state in ActuatorState)


def _is_actuator_state(value: Any) -> Any:
    found = value == _ACTUATOR_STATES[0]
    for state in _ACTUATOR_STATES[1:]:
        found = found | (value == state)
    return found


QUANTITIES: Mapping[str, Quantity] = {
    quantity.name: quantity
    for quantity in (
        Quantity("elevator_speed", "rpm", _within(0.0, _MAX_PLAUSIBLE_RPM), "speed_timeout_s", "upper sprocket shaft", RPM),
        Quantity("actuator_state", "", _is_actuator_state, "feedback_timeout_s", "0 idle, 1 moving, 2 fault, 3 manual"),
        Quantity("plate_angle", "deg", _within(0.0, _MAX_PLAUSIBLE_ANGLE_DEG), "feedback_timeout_s", "of the impact plate"),
        Quantity("moisture", "%", lambda value: (value >= 0.0) & (value < 100.0), "condition_timeout_s", "wet basis"),
        Quantity("grain_temperature", "degC", _within(*_PLAUSIBLE_DEGC), "condition_timeout_s", "of the grain"),
        Quantity("test_weight", "kg/m3", _is_mass, "condition_timeout_s", "bulk density at rest"),
        Quantity(
            "thousand_kernel_weight", "g", _within(*THOUSAND_KERNELS_G), "condition_timeout_s", "mass of a thousand kernels"
        ),
        Quantity("tank_scale_status", "", _is_number, "scale_timeout_s", "0 stable, 1 unstable, 2 fault"),
        Quantity("tank_mass", "kg", _is_number, "scale_timeout_s", "grain in the tank"),
        Quantity("header_down", "", _is_flag, "vehicle_timeout_s", "1 at cutting height"),
        Quantity("work_state", "", _is_flag, "vehicle_timeout_s", "1 threshing and header drives engaged"),
        Quantity("unloading", "", _is_flag, "vehicle_timeout_s", "1 while the grain tank is being emptied"),
        Quantity("course", "deg", _within(0.0, 360.0), "vehicle_timeout_s", "over ground, clockwise from north"),
        Quantity("ground_speed", "km/h", _within(0.0, _MAX_PLAUSIBLE_KM_H), "vehicle_timeout_s", "over ground", M_S_PER_KMH),
        Quantity("latitude", "deg", lambda value: abs(value) <= 90.0, "vehicle_timeout_s", "positive north, WGS 84"),
        Quantity("longitude", "deg", lambda value: abs(value) <= 180.0, "vehicle_timeout_s", "positive east, WGS 84"),
        Quantity("position_group", "", _is_number, "vehicle_timeout_s", "parameter group of the standard source in use"),
        Quantity("speed_group", "", _is_number, "vehicle_timeout_s", "parameter group of the standard source in use"),
        Quantity("factory_mass_flow", "kg/s", _within(0.0, _MAX_PLAUSIBLE_KG_S), "vehicle_timeout_s", "factory's own monitor"),
    )
}
"""The slow inputs by name; the impact sensor's samples are a `SampleSource`."""

CONDITIONS: Mapping[str, tuple[str, float, bool]] = {
    "plate_angle": ("actuator_state", float(ActuatorState.FAULT), False),
    "tank_mass": ("tank_scale_status", float(ScaleStatus.STABLE), True),
}
"""Quantity -> (another, its value, whether it must have that value or must not) for the first to be used."""

PAIRS: Mapping[str, str] = {"latitude": "longitude", "longitude": "latitude"}
"""Quantities that are used only together where one message brings both."""


@dataclass(frozen=True, slots=True)
class SampleSource:
    """Where an impact sensor's samples come from.

    signals: the samples of one frame, oldest first, interval_s apart, the last one taken at the frame's time. counter: signal
    that counts frames modulo counter_modulus, or modulo counter_values once a value shows that it does not turn before, None:
    frames are counted by time alone. status: signal with a `SensorStatus`, None:
    the sensor says nothing of itself. scale_mv, offset_mv: from the signal's unit to millivolts. time_constant_s: of a low-pass
    filter in the sensor, 0: none.
    """

    message: str
    signals: tuple[str, ...]
    interval_s: float
    counter: str | None = None
    counter_modulus: int = 256
    counter_values: int = 256
    status: str | None = None
    scale_mv: float = 1.0
    offset_mv: float = 0.0
    time_constant_s: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return 1.0 / self.interval_s


@dataclass(frozen=True, slots=True)
class InputSource:
    """Which signal brings a quantity, and how its value becomes the quantity's: value * scale + offset. interval_s: at which one
    node sends it; nan: not known."""

    quantity: str
    message: str
    signal: str
    scale: float = 1.0
    offset: float = 0.0
    interval_s: float = float("nan")


@dataclass(frozen=True, slots=True)
class Sources:
    """All that an engine listens to. impact: one source for each impact sensor; the forces of several add up.

    fixed: quantities that nothing measures, with their constant value in the quantity's unit (a bolted plate's angle, a chain
    driven at one speed).
    """

    impact: tuple[SampleSource, ...]
    inputs: tuple[InputSource, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the messages that matter, each once."""
        sensors, inputs = (source.message for source in self.impact), (source.message for source in self.inputs)
        return tuple(dict.fromkeys((*sensors, *inputs)))

    def interval_s(self, quantity: str) -> float:
        """At which a quantity's one sender sends it, s; nan: not known."""
        return next((source.interval_s for source in self.inputs if source.quantity == quantity), float("nan"))


DEFAULT_SOURCES = Sources(
    impact=(
        SampleSource(
            message=bus.IMPACT_SENSOR_SAMPLES,
            signals=tuple(f"Sample{index}" for index in range(SAMPLES_PER_FRAME)),
            interval_s=SAMPLE_INTERVAL_S,
            counter="SampleCounter",
            status="SensorStatus",
        ),
    ),
    inputs=(
        InputSource("elevator_speed", bus.ELEVATOR_SPEED, "ElevatorSpeed", interval_s=0.1),
        InputSource("actuator_state", bus.PLATE_ACTUATOR_FEEDBACK, "ActuatorState"),
        InputSource("plate_angle", bus.PLATE_ACTUATOR_FEEDBACK, "PlateAngle", interval_s=0.05),
        InputSource("moisture", bus.GRAIN_CONDITION, "Moisture"),
        InputSource("grain_temperature", bus.GRAIN_CONDITION, "GrainTemperature"),
        InputSource("test_weight", bus.GRAIN_CONDITION, "TestWeight"),
        InputSource("thousand_kernel_weight", bus.GRAIN_KERNELS, "ThousandKernelWeight"),
        InputSource("tank_scale_status", bus.TANK_SCALE, "TankScaleStatus"),
        InputSource("tank_mass", bus.TANK_SCALE, "TankMass"),
        InputSource("header_down", bus.HARVEST_STATE, "HeaderDown"),
        InputSource("work_state", bus.HARVEST_STATE, "WorkState"),
        InputSource("unloading", bus.GRAIN_TANK, "Unloading"),
        InputSource("latitude", bus.VEHICLE_POSITION, "Latitude"),
        InputSource("longitude", bus.VEHICLE_POSITION, "Longitude"),
        InputSource("course", bus.VEHICLE_DIRECTION_SPEED, "CompassBearing"),
        InputSource("ground_speed", bus.VEHICLE_DIRECTION_SPEED, "NavigationSpeed"),
        InputSource("position_group", bus.VEHICLE_POSITION, "PositionGroup"),
        InputSource("speed_group", bus.VEHICLE_DIRECTION_SPEED, "SpeedGroup"),
        InputSource("factory_mass_flow", bus.FACTORY_MONITOR, "FactoryMassFlow"),
    ),
)
"""The messages and signals of the shipped DBC."""
