"""The page in a real browser: every button, faults, markup in names, accessibility, a large map, and 120 times the pace."""

from __future__ import annotations

import json
import os
import re
import signal
import sqlite3
import struct
import threading
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.service.bench import running
from tests.web.browser import ASKED, CAB, OFFICE, READY, Watched, chromium
from tests.web.standin import StandIn, fault, page, standing_in
from yieldmon.engine.faults import FAULTS
from yieldmon.files import parameter_file
from yieldmon.service.operator.control_client import ask as ask_daemon
from yieldmon.service.storage.batch import FaultEvent, Load, ParameterVersion, SweepRecord

pytest.importorskip("playwright")
pytestmark = pytest.mark.skipif(chromium() is None, reason="needs chromium (Debian: apt-get install chromium)")

if TYPE_CHECKING:
    from playwright.sync_api import Browser

AXE = (Path(__file__).parent / "data" / "axe.min.js").read_text(encoding="utf-8")
TOKEN = "correct-horse-battery"
MARKUP = "<img src=x onerror=\"document.title='run'\"><b>&amp;"
TEXT = "(document.body?.innerText ?? '')"
FITS = "document.documentElement.scrollHeight <= innerHeight && document.documentElement.scrollWidth <= innerWidth"


def same_site(watched: Watched, site: str) -> None:
    """Nothing was asked of anybody else, and nothing went wrong."""
    assert watched.asked
    assert [url for url in watched.asked if not url.startswith(site + "/")] == []
    assert watched.complaints == []


def test_a_page_that_hangs_ends_what_asks_it(browser: Browser) -> None:
    """And the browser has others."""
    with Watched(browser) as watched, pytest.raises(TimeoutError, match="no answer in 1 s to"):
        watched.evaluate("(() => { while (true); })()", timeout_s=1.0)
    with Watched(browser) as watched:
        assert watched.evaluate("[1, {two: 3.5}]") == [1, {"two": 3.5}]


@pytest.mark.parametrize("size", [CAB, OFFICE], ids=["cab", "office"])
def test_the_live_page_shows_what_the_daemon_says(browser: Browser, daemon: StandIn, site: str, size: dict[str, int]) -> None:
    with Watched(browser, size) as watched:
        watched.page.goto(site)
        watched.wait("Number(document.querySelector('#map canvas')?.dataset.points) > 1400")
        shown = {name: watched.page.inner_text(f"#{name}") for name in ("flow", "load", "total", "moisture", "elevator", "plate")}
        last = daemon.windows[-1]
        assert shown == {
            "flow": f"{last.mass_flow_kg_s:.2f}", "load": "10,500", "total": "10.50", "moisture": f"{last.moisture_pct:.1f}",
            "elevator": "402", "plate": "70.0",
        }  # fmt: skip
        assert watched.page.inner_text("#state") == "harvesting"
        assert watched.page.inner_text("#flow-band") == "± 0.25 kg/s"
        # All of it on one screen, and large enough for a thumb in a glove.
        assert watched.evaluate(FITS)
        for button in watched.page.query_selector_all("button:visible"):
            box = button.bounding_box()
            assert box is not None
            assert min(box["width"], box["height"]) >= 44
        same_site(watched, site)


def test_a_fault_comes_and_goes(browser: Browser, daemon: StandIn, site: str) -> None:
    with Watched(browser) as watched:
        watched.page.goto(site)
        watched.wait(f"{TEXT}.includes('harvesting')")
        try:
            daemon.faults = [fault("FramesLost", MARKUP)]
            watched.wait("document.querySelectorAll('.fault').length === 1")
            assert watched.page.inner_text(".fault") == f"FramesLost ({MARKUP}) What it does. What to do."
            assert watched.evaluate("document.querySelector('.fault').closest('[role=alert]') !== null")
        finally:
            daemon.faults = []
        watched.wait("document.querySelectorAll('.fault').length === 0")
        same_site(watched, site)


