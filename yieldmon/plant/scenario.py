"""A scenario: everything that the virtual combine is to do, from one YAML file.

Every key carries its unit in its name and its range in its type; classes here and beside the parts of the combine list them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from yieldmon.arguments import require_path
from yieldmon.errors import InputError
from yieldmon.files import strict_yaml
from yieldmon.plant.actuator import ActuatorFault, ActuatorSettings
from yieldmon.plant.effects import Effects
from yieldmon.plant.elevator import ElevatorSettings
from yieldmon.plant.field import FieldSettings
from yieldmon.plant.grain import Grain
from yieldmon.plant.profiles import FlowProfile, Steady
from yieldmon.plant.sensor import SensorFault, SensorSettings
from yieldmon.plant.tank import TankSettings
from yieldmon.strict_model import StrictModel

_BY_NAME = Field(strict=False)
"""Strict would want a member, which no file can hold."""


class ScenarioCrop(StrictModel):
    """The grain, with its moisture running from start to end of the scenario."""

    friction: Annotated[float, Field(ge=0, le=1)] = 0.2
    restitution: Annotated[float, Field(ge=0, le=1)] = 0.55
    bulk_density_kg_m3: Annotated[float, Field(ge=300, le=2500)] = 1100.0
    shape_ratio: Annotated[float, Field(ge=0.5, le=3)] = 2.0
    reference_moisture_pct: Annotated[float, Field(ge=5, le=45)] = 15.0
    moisture_pct: Annotated[float, Field(ge=5, le=45)] = 15.0
    end_moisture_pct: Annotated[float, Field(ge=5, le=45)] | None = None
    temperature_degc: Annotated[float, Field(ge=-30, le=60)] = 20.0
    end_temperature_degc: Annotated[float, Field(ge=-30, le=60)] | None = None
    test_weight_share: Annotated[float, Field(ge=0.2, le=1.5)] = 0.655
    """Test weight (what GrainCondition frames state) over the bulk density of the heap on a paddle."""
    moisture_noise_pct: Annotated[float, Field(ge=0, le=5)] = 0.2

    @property
    def grain(self) -> Grain:
        """Properties at the reference moisture."""
        return Grain(self.friction, self.restitution, self.bulk_density_kg_m3, self.shape_ratio, self.reference_moisture_pct)


class Channel(StrEnum):
    """Messages whose source can fail as a whole, besides actuator and sensor."""

    ELEVATOR_SPEED = "elevator_speed"
    GRAIN_CONDITION = "grain_condition"
    TANK_SCALE = "tank_scale"


class Kernels(StrictModel):
    """Grain that strikes kernel by kernel instead of as a smooth stream."""

    thousand_kernel_weight_g: Annotated[float, Field(gt=1, le=2000)] = 350.0
    mass_spread_pct: Annotated[float, Field(ge=0, le=60)] = 12.0
    """Standard deviation of a kernel's impulse about the mean."""
    noise_ratio: Annotated[float, Field(ge=0.2, le=3)] = 1.0
    """Variance over that of kernels that strike independently of each other (studies/waveform), of 0.5 kg on a paddle."""
    noise_load_exponent: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """noise_ratio goes with the load on a paddle to this power (studies/waveform: -0.12)."""
    contact_ms: Annotated[float, Field(ge=0, le=5)] = 0.2
    """Time for which a kernel pushes, as half a sine."""


class _Timed(StrictModel):
    start_s: Annotated[float, Field(ge=0)]
    end_s: Annotated[float, Field(gt=0)]

    @model_validator(mode="after")
    def _ordered(self) -> _Timed:
        if self.end_s <= self.start_s:
            raise ValueError(f"end_s {self.end_s:g} is not after start_s {self.start_s:g}")
        return self

    def active(self, time_s: float) -> bool:
        """Whether the fault is present at a time."""
        return self.start_s <= time_s < self.end_s


class TimedActuatorFault(_Timed):
    """An actuator fault from start_s to end_s."""

    kind: Annotated[ActuatorFault, _BY_NAME]


