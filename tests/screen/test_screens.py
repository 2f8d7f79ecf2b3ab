"""Both views of the monitor against kept screens at 80x24 and 120x40, no value cut; change, range, keys, a real terminal."""

from __future__ import annotations

import io
import os
import re
import sys
from pathlib import Path
from typing import Any

import pexpect
import pyte
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from tests.screen.screens import CODEC, KEPT, MANY_FAULTS, SCREENS, STATUS, US, drawn, traffic
from yieldmon import frames
from yieldmon.bus.log_files.log_writing import writing
from yieldmon.cli._typed_mass import mass
from yieldmon.files.crops import crops, shipped_name
from yieldmon.frames import Frame
from yieldmon.screen import values
from yieldmon.screen.cab import Cab
from yieldmon.screen.dialog import NO_DAEMON, Dialog
from yieldmon.screen.panels import Screen, View
from yieldmon.screen.traffic import Traffic
from yieldmon.units import Units


@pytest.mark.parametrize("name", SCREENS)
def test_a_screen_is_the_kept_one(name: str) -> None:
    assert drawn(*SCREENS[name]) == (KEPT / f"{name}.txt").read_text(encoding="utf-8")


def words(screen: str) -> str:
    """A screen's text with wrapped lines joined."""
    return " ".join(screen.split())


@settings(max_examples=30)
@given(data=st.data(), width=st.integers(80, 240), height=st.integers(24, 70))
def test_no_value_of_the_chosen_message_is_cut(data: st.DataObject, width: int, height: int) -> None:
    seen = traffic(3)
    rows = seen.sorted_rows("id")
    place = data.draw(st.integers(0, len(rows) - 1))
    text = words(drawn(Screen(seen, View(selected=place)), width, height))
    row = rows[place]
    assert row.last is not None
    assert bytes(row.last.data).hex(" ").upper() in text
    frame = seen.decoded(row)
    layout = CODEC.layout_of(row.key[0]) if row.key[1] else None
    if frame is None or layout is None:
        return
    for signal in layout.signals:
        if signal.bits != 2:
            assert f"{signal.name} {values.text(signal, frame.signals[signal.name])}" in text
        elif frame.signals[signal.name] == 1:
            assert signal.name in text


@settings(max_examples=30)
@given(
    width=st.integers(80, 200), height=st.integers(24, 60), us=st.booleans(), kg=st.floats(0.0, 1e7), flow=st.floats(0.0, 60.0),
    faults=st.integers(0, 8),
)  # fmt: skip
def test_no_value_of_the_cab_is_cut(width: int, height: int, us: bool, kg: float, flow: float, faults: int) -> None:
    units = US if us else Units()
    load = {**STATUS["load"], "mass_kg": kg, "dry_mass_kg": kg}
    changed = {**STATUS, "load": load, "now": {**STATUS["now"], "mass_flow_kg_s": flow}, "faults": MANY_FAULTS[:faults]}
    screen = drawn(Cab(changed, units, "", View(cab=True)), width, height)
    text = words(screen)
    expected = [units.mass_with_bushels(kg), units.mass(412_345.0), units.area(8123.0), units.speed(1.53), "moisture 17.2 %"]
    expected += [fault["code"] for fault in MANY_FAULTS[:faults]]
    assert [value for value in expected if value not in text] == []
    assert "q quit" in text
    assert len(screen.splitlines()) <= height


def test_a_dry_mass_that_is_not_known_says_why() -> None:
    load, total = {**STATUS["load"], "dry_mass_kg": None}, {**STATUS["total"], "mass_of_unknown_moisture_kg": 310.0}
    screen = words(drawn(Cab({**STATUS, "load": load, "total": total}, Units(), "", View(cab=True)), 80, 24))
    assert "dry not known, moisture missing" in screen
    assert "missing at" not in screen


def test_bytes_that_change_stand_out_and_the_range_is_that_of_all_frames() -> None:
    seen = Traffic(CODEC)
    for k, rpm in enumerate((400.0, 410.0, 390.0, 400.0)):
        seen.observe(CODEC.encode(Frame(1.0 + 0.1 * k, frames.ELEVATOR_SPEED, {"ElevatorSpeed": rpm})))
        if k in (0, 3):
            seen.mark(1.0 + 0.1 * k)
    (row,) = seen.rows.values()
    assert row.extremes["ElevatorSpeed"] == (390.0, 410.0)
    seen.observe(CODEC.encode(Frame(1.5, frames.ELEVATOR_SPEED, {"ElevatorSpeed": 401.0})))
    seen.mark(1.5)
    console = Console(file=io.StringIO(), width=80, height=24, force_terminal=True, color_system="standard")
    console.print(Screen(seen, View()), height=24)
    changed = re.findall(r"\x1b\[1;7m([0-9A-F]{2})\x1b\[0m", console.file.getvalue())
    assert changed == [f"{int(401.0 / 0.125) & 0xFF:02X}"]


