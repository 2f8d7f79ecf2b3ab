"""The local socket of a running daemon: one JSON line asks, one JSON line answers.

A request is {"command": NAME, ...arguments}; an answer {"ok": true, ...} or {"ok": false, "error": TEXT}. Whoever may
open the socket may command; its file mode says who that is.
"""

from __future__ import annotations

import errno
import grp
import json
import logging
import os
import pwd
import selectors
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from yieldmon.errors import InputError, brief, reason
from yieldmon.service.ownership import OccupiedError

_log = logging.getLogger(__name__)

MAX_REQUEST_BYTES = 64 * 1024
#: Of a socket's path, on Linux, without the zero at its end.
LONGEST_SOCKET_BYTES = 107
#: A peer that takes longer than this for its whole request, or for taking the answer, is cut off.
_PATIENCE_S = 5.0
_CONNECT_S = 1.0
_POLL_S = 0.2
_STOP_S = 0.5
_RETRY_S = 0.02
_BACKLOG = 64
_LOOK_EVERY_S = 2.0
#: What only another configuration corrects; a medium that is full or a file that is in the way may pass.
_WRONG_PATH = frozenset({errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.EINVAL})
#: Connections whose requests are awaited, and requests that are answered, at the same time.
_CONNECTIONS, _ANSWERS_AT_ONCE = 32, 8
#: Of a request that is refused.
_EXPECTED = '{"command": NAME} with its arguments, and a line feed'
_BUSY = f'{{"ok": false, "error": "{_ANSWERS_AT_ONCE} requests are being answered; nothing was done, ask again"}}\n'.encode()
_CUT = f'{{"ok": false, "error": "request: no line feed in {_PATIENCE_S:g} s; expected one line; nothing was done"}}\n'.encode()
_NO_THREAD = b'{"ok": false, "error": "the system gives the daemon no thread to answer on; nothing was done, ask again"}\n'
#: From so many connections on the thread rests between two looks at them.
_CROWDED, _CROWDED_PAUSE_S = 8, 0.02
_PIECE_BYTES = 65_536
_MAX_ANSWER_BYTES = 64 * 1024 * 1024

Answer = Mapping[str, Any]


class ControlError(Exception):
    """A daemon that does not answer, or answers that it could not do what was asked. One line."""


class ControlServer:
    """Answers requests on a UNIX socket, on threads of its own."""

    def __init__(self, path: Path, group: str | None, answer: Callable[[Mapping[str, Any]], Answer]) -> None:
        """path: the socket; what is there of an earlier run is replaced. group: may use it too (mode 0660, else 0600).
        answer: called with each request, on any thread; InputError and ControlError become an error answer.

        Raises InputError for a group that does not exist or a path that no socket can have, OSError for one that cannot be bound
        now, OccupiedError for one at which a daemon is running.
        """
        self.path = path
        self._group = group
        self._answer = answer
        self._server = _Server(path, group, answer, _listen(path, group))
        self._thread = threading.Thread(target=self._server.run, name="control", daemon=True)

    def start(self) -> None:
        """Start answering."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def busy_since_s(self) -> float | None:
        """When the thread began its last round, monotonic seconds; it begins several a second."""
        return self._server.round_s

    def restart(self) -> None:
        """Leave thread and socket to themselves and answer at a new one. Raises RuntimeError."""
        old = self._server
        old.stop()
        if old.listening is not None:
            old.listening.socket.close()
        self._server = _Server(self.path, self._group, self._answer, None)
        self._thread = threading.Thread(target=self._server.run, name="control", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop answering and take the socket away."""
        self._server.stop()
        self._thread.join(_STOP_S)
        # Left there it is replaced at the next start; what remains to be written at this stop is worth more.
        with suppress(OSError):
            if self._server.listening is not None and self._server.listening.there():
                self.path.unlink()


