"""The virtual combine as five foreign buses: packed here byte by byte, without the product's decoding.

Each layout brings its DBC file, the section of the configuration that maps it, and its frames.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path

import can

from yieldmon import frames as bus
from yieldmon.frames import Frame

N_PER_MV = 0.4448
"""Gain of the default machine's sensor."""
MV_PER_COUNT = 0.0625
PULSES_PER_TURN = 60
RATIO = 0.2
"""Turns of the elevator per turn of the engine."""
FIXED_DEG = 70.0


@dataclass(frozen=True)
class Layout:
    """name; dbc: text of the file; config: YAML; pack: class that packs the frames."""

    name: str
    dbc: str
    config: str
    pack: type[Packer]

    def write(self, folder: Path) -> Path:
        """DBC and configuration into a folder; returns the configuration."""
        (folder / f"{self.name}.dbc").write_text(self.dbc, encoding="utf-8")
        path = folder / f"{self.name}.yaml"
        path.write_text(self.config, encoding="utf-8")
        return path

    def messages(self, frames: Iterable[Frame], start_s: float = 0.0) -> Iterator[can.Message]:
        """The bus's traffic for the combine's native frames."""
        packer = self.pack()
        yield from packer.opening(start_s)
        for frame in frames:
            yield from packer.messages(frame, start_s + frame.time_s)


def message(time_s: float, identifier: int, data: bytes, extended: bool = False) -> can.Message:
    return can.Message(timestamp=time_s, arbitration_id=identifier, data=data, is_extended_id=extended, channel="can0")


@dataclass
class Packer:
    """Takes native frames apart: samples a millisecond apart, speeds and angles."""

    last_s: float = -1.0
    turns: float = 0.0
    rpm: float = 0.0

    def opening(self, start_s: float) -> Iterator[can.Message]:
        yield from ()

    def messages(self, frame: Frame, at_s: float) -> Iterator[can.Message]:
        signals = frame.signals
        if frame.message == bus.IMPACT_SENSOR_SAMPLES:
            values = [float(signals[f"Sample{k}"]) for k in range(4)]  # type: ignore[arg-type]
            yield from self.samples(at_s, values)
        elif frame.message == bus.ELEVATOR_SPEED:
            self.rpm = float(signals["ElevatorSpeed"])  # type: ignore[arg-type]
            self.turns += self.rpm / 60.0 * (at_s - self.last_s if self.last_s >= 0.0 else 0.0)
            self.last_s = at_s
            yield from self.speed(at_s, self.rpm)
        elif frame.message == bus.PLATE_ACTUATOR_FEEDBACK:
            yield from self.angle(at_s, float(signals["PlateAngle"]))  # type: ignore[arg-type]

    def samples(self, at_s: float, values_mv: Sequence[float]) -> Iterator[can.Message]:
        raise NotImplementedError

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        raise NotImplementedError

    def angle(self, at_s: float, angle_deg: float) -> Iterator[can.Message]:
        yield from ()


@dataclass
class Thinned(Packer):
    """One sample of so many, sent as it is taken."""

    every: int = 10
    count: int = 0

    def samples(self, at_s: float, values_mv: Sequence[float]) -> Iterator[can.Message]:
        for place, value in enumerate(values_mv):
            self.count += 1
            if self.count % self.every == 0:
                yield self.sample(at_s - 0.001 * (len(values_mv) - 1 - place), value)

    def sample(self, at_s: float, value_mv: float) -> can.Message:
        raise NotImplementedError


@dataclass
class Counts(Thinned):
    """100 Hz, big-endian counts in an 11-bit frame; speed of the engine; angle signed and big-endian."""

    def sample(self, at_s: float, value_mv: float) -> can.Message:
        return message(at_s, 0x321, struct.pack(">HH", 0xAAAA, round(value_mv / MV_PER_COUNT)))

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        yield message(at_s, 0x0CF00400, b"\xff\xff\xff" + struct.pack("<H", round(rpm / RATIO / 0.125)) + b"\xff\xff\xff", True)

    def angle(self, at_s: float, angle_deg: float) -> Iterator[can.Message]:
        yield message(at_s, 0x322, struct.pack(">h", round(100.0 * (angle_deg - 90.0))))


