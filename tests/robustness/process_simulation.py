"""The process in a simulated world: signals between any two instructions, peers that ask without end or not at all, parts that
fail; random by seed, invariants after each life.

    python -m tests.robustness process-simulation --lives 40 --seed 1
    python -m tests.robustness process-simulation --undo "flags for signals"      # a mend undone: it must be found
    python -m tests.robustness process-simulation --table                         # every mend undone in turn

Invariants: a hangup is answered by a reload that begins after it, whichever instruction of the engine's thread it comes upon,
and SIGTERM ends the daemon, with no lock waited for that its own thread holds; peers that ask nothing, dribble or ask all at once
keep nobody out, take eight threads at most and write a few lines a minute; a daemon whose journal fails ends with its threads;
only what another configuration mends ends it for good; an answer that is cut is one line for who asked. Ends with 1 when one is
broken.
"""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import json
import logging
import os
import random
import signal
import socket
import sys
import tempfile
import threading
import time
from _thread import allocate_lock, get_ident
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import CodeType, FrameType
from typing import Any
from unittest import mock

import can

from tests.robustness import undoing
from tests.robustness.undoing import Simulation, Trouble, live, mend, require
from tests.service.bench import START_S, encoded, traffic
from yieldmon.cli import main as command
from yieldmon.cli import run as run_verb
from yieldmon.service import control_socket, daemon
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.history.journal import Journal
from yieldmon.service.operator import control
from yieldmon.service.operator.control import ControlServer
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.rate_limited_log import RateLimitedLog
from yieldmon.service.timeouts import Timeouts

_PATIENCE_S = 120.0
_channels = itertools.count()


@contextmanager
def _home(text: str) -> Iterator[Path]:
    """A folder for a daemon's state and socket, with its configuration c.yaml."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "c.yaml").write_text(text, encoding="utf-8")
        places = {"STATE_DIRECTORY": name, "RUNTIME_DIRECTORY": name}
        with mock.patch.dict(os.environ, places):
            yield folder


def _until(holds: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + _PATIENCE_S
    while not holds():
        require(time.monotonic() < end_s, f"still waiting for {what}")
        time.sleep(0.002)


# Signals


class _Deadlock(BaseException):
    """A thread waits for a lock that it holds itself, for ever."""


class _Lock:
    """threading.Lock that tells a thread that waits for itself instead of stopping it."""

    def __init__(self) -> None:
        self._lock, self._owner = allocate_lock(), 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if blocking and timeout < 0 and self._owner == get_ident():
            raise _Deadlock
        taken = self._lock.acquire(blocking, timeout)
        if taken:
            self._owner = get_ident()
        return taken

    def release(self) -> None:
        self._owner = 0
        self._lock.release()

    def locked(self) -> bool:
        return self._lock.locked()

    def _at_fork_reinit(self) -> None:
        self.__init__()  # type: ignore[misc]

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class _Bombardment:
    """A trace of the engine's thread that sends signals between its instructions: so many hangups, each so many instructions
    after the one before, and SIGTERM once a reload has begun after the last."""

    def __init__(self, hangups: int, every: int, patience: int) -> None:
        self._left, self._every, self._patience = hangups, every, patience
        self._instructions = 0
        self._stopped = False
        self.unanswered = True
        self._folders = (str(Path(daemon.__file__).parent), threading.__file__)
        self._watched: dict[CodeType, bool] = {}

    def reload_begins(self) -> None:
        """To be called with each."""
        if self._left == 0:
            self.unanswered = False

    def trace(self, frame: FrameType, event: str, _: object) -> Callable[..., Any] | None:
        """For sys.settrace."""
        code = frame.f_code
        if code not in self._watched:
            self._watched[code] = code.co_filename.startswith(self._folders)
        if not self._watched[code]:
            return None
        frame.f_trace_lines, frame.f_trace_opcodes = False, True
        return self._instruction

    def _instruction(self, frame: FrameType, event: str, _: object) -> Callable[..., Any]:
        if event == "opcode":
            self._instructions += 1
            if self._left and self._instructions % self._every == 0:
                self._left -= 1
                signal.raise_signal(signal.SIGHUP)
            elif not self._left and not self._stopped:
                self._patience -= 1
                if not self.unanswered or self._patience < 0:
                    self._stopped = True
                    signal.raise_signal(signal.SIGTERM)
        return self._instruction


def signalled(rng: random.Random) -> None:
    """Hangups between any two instructions of the engine's thread, and SIGTERM at the end."""
    bombardment = _Bombardment(hangups=rng.randint(1500, 3000), every=rng.choice((1, 1, 2, 3, 7)), patience=200_000)
    numbers = (signal.SIGHUP, signal.SIGTERM, signal.SIGINT)
    before = {number: signal.getsignal(number) for number in numbers}
    made: list[Daemon] = []

    def load(path: Path) -> configuration.Configuration:
        if made:
            bombardment.reload_begins()
        return read(path)

    def make(*given: Any, **named: Any) -> Daemon:
        made.append(Daemon(*given, **named))
        rounds = made[0]._round

        def traced() -> None:
            sys.settrace(bombardment.trace)
            rounds()

        setattr(made[0], "_round", traced)  # noqa: B010 - of this one daemon
        return made[0]

    read = configuration.load
    tracing = sys.gettrace()
    text = f"bus: {{interface: virtual, channel: signalled-{next(_channels)}}}\n"
    try:
        with (
            _home(text) as folder, mock.patch.object(threading, "Lock", _Lock), mock.patch.object(configuration, "load", load),
            mock.patch.object(run_verb, "Daemon", make),
        ):  # fmt: skip
            try:
                code = run_verb.run(Namespace(config=str(folder / "c.yaml")))
            except _Deadlock:
                code = -1
            finally:
                sys.settrace(tracing)
            require(code >= 0, "the engine's thread waits for a lock that it holds")
            require(code == 0, f"ended with {code}")
            require(not bombardment.unanswered, "a hangup that no reload followed")
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# Peers at the control socket


