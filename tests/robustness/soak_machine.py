"""The machine around the daemon in the soak: a harvest in cycles, with sweeps, faults, loads and tickets in each.

Samples come from the virtual combine, recorded at plate angles five degrees apart and played over and over; the plate moves as
it is commanded, and the force is that of the nearest angle recorded.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

import can

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.engine.faults import FaultCode
from yieldmon.frames import ActuatorState, CommandMode, Frame
from yieldmon.physics.machine import Machine
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine, pulse_table

CYCLE_S = 300
EMPTY_S = 30
#: When in a cycle the two troubles begin: after the sweep, and apart from each other.
TROUBLE_AT_S = (190.0, 245.0)
#: Cycles from one sweep with a plate that does not move to the next.
STUCK_EVERY = 4

_RECORD_S = 32
_LEAD_S = 8
_ANGLES_DEG = tuple(range(40, 91, 5))
_HOME_DEG = 70.0
_RATE_DEG_S = 20.0
_SPEED_RPM = 400.0
#: Frames that may wait for the engine: two seconds of traffic, and few while the plate has to answer.
_BACKLOG_FRAMES = 500
_BACKLOG_DRIVEN_FRAMES = 60
_START_S = 1_760_000_000.0


class Trouble(Enum):
    """What goes wrong, and for how many seconds."""

    SENSOR_SILENT = 2.5
    SPEED_SILENT = 2.6
    FEEDBACK_SILENT = 2.7
    FRAMES_LOST = 3.0
    SATURATED = 2.4
    FORGED = 0.5
    ERROR_FRAMES = 0.4
    INTERFACE_LOST = 0.0
    STRANGERS = 3.1
    SLOW_ELEVATOR = 5.0


#: The faults that the troubles and the stuck plate must show.
EXPECTED_FAULTS = frozenset(
    {
        FaultCode.SENSOR_MISSING, FaultCode.SPEED_MISSING, FaultCode.PLATE_FEEDBACK_STALE, FaultCode.FRAMES_LOST,
        FaultCode.SENSOR_SATURATED, FaultCode.OUTPUT_CONFLICT, FaultCode.BUS_ERROR, FaultCode.SPEED_OUT_OF_RANGE,
        FaultCode.PLATE_NOT_FOLLOWING, FaultCode.SWEEP_ABORTED,
    }
)  # fmt: skip


@dataclass
class _Plate:
    """Moves towards its target at its rate; `stuck` holds it."""

    angle_deg: float = _HOME_DEG
    target_deg: float = _HOME_DEG
    stuck: bool = False

    def step(self, interval_s: float) -> None:
        if not self.stuck:
            reach = _RATE_DEG_S * interval_s
            self.angle_deg += min(max(self.target_deg - self.angle_deg, -reach), reach)


class MachineOnBus:
    """All nodes but the daemon. `open_bus` gives the daemon's end; a lost interface is opened anew."""

    def __init__(self, duration_s: float, real_time: bool) -> None:
        """duration_s: bus time to play. real_time: by the clock, else as fast as `backlog` allows."""
        self._codec = Codec()
        self._empty, self._grain = _recordings(self._codec)
        counter = next(s for s in self._codec.layouts[frames.IMPACT_SENSOR_SAMPLES].signals if s.name == "SampleCounter")
        self._counter_bit = counter.start
        self._sample_id = self._codec.layouts[frames.IMPACT_SENSOR_SAMPLES].frame_id
        self._plate = _Plate()
        self._driven = False
        self._duration_s = duration_s
        self._real_time = real_time
        self._begin_s = time.monotonic()
        self._start_s = time.time() if real_time else _START_S
        self._traffic = self._play()
        self._bus: _DaemonsEnd | None = None
        self.backlog: Callable[[], int] = lambda: 0
        self.now_s = 0.0
        """Bus time played so far, from 0."""
        self.heard = 0
        """Frames from the daemon."""
        self.lost = False
        """The interface has gone since the daemon last opened it."""
        self.ended = threading.Event()

    def open_bus(self) -> can.BusABC:
        """The daemon's end of the bus."""
        self.lost = False
        return _DaemonsEnd(self)

    def take(self, message: can.Message) -> None:
        """A frame from the daemon."""
        self.heard += 1
        frame = self._codec.decode(message)
        if frame is None or frame.message != frames.PLATE_ACTUATOR_COMMAND:
            return
        mode = CommandMode(int(frame.signals["CommandMode"]))  # type: ignore[arg-type]
        self._driven = mode is not CommandMode.RELEASE
        if mode is CommandMode.GO_HOME:
            self._plate.target_deg = _HOME_DEG
        elif mode is CommandMode.GO_TO_ANGLE:
            self._plate.target_deg = float(frame.signals["TargetPlateAngle"])  # type: ignore[arg-type]

    def next_message(self, timeout_s: float | None) -> can.Message | None:
        """The next frame when it is due; None when there is none within timeout_s seconds."""
        message = next(self._traffic, None)
        if message is None:
            self.ended.set()
            time.sleep(timeout_s or 0.0)
            return None
        if self._real_time:
            time.sleep(max(0.0, self._begin_s + self.now_s - time.monotonic()))
        else:
            while self.backlog() > (_BACKLOG_DRIVEN_FRAMES if self._driven else _BACKLOG_FRAMES):
                time.sleep(0.0005)
        return message

    def _play(self) -> Iterator[can.Message]:
        for number in range(int(self._duration_s * 250)):
            self.now_s = number / 250.0
            in_cycle_s = self.now_s % CYCLE_S
            trouble = self._trouble(in_cycle_s)
            if trouble is Trouble.INTERFACE_LOST and number % 250 == 0:
                self.lost = True
            self._plate.stuck = int(self.now_s / CYCLE_S) % STUCK_EVERY == STUCK_EVERY - 1 and in_cycle_s < TROUBLE_AT_S[0]
            self._plate.step(1.0 / 250.0)
            yield from self._samples(number, trouble, in_cycle_s)
            yield from self._slow(number, trouble)
            if trouble in (Trouble.FORGED, Trouble.ERROR_FRAMES, Trouble.STRANGERS):
                yield from self._intruders(number, trouble)

    def _trouble(self, in_cycle_s: float) -> Trouble | None:
        kinds = tuple(Trouble)
        cycle = int(self.now_s / CYCLE_S)
        for place, begin_s in enumerate(TROUBLE_AT_S):
            kind = kinds[(len(TROUBLE_AT_S) * cycle + place) % len(kinds)]
            if begin_s <= in_cycle_s < begin_s + max(kind.value, 1.0 / 250.0):
                return kind
        return None

    def _samples(self, number: int, trouble: Trouble | None, in_cycle_s: float) -> Iterator[can.Message]:
        if trouble is Trouble.SENSOR_SILENT or (trouble is Trouble.FRAMES_LOST and number % 7 == 0):
            return
        if in_cycle_s < EMPTY_S:
            payload = self._empty[number % len(self._empty)]
        else:
            recording = self._grain[round((self._plate.angle_deg - _ANGLES_DEG[0]) / 5.0)]
            payload = recording[number % len(recording)]
        data = (payload | number % 256 << self._counter_bit).to_bytes(8, "little")
        if trouble is Trouble.SATURATED:
            full = {**{f"Sample{k}": 4000.0 for k in range(4)}, "SampleCounter": number % 256, "SensorStatus": 1}
            data = bytes(self._codec.encode(Frame(0.0, frames.IMPACT_SENSOR_SAMPLES, full)).data)
        yield can.Message(self._start_s + self.now_s, self._sample_id, is_extended_id=True, data=data)

    def _slow(self, number: int, trouble: Trouble | None) -> Iterator[can.Message]:
        if number % 25 == 0 and trouble is not Trouble.SPEED_SILENT:
            speed = 200.0 if trouble is Trouble.SLOW_ELEVATOR else _SPEED_RPM
            yield self._encode(frames.ELEVATOR_SPEED, {"ElevatorSpeed": speed})
        if number % 12 == 0 and trouble is not Trouble.FEEDBACK_SILENT:
            moving = abs(self._plate.target_deg - self._plate.angle_deg) > 0.1
            state = ActuatorState.MOVING if moving else ActuatorState.IDLE
            yield self._encode(frames.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": self._plate.angle_deg, "ActuatorState": int(state)})
        if number % 250 == 0:
            condition: dict[str, frames.Value] = {"Moisture": 15.0, "GrainTemperature": 20.0, "TestWeight": 720.0}
            yield self._encode(frames.GRAIN_CONDITION, condition)

    def _intruders(self, number: int, trouble: Trouble) -> Iterator[can.Message]:
        at_s = self._start_s + self.now_s
        if trouble is Trouble.FORGED and number % 25 == 0:
            flow: dict[str, frames.Value] = {
                "MassFlowRate": 9.0, "MassFlowStdDev": 0.1, "EstimateQuality": 0, "WindowCounter": 3,
            }  # fmt: skip
            yield self._encode(frames.MASS_FLOW, flow)
        elif trouble is Trouble.ERROR_FRAMES:
            yield can.Message(at_s, 0x80, is_extended_id=False, is_error_frame=True, data=bytes(8))
        elif trouble is Trouble.STRANGERS:
            yield can.Message(at_s, 0x18EF2A17, is_extended_id=True, data=bytes(range(8)))
            yield can.Message(at_s, self._sample_id, is_extended_id=True, data=bytes(number % 8))

    def _encode(self, name: str, signals: dict[str, frames.Value]) -> can.Message:
        return self._codec.encode(Frame(self._start_s + self.now_s, name, signals))


class _DaemonsEnd(can.BusABC):
    """What the daemon has open."""

    def __init__(self, machine: MachineOnBus) -> None:
        super().__init__(channel="soak")
        self.channel_info = "soak"
        self._machine = machine

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._machine.take(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._machine.lost:
            raise can.CanOperationError("the interface has gone", 19)
        return self._machine.next_message(timeout), True


def _recordings(codec: Codec) -> tuple[list[int], list[list[int]]]:
    """Payloads of ImpactSensorSamples frames, counter 0, over _RECORD_S seconds: the elevator empty, and grain at each angle."""
    machine = Machine()
    empty = _scenario(0.0)
    grain = _scenario(12.0)
    table = pulse_table(grain, machine)
    at_rest = _payloads(codec, VirtualCombine(empty, machine, 0), _HOME_DEG)
    return at_rest, [_payloads(codec, VirtualCombine(grain, machine, 0, table), float(angle)) for angle in _ANGLES_DEG]


def _scenario(flow_kg_s: float) -> scenario.Scenario:
    pieces = [{"kind": "steady", "duration_s": 60, "flow_kg_s": flow_kg_s}]
    values = {"duration_s": _LEAD_S + _RECORD_S + 1.0, "flow": {"pieces": pieces}}
    return scenario.from_mapping(values, "soak")


def _payloads(codec: Codec, combine: VirtualCombine, angle_deg: float) -> list[int]:
    payloads = []
    for half_second in range(2 * (_LEAD_S + _RECORD_S)):
        command = {"TargetPlateAngle": angle_deg, "CommandMode": int(CommandMode.GO_TO_ANGLE), "CommandCounter": 0}
        combine.handle(Frame(half_second / 2.0, frames.PLATE_ACTUATOR_COMMAND, command))
        for frame in combine.frames_until((half_second + 1) / 2.0):
            if frame.message == frames.IMPACT_SENSOR_SAMPLES and half_second >= 2 * _LEAD_S:
                uncounted = frame._replace(signals={**frame.signals, "SampleCounter": 0})
                payloads.append(int.from_bytes(codec.encode(uncounted).data, "little"))
    assert len(payloads) == 250 * _RECORD_S
    return payloads
