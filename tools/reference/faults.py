"""Table of the faults, from the engine's own."""

from __future__ import annotations

from yieldmon.engine.faults import FAULTS, Severity

LAMPS = {Severity.NOTE: "none", Severity.WARNING: "amber", Severity.STOP_TRUSTING: "amber; state FAULT"}


def markdown() -> str:
    """A row for each fault."""
    lines = [
        "|fault|SPN/FMI|set/clear|lamp|cause|effect on the estimate|remedy|",
        "|---|---|---|---|---|---|---|",
    ]
    for row in FAULTS.values():
        lines.append(
            f"|{row.code.value}|{row.spn}/{row.fmi}|{row.set_after}/{row.clear_after}|{LAMPS[row.severity]}"
            f"|{row.cause}|{row.effect}|{row.remedy}|"
        )
    return "\n".join(lines)
