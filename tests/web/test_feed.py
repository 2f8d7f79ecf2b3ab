"""What the live pages get: each second once, whoever watches and however fast time goes."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import aclosing
from pathlib import Path

import pytest

from tests.web.standin import StandIn, fault, standing_in
from yieldmon.web import feed
from yieldmon.web.feed import HOUR, WATCHERS, Feed


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[StandIn]:
    with standing_in(tmp_path) as found:
        yield found


async def next_event(events: AsyncIterator[str]) -> dict:
    """The next event that is more than a sign of life."""
    async for text in events:
        lines = dict(line.split(": ", 1) for line in text.strip().splitlines())
        if lines["event"] != "alive":
            assert lines["event"] == "live"
            return {"id": int(lines.get("id", 0)), **json.loads(lines["data"])}
    raise AssertionError("the stream ended")


def numbers(event: dict) -> list[int]:
    return [row[0] for row in event["rows"]]


def test_a_page_gets_the_last_hour_first_and_then_each_second_once(daemon: StandIn) -> None:
    daemon.seconds(HOUR + 200)

    async def drive() -> None:
        async with aclosing(Feed(daemon.socket).watch()) as events:
            first = await next_event(events)
            assert numbers(first) == list(range(201, HOUR + 201))
            assert first["id"] == HOUR + 200
            assert first["state"] == "harvesting"
            seen = []
            for count in (1, 60, 60, 1):
                daemon.seconds(count)
                seen += numbers(await next_event(events))
            assert seen == list(range(HOUR + 201, HOUR + 201 + 122))

    asyncio.run(drive())


@pytest.mark.parametrize(("units", "said"), [("metric", "at 12.0 kg/s"), ("us", "at 1,701 bu/h")])
def test_faults_are_in_the_units_of_the_page(tmp_path: Path, units: str, said: str) -> None:
    with standing_in(tmp_path, units=units, faults=[fault(detail="at 12.0 kg/s")]) as daemon:
        daemon.seconds(3)

        async def drive() -> None:
            async with aclosing(Feed(daemon.socket).watch()) as events:
                assert (await next_event(events))["faults"][0]["detail"] == said

        asyncio.run(drive())


def test_a_page_that_comes_back_gets_what_it_missed(daemon: StandIn) -> None:
    daemon.seconds(100)

    async def drive() -> None:
        feed = Feed(daemon.socket)
        async with aclosing(feed.watch(after=90)) as events:
            assert numbers(await next_event(events)) == list(range(91, 101))
        # Of another life of the store it gets everything.
        async with aclosing(feed.watch(after=5000)) as events:
            event = await next_event(events)
            assert event["begins"] is True
            assert numbers(event) == list(range(1, 101))

    asyncio.run(drive())


@pytest.mark.parametrize(("has", "begins", "gets"), [(90, False, range(91, 101)), (5000, True, range(1, 101))])
def test_a_page_that_comes_back_before_the_daemon_gets_each_second_once(
    tmp_path: Path, has: int, begins: bool, gets: range
) -> None:
    daemon = StandIn(tmp_path)
    daemon.seconds(100)

    async def drive() -> None:
        async with aclosing(Feed(daemon.socket).watch(after=has)) as events:
            event = await next_event(events)
            assert "no daemon answers" in event["problem"]
            assert event["id"] == 0
            daemon.start()
            event = await next_event(events)
            assert event["begins"] is begins
            assert numbers(event) == list(gets)

    try:
        asyncio.run(drive())
    finally:
        daemon.stop()


def test_many_pages_cost_the_daemon_no_more_than_one(daemon: StandIn) -> None:
    daemon.seconds(5)

    async def drive() -> list[int]:
        feed = Feed(daemon.socket)
        counts = []
        for pages in (1, 8):
            streams = [feed.watch() for _ in range(pages)]
            before = daemon.statuses
            for _ in range(3):
                daemon.seconds(1)
                await asyncio.gather(*(next_event(stream) for stream in streams))
            counts.append(daemon.statuses - before)
            for stream in streams:
                await stream.aclose()
        return counts

    alone, together = asyncio.run(drive())
    assert together <= alone + 2 <= 8


def test_without_a_page_the_daemon_is_not_asked(daemon: StandIn) -> None:
    async def drive() -> int:
        feed = Feed(daemon.socket)
        async with aclosing(feed.watch()) as events:
            await next_event(events)
        # A look under way ends; while a page is open two come a second.
        await asyncio.sleep(0.8)
        before = daemon.statuses
        await asyncio.sleep(1.1)
        return daemon.statuses - before

    assert asyncio.run(drive()) == 0


def test_watchers_are_bounded(daemon: StandIn) -> None:
    async def drive() -> None:
        feed = Feed(daemon.socket)
        streams = [feed.watch() for _ in range(WATCHERS)]
        await asyncio.gather(*(next_event(stream) for stream in streams))
        assert feed.full
        await streams.pop().aclose()
        assert not feed.full
        feed.stop()
        for stream in streams:
            assert [event async for event in stream] == []

    asyncio.run(drive())


def test_faults_and_the_daemons_end_are_reported(daemon: StandIn) -> None:
    async def drive() -> None:
        async with aclosing(Feed(daemon.socket).watch()) as events:
            assert (await next_event(events))["faults"] == []
            daemon.faults = [fault("FramesLost", "<b>3 frames</b>")]
            assert (await next_event(events))["faults"] == daemon.faults

    asyncio.run(drive())

    async def alone() -> list[str]:
        feed = Feed(daemon.folder / "nowhere.sock")
        async with aclosing(feed.watch()) as events, aclosing(feed.watch()) as later:
            return [(await next_event(stream))["problem"] for stream in (events, later)]

    assert all("no daemon answers" in problem for problem in asyncio.run(alone()))


def test_a_store_begun_anew_begins_the_rows_anew(daemon: StandIn) -> None:
    daemon.seconds(50)

    async def drive() -> None:
        async with aclosing(Feed(daemon.socket).watch()) as events:
            await next_event(events)
            daemon.store_path.unlink()
            daemon.number, daemon.windows = 0, []
            daemon.seconds(3)
            event = await next_event(events)
            assert event["begins"] is True
            assert numbers(event) == [1, 2, 3]

    asyncio.run(drive())


def test_a_store_that_cannot_be_read_leaves_what_the_daemon_shows(daemon: StandIn) -> None:
    daemon.seconds(50)
    daemon.store_path.write_bytes(b"no store")

    async def drive() -> dict:
        async with aclosing(Feed(daemon.socket).watch()) as events:
            return await next_event(events)

    event = asyncio.run(drive())
    assert event["problem"] is None
    assert numbers(event) == list(range(41, 51))


def test_a_daemon_of_another_version_is_named_as_the_problem(daemon: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    daemon.seconds(3)
    whole = daemon.status
    monkeypatch.setattr(daemon, "status", lambda: whole() | {"bus": []})

    async def drive() -> str:
        async with aclosing(Feed(daemon.socket).watch()) as events:
            return (await next_event(events))["problem"]

    assert "another version" in asyncio.run(drive())


def test_an_unexpected_failure_cuts_one_page_off_and_the_others_go_on(daemon: StandIn) -> None:
    failures: list[RuntimeError] = []

    def clock() -> float:
        if failures:
            raise failures.pop()
        return 0.0

    async def drive() -> list[int]:
        feed = Feed(daemon.socket, clock=clock)
        daemon.seconds(3)
        async with aclosing(feed.watch()) as cut_off, aclosing(feed.watch()) as other:
            assert numbers(await next_event(cut_off)) == numbers(await next_event(other)) == [1, 2, 3]
            failures.append(RuntimeError("unforeseen"))
            with pytest.raises(RuntimeError, match="unforeseen"):
                await next_event(cut_off)
            daemon.seconds(2)
            return numbers(await next_event(other))

    assert asyncio.run(drive()) in ([], [4, 5])


def test_a_look_that_hangs_is_reported_to_open_pages(daemon: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a disk that does not answer, say; the daemon's last answer would pass for what is."""
    daemon.seconds(5)
    gate, ahead_s, ask = threading.Event(), [0.0], feed.ask

    def hanging(*given: object) -> object:
        if ahead_s[0]:
            gate.wait(60.0)
        return ask(*given)

    monkeypatch.setattr(feed, "ask", hanging)

    async def drive() -> None:
        watched = Feed(daemon.socket, clock=lambda: time.monotonic() + ahead_s[0], heartbeat_s=0.1)
        async with aclosing(watched.watch()) as events:
            assert (await next_event(events))["problem"] is None
            assert "event: alive" in await anext(events)
            ahead_s[0] = 60.0
            reported = await next_event(events)
            assert reported["problem"].startswith("this page has been waiting for the daemon and its store for 6")
            gate.set()
            async with asyncio.timeout(60.0):
                while (event := await next_event(events))["problem"] is not None:
                    assert event["problem"].startswith("this page has been waiting")

    asyncio.run(drive())


def test_a_look_under_way_changes_nothing_that_a_page_is_shown(daemon: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    """State and seconds belong together: a page that comes between the daemon's answer and the store's gets those of before."""
    daemon.seconds(5)
    reading, gate, opened = threading.Event(), threading.Event(), feed.opened

    def slowly(path: Path) -> object:
        reading.set()
        assert gate.wait(60.0)
        return opened(path)

    async def drive() -> None:
        watched = Feed(daemon.socket)
        async with aclosing(watched.watch()) as events:
            assert numbers(await next_event(events)) == [1, 2, 3, 4, 5]
            monkeypatch.setattr(feed, "opened", slowly)
            daemon.field_name = "south"
            daemon.seconds(30)
            await asyncio.to_thread(reading.wait, 60.0)
            async with aclosing(watched.watch()) as later:
                early = await next_event(later)
                gate.set()
                assert (early["load"]["field"], numbers(early)) == ("north", [1, 2, 3, 4, 5])
                both = [await next_event(stream) for stream in (events, later)]
        assert [(event["load"]["field"], numbers(event)) for event in both] == [("south", list(range(6, 36)))] * 2

    asyncio.run(drive())