def test_in_the_cab_two_faults_are_read_whole_and_all_are_named(browser: Browser, daemon: StandIn, site: str) -> None:
    """The two with the longest texts; of six, all names stay in view where the texts are scrolled."""
    longest = sorted(FAULTS.values(), key=lambda row: len(row.effect + row.remedy), reverse=True)
    told = [fault(row.code.value) | {"effect": row.effect, "remedy": row.remedy, "severity": "warning"} for row in longest[:6]]
    with Watched(browser, CAB) as watched:
        watched.page.goto(site)
        try:
            for count in (2, 6):
                daemon.faults = told[:count]
                watched.wait(f"document.querySelectorAll('.fault').length === {count}")
                lines = ".fault" if count == 2 else ".fault-names"
                if count == 6:
                    watched.evaluate("document.getElementById('faults').scrollTo(0, 10000)")
                inside = (
                    "(() => { const box = document.getElementById('faults').getBoundingClientRect();"
                    f" return [...document.querySelectorAll('{lines}')].map((line) => line.getBoundingClientRect())"
                    ".every((line) => line.top >= box.top && line.bottom <= box.bottom + 1); })()"
                )
                assert watched.evaluate(inside)
                names = ", ".join(row["code"] for row in told[:count])
                assert watched.page.inner_text(".fault-names") == f"{count} faults: {names}"
                assert watched.evaluate(FITS)
                assert watched.evaluate("document.querySelector('#trend').getBoundingClientRect().height > 120")
        finally:
            daemon.faults = []
        watched.wait("document.querySelectorAll('.fault').length === 0")


def test_markup_in_names_stays_text(browser: Browser, tmp_path: Path) -> None:
    name = MARKUP[:80]
    with standing_in(tmp_path, field_name=name, crop=name) as daemon:
        daemon.seconds(30)
        sweep = SweepRecord(5.0, "aborted", name, {"angles_deg": []})
        load, came = Load(1, name, name, 1.0, 2.0, 10.0, None), FaultEvent(1.0, name, True, name)
        daemon.commit(loads=(load,), sweeps=(sweep,), faults=(came,))
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(f"document.getElementById('load-name').textContent.includes({json.dumps(name)})")
            watched.page.click("text=Ticket")
            watched.page.keyboard.press("Escape")
            watched.page.goto(site + "/history")
            watched.wait("document.querySelectorAll('#faults-table td').length === 4")
            assert watched.evaluate("document.querySelectorAll('main img, main b').length") == 0
            assert watched.page.inner_text("#sweeps-table").count(name) == 1
            assert watched.page.title() == "yieldmon: history"
            assert [url for url in watched.asked if not url.startswith(site + "/")] == []


