"""One boot of a guest: its channels, the process it runs in, and the limits of both."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from .machines import Boot, Machine
from .packages import VmError

TIMED_OUT = 124

BOOT_LIMIT_S = 180.0
"""CPU time, as every limit of the virtual machine: beside other work it only takes longer by the clock."""
WALL_LIMIT_RATIO = 4.0
"""A machine that waits for ever takes no CPU time; the clock ends it after this many times the limit."""
POWER_OFF_LIMIT_S = 20.0
_PREFERRED = -10

Note = Callable[[str], None]


class NotStarted(VmError):
    """The guest did not come as far as its command."""


class Limit:
    """A bound on the CPU time of a session's processes, and WALL_LIMIT_RATIO times it by the clock.

    Parameters
    ----------
    pid : int
        Process that began the session.
    begun_s : float
        When, by the monotonic clock.
    limit_s : float
    """

    def __init__(self, pid: int, begun_s: float, limit_s: float) -> None:
        self._pid = pid
        self._until_s = begun_s + WALL_LIMIT_RATIO * limit_s
        self._limit_s = limit_s
        self._most_s, self._next_s = 0.0, 0.0

    def cpu_s(self) -> float:
        """User and system time so far, looked up once a second."""
        if time.monotonic() >= self._next_s:
            self._most_s = max(self._most_s, sum(_cpu_s(stat, self._pid) for stat in Path("/proc").glob("[0-9]*/stat")))
            self._next_s = time.monotonic() + 1.0
        return self._most_s

    def reached(self) -> bool:
        """Whether one of the bounds is."""
        return self.cpu_s() >= self._limit_s or time.monotonic() >= self._until_s


def _cpu_s(stat: Path, session: int) -> float:
    """CPU time of a process of this session, of its ended children too; 0 for others and those that are gone."""
    try:
        fields = stat.read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK") if int(fields[3]) == session else 0.0


class Guest:
    """A guest that is booted, runs its command and powers off."""

    def __init__(self, machine: Machine, kernel: Path, boot: Boot, limit_s: float, note: Note) -> None:
        self._machine, self._kernel, self._boot = machine, kernel, boot
        self._limit_s, self._note = limit_s, note
        self._started = threading.Event()
        self._status: int | None = None

    def run(self, *, verbose: bool) -> int:
        """The command's exit status. Raises NotStarted, and VmError where the guest ends without one."""
        begun_s = time.monotonic()
        started = self._machine.start(self._kernel, self._boot)
        consumers = {"stdout": _copy_to(sys.stdout.buffer), "stderr": _copy_to(sys.stderr.buffer), "control": self._follow}
        readers = [_reader(name, started.channels[name], consume) for name, consume in consumers.items()]
        with self._console.open("wb") as console:
            process = subprocess.Popen(
                started.command,
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=started.pass_fds,
                env=os.environ | started.environment,
            )
        for descriptor in started.pass_fds:
            os.close(descriptor)
        if self._machine.on_host_clock:
            _prefer(process.pid)
        try:
            limit = Limit(process.pid, begun_s, self._limit_s)
            if not self._wait_for_start(process, limit, Limit(process.pid, begun_s, BOOT_LIMIT_S)):
                if process.poll() is None and limit.reached():
                    return self._out_of_time("while booting", verbose)
                problem = f"the guest did not start the command within {limit.cpu_s():.0f} s of CPU time"
                raise NotStarted(self._last_words(problem))
            booted_s, booted_cpu_s = time.monotonic(), limit.cpu_s()
            self._note(f"{self._machine.name}: booted in {booted_s - begun_s:.1f} s ({booted_cpu_s:.1f} s of CPU time)")
            command_cpu_s = 0.0
            while self._status is None and process.poll() is None:
                command_cpu_s = limit.cpu_s() - booted_cpu_s
                if limit.reached():
                    return self._out_of_time("", verbose)
                time.sleep(0.02)
            self._note(f"the command took {time.monotonic() - booted_s:.1f} s ({command_cpu_s:.1f} s of CPU time)")
            try:
                process.wait(POWER_OFF_LIMIT_S)
            except subprocess.TimeoutExpired:
                self._note("the guest did not power off")
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            for reader in readers:
                reader.join(5.0)
        if self._status is None:
            raise VmError(self._last_words("the guest died without an exit status"))
        return self._status

    @property
    def _console(self) -> Path:
        return self._boot.scratch / "console"

    def _wait_for_start(self, process: subprocess.Popen[bytes], *limits: Limit) -> bool:
        while process.poll() is None and not any(limit.reached() for limit in limits):
            if self._started.wait(0.05):
                return True
        return self._started.is_set()

    def _out_of_time(self, when: str, verbose: bool) -> int:
        text = f"vcan-vm: out of time after {self._limit_s:g} s of CPU time {when}".rstrip()
        print(self._last_words(text) if verbose else text, file=sys.stderr, flush=True)
        return TIMED_OUT

    def _last_words(self, problem: str) -> str:
        lines = self._console.read_text(errors="replace").splitlines()
        printable = [re.sub(r"[^\x20-\x7e]", "", line).strip() for line in lines]
        tail = [line for line in printable if line][-12:]
        return problem + ("; its console ended with:" if tail else "") + "".join(f"\n  {line}" for line in tail)

    def _follow(self, data: bytes) -> None:
        for word in data.decode("ascii", "replace").splitlines():
            if word == "started":
                self._started.set()
            elif word.startswith("exit "):
                self._status = int(word.removeprefix("exit "))


def _prefer(pid: int) -> None:
    """Let a process go before others, where the user may: its clock goes on while it waits for the processor."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, _PREFERRED)


def _reader(name: str, wait: Callable[[], Callable[[], bytes]], consume: Callable[[bytes], None]) -> threading.Thread:
    """A thread that hands on what comes from the guest."""

    def read() -> None:
        following = wait()
        while data := following():
            consume(data)

    thread = threading.Thread(target=read, name=name, daemon=True)
    thread.start()
    return thread


def _copy_to(stream: BinaryIO) -> Callable[[bytes], None]:
    def consume(data: bytes) -> None:
        stream.write(data)
        stream.flush()

    return consume
