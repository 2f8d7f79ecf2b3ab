"""The command line in processes of their own, forked from one that has its packages loaded: for tests that need a process and not
its start, which takes three quarters of a second of CPU time.

The parent of the forks is started once per test process, with nothing in it but the imports, so no thread or lock of the tests is
copied. It ends when the tests' end of its socket is closed.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import IO

LIMIT_S = 60.0
"""A command that is waited for so long is killed."""
_MESSAGE_BYTES = 65536
_ROOT = Path(__file__).resolve().parents[1]


class Forked:
    """A command that runs: as much of a `subprocess.Popen` as the tests use.

    Attributes
    ----------
    pid : int
    stderr : text file
        What it writes to standard error, to look at whether there is something; read by `line` and `rest`.
    """

    def __init__(self, words: tuple[str, ...], before: str = "") -> None:
        status_reads, status_writes = os.pipe()
        error_reads, error_writes = os.pipe()
        try:
            socket.send_fds(_parent()[0], [json.dumps([before, *words]).encode()], [error_writes, status_writes])
        finally:
            os.close(error_writes)
            os.close(status_writes)
        self._status: IO[str] = os.fdopen(status_reads)
        self.stderr: IO[str] = os.fdopen(error_reads)
        self.pid = int(self._status.readline())

    def line(self) -> str:
        """The next line of standard error, "" where it has ended."""
        with self._killed_late():
            return self.stderr.readline()

    def rest(self) -> str:
        """What it still writes to standard error, to the end."""
        with self._killed_late():
            return self.stderr.read()

    def send_signal(self, number: int) -> None:
        """Also to one that has ended, where nothing happens."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def wait(self) -> int:
        """Its exit code, negative for a signal; to be called once."""
        with self._killed_late():
            return int(self._status.readline())

    @contextlib.contextmanager
    def _killed_late(self) -> Iterator[None]:
        """A test that waits for what never comes fails."""
        killing = threading.Timer(LIMIT_S, self.send_signal, (signal.SIGKILL,))
        killing.start()
        try:
            yield
        finally:
            killing.cancel()


@contextlib.contextmanager
def running(*words: str, before: str = "") -> Iterator[Forked]:
    """`yieldmon words` as a process of its own; killed at the end where it still runs. before: Python that it runs first."""
    process = Forked(words, before)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGKILL)
        process.stderr.close()


@cache
def _parent() -> tuple[socket.socket, subprocess.Popen[bytes]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        number = theirs.fileno()
        return ours, subprocess.Popen([sys.executable, "-m", "tests.forked", str(number)], pass_fds=[number], cwd=_ROOT)


def _serve(requests: socket.socket) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        message, files, _, _ = socket.recv_fds(requests, _MESSAGE_BYTES, 2)
        if not message:
            return
        if os.fork() == 0:
            requests.close()
            _watch(json.loads(message), *files)
        for file in files:
            os.close(file)


def _watch(message: list[str], error: int, status: int) -> None:
    """In a process between: the command's number, and its exit code once it has ended."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    child = os.fork()
    if child == 0:
        os.close(status)
        os.dup2(error, 2)
        os.close(error)
        # Anew: what the stream found out about the file that was there does not hold for a pipe.
        sys.stderr = open(2, "w", encoding="utf-8", buffering=1, closefd=False)  # noqa: SIM115 - as long as the process
        _be(*message)
    os.close(error)
    os.write(status, f"{child}\n".encode())
    _, ended = os.waitpid(child, 0)
    with contextlib.suppress(BrokenPipeError):
        os.write(status, f"{os.waitstatus_to_exitcode(ended)}\n".encode())
    os._exit(0)


def _be(before: str, *words: str) -> None:
    from yieldmon.cli.main import main

    sys.argv = ["yieldmon", *words]
    code = 1
    try:
        exec(before)  # noqa: S102 - the test's own
        code = main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    except BaseException:  # noqa: BLE001 - as the interpreter does, which is not to go on from here
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    for module in ("yieldmon.cli.web", "yieldmon.field.table", "yieldmon.web.app", "yieldmon.web.serving"):
        importlib.import_module(module)
    _serve(socket.socket(fileno=int(sys.argv[1])))
