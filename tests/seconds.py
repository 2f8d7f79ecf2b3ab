"""A second of a record as the daemon writes it, for the tests of what reads records."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from yieldmon.frames import EstimateQuality
from yieldmon.service.storage.rows import SecondRow


def measured_second(number: int, time_s: float, flow_kg_s: float, **changes: Any) -> SecondRow:
    """A second of harvest at the home angle with nothing wrong, and what `changes` say."""
    row = SecondRow(
        number=number,
        time_s=time_s,
        duration_s=1.0,
        mass_flow_kg_s=flow_kg_s,
        std_dev_kg_s=0.2,
        quality=int(EstimateQuality.OK),
        operating_state=3,
        mass_kg=flow_kg_s,
        load_number=1,
        load_kg=flow_kg_s * number,
        total_kg=flow_kg_s * number,
        coverage=1.0,
        force_n=60.0,
        force_std_dev_n=0.8,
        elevator_speed_rpm=400.0,
        plate_angle_deg=70.0,
        plate_still=1,
        moisture_pct=20.0,
        test_weight_kg_m3=None,
        zero_mv=500.0,
        pulse_mv=3.0,
        saturated_share=0.0,
        lost_frames=0,
        surplus_frames=0,
        repeated_frames=0,
        sweep_id=0,
        sweep_step=-1,
        usable_for_calibration=0,
        parameter_version=1,
        faults="",
        latitude_deg=40.0,
        longitude_deg=-88.25,
        ground_speed_m_s=2.0,
        course_deg=0.0,
    )
    return replace(row, **changes)
