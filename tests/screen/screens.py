"""Screens that are kept as text: what a terminal of a stated size shows, by way of a terminal emulator.

python -m tests.screen.screens     # draws them anew into tests/screen/kept/
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import can
import pyte
from rich.console import Console, RenderableType

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.frames import NOT_AVAILABLE, Frame
from yieldmon.screen.cab import Cab, from_frames
from yieldmon.screen.panels import Screen, View
from yieldmon.screen.traffic import Traffic
from yieldmon.units import Units, UnitSystem

KEPT = Path(__file__).parent / "kept"
CODEC = Codec()
SMALL, LARGE = (80, 24), (120, 40)
US = Units(UnitSystem.US, 25.4011727)
FAULTS = {s.name: 0 for s in CODEC.layouts[frames.YIELD_MONITOR_STATUS].signals}

STATUS: dict[str, Any] = {
    "state": "harvesting", "stale": False, "age_s": 0.4, "zero_waits_for": None, "units": "metric",
    "crop": {"name": "corn", "bushel_kg": 25.4011727, "market_moisture_pct": 15.5},
    "now": {
        "mass_flow_kg_s": 12.34, "std_dev_kg_s": 0.31, "quality": "good", "yield_kg_m2": 1.043, "moisture_pct": 17.24,
        "ground_speed_m_s": 1.53, "plate_angle_deg": 70.02, "elevator_speed_rpm": 401.2,
    },
    "load": {
        "number": 7, "open": True, "field": "north forty", "crop": "corn", "mass_kg": 8432.1, "std_dev_kg": 61.0,
        "dry_mass_kg": 8258.7, "area_m2": 8123.0, "yield_kg_m2": 1.038, "dry_yield_kg_m2": 1.0167,
    },
    "loads": [{"number": 3}, {"number": 5}, {"number": 7}],
    "total": {"mass_kg": 412_345.0},
    "sweep": {"state": "idle", "progress_pct": 0.0, "due_in_s": 731.0},
    "faults": [],
}  # fmt: skip

ZERO_FAULT = {
    "code": "ZeroDrifted", "detail": "61 mV from the first zero",
    "effect": "Flow is wrong by the force of the drift.",
    "remedy": "Run the elevator empty and give `yieldmon zero`; look for grain stuck on the plate.",
}  # fmt: skip
MANY_FAULTS = [{**ZERO_FAULT, "code": f"{ZERO_FAULT['code']}{letter}"} for letter in "ABCDEFGH"]


def traffic(seconds: int = 12, silent_s: float = 0.0) -> Traffic:
    """Traffic of every message of ours, a factory monitor's, and two that are nobody's; silent_s: with none since."""
    found = Traffic(CODEC)
    for tick in range(seconds * 20 + 1):
        at = 100.0 + 0.05 * tick
        for message in _messages(tick, at):
            found.observe(message)
        if tick % 5 == 0:
            found.mark(at)
    if silent_s > 0.0:
        found.mark(at + silent_s)
    return found


def _messages(tick: int, at: float) -> list[can.Message]:
    reported = [Frame(at, frames.ELEVATOR_SPEED, {"ElevatorSpeed": 400.0 + tick % 7})]
    samples = {f"Sample{k}": float(900 + 37 * ((tick + k) % 11)) for k in range(4)}
    reported.append(Frame(at, frames.IMPACT_SENSOR_SAMPLES, {**samples, "SampleCounter": tick % 256, "SensorStatus": 0}))
    if tick % 20 == 0:
        second = tick // 20
        reported += [
            Frame(at, frames.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": 70.0 + 0.1 * (second % 2), "ActuatorState": 0}),
            Frame(at, frames.GRAIN_CONDITION, {"Moisture": 17.24, "GrainTemperature": 21.5, "TestWeight": 718.0}),
            Frame(at, frames.MASS_FLOW, {
                "MassFlowRate": 12.0 + 0.1 * second, "MassFlowStdDev": 0.31, "EstimateQuality": 0, "WindowCounter": second,
            }),
            Frame(at, frames.ACCUMULATED_MASS, {"LoadMass": 8420.0 + 12.0 * second, "TotalMass": 412_345.0, "LoadNumber": 7}),
            Frame(at, frames.YIELD_MONITOR_STATUS, FAULTS | {"OperatingState": 3, "ZeroDrifted": 1, "CalibrationOld": 1}),
            Frame(at, frames.TANK_SCALE, {"TankMass": NOT_AVAILABLE, "TankScaleStatus": 1}),
            Frame(at, frames.VEHICLE_POSITION, {"Latitude": 40.0621234, "Longitude": -88.1957123}),
        ]  # fmt: skip
    messages = [CODEC.encode(frame) for frame in reported]
    messages.append(can.Message(timestamp=at, arbitration_id=0x0CF00400, is_extended_id=True, data=bytes([240, tick % 256] * 4)))
    if tick % 10 == 0:
        messages.append(can.Message(timestamp=at, arbitration_id=0x123, is_extended_id=False, data=b"\x01\xff"))
    return messages


def _frames(name: str, **view: Any) -> RenderableType:
    seen = traffic()
    rows = seen.sorted_rows("id")
    chosen = next(place for place, row in enumerate(rows) if row.name == name)
    return Screen(seen, View(source="socketcan can0", selected=chosen, **view))


def _cab(units: Units = Units(), prompt: str = "", **changes: Any) -> RenderableType:  # noqa: B008 - frozen
    return Cab(STATUS | changes, units, prompt, View(cab=True))


ZEROING = {
    "state": "zeroing",
    "zero_waits_for": "the elevator to run at 250 to 599 rpm: it turns at 0 rpm",
    "now": {**STATUS["now"], "mass_flow_kg_s": None, "yield_kg_m2": None, "quality": "not_available", "moisture_pct": None},
}

SCREENS: dict[str, tuple[RenderableType, int, int]] = {
    f"{name}-{width}x{height}": (what, width, height)
    for width, height in (SMALL, LARGE)
    for name, what in {
        "frames-flow": _frames(frames.MASS_FLOW),
        "frames-samples": _frames(frames.IMPACT_SENSOR_SAMPLES),
        "frames-status": _frames(frames.YIELD_MONITOR_STATUS, units=US),
        "cab": _cab(),
        "cab-us": _cab(US),
        "cab-faults": _cab(faults=[ZERO_FAULT]),
        "cab-many-faults": _cab(faults=MANY_FAULTS),
        "cab-zeroing": _cab(**ZEROING),
        "cab-question": _cab(prompt="load 7 weighed 9,120 kg: right? y n"),
        "cab-from-frames": Cab(from_frames(traffic()), Units(), "", View(cab=True)),
        "cab-from-old-frames": Cab(from_frames(traffic(silent_s=30.0)), Units(), "", View(cab=True)),
        "cab-no-monitor": Cab(from_frames(Traffic(CODEC)), Units(), "", View(cab=True)),
        "bus-old-frames": Screen(traffic(silent_s=30.0), View(source="socketcan can0")),
    }.items()
}


def drawn(what: RenderableType, width: int, height: int) -> str:
    """What the terminal shows."""
    console = Console(
        file=io.StringIO(), width=width, height=height, force_terminal=True, color_system="standard", legacy_windows=False
    )
    console.print(what, height=height, end="")
    screen = pyte.Screen(width, height)
    pyte.Stream(screen).feed(console.file.getvalue().rstrip("\n").replace("\n", "\r\n"))
    return "\n".join(line.rstrip() for line in screen.display).rstrip() + "\n"


if __name__ == "__main__":
    KEPT.mkdir(exist_ok=True)
    for name, shown in SCREENS.items():
        (KEPT / f"{name}.txt").write_text(drawn(*shown), encoding="utf-8")