def asks(rng: random.Random) -> None:
    """Peers that ask nothing, a byte now and then, or all at once, while one asks in earnest."""
    now_s = 1000.0
    gate = threading.Event()

    def clock() -> float:
        return now_s

    def answer(request: Any) -> dict[str, Any]:
        if request["command"] == "wait":
            gate.wait(_PATIENCE_S)
        return {"fine": True}

    with _home("") as folder, mock.patch.object(control, "monotonic", clock), contextlib.ExitStack() as stack:
        lines = stack.enter_context(_logged(clock))
        path = folder / "s.sock"
        server = ControlServer(path, None, answer)
        before = threading.active_count()
        server.start()
        stack.callback(server.stop)
        stack.callback(gate.set)

        def connected() -> socket.socket:
            peer = stack.enter_context(socket.socket(socket.AF_UNIX))
            peer.connect(str(path))
            peer.setblocking(False)
            return peer

        peers = [connected() for _ in range(rng.randint(60, 200))]
        require(_answered(path), "nobody is answered beside peers that ask nothing")
        threads = threading.active_count() - before - 1
        require(threads <= 1, f"{threads} threads for {len(peers)} peers that ask nothing")
        said = len(lines.getvalue().splitlines())
        require(said <= 2 * 3, f"{said} lines written in a minute")
        slow = connected()
        slow.sendall(b"{")
        require(_answered(path), "nobody is answered beside a peer that dribbles")

        def next_round() -> None:
            _until(lambda: server.busy_since_s == now_s, "a round of the server's thread")

        for _ in range(4):
            with suppress(OSError):
                slow.sendall(b" ")
            now_s += 2.0
            # A round that begins now reads the byte.
            next_round()
            require(_answered(path), "nobody is answered beside a peer that dribbles")
        now_s += 0.5
        # The round in which the peer's time was over has ended; several requests may be answered in one.
        next_round()
        require(_ended(slow), "a peer holds its place with a byte every 2 s")
        crowd = [connected() for _ in range(rng.randint(20, 60))]
        for peer in crowd:
            peer.sendall(b'{"command": "wait"}\n')
        gone = set[socket.socket]()

        def taken() -> int:
            gone.update(peer for peer in crowd if peer not in gone and _ended(peer))
            return sum(thread.name == "control-answer" for thread in threading.enumerate())

        _until(lambda: taken() + len(gone) >= len(crowd), "the crowd to be taken or sent away")
        require(taken() <= 8, f"{taken()} threads for as many requests at once")