class TimedSensorFault(_Timed):
    """A sensor fault from start_s to end_s."""

    kind: Annotated[SensorFault, _BY_NAME]


class TimedSilence(_Timed):
    """A message that is not sent (`error: false`) or that says "error" (`error: true`)."""

    message: Annotated[Channel, _BY_NAME]
    error: bool = False


class Faults(StrictModel):
    """What goes wrong and when."""

    actuator: list[TimedActuatorFault] = Field(default_factory=list)
    sensor: list[TimedSensorFault] = Field(default_factory=list)
    messages: list[TimedSilence] = Field(default_factory=list)


class Frames(StrictModel):
    """Optional frames."""

    grain_condition: bool = True
    position: bool = False
    harvest_state: bool = False
    kernel_weight: bool = False
    """GrainKernels with the thousand-kernel weight; needs `kernels`."""


class Scenario(StrictModel):
    """What the virtual combine harvests and what goes wrong; examples in config/scenarios.

    Parameters
    ----------
    duration_s : float
        s.
    machine : str
        Name of a shipped machine file, or the path of one.
    crop : ScenarioCrop
        Grain and moisture (%).
    effects : Effects
        Physical effects that act, none by default.
    flow : FlowProfile
        Pieces of mass flow (kg/s) over time.
    elevator, actuator, sensor, tank, field : sections
        Elevator speed (rpm), plate actuator, impact sensor (mV), grain tank (kg), way over the field.
    frames : Frames
        Optional frames that are sent.
    faults : Faults
        What goes wrong and when (s).
    kernels : Kernels, optional
        Single kernels; None: smooth pulses.
    paddle_scatter_pct : float
        Standard deviation of a pulse's impulse about what its load should give, %; the load itself is true.

    Raises
    ------
    pydantic.ValidationError
        For a key that is not known or a value out of its range.

    Examples
    --------
    >>> api.Scenario(duration_s=30, paddle_scatter_pct=0).flow.pieces[0].flow_kg_s
    10.0
    """

    duration_s: Annotated[float, Field(ge=1, le=400_000)] = 120.0
    machine: Annotated[str, Field(min_length=1)] = "sprocket-8"
    crop: ScenarioCrop = ScenarioCrop()
    effects: Effects = Effects()
    flow: FlowProfile = FlowProfile(pieces=[Steady(kind="steady", duration_s=60.0, flow_kg_s=10.0)])
    elevator: ElevatorSettings = ElevatorSettings()
    actuator: ActuatorSettings = ActuatorSettings()
    sensor: SensorSettings = SensorSettings()
    tank: TankSettings = TankSettings()
    field: FieldSettings = FieldSettings()
    frames: Frames = Frames()
    faults: Faults = Faults()
    kernels: Kernels | None = None
    paddle_scatter_pct: Annotated[float, Field(ge=0, le=50)] = 7.0


def from_mapping(values: Any, where: str) -> Scenario:
    """Scenario from plain values; `where` names their source in errors. Raises InputError for the first wrong key."""
    if not isinstance(values, dict):
        raise InputError(where, "is not a mapping of keys", "keys such as duration_s and flow")
    try:
        return Scenario.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "scenario"
        if first["type"] == "extra_forbidden":
            expected = "a key of this section, as in config/scenarios/demo.yaml"
            raise InputError(f"{where}: {key}", "is not a key of a scenario", expected) from None
        if first["type"] == "missing":
            raise InputError(f"{where}: {key}", "is missing", "a value") from None
        expected = first["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
        shown = first["input"] if isinstance(first["input"], (str, int, float, bool, type(None))) else "not usable"
        raise InputError(f"{where}: {key}", f"is {shown!r}", expected) from None


def load(path: Path | str) -> Scenario:
    """Read a scenario file.

    Parameters
    ----------
    path : path

    Returns
    -------
    Scenario

    Raises
    ------
    InputError
        Naming file, key, value and what was expected.

    Examples
    --------
    >>> api.load_scenario(api.shipped("config/scenarios/demo.yaml")).machine
    'sprocket-8'
    """
    require_path(path)
    values = strict_yaml.load(path)
    return from_mapping(values if values is not None else {}, str(path))
