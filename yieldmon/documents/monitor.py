"""What `yieldmon monitor --json` prints."""

from __future__ import annotations

from typing import TypedDict

from .common import Number


class MonitorRow(TypedDict):
    """An identifier, hexadecimal. message: of the DBC, null where none names it; age_s: since its last frame; stale: for ten
    periods or more; data: of the last frame, hexadecimal; signals: its values, null for those that are not available."""

    id: str
    message: str | None
    count: int
    rate_hz: float
    age_s: Number
    stale: bool
    data: str
    signals: dict[str, Number] | None


class MonitorDocument(TypedDict):
    """`yieldmon monitor --json`, a line a second without --once. time_s: of the last frame; factory_mass_flow_kg_s: as the
    combine's own monitor sends it."""

    time_s: Number
    frames: int
    error_frames: int
    factory_mass_flow_kg_s: Number
    rows: list[MonitorRow]