@contextlib.contextmanager
def _logged(clock: Callable[[], float]) -> Iterator[io.StringIO]:
    """What the control server logs, as a daemon's service manager gets it."""
    lines, log, disabled = io.StringIO(), logging.getLogger(control.__name__), logging.root.manager.disable
    handler = logging.StreamHandler(lines)
    handler.addFilter(RateLimitedLog(clock))
    logging.disable(logging.NOTSET)
    log.addHandler(handler)
    try:
        with mock.patch.object(log, "propagate", False):
            yield lines
    finally:
        log.removeHandler(handler)
        logging.disable(disabled)


def _answered(path: Path) -> bool:
    with suppress(ControlError):
        return bool(ask(path, {"command": "status"}, _PATIENCE_S)["fine"])
    return False


def _ended(peer: socket.socket) -> bool:
    """Whether the other side has ended the connection by now."""
    try:
        while peer.recv(4096):  # An error that is answered first.
            pass
        return True
    except BlockingIOError:
        return False
    except OSError:
        return True


# Parts that fail


def journal_fails(rng: random.Random) -> None:
    """An exception on the engine's thread where a second is collected for the store."""
    channel = f"journal-{next(_channels)}"
    with _home("bus: {transmit_max_age_s: 60}\n") as folder:

        def bus() -> can.BusABC:
            return can.Bus(interface="virtual", channel=channel)

        made = Daemon(configuration.load(folder / "c.yaml"), bus_factory=bus, timeouts=Timeouts(silence_s=float("inf")))
        peer = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        sent = [encoded(frame) for frame in traffic(START_S, rng.randint(7, 10), 0.0)]

        def play() -> None:
            made.started.wait(_PATIENCE_S)
            for message in sent:
                peer.send(message)

        batch, fails_at, calls = Journal.batch, rng.randint(1, 3), itertools.count(1)

        def fail(*given: Any, **named: Any) -> Any:
            if next(calls) >= fails_at:
                raise ArithmeticError("provoked")
            return batch(*given, **named)

        player = threading.Thread(target=play, daemon=True)
        player.start()
        before = threading.enumerate()
        with mock.patch.object(Journal, "batch", fail), suppress(ArithmeticError):
            made.run()
        player.join(_PATIENCE_S)
        peer.shutdown()
        left = {thread.name for thread in threading.enumerate() if thread not in before}
        require(not left, f"ended, with {', '.join(sorted(left))} going on")


_PASSING = (errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EIO, errno.EMFILE, errno.EADDRINUSE, errno.ENOMEM)
_LASTING = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)


def binds(rng: random.Random) -> None:
    """The control socket cannot be made: for a reason that may pass, or for one that another configuration mends."""
    number = rng.choice((*_PASSING, *_LASTING))

    class Refused(socket.socket):
        def bind(self, address: Any) -> None:
            raise OSError(number, os.strerror(number))

    text = f"bus: {{interface: virtual, channel: binds-{next(_channels)}}}\n"
    handlers = {name: signal.getsignal(name) for name in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT)}
    said = io.StringIO()
    try:
        with _home(text) as folder, mock.patch.object(socket, "socket", Refused), contextlib.redirect_stderr(said):
            code = command.main(["run", "--config", str(folder / "c.yaml")])
    finally:
        for name, handler in handlers.items():
            signal.signal(name, handler)
    due = 1 if number in _PASSING else 2
    require(code == due, f"{errno.errorcode[number]} at the socket ends with {code}, not {due}")
    require("Traceback" not in said.getvalue(), "a traceback")