COUNTS = Layout(
    "counts",
    """VERSION ""
NS_ :
BS_:
BU_: Analog Engine Actuator
BO_ 801 Bridge: 4 Analog
 SG_ Spare : 7|16@0+ (1,0) [0|65535] "" Analog
 SG_ Counts : 23|16@0+ (1,0) [0|65535] "" Analog
BO_ 2364539904 EEC1: 8 Engine
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Analog
BO_ 802 Linear: 2 Actuator
 SG_ Tilt : 7|16@0- (0.01,90) [-100|200] "deg" Analog
""",
    f"""\
sweep: {{enabled: false}}
signals:
  impact_voltage: {{dbc: counts.dbc, message: Bridge, signal: Counts, unit: counts, scale: {MV_PER_COUNT}, rate_hz: 100}}
  elevator_speed: {{dbc: counts.dbc, message: EEC1, signal: EngineSpeed, ratio: {RATIO}}}
  plate_angle: {{dbc: counts.dbc, message: Linear, signal: Tilt}}
  actuator_state: null
""",
    Counts,
)


@dataclass
class Newtons(Thinned):
    """10 Hz, newtons as a float; pulses of the shaft; the plate is bolted on."""

    every: int = 100

    def sample(self, at_s: float, value_mv: float) -> can.Message:
        return message(at_s, 0x200, struct.pack("<f", value_mv * N_PER_MV))

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        yield message(at_s, 0x201, struct.pack("<BH", 0, int(self.turns * PULSES_PER_TURN) & 0xFFFF))


NEWTONS = Layout(
    "newtons",
    """VERSION ""
NS_ :
BS_:
BU_: Cell
BO_ 512 Force: 4 Cell
 SG_ Force : 0|32@1- (1,0) [0|0] "N" Cell
BO_ 513 Shaft: 3 Cell
 SG_ Pulses : 8|16@1+ (1,0) [0|65535] "" Cell
SIG_VALTYPE_ 512 Force : 1;
""",
    f"""\
plate: {{fixed_angle_deg: {FIXED_DEG}}}
signals:
  impact_force: {{dbc: newtons.dbc, message: Force, signal: Force, rate_hz: 10}}
  elevator_speed: {{dbc: newtons.dbc, message: Shaft, signal: Pulses, pulses_per_turn: {PULSES_PER_TURN}}}
""",
    Newtons,
)


@dataclass
class Multiplexed(Thinned):
    """One identifier for everything: samples at 250 Hz, speed in rad/s and angle in rad under other multiplexer values."""

    every: int = 4

    def sample(self, at_s: float, value_mv: float) -> can.Message:
        return message(at_s, 0x400, struct.pack("<BhB", 0, round(2.0 * value_mv - 4000.0), 0))

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        yield message(at_s, 0x400, struct.pack("<BhB", 1, round(100.0 * rpm * pi / 30.0), 0))

    def angle(self, at_s: float, angle_deg: float) -> Iterator[can.Message]:
        yield message(at_s, 0x400, struct.pack("<BhB", 2, round(1e4 * angle_deg * pi / 180.0), 0))


MULTIPLEXED = Layout(
    "multiplexed",
    """VERSION ""
NS_ :
BS_:
BU_: Node
BO_ 1024 Everything: 4 Node
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" Node
 SG_ Voltage m0 : 8|16@1- (0.5,2000) [0|6000] "mV" Node
 SG_ Speed m1 : 8|16@1- (0.01,0) [0|300] "rad/s" Node
 SG_ Angle m2 : 8|16@1- (0.0001,0) [0|3.2] "rad" Node
""",
    """\
sweep: {enabled: false}
signals:
  impact_voltage: {dbc: multiplexed.dbc, message: Everything, signal: Voltage, mux: 0, rate_hz: 250}
  elevator_speed: {dbc: multiplexed.dbc, message: Everything, signal: Speed, mux: 1}
  plate_angle: {dbc: multiplexed.dbc, message: Everything, signal: Angle, mux: 2}
  actuator_state: null
""",
    Multiplexed,
)


