"""What the set-up asks, in order: each with its drawing, unit and range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from yieldmon.files.speeds import LARGEST_SPEED_RPM

SIDE = """\
             plate pivot (x, y from the sprocket's centre)
                      o
          tip  ,       \\   plate, length L
       paddle /|         \\
             / |  grain ->\\  plate angle, from level, 90 = upright
            (sprocket)      \\
     elevator, seen from the side; x to the outlet, y upwards here
"""
CHAIN = """\
      |<-- spacing 1 -->|<---- spacing 2 ---->|<-- spacing 1 ...
      ]-----------------]---------------------]------------- chain
    measure several along the chain and give the pattern that repeats
"""
PADDLE = """\
       |<- width ->|
       +-----------+  tip      length: from the sprocket's centre
       |           |           to the tip of a paddle that stands
       +-----------+           straight out from it
            (o) sprocket's centre
"""
WEIGHTS = """\
       plate <---- string ----(pulley)      The cell reads the level pull.
                                 |          Read the voltage with nothing
                               [ kg ]       hanging, then with two weights.
"""
ANGLES = """\
       put an inclinometer on the plate at two positions and read
       what the actuator reports at each
"""


@dataclass(frozen=True, slots=True)
class Question:
    """One thing to answer. kind: number, numbers, word. low, high: of each number. default: None where there is none."""

    key: str
    text: str
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    default: float | str | None = None
    drawing: str = ""
    kind: str = "number"

    def applies(self, answers: Mapping[str, Any]) -> bool:
        """Whether it is asked, by the answers before it: a bolted plate has no actuator."""
        return self.key != "plate_reported_deg" or not bolted(answers)

    def words(self, answers: Mapping[str, Any]) -> str:
        """The question; a bolted plate has one position."""
        return self.text.removesuffix(", two positions") if bolted(answers) else self.text


def bolted(answers: Mapping[str, Any]) -> bool:
    """Whether the plate has one angle only."""
    low = answers.get("min_plate_angle_deg")
    return low is not None and low == answers.get("max_plate_angle_deg")


QUESTIONS: tuple[Question, ...] = (
    Question("machine_name", "Name of the machine", kind="word", default="combine"),
    Question("bus_interface", "CAN interface (python-can's name)", kind="word", default="socketcan"),
    Question("bus_channel", "Its channel", kind="word", default="can0"),
    Question("sprocket_pitch_radius_m", "Pitch radius of the upper sprocket", "m", 0.01, 1.0, drawing=SIDE),
    Question("paddle_spacings_m", "Distances between paddles along the chain", "m", 0.01, 2.0, drawing=CHAIN, kind="numbers"),
    Question("paddle_length_m", "Sprocket's centre to the tip of a paddle", "m", 0.02, 1.0, drawing=PADDLE),
    Question("paddle_width_m", "Width of a paddle", "m", 0.02, 1.0),
    Question("plate_pivot_x_m", "Plate's pivot, level distance from the sprocket's centre", "m", 0.0, 5.0, drawing=SIDE),
    Question("plate_pivot_above_m", "Plate's pivot, height above the sprocket's centre", "m", -5.0, 5.0),
    Question("plate_length_m", "Length of the plate, pivot to lower edge", "m", 0.02, 2.0),
    Question("home_plate_angle_deg", "Plate angle in work", "deg", 5.0, 120.0, 70.0),
    Question("min_plate_angle_deg", "Smallest plate angle", "deg", 5.0, 120.0, 40.0),
    Question("max_plate_angle_deg", "Largest plate angle", "deg", 5.0, 120.0, 90.0),
    Question("nominal_elevator_speed_rpm", "Sprocket speed in work", "rpm", 1.0, LARGEST_SPEED_RPM, 400.0),
    Question("min_elevator_speed_rpm", "Smallest sprocket speed with grain", "rpm", 1.0, LARGEST_SPEED_RPM, 250.0),
    Question("max_elevator_speed_rpm", "Largest sprocket speed", "rpm", 1.0, LARGEST_SPEED_RPM, 599.0),
    Question("largest_flow_kg_s", "Largest mass flow expected", "kg/s", 1.0, 100.0, 25.0),
    Question("cell_full_scale_mv", "Largest voltage of the force cell", "mV", 1.0, 1e5, 4000.0),
    Question("cell_weights_kg", "Masses hung on the plate, first 0", "kg", 0.0, 500.0, drawing=WEIGHTS, kind="numbers"),
    Question("cell_readings_mv", "Voltage at each of them", "mV", -1e5, 1e5, kind="numbers"),
    Question(
        "plate_measured_deg", "Plate angle by inclinometer, two positions", "deg", 0.0, 180.0, drawing=ANGLES, kind="numbers"
    ),
    Question("plate_reported_deg", "Angle that the actuator reports at each", "deg", 0.0, 180.0, kind="numbers"),
    Question("crop", "Crop", kind="word", default="corn"),
)