def answer_is_cut(rng: random.Random) -> None:
    """A daemon's answer that ends anywhere, or is not one."""
    whole = json.dumps({"ok": True, "windows": [1.0, {"a": None}]}).encode() + b"\n"
    sent = rng.choice(
        (whole[: rng.randrange(len(whole) - 1)], b"[]\n", b"7\n", b'{"ok": false}\n', b"[" * 100_000 + b"\n", b"\xff\n")
    )
    with _home("") as folder, socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(folder / "s"))
        listening.listen()

        def serve() -> None:
            connection, _ = listening.accept()
            with connection:
                connection.recv(100)
                connection.sendall(sent)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            ask(folder / "s", {"command": "status"}, _PATIENCE_S)
        except ControlError:
            return
        except Exception as error:  # noqa: BLE001 - whatever is no line for the operator is what is looked for
            require(False, f"{type(error).__name__} on an answer that begins {sent[:20]!r}")
        finally:
            thread.join(_PATIENCE_S)
        require(False, f"{sent[:20]!r} passes for an answer")


TROUBLES: tuple[Trouble, ...] = (signalled, asks, journal_fails, binds, answer_is_cut)


def simulate(lives: int, seed: int) -> tuple[list[str], Any]:
    """What so many lives broke, and how often each trouble came."""
    return live(lives, seed, TROUBLES)


# Each mend undone


def _with_event(name: str) -> Any:
    """A flag as it was: a threading.Event, whose lock a handler may find held."""

    def event(self: Daemon) -> threading.Event:
        found: threading.Event = self.__dict__.setdefault(f"{name} as it was", threading.Event())
        return found

    def put(self: Daemon, value: bool) -> None:
        if value:
            event(self).set()
        else:
            event(self).clear()

    return mock.patch.object(Daemon, name, property(lambda self: event(self).is_set(), put), create=True)


def _cleared_after_the_reload() -> Any:
    before = Daemon._do_reload

    def reload(self: Daemon) -> None:
        before(self)
        self._reload_wanted = False

    return mock.patch.object(Daemon, "_do_reload", reload)


def _patience_anew_with_each_byte() -> Any:
    before = control._Server._read

    def read(self: Any, selector: Any, asking: Any) -> None:
        asking.until_s += 2.0
        before(self, selector, asking)

    return mock.patch.object(control._Server, "_read", read)


def _end_in_one_go(self: Any, metrics: Any, control: Any) -> bool:
    self._manager.stopping()
    metrics.stop()
    control.stop()
    self._transmitter.stop()
    self._receiver.stop()
    self._commit()
    self._writer.stop()
    return True


def _ask(path: Path, request: Any, timeout_s: float = 10.0) -> dict[str, Any]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(timeout_s)
        connection.connect(str(path))
        connection.sendall(json.dumps(request).encode() + b"\n")
        with connection.makefile("rb") as file:
            line = file.readline()
    if not line:
        raise ControlError("no answer")
    answer: dict[str, Any] = json.loads(line)
    if not answer.pop("ok"):
        raise ControlError(str(answer["error"]))
    return answer


class _Loud(logging.Filter):
    def __init__(self, clock: object) -> None:
        super().__init__()


MENDS = {
    "flags for signals": mend((4,), signalled, lambda: _with_event("_reload_wanted")),
    "a hangup while it reloads": mend((4,), signalled, _cleared_after_the_reload),
    "whole-request deadlines": mend((12,), asks, _patience_anew_with_each_byte),
    "a bounded pool": mend((12,), asks, lambda: mock.patch.object(control, "_ANSWERS_AT_ONCE", 10**6)),
    "a few lines a minute": mend((12,), asks, lambda: mock.patch(f"{__name__}.RateLimitedLog", _Loud)),
    "each step of a stop": mend((15,), journal_fails, lambda: mock.patch.object(Daemon, "_end", _end_in_one_go)),
    "only configuration errors end for good": mend(
        (20,), binds, lambda: mock.patch.object(control_socket, "_WRONG_PATH", frozenset(errno.errorcode)),
    ),
    "answers that are cut": mend((13,), answer_is_cut, lambda: mock.patch(f"{__name__}.ask", _ask)),
}  # fmt: skip

SIMULATION = Simulation(__doc__, "lives", 20, simulate, MENDS)


def main(arguments: list[str]) -> int:
    """See `undoing.main`."""
    return undoing.main(SIMULATION, arguments)
