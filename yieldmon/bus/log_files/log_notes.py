"""What reading a CAN log meets beside its frames: damaged places, frames that its recorder lost."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import can

from yieldmon.errors import InputError
from yieldmon.units import counted

_log = logging.getLogger(__name__)


_LINES = "lines of candump, BUSMASTER, CanKing, or a CL1000, CL2000 or CL3000; export others as .asc or .trc"
_KINDS = {
    ".log": f": {_LINES}",
    ".txt": f": {_LINES}",
    ".csv": ": of python-can, SavvyCAN, Kvaser, CANedge or Vehicle Spy; export others as .asc or .trc",
    ".trc": ": PEAK's; export others as .asc",
    ".asc": ": Vector's",
}
"""By the ending of text formats, what is read; several programs write others under it."""


@dataclass(frozen=True)
class Damage:
    """One place of a log that could not be read. where: ``FILE:LINE``, or ``FILE: byte N`` in a binary file."""

    where: str
    problem: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


@dataclass
class LogNotes:
    """What reading a log met beside its frames; filled while the iterator runs.

    dropped_by_recorder: frames that the recorder says it lost itself. damages: the first of them; damaged_places counts all.
    """

    frames: int = 0
    error_frames: int = 0
    dropped_by_recorder: int = 0
    damaged_places: int = 0
    damages: list[Damage] = field(default_factory=list)
    on_damage: Callable[[Damage], None] | None = None

    _KEPT = 20

    def damage(self, where: str, problem: str) -> None:
        """Counts a damaged place and hands it to on_damage, or to the log while there are few.

        Those before the first frame wait for it: a file without any is no log, which its error says in one line.
        """
        damage = Damage(where, " ".join(problem.split())[:200])
        self.damaged_places += 1
        if len(self.damages) < self._KEPT:
            self.damages.append(damage)
        if self.frames:
            self._report(damage)

    def count(self, frames: int) -> None:
        """Counts frames."""
        if frames and not self.frames:
            for damage in self.damages:
                self._report(damage)
        self.frames += frames

    def lacks(self, log: Path | str) -> list[str]:
        """What the log lacks, a line each: damaged places, how many more there are, and frames that its recorder lost."""
        lines = [str(damage) for damage in self.damages]
        if more := self.damaged_places - len(self.damages):
            lines.append(f"{log}: {counted(more, 'more damaged place')}")
        if self.dropped_by_recorder:
            lines.append(f"{log}: the recorder lost {counted(self.dropped_by_recorder, 'frame')}")
        return lines

    def lost(self, frames: int) -> None:
        """Counts frames that the recorder says it lost."""
        self.dropped_by_recorder += frames

    def frame(self, message: can.Message) -> None:
        """Counts a frame."""
        self.error_frames += message.is_error_frame
        self.count(1)

    def _report(self, damage: Damage) -> None:
        if self.on_damage is not None:
            self.on_damage(damage)
        elif self.damaged_places <= self._KEPT:
            _log.warning("%s", damage)


def refuse_unreadable(notes: LogNotes) -> None:
    """Raises InputError when reading to the end found damage and no frame at all."""
    if notes.damages and not notes.frames:
        first = notes.damages[0]
        kind = next((what for ending, what in _KINDS.items() if ending in first.where.lower()), "")
        raise InputError(first.where, f"{first.problem}; no frame in the whole file", f"a CAN log as its name says{kind}")
