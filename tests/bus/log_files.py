"""Logs as tests write and read them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import can

from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.log_writing import writing
from yieldmon.bus.log_files.logs import read_log


def write(path: Path, messages: Iterable[can.Message]) -> Path:
    """A log by python-can, in the format of its name; the path."""
    with writing(path) as writer:
        for message in messages:
            writer.on_message_received(message)
    return path


def read(path: Path) -> tuple[list[can.Message], LogNotes]:
    """All messages of a log, and what was noted of it."""
    notes = LogNotes(on_damage=lambda damage: None)
    return list(read_log(path, notes)), notes