@dataclass
class Blocks(Packer):
    """Four samples of 1 kHz a frame and no counter; 0xFFFF is not available; speed and angle in one frame."""

    angle_deg: float = FIXED_DEG

    def samples(self, at_s: float, values_mv: Sequence[float]) -> Iterator[can.Message]:
        yield message(at_s, 0x18FFA055, struct.pack("<HHHH", *(round(10.0 * value) for value in values_mv)), True)

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        yield message(at_s, 0x18FFA155, struct.pack("<HH", round(10.0 * rpm), round(100.0 * self.angle_deg)), True)

    def angle(self, at_s: float, angle_deg: float) -> Iterator[can.Message]:
        self.angle_deg = angle_deg
        yield message(at_s, 0x18FFA155, struct.pack("<HH", round(10.0 * self.rpm), round(100.0 * angle_deg)), True)


BLOCKS = Layout(
    "blocks",
    """VERSION ""
NS_ :
BS_:
BU_: Node
BO_ 2566889557 Samples: 8 Node
 SG_ S0 : 0|16@1+ (0.0001,0) [0|6.5535] "V" Node
 SG_ S1 : 16|16@1+ (0.0001,0) [0|6.5535] "V" Node
 SG_ S2 : 32|16@1+ (0.0001,0) [0|6.5535] "V" Node
 SG_ S3 : 48|16@1+ (0.0001,0) [0|6.5535] "V" Node
BO_ 2566889813 Machine: 4 Node
 SG_ Shaft : 0|16@1+ (0.1,0) [0|6553.5] "" Node
 SG_ Plate : 16|16@1+ (0.01,0) [0|655.35] "" Node
""",
    """\
sweep: {enabled: false}
signals:
  impact_voltage: {dbc: blocks.dbc, message: Samples, signals: [S0, S1, S2, S3], spacing_ms: 1, not_available: [65535]}
  elevator_speed: {dbc: blocks.dbc, message: Machine, signal: Shaft, unit: rpm, range: [0, 1000]}
  plate_angle: {dbc: blocks.dbc, message: Machine, signal: Plate, unit: deg, range: [30, 120]}
  actuator_state: null
""",
    Blocks,
)

NODE_NAME = 0x2000_8000_3A20_0042
"""Industry group 2, function 0x80, manufacturer 0x1D1, identity 0x42."""
OTHER_NAME = 0x2000_8000_3A20_0007


