"""What all live pages see: two looks at the daemon a second, however many watch, and none when no page is open.

The daemon's own answer holds its last ten seconds; a page that comes later, or time that goes faster, gets the others from the
store.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from time import monotonic
from typing import Any

from yieldmon.errors import InputError
from yieldmon.service.logs.recorded import opened
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.web.units import in_units, texts_of_status, units_of_status

#: Columns of a row as pages get it, with the decimals that they are worth on a screen.
COLUMNS: Mapping[str, int] = {
    "number": 0, "time_s": 1, "mass_flow_kg_s": 4, "std_dev_kg_s": 4, "moisture_pct": 2, "plate_angle_deg": 2,
    "latitude_deg": 7, "longitude_deg": 7,
}  # fmt: skip
HOUR = 3600
#: Pages that watch at the same time; each costs this process a little, the daemon nothing.
WATCHERS = 24
_ASK_S = 3.0
#: The daemon makes its answer anew each second, and after a command; it is asked so long after, and at least so often.
_PERIOD_S, _AFTER_S, _LEAST_S, _MOST_S = 1.0, 0.1, 0.25, 0.5
#: A page that receives nothing for longer than a few of these says so itself.
HEARTBEAT_S = 2.0
#: A look at daemon and store that takes longer is reported; the daemon's answer is awaited for less.
_HANGS_S = 8.0
#: How long seconds that the daemon has shown to be missing are awaited from its store.
_STORE_TIMEOUT_S = 5.0
_SHOWN = ("version", "uptime_s", "age_s", "stale", "state", "load", "total", "sweep", "parameters", "faults", "zero_mv")
_SHOWN_OF = {"bus": ("interface", "channel", "frames_per_s", "dropped", "kernel_drops"), "store": ("failing", "note", "pending")}

Row = list[float | int | None]


@dataclass(frozen=True)
class _Look:
    """What one look at the daemon and its store found.

    state: what pages show beside the rows. age_s: of the daemon's answer. store: the store, None where no answer names one.
    before: seconds from the store, older than the daemon's own `rows`.
    """

    state: dict[str, Any]
    age_s: float = 0.0
    store: Path | None = None
    before: Sequence[Row] = ()
    rows: Sequence[Row] = ()


class Feed:
    """The live state, shared by all who watch. Belongs to one event loop."""

    def __init__(
        self,
        daemon: Path,
        store: Path | None = None,
        clock: Callable[[], float] = monotonic,
        *,
        heartbeat_s: float = HEARTBEAT_S,
    ) -> None:
        """daemon: its control socket. store: its store, None for the one that it names. clock: monotonic time. heartbeat_s: see
        HEARTBEAT_S."""
        self._daemon = daemon
        self._given_store = store
        self._clock = clock
        self._heartbeat_s = heartbeat_s
        self._rows: deque[Row] = deque(maxlen=HOUR)
        self._state: dict[str, Any] = {"problem": "waiting for the daemon"}
        self._generation = 0
        """Rises when the rows begin anew, with another store."""
        self._watchers: set[asyncio.Event] = set()
        self._looking: asyncio.Task[None] | None = None
        self._looked_s = clock()
        self._hang_reported = False
        self._missing_since_s: float | None = None
        self._stopping = False
        self.store = store
        """The store: the one given, else the one that the daemon last named."""

    @property
    def full(self) -> bool:
        """Whether as many watch as may."""
        return len(self._watchers) >= WATCHERS

    def stop(self) -> None:
        """Let everybody who watches go."""
        self._stopping = True
        self._wake()

    async def watch(self, after: int = 0) -> AsyncIterator[str]:
        """Server-sent events for one page, for as long as it reads them.

        Parameters
        ----------
        after : int
            Number of the last second that the page has.

        Yields
        ------
        str
            Events ``live`` with the state and the seconds since the one before, ``alive`` where nothing is new.
        """
        news = asyncio.Event()
        self._watchers.add(news)
        if self._looking is not None:
            news.set()
        sent, generation = after, None
        try:
            self._keep_looking()
            while not self._stopping:
                try:
                    await asyncio.wait_for(news.wait(), self._heartbeat_s)
                except TimeoutError:
                    yield self._without_news()
                    continue
                news.clear()
                if self._stopping:
                    return
                self._keep_looking()
                if self._state["problem"]:
                    # What the page has stays its own until there are seconds again.
                    yield _event(None, self._state)
                    continue
                newest = self._newest
                begins = generation not in (None, self._generation) or sent > newest
                rows = [row for row in self._rows if begins or _number(row) > sent]
                yield _event(newest, {**self._state, "begins": begins, "rows": rows})
                sent, generation = newest, self._generation
        finally:
            self._watchers.discard(news)

    def _without_news(self) -> str:
        since_s = self._clock() - self._looked_s
        if self._looking is None or since_s < _HANGS_S:
            return "event: alive\ndata: 1\n\n"
        self._hang_reported = True
        return _event(None, {"problem": f"this page has been waiting for the daemon and its store for {since_s:.0f} s"})

    async def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The daemon's answer to a request of a page. Raises ControlError."""
        return await asyncio.to_thread(ask, self._daemon, request)

    @property
    def _newest(self) -> int:
        return _number(self._rows[-1]) if self._rows else 0

    def _keep_looking(self) -> None:
        """Raises what ended the last look unexpectedly: one page is cut off and comes back, the others go on."""
        ended = self._looking if self._looking is not None and self._looking.done() else None
        if ended is not None or self._looking is None:
            self._looked_s = self._clock()
            self._looking = asyncio.create_task(self._look())
            self._looking.add_done_callback(lambda _: self._wake())
        if ended is not None:
            ended.result()

    async def _look(self) -> None:
        before = None
        while self._watchers:
            seen = await asyncio.to_thread(self._seen)
            self._take(seen)
            self._looked_s = self._clock()
            content = self._content()
            if content != before or self._hang_reported:
                self._wake()
            self._hang_reported = False
            before = content
            await asyncio.sleep(min(_MOST_S, max(_LEAST_S, _PERIOD_S + _AFTER_S - seen.age_s)))
        self._looking = None

    def _wake(self) -> None:
        for news in self._watchers:
            news.set()

    def _content(self) -> tuple[int, int, dict[str, Any]]:
        """What a page would show, without what changes by itself; the age matters once it is stale."""
        still = {name: value for name, value in self._state.items() if name not in ("age_s", "uptime_s")}
        return self._generation, self._newest, still if not self._state.get("stale") else self._state

    def _seen(self) -> _Look:
        """One look; runs on another thread, and leaves what pages are shown to `_take`."""
        try:
            status = ask(self._daemon, {"command": "status"}, _ASK_S)
            store = self._given_store or Path(status["store"]["file"])
            rows = [_row(window) for window in status["windows"]]
            before = self._missing(rows, store) if rows else []
            return _Look(_shown(status), float(status["age_s"]), store, before, rows)
        except ControlError as error:
            return _Look({"problem": str(error).removeprefix(f"{self._daemon}: ")})
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            return _Look({"problem": f"the daemon is of another version than this page: {error!r}"})

    def _missing(self, rows: list[Row], store: Path) -> list[Row]:
        """From the store, the seconds between those that pages have and the daemon's."""
        first, last = _number(rows[0]), _number(rows[-1])
        newest = self._newest if last >= self._newest else 0
        if first <= newest + 1:
            return []
        return [row for row in _stored(store, max(newest + 1, last - HOUR + 1)) if newest < _number(row) < first]

    def _take(self, seen: _Look) -> None:
        """Show pages what was seen; on the loop's thread, as pages read it."""
        self._state = seen.state
        if seen.store is not None:
            self.store = seen.store
        if not seen.rows:
            return
        first, last = _number(seen.rows[0]), _number(seen.rows[-1])
        if last < self._newest:
            self._rows.clear()
            self._generation += 1
        newest = self._newest
        if first > newest + 1:
            whole = not newest or len(seen.before) == first - newest - 1 or first - newest > HOUR
            if not whole and self._waits_for_the_store():
                return
            self._rows.extend(seen.before)
        self._missing_since_s = None
        newest = self._newest
        self._rows.extend(row for row in seen.rows if _number(row) > newest)

    def _waits_for_the_store(self) -> bool:
        if self._missing_since_s is None:
            self._missing_since_s = self._clock()
        return self._clock() - self._missing_since_s < _STORE_TIMEOUT_S


