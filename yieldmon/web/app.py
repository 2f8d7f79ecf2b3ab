"""The page's addresses: files, the live feed, what the store says, and commands."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, time
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from yieldmon import __version__
from yieldmon.errors import InputError
from yieldmon.files import machine_file
from yieldmon.finite import finite_document
from yieldmon.physics.machine import Machine
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.units import Units
from yieldmon.web import commands, tokens
from yieldmon.web.feed import COLUMNS, Feed
from yieldmon.web.guard import COMMANDS, COOKIE, SIGN_IN, Access, Door, Guard
from yieldmon.web.history import History
from yieldmon.web.limits import RateLimit, peer_name
from yieldmon.web.tiles import Tiles
from yieldmon.web.units import in_units, page_units, texts_of_status, units_of_status

STATIC = Path(__file__).resolve().parent / "static"
MOST_BODY_BYTES = 4096
_DAY = re.compile("[0-9]{4}-[0-9]{2}-[0-9]{2}")
_NO_STORE = {"cache-control": "no-store"}
_TILE_LIFE = {"cache-control": "private, max-age=86400"}


@dataclass(frozen=True)
class Sources:
    """What the page reads.

    daemon: the control socket. store, configuration: the daemon's files, None for those that it names. tiles: background of the
    map. flow_delay_s: from the header to the plate.
    """

    daemon: Path
    store: Path | None = None
    configuration: Path | None = None
    tiles: Tiles | None = None
    flow_delay_s: float = 0.0


def build_app(
    access: Access,
    sources: Sources,
    *,
    clock: Callable[[], float] = monotonic,
    unix_clock: Callable[[], float] = time,
) -> Guard:
    """The page as an ASGI application.

    Parameters
    ----------
    access : Access
        Who may do what.
    sources : Sources
        What it reads.
    clock, unix_clock : callable
        Monotonic and Unix time, s.

    Returns
    -------
    Guard
        The application, guarded.
    """
    door = Door(access.token, clock)
    page = _Page(access, sources, door, clock, unix_clock)
    routes = [
        Route("/", page.file("live.html")),
        Route("/history", page.file("history.html")),
        Route(SIGN_IN, page.file("sign-in.html")),
        Route(SIGN_IN, page.sign_in, methods=["POST"]),
        Route("/api/page", page.about),
        Route("/api/live", page.live),
        Route("/api/history", page.history),
        Route("/api/points", page.points),
        Route("/api/residuals", page.residuals),
        Route("/api/command", page.command, methods=["POST"]),
        Route("/tiles/{zoom}/{column}/{row}", page.tile),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    app = Starlette(routes=routes, exception_handlers={404: _not_found})
    return Guard(app, access, door, stop=page.stop, clock=clock, unix_clock=unix_clock, prepare=page.prepare)


#: A page does not wait longer than this for the units of a daemon that does not answer.
_UNITS_S = 1.0
Answer = Callable[[Request], Coroutine[Any, Any, Response]]


class _Page:
    """The answers."""

    def __init__(
        self, access: Access, sources: Sources, door: Door, clock: Callable[[], float], unix_clock: Callable[[], float]
    ) -> None:
        self._access = access
        self._sources = sources
        self._door = door
        self._clock = clock
        self._unix_clock = unix_clock
        self._feed = Feed(sources.daemon, sources.store, clock)
        self._history = History(sources.flow_delay_s)
        self._reading = asyncio.Lock()
        self._commands = RateLimit(COMMANDS)

    def stop(self) -> None:
        self._feed.stop()

    def prepare(self) -> None:
        # What is wrong with daemon or store is said to the page that asks.
        with contextlib.suppress(InputError, ControlError, KeyError, TypeError):
            self._history.prepare(self._sources.store or Path(ask(self._sources.daemon, {"command": "status"})["store"]["file"]))

    @staticmethod
    def file(name: str) -> Answer:
        async def answer(_: Request) -> Response:
            return FileResponse(STATIC / name, headers={"cache-control": "no-cache"})

        return answer

    async def about(self, _: Request) -> Response:
        tiles = self._sources.tiles
        return _json(
            {
                "version": __version__,
                "read_only": self._access.read_only,
                "flow_delay_s": self._sources.flow_delay_s,
                "columns": list(COLUMNS),
                "units": await self._units(),
                "tiles": None if tiles is None else {"zooms": tiles.zooms, "attribution": tiles.attribution},
            }
        )

    async def _units(self) -> dict[str, Any]:
        """As the daemon's configuration has them; metric where it cannot be asked."""
        with contextlib.suppress(KeyError, TypeError):
            return units_of_status(await self._status())
        return page_units()

    async def _texts(self) -> Units:
        """The same for what the daemon says."""
        with contextlib.suppress(KeyError, TypeError):
            return texts_of_status(await self._status())
        return Units()

    async def _status(self) -> Mapping[str, Any]:
        """The daemon's; empty where it does not answer in time."""
        with contextlib.suppress(ControlError, TimeoutError):
            return await asyncio.wait_for(self._feed.ask({"command": "status"}), _UNITS_S)
        return {}

    async def live(self, request: Request) -> Response:
        if self._feed.full:
            return _error(503, "too many pages are open", {"retry-after": "10"})
        last = request.headers.get("last-event-id", "")
        after = _number(last) or 0
        return StreamingResponse(_closed_at_the_end(self._feed.watch(after)), media_type="text/event-stream", headers=_NO_STORE)

    async def history(self, _: Request) -> Response:
        units = await self._texts()
        return await self._from_store(lambda path: _json(in_units(self._history.document(path), units)))

    async def points(self, request: Request) -> Response:
        try:
            day, number = _of_points(request.query_params)
        except InputError as error:
            return _error(400, str(error))

        def read(path: Path) -> Response:
            packed = self._history.points(path, day, number)
            return Response(packed, media_type="application/octet-stream", headers=_NO_STORE)

        return await self._from_store(read)

    async def residuals(self, _: Request) -> Response:
        try:
            machine, note = await asyncio.to_thread(self._machine, await self._configuration())
        except InputError as error:
            return _error(503, str(error))
        return await self._from_store(lambda path: _json({"machine": note, **self._residuals(path, machine)}))

    def _residuals(self, path: Path, machine: Machine) -> dict[str, Any]:
        try:
            return self._history.residuals(path, machine)
        except InputError as error:
            # A store of few sweeps is as it should be.
            return {"note": str(error), "cells": []}

    async def command(self, request: Request) -> Response:
        if self._access.read_only:
            return _error(403, "this page only shows")
        wait_s = self._commands.take("all", self._clock())
        if wait_s:
            return _error(429, "too many commands; wait a moment", {"retry-after": str(int(wait_s) + 1)})
        try:
            document = await _body(request)
            status = await self._feed.ask({"command": "status"})
            # Of a daemon of another version these may be missing.
            units, load_number = texts_of_status(status), status["load"]["number"]
        except (InputError, ControlError) as error:
            return _error(409, str(error))
        try:
            answer = await self._feed.ask(commands.request_of(document, load_number))
        except (InputError, ControlError) as error:
            return _error(409, commands.with_buttons(units.in_text(str(error))))
        return _json(commands.answer_with_buttons(in_units(answer, units)))

    async def sign_in(self, request: Request) -> Response:
        try:
            document = await _body(request)
        except InputError as error:
            return _error(400, str(error))
        given = document.get("token") if isinstance(document, dict) else None
        peer = peer_name(request.client.host if request.client else "")
        refusal = self._door.refusal(given if isinstance(given, str) else "", peer)
        if refusal is not None or self._access.token is None:
            refused = (refusal.status, refusal.error, dict(refusal.headers)) if refusal else (404, "this page has no token", {})
            return _error(*refused)
        response = Response(status_code=204, headers=_NO_STORE)
        value = tokens.cookie(self._access.token, self._unix_clock())
        response.set_cookie(COOKIE, value, max_age=tokens.COOKIE_LIFE_S, httponly=True, samesite="strict")
        return response

    async def tile(self, request: Request) -> Response:
        tiles, place = self._sources.tiles, [_number(request.path_params[name]) for name in ("zoom", "column", "row")]
        found = None
        if tiles is not None and None not in place:
            found = await asyncio.to_thread(tiles.tile, *(number or 0 for number in place))
        return _error(404, "no such tile") if found is None else Response(found[0], media_type=found[1], headers=_TILE_LIFE)

    async def _from_store(self, read: Callable[[Path], Response]) -> Response:
        path = self._sources.store or self._feed.store
        try:
            if path is None:
                path = Path((await self._feed.ask({"command": "status"}))["store"]["file"])
            # One at a time, so that many requests cost no more than one.
            async with self._reading:
                return await asyncio.to_thread(read, path)
        except (InputError, ControlError) as error:
            return _error(503, str(error))

    async def _configuration(self) -> Path | None:
        if self._sources.configuration is not None:
            return self._sources.configuration
        with contextlib.suppress(ControlError, KeyError, TypeError):
            return Path((await self._feed.ask({"command": "status"}))["configuration"]["file"])
        return None

    @staticmethod
    def _machine(path: Path | None) -> tuple[Machine, str]:
        if path is not None and path.is_file():
            found = configuration.load(path)
            return found.machine, found.machine_path.name
        default = shipped(machine_file.DEFAULT)
        return machine_file.load(default), f"{default.name} (the shipped one)"


