"""One second's window as a flat row, for the store and for tables: units as people read them, None for "not available"."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, isfinite

from yieldmon.engine.records import WindowRecord
from yieldmon.physics.machine import RPM


@dataclass(frozen=True, slots=True)
class SecondRow:
    """A WindowRecord (see there) in deg and rpm, with codes as int, flags as 0 and 1, and faults joined with spaces.

    number: counts the rows of a store, or of an output file, up from 1 without a gap.
    """

    number: int
    time_s: float
    duration_s: float
    mass_flow_kg_s: float | None
    std_dev_kg_s: float | None
    quality: int
    operating_state: int
    mass_kg: float
    load_number: int
    load_kg: float
    total_kg: float
    coverage: float
    force_n: float | None
    force_std_dev_n: float | None
    elevator_speed_rpm: float | None
    plate_angle_deg: float | None
    plate_still: int
    moisture_pct: float | None
    test_weight_kg_m3: float | None
    zero_mv: float | None
    pulse_mv: float | None
    saturated_share: float | None
    lost_frames: int
    surplus_frames: int
    repeated_frames: int
    sweep_id: int
    sweep_step: int
    usable_for_calibration: int
    parameter_version: int
    faults: str
    latitude_deg: float | None
    longitude_deg: float | None
    ground_speed_m_s: float | None
    course_deg: float | None


def second_row(number: int, record: WindowRecord) -> SecondRow:
    """The row of a window record."""
    return SecondRow(
        number=number,
        time_s=float(record.time_s),
        duration_s=float(record.duration_s),
        mass_flow_kg_s=_known(record.mass_flow_kg_s),
        std_dev_kg_s=_known(record.std_dev_kg_s),
        quality=int(record.quality),
        operating_state=int(record.operating_state),
        mass_kg=float(record.mass_kg),
        load_number=int(record.load_number),
        load_kg=float(record.load_kg),
        total_kg=float(record.total_kg),
        coverage=float(record.coverage),
        force_n=_known(record.force_n),
        force_std_dev_n=_known(record.force_std_dev_n),
        elevator_speed_rpm=_known(record.elevator_speed_rad_s / RPM),
        plate_angle_deg=_known(degrees(record.plate_angle_rad)),
        plate_still=int(record.plate_still),
        moisture_pct=_known(record.moisture_pct),
        test_weight_kg_m3=_known(record.test_weight_kg_m3),
        zero_mv=_known(record.zero_mv),
        pulse_mv=_known(record.pulse_mv),
        saturated_share=_known(record.saturated_share),
        lost_frames=int(record.lost_frames),
        surplus_frames=int(record.surplus_frames),
        repeated_frames=int(record.repeated_frames),
        sweep_id=int(record.sweep_id),
        sweep_step=int(record.sweep_step),
        usable_for_calibration=int(record.usable_for_calibration),
        parameter_version=int(record.parameter_version),
        faults=" ".join(code.value for code in record.faults),
        latitude_deg=_known(record.latitude_deg),
        longitude_deg=_known(record.longitude_deg),
        ground_speed_m_s=_known(record.ground_speed_m_s),
        course_deg=_known(record.course_deg),
    )


def _known(value: float) -> float | None:
    return float(value) if isfinite(value) else None