def _stored(path: Path, first: int) -> list[Row]:
    try:
        with opened(path) as store:
            return [_row({name: getattr(row, name) for name in COLUMNS}) for row in store.seconds(first, lambda _: None)]
    except InputError:
        # The trend begins with what the daemon shows, and the history page says what is wrong with the store.
        return []


def _shown(status: Mapping[str, Any]) -> dict[str, Any]:
    parts = {name: {key: status[name].get(key) for key in keys} for name, keys in _SHOWN_OF.items()}
    now = {**status["windows"][-1], "yield_kg_m2": status.get("now", {}).get("yield_kg_m2")} if status["windows"] else None
    shown = in_units(
        {"zero_waits_for": status.get("zero_waits_for"), **{name: status[name] for name in _SHOWN}}, texts_of_status(status)
    )
    # Those of the status hold grain, or are open.
    complete = [load["number"] for load in status.get("loads", ()) if load["number"] != _open_load(status)]
    last = complete[-1] if complete else None
    return {"problem": None, **shown, **parts, "now": now, "last_complete_load": last, "units": units_of_status(status)}


def _open_load(status: Mapping[str, Any]) -> int | None:
    return int(status["load"]["number"]) if status["load"]["open"] else None


def _row(window: Mapping[str, Any]) -> Row:
    row: Row = []
    for name, decimals in COLUMNS.items():
        value = window[name]
        known = isinstance(value, int | float) and isfinite(value)
        row.append((round(value, decimals) if decimals else int(value)) if known else None)
    return row


def _number(row: Row) -> int:
    return int(row[0] or 0)


def _event(number: int | None, document: Mapping[str, Any]) -> str:
    """number: of the last second in it, None where it has none."""
    identifier = "" if number is None else f"id: {number}\n"
    return f"{identifier}event: live\ndata: {json.dumps(document, separators=(',', ':'))}\n\n"