@dataclass
class Proprietary(Packer):
    """J1939 proprietary B from a node that is known by its NAME alone and changes its address; another sends the same group."""

    counter: int = 0
    address: int = 0x90
    pending: list[float] = field(default_factory=list)

    def opening(self, start_s: float) -> Iterator[can.Message]:
        yield message(start_s, 0x18EEFF90, NODE_NAME.to_bytes(8, "little"), True)
        yield message(start_s, 0x18EEFF91, OTHER_NAME.to_bytes(8, "little"), True)
        self.opened_s = start_s

    def samples(self, at_s: float, values_mv: Sequence[float]) -> Iterator[can.Message]:
        if self.address == 0x90 and at_s - self.opened_s > 30.0:
            self.address = 0xA5
            yield message(at_s - 0.004, 0x18EEFFA5, NODE_NAME.to_bytes(8, "little"), True)
        self.pending += values_mv
        for place in range(len(self.pending) // 3):
            three = self.pending[3 * place : 3 * place + 3]
            late_s = 0.001 * (len(self.pending) - 3 * place - 3)
            data = struct.pack("<HHHH", self.counter, *(round(10.0 * value) for value in three))
            yield message(at_s - late_s, 0x18FF0100 | self.address, data, True)
            self.counter = self.counter + 1 & 0xFFFF
            if self.counter % 50 == 0:
                yield message(at_s - late_s, 0x18FF0191, b"\x00" * 8, True)
        self.pending = self.pending[3 * (len(self.pending) // 3) :]

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        yield message(at_s, 0x18FF0200 | self.address, struct.pack("<HHHH", round(rpm / 0.125), 0xFFFF, 0xFFFF, 0xFFFF), True)


PROPRIETARY = Layout(
    "proprietary",
    """VERSION ""
NS_ :
BS_:
BU_: Node
BO_ 2566849022 PropB01: 8 Node
 SG_ Count : 0|16@1+ (1,0) [0|65535] "" Node
 SG_ A : 16|16@1+ (0.1,0) [0|6425.5] "mV" Node
 SG_ B : 32|16@1+ (0.1,0) [0|6425.5] "mV" Node
 SG_ C : 48|16@1+ (0.1,0) [0|6425.5] "mV" Node
BO_ 2566849278 PropB02: 8 Node
 SG_ ShaftSpeed : 0|16@1+ (0.125,0) [0|8031.875] "rpm" Node
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566849022 3;
BA_ "VFrameFormat" BO_ 2566849278 3;
""",
    f"""\
plate: {{fixed_angle_deg: {FIXED_DEG}}}
signals:
  impact_voltage:
    dbc: proprietary.dbc
    message: PropB01
    signals: [A, B, C]
    rate_hz: 1000
    counter: Count
    source: {{function: 0x80, identity_number: 0x42}}
  elevator_speed: {{dbc: proprietary.dbc, message: PropB02, signal: ShaftSpeed, source: {{identity_number: 0x42}}}}
""",
    Proprietary,
)


@dataclass
class Long(Packer):
    """28 samples of 1 kHz in a CAN FD frame; the speed in broadcasts of the transport protocol, which another node sends as well;
    the angle in fast packets."""

    counter: int = 0
    packets: int = 0
    pending: list[float] = field(default_factory=list)

    def samples(self, at_s: float, values_mv: Sequence[float]) -> Iterator[can.Message]:
        self.pending += values_mv
        if len(self.pending) == 28:
            data = struct.pack("<30H", self.counter, 0, *(round(10.0 * value) for value in self.pending)).ljust(64, b"\0")
            found = message(at_s, 0x18FFA055, data, True)
            found.is_fd, found.dlc = True, 64
            yield found
            self.counter, self.pending = self.counter + 1 & 0xFFFF, []

    def speed(self, at_s: float, rpm: float) -> Iterator[can.Message]:
        for source, value in ((0x55, rpm), (0x56, 0.0)):
            data = bytes(12) + struct.pack(">H", round(10.0 * value)) + b"\xff" * 6
            yield message(at_s - 0.030, 0x1CECFF00 | source, bytes([32, 20, 0, 3, 255, 0x02, 0xFF, 0]), True)
            for part in range(3):
                packet = bytes([part + 1]) + data[7 * part : 7 * part + 7].ljust(7, b"\xff")
                yield message(at_s - 0.010 * (2 - part), 0x1CEBFF00 | source, packet, True)

    def angle(self, at_s: float, angle_deg: float) -> Iterator[can.Message]:
        data = bytes(9) + struct.pack("<h", round(100.0 * (angle_deg - 90.0))) + b"\0"
        lead, self.packets = (self.packets & 7) << 5, self.packets + 1
        yield message(at_s - 0.001, 0x19FBD057, bytes([lead, 12]) + data[:6], True)
        yield message(at_s, 0x19FBD057, bytes([lead | 1]) + data[6:].ljust(7, b"\xff"), True)


_SAMPLES = "\n".join(f' SG_ S{k} : {32 + 16 * k}|16@1+ (0.1,0) [0|6425.5] "mV" Node' for k in range(28))
LONG = Layout(
    "long",
    f"""VERSION ""
NS_ :
BS_:
BU_: Node
BO_ 2566889557 Samples: 64 Node
 SG_ Count : 0|16@1+ (1,0) [0|65535] "" Node
{_SAMPLES}
BO_ 2566849278 Machine: 20 Node
 SG_ Shaft : 103|16@0+ (0.1,0) [0|6553.5] "rpm" Node
BO_ 2583417086 Plate: 12 Node
 SG_ Tilt : 72|16@1- (0.01,90) [-100|200] "deg" Node
""",
    f"""\
sweep: {{enabled: false}}
signals:
  impact_voltage:
    dbc: long.dbc
    message: Samples
    signals: [{", ".join(f"S{k}" for k in range(28))}]
    rate_hz: 1000
    counter: Count
  elevator_speed: {{dbc: long.dbc, message: Machine, signal: Shaft, source: 0x55}}
  plate_angle: {{dbc: long.dbc, message: Plate, signal: Tilt}}
  actuator_state: null
""",
    Long,
)
"""CAN FD, which not every interface has."""

LAYOUTS = (COUNTS, NEWTONS, MULTIPLEXED, BLOCKS, PROPRIETARY)
