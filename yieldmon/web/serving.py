"""The server process: its socket, its limits, and how it ends."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from threading import Thread, current_thread, main_thread
from types import FrameType

import uvicorn

from yieldmon.errors import InputError
from yieldmon.web.addresses import Listen
from yieldmon.web.guard import Access, Guard
from yieldmon.web.protocol import TIMEOUT_S, BoundedProtocol

_BACKLOG = 128
_HEADER_BYTES = 16 * 1024
_STOP_S = 1


def own_names() -> frozenset[str]:
    """Names under which this machine's neighbours may ask for it, in lower case."""
    name = socket.gethostname().lower()
    return frozenset({name, f"{name}.local"}) if name else frozenset()


def check_access(listen: Listen, token: str | None) -> None:
    """Raises InputError for a page that others could open without a token."""
    if not listen.loopback and token is None:
        raise InputError("--listen", f"{listen.address} can be reached from other machines", "--token-file with it, or 127.0.0.1")


class _Server(uvicorn.Server):
    """Says when it listens, also to signals, and lets the live pages go before it waits for their connections' ends."""

    def __init__(self, configuration: uvicorn.Config, ready: Callable[[], None], stop: Callable[[], None]) -> None:
        super().__init__(configuration)
        self._ready = ready
        self._stop = stop

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """SIGTERM and SIGINT end the server. uvicorn would raise them again afterwards, which the unit does not allow."""
        if current_thread() is not main_thread():
            yield
            return
        seen: list[int] = []

        def end(number: int, frame: FrameType | None) -> None:
            seen.append(number)
            self.handle_exit(number, frame)

        before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        if signal.SIGINT in seen:
            raise KeyboardInterrupt

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._stop()
        await super().shutdown(sockets)


def serve(access: Access, build: Callable[[Access], Guard], ready: Callable[[str], None] = lambda _: None) -> None:
    """Serve until SIGTERM or SIGINT.

    Parameters
    ----------
    access : Access
        Where to listen, and who may do what.
    build : callable
        Makes the application, once the port is known.
    ready : callable
        Called with the page's address once it can be opened and a signal ends it in order.

    Raises
    ------
    InputError
        For an address that others can reach, without a token.
    OSError
        When the address cannot be listened at.
    """
    check_access(access.listen, access.token)
    with _listening(access.listen) as listening:
        listen = replace(access.listen, port=listening.getsockname()[1])
        app = build(replace(access, listen=listen))
        configuration = uvicorn.Config(
            app,
            http=BoundedProtocol,
            ws="none",
            lifespan="off",
            log_config=None,
            log_level="error",
            access_log=False,
            server_header=False,
            date_header=False,
            proxy_headers=False,
            timeout_keep_alive=int(TIMEOUT_S),
            timeout_graceful_shutdown=_STOP_S,
            h11_max_incomplete_event_size=_HEADER_BYTES,
        )
        Thread(target=app.prepare, daemon=True).start()
        _Server(configuration, partial(ready, listen.url), app.stop).run(sockets=[listening])


def _listening(listen: Listen) -> socket.socket:
    family = socket.AF_INET6 if listen.address.version == 6 else socket.AF_INET
    try:
        return socket.create_server((str(listen.address), listen.port), family=family, backlog=_BACKLOG)
    except OSError as error:
        raise OSError(error.errno, os.strerror(error.errno or 0), f"{listen.address}:{listen.port}") from error
