"""Frames into a log while recording is on."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import can

from yieldmon.bus.log_files.log_writing import ENDINGS, writing
from yieldmon.errors import InputError


class Recorder:
    """Writes frames to a log while recording is on."""

    def __init__(self, stack: ExitStack) -> None:
        """stack: closes a log that is still written at its end."""
        self._open = stack.enter_context(ExitStack())
        self._logger: can.Listener | None = None

    def start(self, path: Path) -> str:
        """Record to this log; returns its name. Raises InputError."""
        try:
            self._logger = self._open.enter_context(writing(path))
        except ValueError as error:
            raise InputError(str(path), str(error), ENDINGS) from error
        except OSError as error:
            raise InputError(str(path), error.strerror or str(error), "a log file that can be written") from error
        return path.name

    def toggle(self) -> str:
        """Begin a log named by the time, or end the one that is written; returns its name, "" for none. An ended log is whole."""
        if self._logger is not None:
            self._logger = None
            self._open.close()
            return ""
        return self.start(_not_taken(time.strftime("yieldmon-%Y%m%d-%H%M%S")))

    def take(self, message: can.Message) -> None:
        """The next frame."""
        if self._logger is not None:
            self._logger.on_message_received(message)


def _not_taken(name: str) -> Path:
    """A log of this name, with a number behind where there is one: a clock that is set back says the same time twice."""
    path, count = Path(f"{name}.log"), 1
    while path.exists():
        count += 1
        path = Path(f"{name}-{count}.log")
    return path
