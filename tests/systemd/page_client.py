"""The page of the machine under test, asked as a browser asks it."""

from __future__ import annotations

import json
import time
import urllib.request
from typing import Any

from service_manager import PATIENCE_S, WEB_UNIT, journal, show

PAGE = "http://127.0.0.1:8090"


def asked(path: str, body: dict[str, Any] | None = None) -> Any:
    """The page's answer, from JSON."""
    data = json.dumps(body).encode() if body is not None else None
    request = urllib.request.Request(PAGE + path, data, {"Content-Type": "application/json", "Origin": PAGE})
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
        return json.load(answer)


def page_listens() -> bool:
    try:
        return bool(asked("/api/page"))
    except OSError:
        return False


def page_pid() -> int:
    return int(show("MainPID", WEB_UNIT))


def live_rows() -> list[list[float | None]]:
    """The first seconds that a live page is shown."""
    reported: dict[str, Any] = {}
    deadline = time.monotonic() + PATIENCE_S
    with urllib.request.urlopen(PAGE + "/api/live", timeout=PATIENCE_S) as lines:
        # A line comes at least every ten seconds.
        for line in lines:
            assert time.monotonic() < deadline, f"no seconds, but {reported}\n{journal()}"
            if line.startswith(b"data: "):
                reported = json.loads(line.removeprefix(b"data: "))
                if reported["rows"]:
                    return list(reported["rows"])
    raise AssertionError(f"the page ended its live state after {reported}\n{journal()}")
