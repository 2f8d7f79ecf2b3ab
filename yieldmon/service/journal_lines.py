"""Log lines on their way to standard error, on a thread of their own: a journal that takes nothing must not hold up measuring."""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from contextlib import suppress

#: Lines that wait; of more the oldest go.
CAPACITY = 1000


class JournalLines(logging.Handler):
    """Writes each record as a line to a descriptor, in order.

    Parameters
    ----------
    descriptor : int
        2 is standard error.
    """

    def __init__(self, descriptor: int = 2) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._lines: deque[str] = deque()
        self._left_out = 0
        self._busy = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Hand over a line; returns at once."""
        try:
            line = self.format(record)
        except Exception:  # noqa: BLE001 - as logging has it: a line that cannot be made is reported, and ends nothing
            self.handleError(record)
            return
        with self._changed:
            if self._thread is None:
                self._begin()
            if len(self._lines) >= CAPACITY:
                self._lines.popleft()
                self._left_out += 1
            self._lines.append(line)
            self._changed.notify_all()

    def finish(self, timeout_s: float = 1.0) -> bool:
        """Wait until all is written; False when that takes longer than timeout_s seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._lines and not self._busy, timeout_s)

    def _begin(self) -> None:
        thread = threading.Thread(target=self._run, name="journal-lines", daemon=True)
        with suppress(RuntimeError):
            thread.start()
            self._thread = thread

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._lines)
                line, left_out, self._left_out = self._lines.popleft(), self._left_out, 0
                self._busy = True
            if left_out:
                line = f"WARNING yieldmon: {left_out} lines left out, because nothing read them\n{line}"
            # Not by sys.stderr: a thread that hangs with its lock would abort the process at its end.
            self._write(f"{line}\n".encode(errors="backslashreplace"))
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def _write(self, content: bytes) -> None:
        with suppress(OSError):
            while content:
                content = content[os.write(self._descriptor, content) :]
