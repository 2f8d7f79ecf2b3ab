"""The frames that the machine's nodes send: sensor, actuator, speed, moisture, tank scale and position, each with its faults."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from yieldmon import frames
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM
from yieldmon.physics.numerics import Array
from yieldmon.plant import elevator, profiles
from yieldmon.plant.actuator import PlateActuator
from yieldmon.plant.crop_course import CropCourse
from yieldmon.plant.field import Track
from yieldmon.plant.scenario import Channel, Scenario
from yieldmon.plant.sensor import ImpactCell, SensorFault
from yieldmon.plant.tank import Tank

BLOCK_SAMPLES = 20
"""Samples, at 1 kHz, whose frames are made together."""


def sensor_fault(scenario: Scenario, time_s: float) -> SensorFault | None:
    """The impact sensor's fault at a time."""
    return next((f.kind for f in scenario.faults.sensor if f.active(time_s)), None)


class Nodes:
    """They look at the parts of a combine and move none of them but the vehicle."""

    def __init__(
        self,
        scenario: Scenario,
        *,
        run: elevator.Run,
        harvest: profiles.Harvest,
        cell: ImpactCell,
        actuator: PlateActuator,
        tank: Tank,
        rng: np.random.Generator,
    ) -> None:
        """run: of the elevator. rng: of moisture and tank scale."""
        self._scenario = scenario
        self._course = CropCourse(scenario)
        self._track = Track(scenario.field)
        self._run, self._harvest = run, harvest
        self._cell, self._actuator, self._tank, self._rng = cell, actuator, tank, rng

    def frames_of(self, block: int, voltage_mv: Array) -> Iterator[Frame]:
        """Frames of a block of samples, in time order."""
        start_ms = block * BLOCK_SAMPLES
        out: list[Frame] = []
        fault = sensor_fault(self._scenario, start_ms * 1e-3)
        if fault is not SensorFault.SILENT:
            per = frames.SAMPLES_PER_FRAME
            for k in range(0, BLOCK_SAMPLES, per):
                values = voltage_mv[k : k + per]
                number = (start_ms + k) // per
                signals: dict[str, frames.Value] = {f"Sample{j}": float(values[j]) for j in range(per)}
                signals["SampleCounter"] = number % 256
                signals["SensorStatus"] = int(self._cell.status(float(values.max()), fault))
                out.append(Frame((start_ms + k + per) * 1e-3, frames.IMPACT_SENSOR_SAMPLES, signals))
        for milliseconds in range(start_ms + 10, start_ms + BLOCK_SAMPLES + 1, 10):
            out.extend(self._slow_frames(milliseconds))
        out.sort(key=lambda frame: frame.time_s)
        yield from out

    def _slow_frames(self, milliseconds: int) -> Iterator[Frame]:
        time = milliseconds * 1e-3
        if milliseconds % 50 == 0 and (feedback := self._actuator.feedback()) is not None:
            yield Frame(time, frames.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": feedback[0], "ActuatorState": int(feedback[1])})
        if milliseconds % 100 == 0:
            yield from self._spoken(
                Channel.ELEVATOR_SPEED,
                Frame(time, frames.ELEVATOR_SPEED, {"ElevatorSpeed": profiles.at(self._run.speed_rad_s, time) / RPM}),
            )
            if self._scenario.frames.harvest_state:
                working = int(profiles.at(self._harvest.working, time))
                yield Frame(time, "HarvestState", {"HeaderDown": working, "WorkState": working})
        if milliseconds % 1000 == 0:
            yield from self._second_frames(time)

    def _second_frames(self, time: float) -> Iterator[Frame]:
        crop, rng = self._scenario.crop, self._rng
        working = bool(profiles.at(self._harvest.working, time))
        if self._scenario.frames.grain_condition:
            moisture = self._course.moisture_pct(time)
            grain = crop.grain.at_moisture(moisture, self._scenario.effects.moisture_dependence)
            signals: dict[str, frames.Value] = {
                "Moisture": max(moisture + crop.moisture_noise_pct * float(rng.standard_normal()), 0.0),
                "GrainTemperature": self._course.temperature_degc(time),
                "TestWeight": grain.bulk_density_kg_m3 * crop.test_weight_share,
            }
            yield from self._spoken(Channel.GRAIN_CONDITION, Frame(time, frames.GRAIN_CONDITION, signals))
        if self._scenario.frames.kernel_weight and self._scenario.kernels is not None:
            yield Frame(time, frames.GRAIN_KERNELS, {"ThousandKernelWeight": self._scenario.kernels.thousand_kernel_weight_g})
        if self._scenario.tank.scale:
            mass, status = self._tank.reading(working, rng)
            yield from self._spoken(
                Channel.TANK_SCALE, Frame(time, frames.TANK_SCALE, {"TankMass": mass, "TankScaleStatus": int(status)})
            )
        if self._scenario.frames.position:
            place = self._track.step(1.0, working)
            yield Frame(time, "VehiclePosition", {"Latitude": place.latitude_deg, "Longitude": place.longitude_deg})
            yield Frame(
                time,
                "VehicleDirectionSpeed",
                {"CompassBearing": place.bearing_deg, "NavigationSpeed": place.ground_speed_km_h},
            )

    def _spoken(self, channel: Channel, frame: Frame) -> Iterator[Frame]:
        """The frame, or what is left of it under a fault of its source."""
        for fault in self._scenario.faults.messages:
            if fault.message is channel and fault.active(frame.time_s):
                if fault.error:
                    yield Frame(frame.time_s, frame.message, dict.fromkeys(frame.signals, frames.ERROR))
                return
        yield frame
