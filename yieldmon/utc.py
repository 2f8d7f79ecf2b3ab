"""Points in time as text: UTC, ISO 8601."""

from __future__ import annotations

from datetime import UTC, datetime


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