async def _closed_at_the_end(events: AsyncIterator[str]) -> AsyncIterator[str]:
    """A generator that is closed when the page goes, not when it is collected."""
    async with contextlib.aclosing(events) as source:  # type: ignore[type-var]
        async for event in source:
            yield event


async def _body(request: Request) -> object:
    """The JSON document of a request. Raises InputError."""
    expected = f"application/json of at most {MOST_BODY_BYTES} bytes"
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise InputError("request", "is not JSON", expected)
    body = bytearray()
    try:
        async for piece in request.stream():
            body += piece
            if len(body) > MOST_BODY_BYTES:
                raise InputError("request", "is too large", expected)
        return json.loads(body)
    except (ValueError, RecursionError, ClientDisconnect) as error:
        raise InputError("request", "is not JSON", expected) from error


def _of_points(query: Mapping[str, str]) -> tuple[str, int | None]:
    """Day and load of which points are asked for; no day is all of them. Raises InputError."""
    strange = sorted(query.keys() - {"day", "load"})
    if strange:
        raise InputError(repr(strange[0]), "is not known here", "day or load")
    day, load = query.get("day", ""), query.get("load", "")
    if day not in ("", "today") and not _DAY.fullmatch(day):
        raise InputError("day", repr(day), "today or a day such as 2025-10-09")
    if load and _number(load) is None:
        raise InputError("load", repr(load), "the number of a load")
    return day, _number(load)


def _number(text: str) -> int | None:
    """A whole number of an address, None where it is none or has more digits than any here."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 16 else None


def _json(document: Any) -> Response:
    return JSONResponse(finite_document(document), headers=_NO_STORE)


def _error(status: int, text: str, headers: dict[str, str] | None = None) -> Response:
    return JSONResponse({"error": text}, status_code=status, headers={**_NO_STORE, **(headers or {})})


async def _not_found(_: Request, __: Exception) -> Response:
    return _error(404, "no such page")