CORRECT = {"command": "load-correct", "first_load": 6, "last_load": 6, "crop": "wheat"}
WHEAT = {"command": "load-start", "crop": "wheat"}
ALL_KEYS = ("l", "x", "t", "z", "w")


@pytest.mark.parametrize(("units", "said"), [(Units(), "weighed 9072 kg"), (US, "weighed 20,000 lb")])
def test_a_fault_in_the_cab_is_in_the_units_chosen(units: Units, said: str) -> None:
    fault = {"code": "ScaleDisagrees", "detail": "load 6 weighed 9072 kg", "effect": "Off.", "remedy": "Check the ticket."}
    waits = "an elevator that runs empty: the tank has gained 9072 kg"
    shown = drawn(Cab({**STATUS, "faults": [fault], "zero_waits_for": waits}, units, "", View(cab=True)), 120, 40)
    assert said in words(shown)
    assert said.replace("weighed", "gained") in words(shown)


@settings(max_examples=40)
@given(
    width=st.integers(30, 130), height=st.integers(8, 40), faults=st.integers(0, 8),
    prompt=st.sampled_from(["", "ticket: number of the load and its weighed mass, such as 7 9.12t: 7_"]),
)  # fmt: skip
def test_a_low_window_shows_what_is_asked_and_that_there_are_faults(width: int, height: int, faults: int, prompt: str) -> None:
    """At 40x12 a ticket was typed and confirmed unseen, and no fault was shown."""
    status = {**STATUS, "faults": MANY_FAULTS[:faults], "load": {**STATUS["load"], "field": "", "crop": ""}}
    shown = words(drawn(Cab(status, Units(), prompt, View(cab=True)), width, height))
    assert prompt in shown
    assert "HARVESTING" in shown
    assert height < 12 or ("ZeroDrifted" if faults else "no faults") in shown


@pytest.mark.parametrize(("width", "height"), [(40, 12), (30, 8), (80, 24), (60, 7)])
def test_a_low_window_of_the_bus_shows_flow_state_and_filter(width: int, height: int) -> None:
    shown = words(drawn(Screen(traffic(), View(needle="mass", typing=True)), width, height))
    assert "faults: ZeroDrifted" in shown
    assert "filter: mass_" in shown
    assert "id message" in shown


def test_a_terminal_that_draws_nothing_is_refused_in_a_line(tmp_path: Path) -> None:
    """TERM=dumb gave an empty screen for ever."""
    log = tmp_path / "a.log"
    log.write_text("(1.000000) can0 123#00\n")
    terminal = pexpect.spawn(
        sys.executable, ["-m", "yieldmon.cli.main", "monitor", str(log)], env={**os.environ, "TERM": "dumb"}, encoding="utf-8"
    )
    terminal.expect(pexpect.EOF, timeout=60)
    said = " ".join(terminal.before.split())
    assert said == "yieldmon: TERM: is 'dumb', a terminal without screen control; expected `--once`, or another terminal"
    terminal.close()
    assert terminal.exitstatus == 2


@pytest.mark.parametrize(
    ("is_open", "state", "told"),
    [(False, "harvesting", True), (False, "sweeping", True), (True, "harvesting", False), (False, "not_harvesting", False)],
)
def test_grain_while_no_load_is_open_is_told(is_open: bool, state: str, told: bool) -> None:
    status = {**STATUS, "state": state, "load": {**STATUS["load"], "open": is_open}}
    shown = words(drawn(Cab(status, Units(), "", View(cab=True)), 80, 24))
    assert ("no load is open: grain counts only in the total; l, n starts one" in shown) is told


def pressed(keys: list[str], status: dict[str, Any] | None = STATUS) -> tuple[Dialog, list[dict[str, Any]]]:
    dialog = Dialog(mass, shipped_name, lambda: tuple(crops()))
    return dialog, [request for key in keys for request in dialog.press(key, status, Units())]


