"""Points in time as text: UTC, ISO 8601."""

from __future__ import annotations

from datetime import UTC, datetime

from yieldmon.units import S_PER_DAY

SERIAL_DAY_OF_1970 = 25_569.0
"""1 January 1970 as spreadsheets and PEAK's programs count days: those since 30 December 1899."""
EARLIEST_BUS_TIME_S = 1e8
"""Bus times up to this (1973) count from a recorder's start and are no dates; those above are Unix times."""


def moment(time_s: float) -> datetime:
    """Unix time as date and time in UTC. Raises ValueError or OverflowError for a time that no calendar has."""
    return datetime.fromtimestamp(time_s, UTC)


def text(at: datetime) -> str:
    """To the second, as files and provenance hold it.

    >>> text(moment(1_790_000_000))
    '2026-09-21T14:13:20Z'
    """
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def read(text: str) -> datetime:
    """A date, or date and time, in ISO 8601; UTC where it names no zone. Raises ValueError."""
    return in_utc(datetime.fromisoformat(text))


def in_utc(at: datetime) -> datetime:
    """The same, taken as UTC where it names no zone."""
    return at if at.tzinfo is not None else at.replace(tzinfo=UTC)


def of_serial_days(days: float) -> float:
    """Unix time, to the microsecond, of a moment that spreadsheets and PEAK's programs give in days.

    >>> of_serial_days(25569.5)
    43200.0
    """
    return round((days - SERIAL_DAY_OF_1970) * S_PER_DAY, 6)
