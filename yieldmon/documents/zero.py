"""What `yieldmon zero --json` prints."""

from __future__ import annotations

from typing import TypedDict

from .common import Answered


class ZeroStarted(TypedDict):
    """A zero calibration that began. zero: what it needs, for people."""

    zero: str


class ZeroDocument(ZeroStarted, Answered):
    """`yieldmon zero --json`."""


class ZeroUndone(TypedDict):
    """A zero calibration that was taken back. restored_kg: mass that the seconds since then gain, measured with the zero before
    it; below 0 where they lose."""

    zero: str
    restored_kg: float


class ZeroUndoDocument(ZeroUndone, Answered):
    """`yieldmon zero --undo --json`."""
