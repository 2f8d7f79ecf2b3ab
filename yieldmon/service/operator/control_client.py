"""Asking a running daemon over its local socket."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from yieldmon import __version__
from yieldmon.errors import reason
from yieldmon.service.operator.control_protocol import PIECE_BYTES, ControlError

ANSWER_S = 10.0
_RETRY_S = 0.02
_MAX_ANSWER_BYTES = 64 * 1024 * 1024


class NoDaemonError(ControlError):
    """Nobody listens at the socket."""


class SilentDaemonError(ControlError):
    """A daemon has the socket and says nothing."""


class OtherVersionError(ControlError, KeyError):
    """A daemon that does not say what this version's do."""

    def __str__(self) -> str:
        return str(self.args[0])


class _Answer(dict[str, Any]):
    """A part of an answer. What a daemon of another version does not say is reported as that."""

    def __missing__(self, key: str) -> Any:
        raise OtherVersionError(
            f"the daemon's answer has no {key!r}: it runs another version; expected {__version__} as here, "
            "from `systemctl restart yieldmon` after an update"
        )


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


def ask(path: Path, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> dict[str, Any]:
    """The daemon's answer to a request. Raises ControlError when it is an error or there is none: NoDaemonError where no daemon
    listens, SilentDaemonError where one says nothing for timeout_s seconds."""
    received = _received(path, request, timeout_s)
    if not received:
        raise ControlError(f"{path}: the daemon closed the connection without an answer")
    try:
        answer: dict[str, Any] = json.loads(received, object_hook=_Answer)
        problem = None if answer.pop("ok") else str(answer["error"])
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError) as error:
        raise ControlError(f"{path}: the daemon's answer is cut off or cannot be read") from error
    if problem is not None:
        raise ControlError(problem)
    return answer


def _received(path: Path, request: Mapping[str, Any], timeout_s: float) -> bytearray:
    """What comes back, until a line feed or the end of the connection."""
    end_s = monotonic() + timeout_s
    received = bytearray()
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout_s)
            _connect(connection, path, end_s)
            connection.sendall(json.dumps(request).encode() + b"\n")
            while b"\n" not in received and len(received) <= _MAX_ANSWER_BYTES:
                connection.settimeout(max(0.01, end_s - monotonic()))
                piece = connection.recv(PIECE_BYTES)
                if not piece:
                    break
                received += piece
                if monotonic() > end_s:
                    raise TimeoutError("timed out")
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise NoDaemonError(f"{path}: no daemon answers there; is the service running? (`systemctl status yieldmon`)") from error
    except PermissionError as error:
        raise ControlError(f"{path}: {reason(error)}; expected sudo, or a user of the group that status.group names") from error
    except TimeoutError as error:
        said = "the daemon does not answer; expected an answer within a second: if it lasts, `systemctl restart yieldmon`"
        raise SilentDaemonError(f"{path}: {said}") from error
    except OSError as error:
        raise ControlError(f"{path}: {reason(error)}") from error
    return received
