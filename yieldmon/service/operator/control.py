"""The control server of a running daemon: it answers requests on a local socket, as `control_protocol` has them."""

from __future__ import annotations

import json
import logging
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

from yieldmon.errors import InputError, reason
from yieldmon.service.control_socket import Listening, listen
from yieldmon.service.operator.control_protocol import MAX_REQUEST_BYTES, PIECE_BYTES, Answer, ControlError, parse_request

_log = logging.getLogger(__name__)

_POLL_S = 0.2
_STOP_S = 0.5
#: Connections whose requests are awaited, and requests that are answered, at the same time.
_CONNECTIONS, _ANSWERS_AT_ONCE = 32, 8
_BUSY = f'{{"ok": false, "error": "{_ANSWERS_AT_ONCE} requests are being answered; nothing was done, ask again"}}\n'.encode()
_NO_THREAD = b'{"ok": false, "error": "the system gives the daemon no thread to answer on; nothing was done, ask again"}\n'
#: From so many connections on the thread rests between two looks at them.
_CROWDED = 8
#: New connections in one look. Each is looked at once more, at least, before those that come after it can take its place.
_ACCEPTED_AT_ONCE = 8


@dataclass(frozen=True)
class Pace:
    """How long the server waits for what.

    Parameters
    ----------
    timeout_s : float
        A peer that takes longer for its whole request, or for taking the answer, is cut off.
    look_every_s : float
        Between two looks whether the socket's file is still there.
    crowded_pause_s : float
        Rest between two looks at many connections.
    """

    timeout_s: float = 5.0
    look_every_s: float = 2.0
    crowded_pause_s: float = 0.02


PACE = Pace()
"""A daemon's."""


class ControlServer:
    """Answers requests on a UNIX socket, on threads of its own."""

    def __init__(
        self, path: Path, group: str | None, answer: Callable[[Mapping[str, Any]], Answer], *, pace: Pace = PACE
    ) -> None:
        """path: the socket; what is there of an earlier run is replaced. group: may use it too (mode 0660, else 0600).
        answer: called with each request, on any thread; InputError and ControlError become an error answer.

        Raises as `control_socket.listen`.
        """
        self.path = path
        self._group = group
        self._answer = answer
        self._pace = pace
        self._server = _Server(path, group, answer, listen(path, group), pace)
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
        self._server = _Server(self.path, self._group, self._answer, None, self._pace)
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


@dataclass
class _Asking:
    """A connection whose request is not whole yet."""

    connection: socket.socket
    until_s: float
    request: bytearray = field(default_factory=bytearray)


class _Server:
    """One thread collects the requests of all connections, a few others answer those that are whole.

    A request has to be whole within `Pace.timeout_s` of the connection, whatever comes meanwhile, and so has the taking of the
    answer.
    Beyond _CONNECTIONS the one that has waited longest is cut off, so idle peers keep no other out. A socket whose file has been
    removed, or that fails, is made anew.
    """

    def __init__(
        self,
        path: Path,
        group: str | None,
        answer: Callable[[Mapping[str, Any]], Answer],
        listening: Listening | None,
        pace: Pace,
    ) -> None:
        """listening: None for one that `run` is to make."""
        self._pace = pace
        self.stopping = False
        self._waker: socket.socket | None = None
        """Ends the wait for requests while they are served."""
        self.listening = listening
        self.round_s = monotonic()
        self._path = path
        self._group = group
        self._looks_at_s = monotonic() + self._pace.look_every_s
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
                    self.listening = self.listening or listen(self._path, self._group)
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

    def _serve(self, listening: Listening) -> None:
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
                        self._looks_at_s = now_s + self._pace.look_every_s
                        listening = self.listening = self._listen_again(selector, listening)
                    for asking in [a for a in self._asking.values() if a.until_s <= now_s]:
                        if asking.request:
                            _refuse(asking.connection, _cut(self._pace.timeout_s))
                        self._drop(selector, asking)
                    if len(self._asking) >= _CROWDED:
                        # Peers that come and speak without end get this many looks and not the processor.
                        sleep(self._pace.crowded_pause_s)
            finally:
                for asking in list(self._asking.values()):
                    self._drop(selector, asking)

    def _listen_again(self, selector: selectors.BaseSelector, old: Listening) -> Listening:
        """Another one where the socket's file is no longer there and can be made."""
        if old.there():
            return old
        try:
            new = listen(old.path, self._group)
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
        """Those that wait, a few at once: behind many that only connect nobody waits for a look each."""
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                connection, _ = listening.accept()
            except BlockingIOError:
                return
            except OSError as error:
                _log.warning("control: %s", error)
                # Out of descriptors the listening socket stays readable.
                sleep(_POLL_S)
                return
            self._take(selector, connection)

    def _take(self, selector: selectors.BaseSelector, connection: socket.socket) -> None:
        """A connection; what it has asked already is taken at once."""
        if len(self._asking) >= _CONNECTIONS:
            _log.warning("control: more than %d connections; the one that has asked nothing for longest is cut off", _CONNECTIONS)
            self._drop(selector, min(self._asking.values(), key=lambda asking: asking.until_s))
        connection.setblocking(False)
        asking = self._asking[connection.fileno()] = _Asking(connection, monotonic() + self._pace.timeout_s)
        selector.register(connection, selectors.EVENT_READ, asking)
        self._read(selector, asking)

    def _read(self, selector: selectors.BaseSelector, asking: _Asking) -> None:
        try:
            piece = asking.connection.recv(PIECE_BYTES)
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
                asking.connection.settimeout(self._pace.timeout_s)
                asking.connection.sendall(json.dumps(answer, allow_nan=False).encode() + b"\n")
        except OSError as error:
            _log.debug("control connection: %s", error)
        except Exception:  # noqa: BLE001 - an answer that fails is one line for its asker, not the end of a thread
            _log.exception("control")
        finally:
            self._answering.release()

    def _answer_to(self, line: bytes, who: str) -> Answer:
        try:
            return {"ok": True, **self._answer({**parse_request(line), "who": who})}
        except (InputError, ControlError) as error:
            return {"ok": False, "error": str(error)}


def _cut(timeout_s: float) -> bytes:
    text = f"request: no line feed in {timeout_s:g} s; expected one line; nothing was done"
    return json.dumps({"ok": False, "error": text}).encode() + b"\n"


def _refuse(connection: socket.socket, answer: bytes) -> None:
    """What the socket has no room for is not waited for."""
    with suppress(OSError):
        connection.send(answer)


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
