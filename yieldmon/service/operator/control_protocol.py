"""What is said on the local socket of a running daemon: one JSON line asks, one JSON line answers.

A request is {"command": NAME, ...arguments}; an answer {"ok": true, ...} or {"ok": false, "error": TEXT}. Whoever may
open the socket may command; its file mode says who that is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from yieldmon.errors import InputError, brief

MAX_REQUEST_BYTES = 64 * 1024
PIECE_BYTES = 65_536
"""Read at a time, on either side."""
TICKET_KG = (1e-3, 1e6)
"""Least and largest mass of a ticket, which may be of several loads."""
_EXPECTED = '{"command": NAME} with its arguments, and a line feed'

Answer = Mapping[str, Any]


class ControlError(Exception):
    """A daemon that does not answer, or answers that it could not do what was asked. One line."""


def parse_request(line: bytes) -> dict[str, Any]:
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
