"""The next experiment as files: rows for people, plate angles for the daemon's own sweep."""

from __future__ import annotations

from math import degrees
from pathlib import Path

from yieldmon.files import whole_file
from yieldmon.physics.machine import RPM

from .experiment import REPEATS, Plan


def write_plan(plan: Plan, path: Path) -> Path:
    """Write the rows as CSV (each to be measured `REPEATS` times) and the sweep section beside it; returns the latter's path."""
    lines = ["plate_angle_deg,mass_flow_kg_s,elevator_speed_rpm,repeats"]
    for row in plan.rows:
        lines.append(
            f"{degrees(row.plate_angle_rad):.6g},{row.mass_flow_kg_s:.6g},{row.elevator_speed_rad_s / RPM:.6g},{REPEATS}"
        )
    schedule = schedule_path(path)
    for place, text in ((path, "\n".join(lines) + "\n"), (schedule, sweep_section(plan))):
        whole_file.write(place, text)
    return schedule


def schedule_path(path: Path) -> Path:
    """Path of the sweep section that `write_plan` writes for a plan at `path`."""
    return path.with_suffix(".sweep.yaml")


def sweep_section(plan: Plan) -> str:
    """Configuration text with the `sweep` keys for the plan's angles; the operator sets speed and flow."""
    angles = sorted({round(degrees(r.plate_angle_rad), 3) for r in plan.rows})
    speeds = sorted({round(r.elevator_speed_rad_s / RPM) for r in plan.rows})
    flows = sorted({round(r.mass_flow_kg_s, 2) for r in plan.rows})
    return (
        f"# Merge into the daemon's configuration. Hold the elevator at {', '.join(map(str, speeds))} rpm in turn,\n"
        f"# the flow near {', '.join(f'{f:g}' for f in flows)} kg/s.\n"
        "sweep:\n"
        "  enabled: true\n"
        f"  angles_deg: [{', '.join(f'{a:g}' for a in angles)}]\n"
        f"  windows_per_step: {REPEATS}\n"
        f"  min_flow_kg_s: {max(min(flows, default=1.0) * 0.8, 0.1):.3g}\n"
    )
