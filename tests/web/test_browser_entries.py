"""What is typed and pressed on the live page, in a real browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.web.browser import ASKED, CAB, READY, Watched, chromium
from tests.web.standin import StandIn, fault, page, standing_in

pytest.importorskip("playwright")
pytestmark = pytest.mark.skipif(chromium() is None, reason="needs chromium (Debian: apt-get install chromium)")

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator

PHONE = {"width": 390, "height": 844}


def dialog_of(watched: Watched, button: str) -> Locator:
    """The dialog that a button opens."""
    watched.page.get_by_role("group", name="Commands").get_by_role("button", name=button, exact=True).click()
    return watched.page.locator("dialog[open]")


def ticket_entered(watched: Watched, site: str, typed: str) -> Locator:
    """The dialog after a ticket of this mass for load 1 was entered."""
    watched.page.goto(site)
    watched.wait(READY)
    dialog = dialog_of(watched, "Ticket")
    dialog.locator("[name=first_load]").fill("1")
    dialog.locator("[name=last_load]").fill("1")
    dialog.locator("[name=mass]").press_sequentially(typed)
    dialog.get_by_role("button", name="Correct the loads").click()
    watched.wait(ASKED)
    return dialog


def test_what_is_typed_keeps_its_unit_where_the_daemon_takes_others(browser: Browser, tmp_path: Path) -> None:
    """1000 kg became 1000 lb in an open dialog, whose text still said kg."""
    with standing_in(tmp_path) as daemon:
        daemon.seconds(30)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(READY)
            unit = "document.querySelector('#load-tile [data-unit=mass]').textContent"
            dialog = dialog_of(watched, "Ticket")
            for field, text in (("first_load", "1"), ("last_load", "1"), ("mass", "1000")):
                dialog.locator(f"[name={field}]").fill(text)
            daemon.units = "us"
            daemon.seconds(1)
            watched.wait("document.body.dataset.last === '31'")
            assert watched.evaluate(unit) == "kg"
            assert "Weighed, kg" in dialog.inner_text()
            dialog.get_by_role("button", name="Correct the loads").click()
            watched.wait(ASKED)
            assert daemon.asked[-1]["mass_kg"] == 1000.0
            daemon.seconds(1)
            watched.wait(f"{unit} === 'lb'")


@pytest.mark.parametrize(
    ("typed", "mass_kg"),
    [
        ("9120", 9120.0), ("9120.5", 9120.5), (" 9120 ", 9120.0), ("9120,5", 9120.5), ("0,75", 0.75), ("9,120", 9120.0),
        ("1,009,120", 1009120.0), ("9,120.5", 9120.5), ("9.120,5", 9120.5), ("1.009.120", 1009120.0), ("9'120", 9120.0),
        ("9 120,5", 9120.5), ("9\u202f120", 9120.0),
    ],
)  # fmt: skip
def test_a_mass_is_taken_as_it_was_typed(browser: Browser, daemon: StandIn, site: str, typed: str, mass_kg: float) -> None:
    daemon.asked.clear()
    with Watched(browser) as watched:
        ticket_entered(watched, site, typed)
    assert [asked["mass_kg"] for asked in daemon.asked] == [mass_kg]


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("9.120", "9.120 can be 9120 or 9.12 kg: enter it without the point."),
        ("9.12t", '"9.12t" is not a number of kg, such as 9120 or 9120.5.'),
        ("9 12", '"9 12" is not a number of kg, such as 9120 or 9120.5.'),
        ("-9120", '"-9120" is not a number of kg, such as 9120 or 9120.5.'),
        ("1e4", '"1e4" is not a number of kg, such as 9120 or 9120.5.'),
    ],
)
def test_what_is_no_mass_is_told_and_not_sent(browser: Browser, daemon: StandIn, site: str, typed: str, said: str) -> None:
    daemon.asked.clear()
    with Watched(browser) as watched:
        dialog = ticket_entered(watched, site, typed)
        assert dialog.locator(".problem").inner_text() == said
    assert daemon.asked == []


@pytest.mark.parametrize("size", [CAB, PHONE], ids=["cab", "phone"])
def test_grain_after_the_end_of_a_load_is_told_whole(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: dict[str, int]
) -> None:
    with standing_in(tmp_path, field_name="behind the old mill, north of the line") as daemon:
        daemon.seconds(20)
        status = daemon.status

        def ended() -> dict[str, Any]:
            document = status()
            document["load"]["open"] = False
            return document

        monkeypatch.setattr(daemon, "status", ended)
        daemon.faults = [
            fault("FramesLost", "7500 lost, 0 too many; they were lost while no samples came"),
            fault("SpeedMissing"),
        ]
        with page(daemon.socket) as site, Watched(browser, size) as watched:
            watched.page.goto(site)
            watched.wait(READY)
            assert watched.page.inner_text("#load-note") == "Grain counts only in the total"
            cut = "(element) => element.scrollWidth > element.clientWidth || element.scrollHeight > element.clientHeight"
            tile = watched.page.locator("#load-tile")
            assert tile.evaluate(cut) is False
            assert tile.locator("#load-note").evaluate(cut) is False
            assert tile.evaluate("(element) => getComputedStyle(element).backgroundColor") == "rgb(255, 212, 0)"


def test_an_answer_says_when_it_was_given(browser: Browser, daemon: StandIn, site: str) -> None:
    with Watched(browser) as watched:
        watched.page.clock.set_fixed_time("2025-10-09T14:05:30Z")
        watched.page.goto(site)
        watched.wait(READY)
        dialog_of(watched, "End load").get_by_role("button", name="End load").click()
        watched.wait(ASKED)
        assert watched.page.inner_text(".answer") == "14:05 Load 1 ended: 1 kg."


def test_a_silent_bus_is_told_at_a_glance(browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with standing_in(tmp_path) as daemon:
        daemon.seconds(20)
        status, frames_per_s = daemon.status, [300.0]

        def heard() -> dict[str, Any]:
            document = status()
            document["state"] = "harvesting" if frames_per_s[0] else "fault"
            document["bus"]["frames_per_s"] = frames_per_s[0]
            return document

        monkeypatch.setattr(daemon, "status", heard)
        with page(daemon.socket) as site, Watched(browser, PHONE) as watched:
            watched.page.goto(site)
            watched.wait("document.getElementById('state').textContent === 'harvesting'")
            frames_per_s[0] = 0.0
            watched.wait("document.getElementById('state').textContent === 'fault: no frames on the bus'")
            assert watched.evaluate("document.body.classList.contains('stale')")
            frames_per_s[0] = 300.0
            watched.wait("document.getElementById('state').textContent === 'harvesting'")
            assert not watched.evaluate("document.body.classList.contains('stale')")


@pytest.mark.parametrize(("zero_mv", "uncounted"), [(None, " Until then no mass is counted."), (500.0, "")])
def test_what_the_zero_waits_for_is_told(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, zero_mv: float | None, uncounted: str
) -> None:
    with standing_in(tmp_path) as daemon:
        daemon.seconds(20)
        status, waits = daemon.status, ["the elevator running empty: 0 of 5 s"]

        def zeroing() -> dict[str, Any]:
            return {**status(), "state": "zeroing", "zero_mv": zero_mv, "zero_waits_for": waits[0] or None}

        monkeypatch.setattr(daemon, "status", zeroing)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait("document.getElementById('state').textContent === 'zeroing'")
            watched.wait("document.querySelector('.fault') !== null")
            said = f"The zero waits for the elevator running empty: 0 of 5 s.{uncounted}"
            assert watched.page.inner_text("#faults") == said
            waits[0] = ""
            watched.wait("document.querySelector('.fault') === null")
