"""HTTP connections that no peer can hold open without use.

uvicorn gives a request as long as it likes to arrive and an answer as long as it likes to be taken. Here a request has to be
whole, and what was sent has to be taken, within TIMEOUT_S; of more than CONNECTIONS the one that has asked nothing for longest
is cut off.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

TIMEOUT_S = 5.0
CONNECTIONS = 64


class BoundedProtocol(H11Protocol):
    """uvicorn's protocol with limits; see the module's docstring."""

    timeout_s = TIMEOUT_S
    most_connections = CONNECTIONS

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self._request_timer: asyncio.TimerHandle | None = None
        self._answer_timer: asyncio.TimerHandle | None = None
        self._begun = False
        """Some bytes of a request came that is not whole."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Takes the connection, for another's place where there are too many."""
        super().connection_made(transport)
        self._await_request()
        if len(self.connections) > self.most_connections:
            others = [c for c in self.connections if isinstance(c, BoundedProtocol) and c is not self]
            waiting = [c for c in others if c.waits_until_s is not None]
            min(waiting, key=lambda c: c.waits_until_s or 0.0, default=self).cut_off()

    @property
    def waits_until_s(self) -> float | None:
        """Until when this connection's request is waited for, None while one is answered."""
        return self._request_timer.when() if self._request_timer is not None else None

    def data_received(self, data: bytes) -> None:
        """Part of a request, or several requests."""
        if self.waits_until_s is not None and not self._begun:
            self._begun = True
            self._await_request()
        super().data_received(data)
        if not self._waiting():
            self._begun = False
            _stop(self._request_timer)
            self._request_timer = None

    def on_response_complete(self) -> None:
        """The answer is out; the next request may come."""
        super().on_response_complete()
        if self._waiting() and self._request_timer is None:
            self._await_request()

    def pause_writing(self) -> None:
        """The peer takes nothing for the time being."""
        super().pause_writing()
        self._answer_timer = self.loop.call_later(self.timeout_s, self.cut_off)

    def resume_writing(self) -> None:
        """The peer takes what is sent."""
        super().resume_writing()
        _stop(self._answer_timer)

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is gone."""
        for timer in (self._request_timer, self._answer_timer):
            _stop(timer)
        super().connection_lost(exc)

    def cut_off(self) -> None:
        """End the connection at once; from now on it counts no more."""
        self.connections.discard(self)
        _stop(self._request_timer)
        self._request_timer = None
        self.transport.abort()

    def _waiting(self) -> bool:
        cycle = self.cycle
        return cycle is None or cycle.more_body or cycle.response_complete

    def _await_request(self) -> None:
        _stop(self._request_timer)
        self._request_timer = self.loop.call_later(self.timeout_s, self.cut_off)


def _stop(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
