"""A reader's own process as a fork of this one, which has its packages loaded: a hundredth of the time of a start.

The steps that it takes come back to the coverage that guides, and its memory counts as a child's.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO
from unittest import mock

from tests.robustness import guided
from yieldmon.bus.log_files import mf4, mf4_reading

_COUNTED = 20.0


class _Fork:
    """As much of a `subprocess.Popen` as `Mf4Log` uses."""

    def __init__(self, command: list[str], **_: object) -> None:
        # Counting steps makes everything slower.
        path, stalled_s, copies = command[-3:]
        limit_s = float(stalled_s) * (_COUNTED if guided.current is not None else 1.0)
        self._steps = Path(tempfile.mkdtemp()) / "steps"
        reads, writes = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            os.close(reads)
            os.dup2(writes, 1)
            os.close(writes)
            self._be_the_process(path, limit_s, copies)
        os.close(writes)
        self.stdout: IO[bytes] = os.fdopen(reads, "rb")
        self._code: int | None = None

    def _be_the_process(self, path: str, limit_s: float, copies: str) -> None:
        leave = os._exit

        def reported(code: int) -> None:
            if guided.current is not None:
                self._steps.write_bytes(pickle.dumps(guided.current.counted()))
            leave(code)

        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        gc.disable()  # its pages are this process's as long as nothing writes to them
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            with mock.patch("os._exit", reported):
                mf4_reading.main(path, limit_s, copies)
        finally:
            leave(1)

    def kill(self) -> None:
        """It ends by itself, at a pipe that nobody reads any more or at its limit of processor time."""
        self.stdout.close()

    def wait(self) -> int:
        if self._code is None:
            _, status = os.waitpid(self._child, 0)
            self._code = os.waitstatus_to_exitcode(status)
            if self._steps.exists():
                if guided.current is not None:
                    guided.current.add(pickle.loads(self._steps.read_bytes()))  # noqa: S301 - our own child's
                self._steps.unlink()
            self._steps.parent.rmdir()
        return self._code


@contextmanager
def processes() -> Iterator[None]:
    """Within it, MF4 logs are read in forks."""
    mf4.provide()
    with mock.patch("yieldmon.bus.log_files.mf4_reading.subprocess.Popen", _Fork):
        yield
