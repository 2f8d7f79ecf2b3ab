"""Whole logs as one block of frames."""

from __future__ import annotations

from pathlib import Path

from yieldmon.bus.bulk import FrameBlock, concatenate
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes


def load_frames(path: Path | str, notes: LogNotes | None = None) -> FrameBlock:
    """The whole log; damage is counted and raised as by `iter_blocks`."""
    return concatenate(list(iter_blocks(path, notes)))
