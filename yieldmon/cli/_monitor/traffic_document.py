"""The traffic on a bus as `yieldmon monitor --json` prints it."""

from __future__ import annotations

from yieldmon.documents.monitor import MonitorDocument, MonitorRow
from yieldmon.frames import Unusable
from yieldmon.screen.panels import View
from yieldmon.screen.traffic import Row, Traffic


def document(traffic: Traffic, view: View) -> MonitorDocument:
    """The rows that the view shows, in its order."""
    now = traffic.now_s
    return {
        "time_s": now if traffic.frames else None,
        "frames": traffic.frames,
        "error_frames": traffic.error_frames,
        "factory_mass_flow_kg_s": traffic.factory_kg_s,
        "rows": [_row_document(traffic, row, now) for row in traffic.sorted_rows(view.order, view.needle)],
    }


def _row_document(traffic: Traffic, row: Row, now_s: float) -> MonitorRow:
    frame = traffic.decoded(row)
    signals = None
    if frame is not None:
        signals = {name: None if isinstance(value, Unusable) else value for name, value in frame.signals.items()}
    return {
        "id": f"{row.key[0]:X}",
        "message": row.name or None,
        "count": row.count,
        "rate_hz": round(row.rate_hz(now_s), 2),
        "age_s": round(row.age_s(now_s), 3),
        "stale": row.is_stale(now_s),
        "data": bytes(row.last.data).hex() if row.last is not None else "",
        "signals": signals,
    }
