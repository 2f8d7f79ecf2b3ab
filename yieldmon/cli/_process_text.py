"""The text of `process` on standard error: what a record holds, and why it has no mass."""

from __future__ import annotations

from yieldmon.documents.process import ProcessSummary
from yieldmon.engine.faults import FaultCode
from yieldmon.service.logs.record_check import SEPARATE_FILES, record_lines
from yieldmon.service.logs.recorded_before import COUNTED_TWICE, LEFT_OUT
from yieldmon.service.logs.time_units import spacing_line
from yieldmon.units import Units, counted

_MOSTLY = 0.5
"""Share of a record's seconds above which what they lack is named as the cause."""


def summary_line(document: ProcessSummary, units: Units) -> str:
    """What `process` says of a record on standard error."""
    line = (
        f"{counted(document['frames'], 'frame')}, {document['windows']} s, {units.mass_with_bushels(document['total_mass_kg'])}"
    )
    if document["total_std_dev_kg"] is not None and document["total_mass_kg"] > 0.0:
        line += f" ± {units.mass(document['total_std_dev_kg'])}"
    if document["dry_mass_kg"] is not None and document["total_mass_kg"] > 0.0:
        line += f" ({units.mass_with_bushels(document['dry_mass_kg'])} dry)"
    if document["area_m2"] is not None:
        line += f" on {units.area(document['area_m2'])}, {units.crop_yield(document['yield_kg_m2'])}"
    line += f", {counted(document['frames_malformed'], 'malformed frame')}" if document["frames_malformed"] else ""
    incomplete = document["messages_incomplete"]
    line += f", {counted(incomplete, 'incomplete message')}" if incomplete else ""
    twice = (LEFT_OUT, COUNTED_TWICE)
    lines = [line, *(f"{'twice' if text.endswith(twice) else 'damaged'}: {text}" for text in document["damages"])]
    if document["faults"]:
        lines.append("faults: " + ", ".join(f"{code} {count} x" for code, count in document["faults"].items()))
    lines += record_lines(document)
    if why := _why_no_mass(document):
        lines.append(f"no mass: {why}")
    return "\n".join(lines)


def _why_no_mass(document: ProcessSummary) -> str:
    """Why nothing could be measured; "" where something was, or where there may have been no grain."""
    shown = "run `yieldmon check-config CONFIG --log LOG`"
    if "sensor_interval_s" in document and not (document["windows"] and document["zero_known"]):
        return f"{spacing_line(document['sensor_interval_s'], document['mapped_interval_s'])}; {shown}"
    if not document["windows"]:
        return "the frames' times span less than a second: recorder without a clock, or candump -td"
    if document["zero_known"]:
        turned = not document["total_mass_kg"] and FaultCode.ZERO_DRIFTED in document["faults"]
        return f"the zero drifted (ZeroDrifted): if there was grain, check the sensor's sign; {shown}" if turned else ""
    if why := _why_no_zero(document):
        return f"{why}; {shown}"
    return (
        "the elevator never runs empty in the log, header_down or work_state says throughout that the machine cuts, or its "
        "paddles shake the plate too much, so there is no zero; give one with --zero-mv, from the table of an earlier log or "
        "`yieldmon status`; if the log begins empty, run `yieldmon check-config CONFIG --log LOG`: it tests whether the samples "
        "can be a force"
    )


def _why_no_zero(document: ProcessSummary) -> str:
    """What most of the seconds lack for a zero; "" where they lack none of this."""
    missing = document.get("missing", {})
    if missing.get("elevator speed", 0.0) > _MOSTLY:
        return "no frame reports the elevator speed, which the zero needs"
    if missing.get("plate angle", 0.0) > _MOSTLY:
        return "no frame reports the plate angle, which the zero needs; for a plate at a fixed angle set plate.fixed_angle_deg"
    if document.get("plate_away_share", 0.0) > _MOSTLY:
        return (
            "the plate is away from home by its reported angle, and the zero needs it there: check unit, scale and offset of "
            "plate_angle, and home_plate_angle_deg of the machine file"
        )
    if document.get("frames_lost_share", 0.0) > _MOSTLY:
        return (
            "every second lacks samples (FramesLost), so there is no zero: frames are lost, two nodes or channels send them, or "
            f"the log has some twice; {SEPARATE_FILES}"
        )
    return ""
