"""What of a store is kept, and for how long."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Retention:
    """What is kept: the newest `record_hours` hours of one-second records, fewer when the file would pass `size_mb` MB,
    and the newest `event_rows` sweeps and faults. Loads, parameter versions, tickets and what took them back are few and stay: of
    tickets a part would correct other loads.

    Hours are hours of records, so a clock that is wrong by years takes nothing away.
    """

    record_hours: float = 2000.0
    size_mb: float = 512.0
    event_rows: int = 100_000


DEFAULT_RETENTION = Retention()