def _answers(path: Path) -> bool:
    """Whether somebody listens at a socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_CONNECT_S)
        try:
            connection.connect(str(path))
        except (BlockingIOError, TimeoutError):
            # Listening, with more waiting than it has room for.
            return True
        except OSError:
            return False
    return True


@dataclass(frozen=True)
class _Listening:
    """A socket that listens at a path, and the file that stands for it there."""

    socket: socket.socket
    path: Path
    file: tuple[int, int]

    def there(self) -> bool:
        """Whether the file is still there; without it no client finds the socket."""
        with suppress(OSError):
            return _identity(self.path) == self.file
        return False


def _identity(path: Path) -> tuple[int, int]:
    found = path.lstat()
    return found.st_dev, found.st_ino


def _listen(path: Path, group: str | None) -> _Listening:
    """Raises as ControlServer does."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if _answers(path):
            raise OccupiedError("status.socket", f"{path}: a daemon is running there", "a socket for each daemon")
        if path.is_file() and not path.is_symlink():
            raise InputError("status.socket", f"{path}: is a file; it is left as it is", "a path that can be bound")
        path.unlink(missing_ok=True)
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # The file has the socket's mode, less the umask, from the first moment on.
            os.fchmod(listening.fileno(), 0o600)
            listening.bind(str(path))
            path.chmod(0o600)
            listening.listen(_BACKLOG)
            if group is not None:
                os.chown(path, -1, grp.getgrnam(group).gr_gid)
                path.chmod(0o660)
            return _Listening(listening, path, _identity(path))
        except BaseException:
            listening.close()
            raise
    except KeyError as error:
        raise InputError("status.group", repr(group), "a group of this system") from error
    except OSError as error:
        # Without a number: a path that is too long for a socket's address.
        if error.errno is None or error.errno in _WRONG_PATH:
            problem = f"{path}: {reason(error)}"
            raise InputError("status.socket", problem, "a path that can be bound") from error
        if error.filename is None:
            # bind() does not say what it was asked to bind.
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@dataclass
class _Asking:
    """A connection whose request is not whole yet."""

    connection: socket.socket
    until_s: float
    request: bytearray = field(default_factory=bytearray)


