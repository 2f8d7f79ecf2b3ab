"""The local socket of a running daemon: one JSON line asks, one JSON line answers.

A request is {"command": NAME, ...arguments}; an answer {"ok": true, ...} or {"ok": false, "error": TEXT}. Whoever may
open the socket may command; its file mode says who that is.
"""

from __future__ import annotations

import grp
import json
import logging
import os
import socket
import socketserver
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.service.ownership import OccupiedError

_log = logging.getLogger(__name__)

MAX_REQUEST_BYTES = 64 * 1024
#: A peer that is slower than this with its request is cut off.
_PATIENCE_S = 5.0
_CONNECT_S = 1.0

Answer = Mapping[str, Any]


class ControlError(Exception):
    """A daemon that does not answer, or answers that it could not do what was asked. One line."""


class ControlServer:
    """Answers requests on a UNIX socket, on threads of its own."""

    def __init__(self, path: Path, group: str | None, answer: Callable[[Mapping[str, Any]], Answer]) -> None:
        """path: the socket; what is there of an earlier run is replaced. group: may use it too (mode 0660, else 0600).
        answer: called with each request, on any thread; InputError and ControlError become an error answer.

        Raises InputError for a group that does not exist or a path that cannot be bound, OccupiedError for one at which a daemon
        is running.
        """
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if _answers(path):
                raise OccupiedError("status.socket", f"{path}: a daemon is running there", "a socket for each daemon")
            path.unlink(missing_ok=True)
            # The mode must be right from the first moment on, so bind() runs under the umask.
            before = os.umask(0o177)
            try:
                self._server = _Server(str(path), _Handler)
            finally:
                os.umask(before)
            if group is not None:
                os.chown(path, -1, grp.getgrnam(group).gr_gid)
                path.chmod(0o660)
        except KeyError as error:
            raise InputError("status.group", repr(group), "a group of this system") from error
        except OSError as error:
            problem = f"{path}: {error.strerror or error}"
            raise InputError("status.socket", problem, "a path that can be bound") from error
        self._server.answer = answer
        self._thread = threading.Thread(target=self._server.serve_forever, name="control", args=(0.2,), daemon=True)

    def start(self) -> None:
        """Start answering."""
        self._thread.start()

    def stop(self) -> None:
        """Stop answering and take the socket away."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
        # Left there it is replaced at the next start; what remains to be written at this stop is worth more.
        with suppress(OSError):
            self.path.unlink(missing_ok=True)


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


class _Server(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    daemon_threads = True
    request_queue_size = 64
    answer: Callable[[Mapping[str, Any]], Answer]


class _Handler(socketserver.StreamRequestHandler):
    timeout = _PATIENCE_S
    server: _Server

    def handle(self) -> None:
        try:
            answer = self._answer(self.rfile.readline(MAX_REQUEST_BYTES + 1))
            self.wfile.write(json.dumps(answer, allow_nan=False).encode() + b"\n")
        except OSError as error:
            _log.debug("control connection: %s", error)

    def _answer(self, line: bytes) -> Answer:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            return {"ok": False, "error": "the request is not one line of JSON"}
        if not isinstance(request, dict) or not isinstance(request.get("command"), str):
            return {"ok": False, "error": "the request names no command"}
        try:
            return {"ok": True, **self.server.answer(request)}
        except (InputError, ControlError) as error:
            return {"ok": False, "error": str(error)}


def ask(path: Path, request: Mapping[str, Any], timeout_s: float = 10.0) -> dict[str, Any]:
    """The daemon's answer to a request. Raises ControlError when there is none or it is an error."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout_s)
            connection.connect(str(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as file:
                line = file.readline()
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise ControlError(f"{path}: no daemon answers there; is the service running?") from error
    except OSError as error:
        raise ControlError(f"{path}: {error.strerror or error}") from error
    if not line:
        raise ControlError(f"{path}: the daemon closed the connection without an answer")
    answer: dict[str, Any] = json.loads(line)
    if not answer.pop("ok"):
        raise ControlError(str(answer["error"]))
    return answer
