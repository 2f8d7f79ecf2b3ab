"""What `yieldmon predict --json` prints."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from .common import Number


class PredictedRow(TypedDict):
    """An operating point and what the model gives for it. force_n: mean; momentum and force are in the sensor's unit where the
    parameters are in one. moisture_pct, plate_position_m: as given; force_std_dev_n: by the parameters' covariance, the model's
    own error and the distance from the calibrated range."""

    mass_flow_kg_s: float
    plate_angle_deg: float
    elevator_speed_rpm: float
    paddle_mass_kg: float
    paddle_momentum_kg_m_s: float
    force_n: float
    moisture_pct: NotRequired[float]
    plate_position_m: NotRequired[float]
    force_std_dev_n: NotRequired[Number]


class PredictionDocument(TypedDict):
    """`yieldmon predict --json`. parameters: values by name; rows: mass flow varies slowest."""

    machine: str
    parameters: dict[str, float]
    rows: list[PredictedRow]