class _Server:
    """One thread collects the requests of all connections, a few others answer those that are whole.

    A request has to be whole within _PATIENCE_S of the connection, whatever comes meanwhile, and so has the taking of the answer.
    Beyond _CONNECTIONS the one that has waited longest is cut off, so idle peers keep no other out. A socket whose file has been
    removed, or that fails, is made anew.
    """

    def __init__(
        self, path: Path, group: str | None, answer: Callable[[Mapping[str, Any]], Answer], listening: _Listening | None
    ) -> None:
        """listening: None for one that `run` is to make."""
        self.stopping = False
        self._waker: socket.socket | None = None
        """Ends the wait for requests while they are served."""
        self.listening = listening
        self.round_s = monotonic()
        self._path = path
        self._group = group
        self._looks_at_s = monotonic() + _LOOK_EVERY_S
        self._trouble = ""
        self._answer = answer
        self._asking: dict[int, _Asking] = {}
        self._answering = threading.BoundedSemaphore(_ANSWERS_AT_ONCE)

    def stop(self) -> None:
        """Have `run` end, without waiting for it; from any thread."""
        self.stopping = True
        # Closed where serving has ended already.
        with suppress(OSError):
            if self._waker is not None:
                self._waker.send(b"\0")

    def run(self) -> None:
        """Until `stop`."""
        try:
            while not self.stopping:
                try:
                    self.listening = self.listening or _listen(self._path, self._group)
                    self._serve(self.listening)
                except OSError as error:
                    # Of the system, such as no descriptor left; where in the code says nothing about it.
                    self._begin_again(f"{self._path}: {reason(error)}; status and commands are answered once that is over")
                except Exception:  # noqa: BLE001 - without this thread no status is answered
                    _log.exception("control")
                    self._begin_again("")
        finally:
            self._shut()

    def _begin_again(self, trouble: str) -> None:
        """After a while; says why, once."""
        if trouble and trouble != self._trouble:
            _log.error("%s", trouble)
        self._trouble = trouble
        self._shut()
        sleep(_POLL_S)

    def _shut(self) -> None:
        """The socket; the file that stood for it is taken away by the one that comes after it, or at the stop."""
        if self.listening is not None:
            self.listening.socket.close()
            if not self.stopping:
                self.listening = None

    def _serve(self, listening: _Listening) -> None:
        """Until `stopping`, or an error that was not foreseen; connections under way end with it."""
        woken, self._waker = socket.socketpair()
        with woken, self._waker, selectors.DefaultSelector() as selector:
            listening.socket.setblocking(False)
            selector.register(listening.socket, selectors.EVENT_READ)
            selector.register(woken, selectors.EVENT_READ)
            try:
                while not self.stopping:
                    self.round_s = monotonic()
                    for key, _ in selector.select(_POLL_S):
                        if key.fileobj is listening.socket:
                            self._accept(selector, listening.socket)
                        elif (asking := self._asking.get(key.fd)) is not None and asking is key.data:
                            self._read(selector, asking)
                        # Else cut off since the selection, for another's place.
                    now_s = monotonic()
                    # One that was left to itself while it hung has a successor, or the daemon has ended.
                    if now_s >= self._looks_at_s and not self.stopping:
                        self._looks_at_s = now_s + _LOOK_EVERY_S
                        listening = self.listening = self._listen_again(selector, listening)
                    for asking in [a for a in self._asking.values() if a.until_s <= now_s]:
                        if asking.request:
                            _refuse(asking.connection, _CUT)
                        self._drop(selector, asking)
                    if len(self._asking) >= _CROWDED:
                        # Peers that come and speak without end get this many looks and not the processor.
                        sleep(_CROWDED_PAUSE_S)
            finally:
                for asking in list(self._asking.values()):
                    self._drop(selector, asking)

    def _listen_again(self, selector: selectors.BaseSelector, old: _Listening) -> _Listening:
        """Another one where the socket's file is no longer there and can be made."""
        if old.there():
            return old
        try:
            new = _listen(old.path, self._group)
        except (InputError, OSError) as error:
            if self._trouble != str(error):
                self._trouble = str(error)
                _log.error("%s has been removed and cannot be recreated: %s", old.path, error)
            return old
        self._trouble = ""
        _log.error("%s has been removed; recreated", old.path)
        selector.unregister(old.socket)
        old.socket.close()
        new.socket.setblocking(False)
        selector.register(new.socket, selectors.EVENT_READ)
        return new

    def _accept(self, selector: selectors.BaseSelector, listening: socket.socket) -> None:
        try:
            connection, _ = listening.accept()
        except OSError as error:
            _log.warning("control: %s", error)
            # Out of descriptors the listening socket stays readable.
            sleep(_POLL_S)
            return
        if len(self._asking) >= _CONNECTIONS:
            _log.warning("control: more than %d connections; the one that has asked nothing for longest is cut off", _CONNECTIONS)
            self._drop(selector, min(self._asking.values(), key=lambda asking: asking.until_s))
        connection.setblocking(False)
        asking = self._asking[connection.fileno()] = _Asking(connection, monotonic() + _PATIENCE_S)
        selector.register(connection, selectors.EVENT_READ, asking)

    def _read(self, selector: selectors.BaseSelector, asking: _Asking) -> None:
        try:
            piece = asking.connection.recv(_PIECE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            piece = b""
            asking.request.clear()
        asking.request += piece
        if piece and b"\n" not in piece and len(asking.request) <= MAX_REQUEST_BYTES:
            return
        if not asking.request or not self._answering.acquire(blocking=False):
            if asking.request:
                _refuse(asking.connection, _BUSY)
            self._drop(selector, asking)
            return
        selector.unregister(asking.connection)
        del self._asking[asking.connection.fileno()]
        try:
            threading.Thread(target=self._reply, args=(asking,), name="control-answer", daemon=True).start()
        except RuntimeError as error:
            _log.warning("control: %s", error)
            self._answering.release()
            _refuse(asking.connection, _NO_THREAD)
            asking.connection.close()

    def _drop(self, selector: selectors.BaseSelector, asking: _Asking) -> None:
        selector.unregister(asking.connection)
        del self._asking[asking.connection.fileno()]
        asking.connection.close()

    def _reply(self, asking: _Asking) -> None:
        try:
            with asking.connection:
                answer = self._answer_to(bytes(asking.request).partition(b"\n")[0], _user(asking.connection))
                asking.connection.settimeout(_PATIENCE_S)
                asking.connection.sendall(json.dumps(answer, allow_nan=False).encode() + b"\n")
        except OSError as error:
            _log.debug("control connection: %s", error)
        except Exception:  # noqa: BLE001 - an answer that fails is one line for its asker, not the end of a thread
            _log.exception("control")
        finally:
            self._answering.release()

    def _answer_to(self, line: bytes, who: str) -> Answer:
        try:
            return {"ok": True, **self._answer({**_request(line), "who": who})}
        except (InputError, ControlError) as error:
            return {"ok": False, "error": str(error)}


def _refuse(connection: socket.socket, answer: bytes) -> None:
    """What the socket has no room for is not waited for."""
    with suppress(OSError):
        connection.send(answer)


def _request(line: bytes) -> dict[str, Any]:
    """What one line asks. Raises InputError."""
    try:
        request = json.loads(line, object_pairs_hook=_once_each) if len(line) <= MAX_REQUEST_BYTES else None
    except InputError:
        raise
    except (ValueError, RecursionError):
        request = None
    if request is None:
        raise InputError("request", "is not one line of JSON", f"{_EXPECTED}, of at most {MAX_REQUEST_BYTES} bytes")
    if not isinstance(request, dict) or not isinstance(request.get("command"), str):
        raise InputError("request", "names no command", _EXPECTED)
    return request


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; of a key that comes twice nobody knows which value is meant. Raises InputError."""
    values = dict(pairs)
    if len(values) < len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in values if names.count(name) > 1)
        raise InputError("request", f"{brief(double)!r} comes twice", "each key once")
    return values


def _user(connection: socket.socket) -> str:
    """The user of this computer at the other end, as the kernel knows him; "" where it does not say."""
    try:
        _, user, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
    except (OSError, AttributeError, struct.error):
        return ""
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"user {user}"


def _connect(connection: socket.socket, path: Path, end_s: float) -> None:
    """Waits where more peers wait than the socket has room for; a socket with a time limit gets the error at once."""
    while True:
        try:
            connection.connect(str(path))
            return
        except BlockingIOError:
            if monotonic() > end_s:
                raise
            sleep(_RETRY_S)


def ask(path: Path, request: Mapping[str, Any], timeout_s: float = 10.0) -> dict[str, Any]:
    """The daemon's answer to a request. Raises ControlError when there is none within timeout_s seconds or it is an error."""
    end_s = monotonic() + timeout_s
    received = bytearray()
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout_s)
            _connect(connection, path, end_s)
            connection.sendall(json.dumps(request).encode() + b"\n")
            while b"\n" not in received and len(received) <= _MAX_ANSWER_BYTES:
                connection.settimeout(max(0.01, end_s - monotonic()))
                piece = connection.recv(_PIECE_BYTES)
                if not piece:
                    break
                received += piece
                if monotonic() > end_s:
                    raise TimeoutError("timed out")
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise ControlError(f"{path}: no daemon answers there; is the service running?") from error
    except PermissionError as error:
        raise ControlError(f"{path}: {reason(error)}; expected sudo, or a user of the group that status.group names") from error
    except OSError as error:
        raise ControlError(f"{path}: {reason(error)}") from error
    if not received:
        raise ControlError(f"{path}: the daemon closed the connection without an answer")
    try:
        answer = json.loads(received)
        ok = answer.pop("ok")
        problem = "" if ok else str(answer["error"])
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError) as error:
        raise ControlError(f"{path}: the daemon's answer is cut or makes no sense") from error
    if not ok:
        raise ControlError(problem)
    return dict(answer)
