"""What every request passes before anything looks at it, and the headers of every answer.

In this order: is the page meant (Host), not too often (rate), a method that there is, not from another site (Origin,
Sec-Fetch-Site), and, where there is a token, from somebody who has shown it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import monotonic, time
from typing import Any

from yieldmon.web import tokens
from yieldmon.web.addresses import Listen, host_is_ours, origin_is_ours
from yieldmon.web.limits import Rate, RateLimit, peer_name

COOKIE = "yieldmon"
SIGN_IN = "/sign-in"
#: Requests of one peer; files that never change are not counted.
REQUESTS = Rate(burst=120, per_s=20)
#: Wrong tokens of one peer.
WRONG_TOKENS = Rate(burst=5, per_s=1 / 30)
#: Commands of all peers together: a thumb, not a program.
COMMANDS = Rate(burst=10, per_s=0.5)

_PUBLIC = ("/static/", SIGN_IN)
_UNCOUNTED = ("/static/", "/tiles/")
_PAGES = ("/", "/history")

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS: Mapping[str, str] = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
}

Scope = dict[str, Any]
Receive = Callable[[], Any]
Send = Callable[[Any], Any]


@dataclass(frozen=True)
class Access:
    """Who may do what.

    listen: where the page listens. token: that opens it, None for none. read_only: no commands. names: of this machine.
    """

    listen: Listen
    token: str | None = None
    read_only: bool = False
    names: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Refusal:
    """An answer instead of the one that was asked for."""

    status: int
    error: str
    headers: tuple[tuple[str, str], ...] = ()


class Door:
    """Looks at tokens that are shown; after too many wrong ones from a peer at no further one for a while."""

    def __init__(self, token: str | None, clock: Callable[[], float]) -> None:
        self._token = token
        self._clock = clock
        self._wrong = RateLimit(WRONG_TOKENS)

    def refusal(self, given: str, peer: str) -> Refusal | None:
        """None where this is the token."""
        wait_s = self._wrong.wait_s(peer, self._clock())
        if wait_s:
            return _too_often(wait_s)
        if self._token is not None and tokens.same(given, self._token):
            return None
        self._wrong.take(peer, self._clock())
        return Refusal(401, "that is not the token")


class Guard:
    """ASGI middleware; see the module's docstring."""

    def __init__(
        self,
        app: Any,
        access: Access,
        door: Door,
        *,
        stop: Callable[[], None],
        clock: Callable[[], float] = monotonic,
        unix_clock: Callable[[], float] = time,
        prepare: Callable[[], None] = lambda: None,
    ) -> None:
        self.stop = stop
        """Ends what goes on by itself, before the server waits for the connections' ends."""
        self.prepare = prepare
        """Reads what pages will ask for, on a thread beside the server; never raises."""
        self._app = app
        self._access = access
        self._door = door
        self._clock = clock
        self._unix_clock = unix_clock
        self._requests = RateLimit(REQUESTS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return

        async def send_guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                given = [(name, value) for name, value in message["headers"] if name.lower().decode() not in HEADERS]
                ours = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*given, *ours]}
            await send(message)

        refusal = self._refusal(scope)
        if refusal is None:
            await self._app(scope, receive, send_guarded)
            return
        body = json.dumps({"error": refusal.error}).encode()
        headers = [("content-type", "application/json"), ("cache-control", "no-store"), ("content-length", str(len(body)))]
        pairs = [(name.encode(), value.encode()) for name, value in (*headers, *refusal.headers)]
        await send_guarded({"type": "http.response.start", "status": refusal.status, "headers": pairs})
        await send_guarded({"type": "http.response.body", "body": b"" if scope["method"] == "HEAD" else body})

    def _refusal(self, scope: Scope) -> Refusal | None:
        headers = _once(scope)
        if headers is None or not host_is_ours(headers.get("host", ""), self._access.listen, self._access.names):
            return Refusal(421, "this page is asked for by its address, not by this name")
        peer = peer_name(scope["client"][0] if scope.get("client") else "")
        path = scope["path"]
        if not path.startswith(_UNCOUNTED):
            wait_s = self._requests.take(peer, self._clock())
            if wait_s:
                return _too_often(wait_s)
        if scope["method"] not in ("GET", "HEAD", "POST"):
            return Refusal(405, "GET, HEAD and POST only", (("allow", "GET, HEAD, POST"),))
        return self._foreign(scope["method"], headers) or self._stranger(path, peer, headers)

    def _foreign(self, method: str, headers: Mapping[str, str]) -> Refusal | None:
        """Requests that a page of another site makes in somebody's browser."""
        refused = Refusal(403, "a request from another site")
        if method == "POST":
            origin = headers.get("origin")
            if origin is None:
                # No browser; a program shows who it is with each request.
                return None if self._bearer(headers) else refused
            return None if origin_is_ours(origin, headers["host"]) else refused
        if headers.get("sec-fetch-site", "none") in ("same-origin", "none"):
            return None
        # A link from elsewhere may open the page.
        opens = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
        return None if opens else refused

    def _stranger(self, path: str, peer: str, headers: Mapping[str, str]) -> Refusal | None:
        """Those who have not shown the token."""
        token = self._access.token
        if token is None or path.startswith(_PUBLIC):
            return None
        if tokens.cookie_is_good(_cookie(headers.get("cookie", "")), token, self._unix_clock()):
            return None
        given = self._bearer(headers)
        if given is not None:
            return self._door.refusal(given, peer)
        if path in _PAGES:
            return Refusal(303, "sign in first", (("location", SIGN_IN),))
        return Refusal(401, "sign in first", (("www-authenticate", "Bearer"),))

    @staticmethod
    def _bearer(headers: Mapping[str, str]) -> str | None:
        scheme, _, given = headers.get("authorization", "").partition(" ")
        return given if scheme.lower() == "bearer" and given else None


def _once(scope: Scope) -> dict[str, str] | None:
    """Headers by name in lower case; None where one that is decided by comes twice."""
    headers: dict[str, str] = {}
    for raw_name, raw_value in scope["headers"]:
        name = raw_name.decode("latin-1").lower()
        if name in headers and name in ("host", "origin", "authorization", "sec-fetch-site"):
            return None
        headers[name] = raw_value.decode("latin-1")
    return headers


def _cookie(header: str) -> str:
    for part in header.split(";"):
        name, _, value = part.strip().partition("=")
        if name == COOKIE:
            return value
    return ""


def _too_often(wait_s: float) -> Refusal:
    whole_s = max(1, math.ceil(wait_s))
    return Refusal(429, f"too often; again in {whole_s} s", (("retry-after", str(whole_s)),))