@pytest.mark.parametrize(
    ("keys", "sent"),
    [
        (["l", "n", "y"], [{"command": "load-start"}]),
        (["l", "s", "y"], [{"command": "load-stop"}]),
        (["l", "n", "n"], []),
        (["l", "x", "y"], []),
        (["z", "y"], [{"command": "zero"}]),
        (["z", "\r"], []),
        (["w", "y"], [{"command": "sweep-start"}]),
        ([*"t7 9.12t", "\r", "y"], [{"command": "ticket", "first_load": 7, "mass_kg": 9120.0}]),
        ([*"t7 8,1", "\r", "y"], []),
        ([*"t9120", "\r", "y"], []),
        ([*"t7 9.12t", "\x1b", "y"], []),
        (["t", "7", "8", "\x7f", *" 100lb", "\r", "y"], [{"command": "ticket", "first_load": 7, "mass_kg": 45.359237}]),
        (["x", "y"], []),
        (["x", "c", "\r", *"wheat", "\r", "y"], [{**CORRECT, "first_load": 5, "last_load": 5}]),
        (["x", "c", *"6", "\r", *"Winter Wheat", "\r", "y"], [CORRECT]),
        (["x", "c", "\r", *"wheat", "\r", "n"], []),
        (["x", "c", "\r", *"wheat", "\x1b", "y"], []),
        (["x", "c", "\r", "\r", "y"], []),
        (["x", "c", *"8", "\r", "y"], []),
        (["x", "c", *"-1", "\r", "y"], []),
        (["x", "c", *"7", "\r", *"wheat", "\r", "y"], [WHEAT, {**CORRECT, "first_load": 7, "last_load": 7}]),
        (["x", "n", *"wheat", "\r", "y"], [WHEAT]),
        (["x", "n", *"wheat", "\r", "\r"], []),
        (["x", "l", "y"], []),
    ],
)
def test_nothing_is_asked_of_the_daemon_without_a_yes(keys: list[str], sent: list[dict[str, Any]]) -> None:
    assert pressed(keys)[1] == sent


def test_each_step_of_a_wrong_crop_is_one_prompt_with_its_figures() -> None:
    """The load that is proposed is the last complete one with grain; load 6 has none."""
    known = " ".join(crops())
    dialog = Dialog(mass, shipped_name, lambda: tuple(crops()))
    shown = []
    for key in ("x", "c", *"7", "\r", *"quinoa", "\r", "n"):
        assert not dialog.press(key, STATUS, Units())
        if not key.isalnum() or key in "xcn":
            shown.append(dialog.prompt)
    assert shown[:3] == [
        "n: a new load of another crop, c: correct the crop of a load, Esc: neither",
        "number of the load whose crop is wrong (Enter: 5): _",
        f"crop of load 7 ({known}): _",
    ]
    assert shown[-2:] == [
        "load 7 is open and holds 8,432 kg: start load 8 of quinoa, and make load 7 quinoa too (not a crop that is known: it is "
        "only named)? y n",
        "nothing was done",
    ]


@pytest.mark.parametrize("key", ALL_KEYS)
def test_without_a_daemon_the_keys_say_so(key: str) -> None:
    dialog, sent = pressed([key, "y"], None)
    assert (dialog.prompt, sent) == (NO_DAEMON, [])


def test_a_sweep_under_way_is_ended() -> None:
    moving = {**STATUS, "sweep": {**STATUS["sweep"], "state": "measuring"}}
    assert pressed(["w", "y"], moving)[1] == [{"command": "sweep-abort"}]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.log"
    with writing(path) as logger:
        for k in range(100):
            signals = {"MassFlowRate": 12.0, "MassFlowStdDev": 0.3, "EstimateQuality": 0, "WindowCounter": k}
            logger.on_message_received(CODEC.encode(Frame(100.0 + 0.1 * k, frames.MASS_FLOW, signals)))
    return path


@pytest.mark.parametrize(("rows", "columns"), [(24, 80), (40, 120)])
def test_both_views_on_a_real_terminal(log: Path, rows: int, columns: int) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
    words = ["-m", "yieldmon", "monitor", str(log), "--speed", "0.5"]
    child = pexpect.spawn(
        sys.executable, words, dimensions=(rows, columns), env=environment | {"TERM": "xterm-256color"}, timeout=60
    )
    screen = pyte.Screen(columns, rows)
    stream = pyte.ByteStream(screen)

    def until(*texts: str) -> None:
        while any(text not in "\n".join(screen.display) for text in texts):
            child.expect(re.compile(rb".+", re.DOTALL))
            stream.feed(child.after)

    until("MassFlowRate", "WindowCounter")
    child.send("c")
    until("flow, ok, kg/s", "NO MONITOR ON THE BUS")
    child.send("u")
    until("flow, ok, lb/s")
    child.send("l")
    until(NO_DAEMON)
    child.send("q")
    child.expect(pexpect.EOF)
    child.close()
    assert child.exitstatus == 0