def test_every_button_with_a_real_daemon(browser: Browser, tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        # Empty first, so that the zero is found, then grain.
        bench.play(14.0, 0.0)
        bench.play(8.0, 150.0)
        bench.played()
        with page(bench.daemon.configuration.socket_path) as site, Watched(browser) as watched:
            tab = watched.page
            tab.goto(site)
            watched.wait(READY)

            def press(name: str, confirm: str, **fields: str) -> str:
                """What the page says after a button, its dialog's fields and the confirmation."""
                tab.get_by_role("group", name="Commands").get_by_role("button", name=name, exact=True).click()
                dialog = tab.locator("dialog[open]")
                for field, text in fields.items():
                    dialog.locator(f"[name={field}]").fill(text)
                before = tab.inner_text("#answer")
                dialog.get_by_role("button", name=confirm, exact=True).click()
                watched.wait(ASKED)
                problem = dialog.locator(".problem").inner_text() if dialog.count() else ""
                if dialog.count():
                    tab.keyboard.press("Escape")
                else:
                    assert tab.inner_text("#answer") != before
                return problem or tab.inner_text("#answer")

            def ticket(mass_kg: float) -> str:
                text = str(number)
                return press("Ticket", "Correct the loads", first_load=text, last_load=text, mass=str(mass_kg))

            number = bench.status["load"]["number"]
            measured_kg = bench.status["load"]["mass_kg"]
            assert measured_kg > 10.0
            assert press("Zero", "Calibrate zero").startswith("zero: there is grain")
            assert f"load {number}" in ticket(9000.0)
            assert press("End load", "End load").startswith(f"Load {number} ended:")
            assert "no load is open" in press("End load", "End load")
            said = ticket(2.0 * measured_kg)
            assert "a reference for the calibration" in said
            assert "if it is a slip, enter the right mass as another ticket" in said
            tab.get_by_role("group", name="Commands").get_by_role("button", name="Undo ticket").click()
            dialog = tab.locator("dialog[open]")
            dialog.get_by_role("option", name=f"1: load {number},").wait_for(state="attached")
            dialog.get_by_role("button", name="Undo ticket").click()
            watched.wait("document.getElementById('answer').textContent === 'Ticket 1 undone.'")
            assert press("New load", "Begin load", field="south <b>", crop="") == f"Load {number + 1} begun."
            assert bench.status["load"]["field"] == "south <b>"
            assert "as soon as a flow of at least 4 kg/s" in press("Sweep", "Start sweep")
            assert "ended" in press("End sweep", "End sweep now")
            assert press("Undo zero", "Undo zero") != ""
            # The daemon's answer is what decides; nothing is pressed by opening and closing.
            loads = bench.status["load"]["number"]
            tab.get_by_role("button", name="New load").click()
            tab.locator("dialog[open]").get_by_role("button", name="Cancel").click()
            tab.get_by_role("button", name="New load").click()
            tab.keyboard.press("Escape")
            assert tab.locator("dialog[open]").count() == 0
            assert bench.status["load"]["number"] == loads


def test_a_load_begun_under_a_wrong_crop(browser: Browser, tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        bench.play(14.0, 0.0)
        bench.play(8.0, 150.0)
        bench.played()
        with page(bench.daemon.configuration.socket_path) as site, Watched(browser, {"width": 360, "height": 640}) as watched:
            watched.page.goto(site)
            watched.wait(READY)
            commands, dialog = watched.page.get_by_role("group", name="Commands"), watched.page.locator("dialog[open]")
            for crop, said in (
                ("wheat", "is still open"),
                ("wheat", "Load 1: wheat; recomputed."),
                ("wheat", "has 'wheat' already"),
            ):
                commands.get_by_role("button", name="Wrong crop").click()
                dialog.locator("[name=first_load]").fill("1")
                dialog.locator("[name=last_load]").fill("1")
                dialog.locator("[name=crop]").fill(crop)
                dialog.get_by_role("button", name="Correct the loads").click()
                watched.wait(ASKED)
                shown = dialog.locator(".problem").inner_text() if dialog.count() else watched.page.inner_text("#answer")
                assert said in shown
                if dialog.count():
                    watched.page.keyboard.press("Escape")
                if "open" in said:
                    commands.get_by_role("button", name="End load").click()
                    dialog.get_by_role("button", name="End load").click()
                    watched.wait(ASKED)
            # A crop that was filled in and is taken out.
            watched.page.locator("#load-name").filter(has_text="wheat").wait_for()
            commands.get_by_role("button", name="New load").click()
            dialog.locator("[name=crop]").fill("")
            dialog.get_by_role("button", name="Begin load").click()
            watched.wait(ASKED)
            assert dialog.locator(".problem").inner_text().startswith("crop: is empty")
            assert bench.status["load"]["number"] == 1


def test_what_a_late_ticket_is_told(browser: Browser, tmp_path: Path) -> None:
    """Of another crop than is harvested, for loads of two crops, in place of an earlier one, and of a crop that is not known."""
    with running(tmp_path) as bench:
        bench.play(14.0, 0.0)
        # The zero first: seconds without one are not measured.
        bench.played()
        for crop in ("wheat", "corn"):
            ask_daemon(bench.daemon.configuration.socket_path, {"command": "load-start", "crop": crop})
            bench.play(6.0, 100.0)
            bench.play(1.0, 0.0)
            bench.played()
        ask_daemon(bench.daemon.configuration.socket_path, {"command": "load-stop"})
        masses = {load["number"]: load["mass_kg"] for load in bench.status["loads"]}
        with page(bench.daemon.configuration.socket_path) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(READY)
            dialog = watched.page.locator("dialog[open]")

            def told(button: str, confirm: str, **fields: str) -> str:
                watched.page.get_by_role("group", name="Commands").get_by_role("button", name=button, exact=True).click()
                for name, text in fields.items():
                    dialog.locator(f"[name={name}]").fill(text)
                dialog.get_by_role("button", name=confirm, exact=True).click()
                watched.wait("!document.querySelector('dialog[open]')")
                return watched.page.inner_text("#answer")

            late = told("Ticket", "Correct the loads", first_load="2", last_load="2", mass=f"{1.05 * masses[2]:.2f}")
            assert (
                "a reference for wheat, whose parameters it updates once that is harvested again. "
                "It is the first and alone sets the scale"
            ) in late
            both = told("Ticket", "Correct the loads", first_load="2", last_load="3", mass=f"{masses[2] + masses[3]:.2f}")
            assert (
                "no reference for the calibration: loads of corn and wheat on one ticket update the parameters of none; "
                "Wrong crop if" in both
            )
            assert "It replaces ticket 1 (of a load weighed in parts enter the sum)." in both
            unknown = told("New load", "Begin load", crop="havre")
            assert unknown == "Load 4 begun; havre is not a known crop: it starts with the parameters of the crop before."


def test_us_units(browser: Browser, tmp_path: Path) -> None:
    with standing_in(tmp_path, units="us", crop="corn") as daemon:
        daemon.seconds(60)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(READY)
            text = watched.page.inner_text("main")
            # 420 kg; 1.1 ha; 0.92 kg/m2 of 25.4 kg bushels; 1.8 m/s
            assert "926 lb" in text
            assert "2.72 ac" in text
            assert "147 bu/ac" in text
            assert "4.0 mph" in text
            assert not re.search(r"\bkg\b", text)
            watched.page.get_by_role("button", name="Ticket", exact=True).click()
            for name, value in {"first_load": "1", "last_load": "1", "mass": "2000"}.items():
                watched.page.locator(f"dialog[open] [name={name}]").fill(value)
            daemon.asked.clear()
            watched.page.get_by_role("button", name="Correct the loads").click()
            watched.wait("document.getElementById('answer').textContent.startsWith('Measured 2 lb')")
            assert [asked["mass_kg"] for asked in daemon.asked] == [pytest.approx(907.18474)]
            watched.page.goto(f"{site}/history")
            watched.wait("document.getElementById('days-table').textContent.includes('Grain, lb')")
            assert not re.search(r"\bkg\b", watched.page.inner_text("main"))


@pytest.mark.parametrize(
    ("parameters_crop", "flow", "band", "crop_yield"),
    [("corn", "1,270 bu/h", "± 35 bu/h", "147 bu/ac"), ("", "19.8 lb/s", "± 0.6 lb/s", "8,208 lb/ac")],
    ids=["bushels of the parameters' crop", "pounds where no crop is known"],
)
def test_us_units_of_a_load_without_a_crop(
    browser: Browser, tmp_path: Path, parameters_crop: str, flow: str, band: str, crop_yield: str
) -> None:
    # 8.96 +- 0.25 kg/s; 0.92 kg/m2; 25.4 kg bushels
    with standing_in(tmp_path, units="us", crop="", parameters_crop=parameters_crop) as daemon:
        daemon.seconds(60)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(READY)
            text = " ".join(watched.page.inner_text("main").split())
            assert [shown for shown in (flow, band, crop_yield) if shown not in text] == []


def test_a_button_by_keyboard_alone(browser: Browser, daemon: StandIn, site: str) -> None:
    daemon.asked.clear()
    with Watched(browser) as watched:
        watched.page.goto(site)
        watched.wait(READY)
        for _ in range(40):
            watched.page.keyboard.press("Tab")
            if watched.evaluate("document.activeElement.textContent") == "End load":
                break
        watched.page.keyboard.press("Enter")
        for _ in range(5):
            if watched.evaluate("document.activeElement.className") == "yes":
                break
            watched.page.keyboard.press("Tab")
        watched.page.keyboard.press("Enter")
        watched.wait("document.getElementById('answer').textContent.startsWith('Load 1 ended')")
        assert watched.evaluate("document.activeElement.textContent") == "End load"
    assert daemon.asked == [{"command": "load-stop"}]


def test_a_read_only_page_has_no_buttons(browser: Browser, daemon: StandIn) -> None:
    with page(daemon.socket, "--read-only") as site, Watched(browser) as watched:
        watched.page.goto(site)
        watched.wait(f"{TEXT}.includes('harvesting')")
        assert watched.page.query_selector_all(".buttons button:visible") == []


def test_signing_in(browser: Browser, daemon: StandIn, tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text(TOKEN)
    path.chmod(0o600)
    with page(daemon.socket, "--token-file", str(path)) as site, Watched(browser) as watched:
        watched.page.goto(site)
        assert watched.page.url.endswith("/sign-in")
        watched.page.fill("[name=token]", "not the token, but long")
        watched.page.keyboard.press("Enter")
        watched.wait(f"{TEXT}.includes('not the token')")
        watched.page.fill("[name=token]", TOKEN)
        watched.page.keyboard.press("Enter")
        watched.wait(f"{TEXT}.includes('harvesting')")
        assert [url for url in watched.asked if not url.startswith(site + "/")] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_serious_fault(browser: Browser, daemon: StandIn, site: str, scheme: str) -> None:
    def faults_of(watched: Watched) -> list[str]:
        watched.evaluate(AXE)
        result = watched.evaluate("axe.run(document, {resultTypes: ['violations']})")
        serious = [found for found in result["violations"] if found["impact"] in ("serious", "critical")]
        return [f"{found['id']}: {[node['target'] for node in found['nodes']]}" for found in serious]

    daemon.faults = [fault(), fault("MoistureMissing") | {"severity": "warning"}, fault("Other") | {"severity": "note"}]
    try:
        with Watched(browser, color_scheme=scheme) as watched:
            watched.page.goto(site)
            watched.wait("document.querySelectorAll('.fault').length === 3")
            assert faults_of(watched) == []
            for button in watched.page.query_selector_all("[data-dialog]" if scheme == "light" else "[data-dialog$=ticket]"):
                button.click()
                assert faults_of(watched) == []
                watched.page.keyboard.press("Escape")
            for path, ready in (("/history", "document.querySelectorAll('#days-table td').length > 1"), ("/sign-in", "true")):
                watched.page.goto(site + path)
                watched.wait(ready)
                assert faults_of(watched) == []
    finally:
        daemon.faults = []


def many_points(count: int, west_deg: float = 12.15) -> bytes:
    """An answer of /api/points: passes of 500 points."""
    number = np.arange(count)
    longitude, latitude = west_deg + 1e-4 * (number // 500), 51.05 + 1.6e-5 * (number % 500)
    longitude = (longitude + 180.0) % 360.0 - 180.0
    places = [np.round(column * 1e7).astype("<i4").tobytes() for column in (longitude, latitude)]
    return b"".join((struct.pack("<II", count, count), *places, np.sin(number / 50.0).astype("<f4").tobytes()))


def test_the_history_on_a_phone_has_rows_of_some_lines_and_charts_of_some_days(browser: Browser, tmp_path: Path) -> None:
    """Of long names and faults, and of parameters that have one version."""
    said = "samples for 96 % of the second, no frame missing: if this persists, check rate_hz"
    with standing_in(tmp_path, field_name="far behind the old station, on the left of the river, 12b") as daemon:
        version = ParameterVersion(1, daemon.start_s, "file", parameter_file.to_document(parameter_file.load()))
        daemon.commit(parameter_versions=(version,), faults=(FaultEvent(daemon.start_s, "FramesLost", True, said),))
        daemon.seconds(60)
        with page(daemon.socket) as site, Watched(browser, {"width": 390, "height": 844}) as watched:
            watched.page.goto(site + "/history")
            watched.wait("document.querySelectorAll('.charts figure [data-seconds]').length === 3")
            seconds = watched.evaluate("[...document.querySelectorAll('[data-seconds]')].map(e => Number(e.dataset.seconds))")
            assert seconds == [2 * 86_400] * 3
            watched.wait(f"{TEXT}.includes('check rate_hz')")
            heights = watched.evaluate("[...document.querySelectorAll('tbody tr')].map(row => row.offsetHeight)")
            assert max(heights) < 130
            same_site(watched, site)


def test_110_000_points_are_drawn_and_moved(browser: Browser, tmp_path: Path) -> None:
    with standing_in(tmp_path) as daemon:
        daemon.seconds(60)
        with page(daemon.socket) as site, Watched(browser) as watched:
            # A store of so many seconds takes a minute to make: `python -m tests.robustness web-page` does.
            watched.page.route("**/api/points*", lambda route: route.fulfill(body=many_points(110_000)))
            watched.page.goto(site + "/history")
            watched.wait("document.querySelector('#map-of')?.options.length > 1")
            watched.page.select_option("#map-of", "all")
            watched.wait("document.querySelector('#map canvas').dataset.points === '110000'")
            assert watched.page.url == site + "/history?map=all"
            watched.page.reload()
            watched.wait("document.querySelector('#map canvas')?.dataset.points === '110000'")
            watched.wait("document.querySelector('#map-of').value === 'all'")
            picture = (
                "(() => { const c = document.querySelector('#map canvas'); const d = c.getContext('2d')"
                ".getImageData(0, 0, c.width, c.height).data; let n = 0, x = 0; for (let i = 3; i < d.length; i += 4)"
                " if (d[i]) { n++; x += (i >> 2) % c.width; } return [n, x / n]; })()"
            )
            painted, middle = watched.evaluate(picture)
            assert painted > 5000
            canvas = watched.page.locator("#map canvas")
            canvas.scroll_into_view_if_needed()
            box = canvas.bounding_box()
            assert box is not None
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            drawn = "Number(document.querySelector('#map canvas').dataset.drawn)"
            for act, shift in (("mouse", 40.0), ("keyboard", -60.0)):
                before = watched.evaluate(drawn)
                if act == "mouse":
                    watched.page.mouse.move(x, y)
                    watched.page.mouse.down()
                    watched.page.mouse.move(x + shift, y)
                    watched.page.mouse.up()
                else:
                    canvas.focus()
                    watched.page.keyboard.press("ArrowRight")
                watched.wait(f"{drawn} > {before}")
                _, moved = watched.evaluate(picture)
                assert moved - middle == pytest.approx(shift, abs=2.0)
                middle = moved
            same_site(watched, site)


def test_a_field_across_the_180th_meridian_fills_the_map(browser: Browser, tmp_path: Path) -> None:
    with standing_in(tmp_path) as daemon:
        daemon.seconds(60)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.route("**/api/points*", lambda route: route.fulfill(body=many_points(20_000, 179.998)))
            watched.page.goto(site + "/history?map=all")
            watched.wait("document.querySelector('#map canvas')?.dataset.points === '20000'")
            painted = watched.evaluate(
                "(() => { const c = document.querySelector('#map canvas'); const d = c.getContext('2d')"
                ".getImageData(0, 0, c.width, c.height).data; let n = 0; for (let i = 3; i < d.length; i += 4)"
                " if (d[i]) n++; return n / (c.width * c.height); })()"
            )
            assert painted > 0.1
            same_site(watched, site)


def test_at_120_times_the_pace_no_second_is_missed(browser: Browser, tmp_path: Path) -> None:
    with standing_in(tmp_path) as daemon:
        daemon.seconds(3600)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait("Number(document.body.dataset.last) >= 3600")
            stop = threading.Event()

            def play() -> None:
                while not stop.wait(0.25):
                    daemon.seconds(30)

            playing = threading.Thread(target=play)
            playing.start()
            try:
                heap = "(gc(), performance.memory.usedJSHeapSize)"
                watched.wait("Number(document.body.dataset.last) >= 3700")
                before = watched.evaluate(heap)
                watched.wait("Number(document.body.dataset.last) >= 4200", timeout_s=60.0)
                after = watched.evaluate(heap)
            finally:
                stop.set()
                playing.join()
            watched.wait(f"Number(document.body.dataset.last) === {daemon.number}")
            assert watched.evaluate("document.body.dataset.missed") == "0"
            assert after - before < 5e6
            same_site(watched, site)


def test_a_daemon_that_ends_and_comes_back(browser: Browser, tmp_path: Path) -> None:
    with standing_in(tmp_path) as daemon:
        daemon.seconds(20)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(f"{TEXT}.includes('harvesting')")
            daemon.stop()
            watched.wait(f"{TEXT}.includes('no daemon answers') && document.body.classList.contains('stale')")
            daemon.start()
            watched.wait(f"{TEXT}.includes('harvesting') && !document.body.classList.contains('stale')")


def test_on_a_phone_that_shows_the_map_a_daemon_that_ends_is_told(browser: Browser, tmp_path: Path) -> None:
    """The page is longer than a phone, and the word stood above what was shown."""
    seen = "(() => { const box = document.getElementById('state').getBoundingClientRect();"
    seen += " return box.top >= 0 && box.bottom <= innerHeight && document.elementFromPoint(box.right - 2, box.top + 2).id; })()"
    with standing_in(tmp_path) as daemon:
        daemon.seconds(20)
        with page(daemon.socket) as site, Watched(browser, {"width": 390, "height": 844}) as watched:
            watched.page.goto(site)
            watched.wait(f"{TEXT}.includes('harvesting')")
            watched.evaluate("window.scrollTo(0, document.documentElement.scrollHeight)")
            watched.wait("scrollY > 100")
            daemon.stop()
            watched.wait(f"{TEXT}.includes('no daemon answers')")
            assert watched.evaluate(seen) == "state"


def test_a_ticket_without_a_connection_is_told_in_words(browser: Browser, daemon: StandIn, site: str) -> None:
    with Watched(browser) as watched:
        watched.page.goto(site)
        watched.wait(f"{TEXT}.includes('harvesting')")
        watched.page.get_by_role("button", name="Ticket", exact=True).click()
        for name, value in (("first_load", "1"), ("last_load", "1"), ("mass", "9120")):
            watched.page.fill(f"dialog[open] [name={name}]", value)
        watched.page.context.set_offline(True)
        watched.page.get_by_role("button", name="Correct the loads").click()
        watched.wait(f"{TEXT}.includes('No connection to the monitor: whether this arrived is not known')")
        watched.page.context.set_offline(False)


AHEAD_MS = 5500


def test_a_server_that_hangs_is_no_harvest(browser: Browser, tmp_path: Path) -> None:
    """Its connections stay open, and what it said last would pass for what is."""
    with standing_in(tmp_path) as daemon:
        daemon.seconds(20)
        with page(daemon.socket) as site, Watched(browser) as watched:
            watched.page.goto(site)
            watched.wait(f"{TEXT}.includes('harvesting')")
            os.kill(site.pid, signal.SIGSTOP)
            # The page's clock goes ahead by less than its patience beyond what a server that lives leaves between two events.
            watched.evaluate(f"const real = performance.now.bind(performance); performance.now = () => real() + {AHEAD_MS};")
            try:
                watched.wait(f"{TEXT}.includes('no news for') && document.body.classList.contains('stale')")
            finally:
                os.kill(site.pid, signal.SIGCONT)
            watched.wait(f"{TEXT}.includes('harvesting') && !document.body.classList.contains('stale')")


def png() -> bytes:
    """A picture of 256 by 256 pixels in one colour."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    lines = (b"\0" + b"\x80\xa0\x80" * 256) * 256
    header = struct.pack(">IIBBBBB", 256, 256, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")


def test_tiles_come_from_the_file(browser: Browser, daemon: StandIn, tmp_path: Path) -> None:
    path = tmp_path / "field.mbtiles"
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE metadata (name TEXT, value TEXT)")
    database.execute("CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB)")
    # All of one zoom around the field: 12.15 E, 51.05 N.
    for column in range(4370, 4375):
        for north in range(2736, 2742):
            database.execute("INSERT INTO tiles VALUES (13, ?, ?, ?)", (column, (1 << 13) - 1 - north, png()))
    database.commit()
    database.close()
    with page(daemon.socket, "--tiles", str(path)) as site, Watched(browser) as watched:
        answers: list[int] = []
        watched.page.on("response", lambda answer: answers.append(answer.status) if "/tiles/" in answer.url else None)
        watched.page.goto(site)
        watched.wait("Number(document.querySelector('#map canvas')?.dataset.points) > 1400")
        watched.page.wait_for_timeout(300)
        assert 200 in answers
        assert all(re.match(rf"{site}/(tiles/13/|static/|api/|$)", url) for url in watched.asked)
