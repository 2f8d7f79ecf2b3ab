"""The daemon as a whole: measures, remembers, obeys, and says what is wrong."""

from __future__ import annotations

import dataclasses
import errno
import os
import re
import socket
import sqlite3
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import can
import pytest

from tests.schema_check import problems
from tests.service.bench import (
    CODEC,
    EMPTY_MV,
    GRAIN_MV,
    PATIENCE_S,
    START_S,
    ZERO_MV,
    ask,
    encoded,
    messages,
    running,
    wait_for,
    warm_up,
)
from yieldmon import frames
from yieldmon.bus.receiver import Receiver
from yieldmon.cli import main as cli
from yieldmon.files import parameter_file
from yieldmon.files.crops import crop
from yieldmon.frames import EstimateQuality, Frame
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.operator.command_queue import CommandQueue, Job
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.writer import StoreWriter
from yieldmon.service.timeouts import Timeouts


def test_measures_publishes_and_stores(tmp_path):
    with running(tmp_path) as bench:
        warm_up(bench)
        status = bench.status
        wait_for(lambda: len(bench.published(frames.MASS_FLOW)) >= 19, "the last window's MassFlow")
        wait_for(lambda: len(bench.published(frames.ACCUMULATED_MASS)) >= 19, "the last window's AccumulatedMass")
        flows = bench.published(frames.MASS_FLOW)
        masses = bench.published(frames.ACCUMULATED_MASS)
    assert status["state"] == "harvesting"
    assert status["faults"] == []
    assert status["windows"][-1]["mass_flow_kg_s"] > 1.0
    assert [flow["WindowCounter"] for flow in flows] == list(range(1, len(flows) + 1))
    assert flows[5]["EstimateQuality"] == EstimateQuality.NOT_HARVESTING
    assert flows[18]["MassFlowRate"] == pytest.approx(status["windows"][-1]["mass_flow_kg_s"], abs=0.3)
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows = store.seconds()
        state = store.state()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    total_kg = sum(row.mass_kg for row in rows)
    assert rows[-1].total_kg == pytest.approx(total_kg, rel=1e-12)
    assert state["engine"]["totals"]["total_kg"] == rows[-1].total_kg
    assert masses[-1]["TotalMass"] == pytest.approx(rows[len(masses) - 1].total_kg, abs=0.05)


def test_goes_on_after_a_restart_where_it_stopped(tmp_path, caplog):
    caplog.set_level("INFO")
    with running(tmp_path) as bench:
        warm_up(bench)
    assert f"store {tmp_path / 'yieldmon.sqlite'}: new, the total begins at 0 kg" in caplog.text
    with Store(tmp_path / "yieldmon.sqlite") as store:
        before = store.last_second()
        state = store.state()
    with running(tmp_path, start_s=START_S + 60) as bench:
        total_kg = state["engine"]["totals"]["total_kg"]
        assert bench.status["total"]["mass_kg"] == total_kg
        assert f"goes on from {total_kg:.1f} kg, load 1" in caplog.text
        bench.play(4, GRAIN_MV)
        bench.played()
        assert bench.rows[-1]["mass_flow_kg_s"] > 1.0, "the zero is remembered"
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows = store.seconds()
        assert store.counters()["starts"] == 2
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert len(rows) > before.number
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg, rel=1e-12)
    totals = [row.total_kg for row in rows]
    assert totals == sorted(totals)


def test_faults_on_the_bus_in_status_and_in_the_store(tmp_path):
    with running(tmp_path) as bench:
        bench.play(4, EMPTY_MV)
        bench.now_s += 6.0
        bench.play(5, EMPTY_MV)
        bench.played()
        wait_for(lambda: any(s["SensorMissing"] for s in bench.published(frames.YIELD_MONITOR_STATUS)), "SensorMissing")
    with Store(tmp_path / "yieldmon.sqlite") as store:
        events = [(event.code, event.active) for event in store.faults()]
    assert ("SensorMissing", True) in events
    assert ("SensorMissing", False) in events


def test_a_silent_bus_is_reported(tmp_path):
    with running(tmp_path, "bus: {idle_after_s: 0.5}", silence_s=Timeouts().silence_s) as bench:
        wait_for(lambda: any(s["SensorMissing"] for s in bench.published(frames.YIELD_MONITOR_STATUS)), "SensorMissing")
        assert {flow["EstimateQuality"] for flow in bench.published(frames.MASS_FLOW)} == {EstimateQuality.NOT_AVAILABLE}


def test_our_frames_from_another_node_are_a_conflict(tmp_path):
    with running(tmp_path) as bench:
        bench.play(2, EMPTY_MV)
        # Said for three seconds of the machine's own time, in which a window has to close.
        while "OutputConflict" not in bench.faults:
            forged = Frame(bench.now_s, frames.ACCUMULATED_MASS, {"LoadMass": 1.0, "TotalMass": 2.0, "LoadNumber": 3})
            bench.peer.send(CODEC.encode(forged))
            bench.play(1, EMPTY_MV)
            bench.played()
            assert bench.now_s < START_S + 60
        assert bench.faults["OutputConflict"] == "AccumulatedMass from another node"
        wait_for(lambda: any(s["OutputConflict"] for s in bench.published(frames.YIELD_MONITOR_STATUS)[-1:]), "it on the bus")


BAD_FRAMES = [
    can.Message(arbitration_id=0x98FF1280 & 0x1FFFFFFF, data=b"\x01"),
    can.Message(arbitration_id=0x123, is_extended_id=False, data=b"12345678"),
    can.Message(arbitration_id=CODEC.layouts[frames.ELEVATOR_SPEED].frame_id, is_remote_frame=True, dlc=8),
    *(can.Message(arbitration_id=CODEC.layouts[name].frame_id, data=b"\x00" * 3) for name in frames.INPUTS),
    *(can.Message(arbitration_id=CODEC.layouts[name].frame_id, data=b"\xff" * 8) for name in frames.INPUTS),
    *(can.Message(arbitration_id=CODEC.layouts[name].frame_id, data=b"\xfe" * 8) for name in frames.INPUTS),
]


def test_bad_frames_are_counted_and_stop_nothing(tmp_path):
    with running(tmp_path) as bench:
        bench.play(2, EMPTY_MV)
        for message in BAD_FRAMES:
            message.timestamp = bench.now_s
            bench.peer.send(message)
        bench.play(3, EMPTY_MV)
        bench.played()
        assert bench.status["bus"]["malformed"] == len(frames.INPUTS)


def test_store_failing_is_a_fault_and_measuring_goes_on(tmp_path):
    with running(tmp_path, retry_s=0.05) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "the first seconds in the store")
        blocker = sqlite3.connect(tmp_path / "yieldmon.sqlite", isolation_level=None)
        blocker.execute("BEGIN IMMEDIATE")
        bench.play(2, EMPTY_MV)
        wait_for(lambda: bench.daemon.writer.health().failing, "the disk's failing to be noticed")
        bench.play(4, EMPTY_MV)
        wait_for(lambda: "StoreFailing" in bench.faults, "StoreFailing")
        assert "locked" in bench.faults["StoreFailing"]
        wait_for(lambda: any(s["StoreFailing"] for s in bench.published(frames.YIELD_MONITOR_STATUS)[-1:]), "it on the bus")
        blocker.execute("ROLLBACK")
        blocker.close()
        wait_for(lambda: not bench.daemon.writer.health().failing, "the store's recovery")
        bench.play(6, EMPTY_MV)
        bench.played()
        assert "StoreFailing" not in bench.faults
    with Store(tmp_path / "yieldmon.sqlite") as store:
        numbers = [row.number for row in store.seconds()]
        events = [(event.code, event.active) for event in store.faults() if event.code == "StoreFailing"]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= 14
    assert events == [("StoreFailing", True), ("StoreFailing", False)]


def test_a_stop_writes_everything_whatever_cannot_be_taken_away(tmp_path, monkeypatch):
    names = ("yieldmon.sock", "metrics.prom")
    with running(tmp_path, "bus: {transmit_max_age_s: 60}\nstatus: {prometheus_file: metrics.prom}") as bench:
        wait_for((tmp_path / names[1]).exists, "metrics")
        for name in names:
            (tmp_path / name).unlink()
            (tmp_path / name).mkdir()
        bench.play(3, EMPTY_MV)
        bench.played()
        last = bench.rows[-1]["number"]
    with Store(tmp_path / "yieldmon.sqlite") as store:
        assert store.last_second().number >= last
        assert store.counters()["starts"] == 1


def test_a_command_that_was_not_answered_is_not_carried_out_later():
    """The operator gives it again after this answer."""
    queued = CommandQueue(timeout_s=0.01)
    with pytest.raises(ControlError, match="did not answer in time; nothing was done"):
        queued.ask({"command": "load-start"})
    assert list(queued.take()) == []


def test_a_command_that_the_engine_has_begun_is_not_waited_for_without_end() -> None:
    """Whoever asked is told that it may be done; an answer that never came would keep another's place."""
    begun: list[Job] = []
    queued = CommandQueue(timeout_s=0.01, wake=lambda: begun.extend(queued.take()))
    with pytest.raises(ControlError, match="it may still be done: check `yieldmon status`"):
        queued.ask({"command": "load-start"})
    assert [job.request for job in begun] == [{"command": "load-start"}]


def test_a_command_is_not_carried_out_once_who_asked_has_gone(tmp_path: Path) -> None:
    """The disk has held the reading of the store up for as long as a client waits, who gives the command again."""
    with running(tmp_path, answer_s=Timeouts().written_s) as bench:
        before = bench.daemon.monitor.totals.load_number
        with pytest.raises(ControlError, match="reading the store took too long; nothing was done"):
            bench.daemon.command({"command": "load-start"})
        assert bench.daemon.monitor.totals.load_number == before


def test_a_command_ends_the_wait_for_frames(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a quiet bus, whose silence the daemon otherwise listens to for 50 ms more."""
    asked: list[str] = []
    wake = Receiver.wake

    def woken(receiver: Receiver) -> None:
        asked.append("woken")
        wake(receiver)

    monkeypatch.setattr(Receiver, "wake", woken)
    with running(tmp_path) as bench:
        before = len(asked)
        ask(tmp_path, capsys, "zero")
        assert len(asked) == before + 1
        assert bench.daemon.receiver.alive


def test_names_are_shown_as_they_were_given(tmp_path, capsys):
    name = "[/north] [bold] :corn:"
    with running(tmp_path) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        for words in (["load", "start", "--field", name, "--crop", "oats"], ["status"], ["load", "list"]):
            assert cli.main([*words, "--socket", str(tmp_path / "yieldmon.sock")]) == 0
            assert set(name.split()) <= set(capsys.readouterr().out.split())


def test_a_slow_disk_is_a_fault_until_it_has_caught_up(tmp_path, monkeypatch):
    gate, late_s = threading.Event(), [0.0]
    gate.set()
    commit = Store.commit

    def slow(store, batches):
        assert gate.wait(PATIENCE_S)
        commit(store, batches)

    monkeypatch.setattr(Store, "commit", slow)
    monkeypatch.setattr("yieldmon.service.storage.writer.monotonic", lambda: time.monotonic() + late_s[0])
    with running(tmp_path) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "the seconds so far on the disk")
        gate.clear()
        bench.play(3, EMPTY_MV)
        bench.played()
        assert "StoreFailing" not in bench.faults
        late_s[0] = 11.0
        # Seen between two rounds, shown by the window after.
        for _ in range(2):
            bench.play(2, EMPTY_MV)
            bench.played()
        assert re.fullmatch(r"the disk is slow, (1 second|\d+ seconds) waiting", bench.faults["StoreFailing"])
        gate.set()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "the disk to catch up")
        bench.play(6, EMPTY_MV)
        bench.played()
        assert "StoreFailing" not in bench.faults


DAY_S = 86400.0


def calibrated(path: Path, days_ago: float) -> None:
    """The shipped parameters as if they had been found so long ago."""
    shipped = parameter_file.load()
    date = datetime.fromtimestamp(time.time() - days_ago * DAY_S, UTC).isoformat()
    parameter_file.save(dataclasses.replace(shipped, provenance={"date": date}), path)


def test_the_age_of_the_calibration_goes_on_over_restarts_and_reloads(tmp_path, monkeypatch):
    text, played_s = "parameter_file: p.yaml\nbus: {transmit_max_age_s: 60}", 45
    now, later_s = time.time, [0.0]
    monkeypatch.setattr("time.time", lambda: now() + later_s[0])

    def age_s(bench) -> float:
        return bench.status["parameters"]["age_s"]

    calibrated(tmp_path / "p.yaml", days_ago=10)
    with running(tmp_path, text) as bench:
        assert age_s(bench) == pytest.approx(10 * DAY_S, abs=PATIENCE_S)
        bench.play(played_s, EMPTY_MV)
        bench.played()
    aged_s = 10 * DAY_S + played_s
    later_s[0] = DAY_S
    with running(tmp_path, text) as bench:
        assert age_s(bench) == pytest.approx(aged_s + DAY_S, abs=PATIENCE_S), "it was off for a day"
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"] == "taken", "the reload")
        assert age_s(bench) == pytest.approx(aged_s + DAY_S, abs=PATIENCE_S), "the same file changes nothing"
    later_s[0] = 0.0
    with running(tmp_path, text) as bench:
        assert age_s(bench) == pytest.approx(aged_s + DAY_S, abs=PATIENCE_S), "a clock set back makes nothing younger"
        calibrated(tmp_path / "p.yaml", days_ago=3)
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"] == "taken", "the reload")
        assert age_s(bench) == pytest.approx(3 * DAY_S, abs=PATIENCE_S), "another file has an age of its own"
    calibrated(tmp_path / "p.yaml", days_ago=5)
    with running(tmp_path, text) as bench:
        assert age_s(bench) == pytest.approx(5 * DAY_S, abs=PATIENCE_S), "the same at a start"


def test_damaged_store_is_set_aside_and_said(tmp_path):
    (tmp_path / "yieldmon.sqlite").write_bytes(b"SQLite format 3\x00" + b"\xaa" * 5000)
    with running(tmp_path) as bench:
        bench.play(4, EMPTY_MV)
        bench.played()
        assert "set aside" in bench.status["store"]["note"]
        assert "StoreFailing" in bench.faults
    assert len(list(tmp_path.glob("yieldmon.sqlite.damaged-*"))) == 1
    with Store(tmp_path / "yieldmon.sqlite") as store:
        assert len(store.seconds()) >= 3


def test_a_reload_that_cannot_read_its_file_this_time_ends_nothing(tmp_path, monkeypatch):
    with running(tmp_path) as bench:

        def read(*_: object) -> None:
            raise OSError(errno.EIO, os.strerror(errno.EIO), "c.yaml")

        monkeypatch.setattr(configuration, "load", read)
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"].startswith("refused"), "the refusal")
        assert "Input/output error" in bench.status["configuration"]["reload"]
        bench.play(3, 0.0)
        bench.played()


def test_a_store_that_is_opened_again_after_a_reload_is_the_one_of_the_start(tmp_path):
    with running(tmp_path) as bench:
        bench.play(14, EMPTY_MV)
        bench.play(3, GRAIN_MV)
        bench.played()
        (tmp_path / "c.yaml").write_text("bus: {channel: other}\nstore: {path: other.sqlite}\nunits: us")
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reloads"] == 1, "the reload")
        assert bench.status["configuration"]["reload"] == "taken; bus, store will be taken at the next start"
        assert bench.status["units"] == "us"
        assert bench.daemon.writer.wait_until_written(PATIENCE_S)
        # Files that are removed in use are written anew, and opened.
        for file in tmp_path.glob("yieldmon.sqlite*"):
            if not file.name.endswith(".lock"):
                file.unlink()
        bench.play(3, GRAIN_MV)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().replacements == 1, "the replacement")
        bench.play(3, GRAIN_MV)
        bench.played()
        assert bench.status["store"]["file"] == str(tmp_path / "yieldmon.sqlite")
    assert not (tmp_path / "other.sqlite").exists()
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows = store.seconds()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))


def test_no_commit_names_a_parameter_file_without_its_parameters(tmp_path, monkeypatch):
    """A power cut between two commits would leave the start after it with what was learnt before the file."""
    batches, submit = [], StoreWriter.submit
    monkeypatch.setattr(StoreWriter, "submit", lambda writer, batch: (batches.append(batch), submit(writer, batch)))
    known = parameter_file.load()
    other = dataclasses.replace(known, values={**known.values, "friction": 0.9 * known.values["friction"]})
    parameter_file.save(other, tmp_path / "other.yaml")
    with running(tmp_path) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        (tmp_path / "c.yaml").write_text("parameter_file: other.yaml")
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reloads"] == 1, "the reload")
        bench.play(3, EMPTY_MV)
        bench.played()
    first = next(n for n, batch in enumerate(batches) if batch.state["parameter_digest"] == parameter_file.digest(other))
    assert [version.version for batch in batches[: first + 1] for version in batch.parameter_versions] == [1, 2]


def test_what_is_answered_is_in_the_store(tmp_path, monkeypatch):
    gate, commit = threading.Event(), Store.commit

    def slow(store, batches):
        assert gate.wait(PATIENCE_S)
        commit(store, batches)

    with running(tmp_path, written_s=PATIENCE_S) as bench:
        bench.play(2, EMPTY_MV)
        bench.played()
        assert bench.daemon.writer.wait_until_written(PATIENCE_S)
        monkeypatch.setattr(Store, "commit", slow)
        asking = threading.Thread(target=bench.daemon.command, args=({"command": "load-start", "field": "north"},))
        asking.start()
        wait_for(lambda: bench.status["load"]["number"] == 2, "the load")
        assert bench.daemon.command({"command": "loads"})["loads"], "questions wait for nothing"
        assert asking.is_alive(), "no answer before the disk has it"
        gate.set()
        asking.join(PATIENCE_S)
        with Store.reading(tmp_path / "yieldmon.sqlite") as store:
            assert [load.field for load in store.loads()] == ["", "north"]


def test_reload_takes_a_good_configuration_and_refuses_a_bad_one(tmp_path):
    with running(tmp_path) as bench:
        warm_up(bench)
        before = bench.status
        (tmp_path / "c.yaml").write_text("sweep: {interval_s: 7200}\nstore: {size_mb: 64}\nbus: {transmit_max_age_s: 60}")
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"].startswith("taken"), "the reload")
        assert bench.status["configuration"]["reload"] == "taken; store will be taken at the next start"
        assert bench.daemon.monitor.settings.sweep.interval_s == 7200.0
        bench.play(3, GRAIN_MV)
        bench.played()
        after = bench.status
        assert after["total"]["mass_kg"] > before["total"]["mass_kg"]
        assert after["windows"][-1]["mass_flow_kg_s"] > 1.0, "the zero goes on"
        (tmp_path / "c.yaml").write_text("sweep: {interval_s: 1}")
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"].startswith("refused"), "the refusal")
        assert "sweep.interval_s: 1; expected a number" in bench.status["configuration"]["reload"]
        assert bench.daemon.monitor.settings.sweep.interval_s == 7200.0


def test_a_reload_says_that_its_parameters_are_of_another_crop_than_the_load(tmp_path):
    with running(tmp_path) as bench:
        warm_up(bench)
        bench.daemon.command({"command": "load-start", "crop": "wheat"})
        parameter_file.save(crop("corn").parameters(), tmp_path / "p.yaml")
        (tmp_path / "c.yaml").write_text("parameter_file: p.yaml\nbus: {transmit_max_age_s: 60}")
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reload"].startswith("taken"), "the reload")
        said = "the parameters are of corn, the load is of wheat: `yieldmon load start --crop wheat` uses those of wheat"
        assert bench.status["configuration"]["reload"] == f"taken; {said}"


def test_what_waits_for_a_start_is_reported_against_what_this_one_began_with(tmp_path):
    with running(tmp_path) as bench:
        texts = (
            "store: {size_mb: 64}\nbus: {transmit_max_age_s: 60}",
            "bus: {transmit_max_age_s: 60}",
            "bus: {transmit_max_age_s: 9}",
        )
        answers = []
        for number, text in enumerate((texts[0], texts[0], texts[1], texts[2]), start=1):
            (tmp_path / "c.yaml").write_text(text)
            bench.daemon.request_reload()
            wait_for(lambda number=number: bench.status["configuration"]["reloads"] == number, "the reload")
            answers.append(bench.status["configuration"]["reload"])
        assert answers == ["taken; store will be taken at the next start"] * 2 + [
            "taken",
            "taken; bus will be taken at the next start",
        ]


def test_an_interface_that_goes_and_comes_back(tmp_path):
    with running(tmp_path) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        lost = bench.daemon.receiver.bus
        assert lost is not None
        lost.shutdown()
        wait_for(lambda: bench.daemon.receiver.counters().interface_losses == 1, "the loss")
        wait_for(lambda: bench.daemon.receiver.bus not in (None, lost), "the return")
        bench.play(3, EMPTY_MV)
        bench.played()
        with suppress(IndexError):
            assert bench.rows[-1]["coverage"] == 1.0


def test_an_empty_load_is_counted_and_not_listed(tmp_path, capsys):
    with running(tmp_path) as bench:
        bench.play(6, GRAIN_MV)
        warm_up(bench)
        for _ in range(2):
            ask(tmp_path, capsys, "load", "start")
        found = ask(tmp_path, capsys, "load", "list")
        assert ([load["number"] for load in found["loads"]], found["empty_loads"]) == ([1, 3], [2])
        assert [load["number"] for load in bench.status["loads"]] == [1, 3]
        whole = ask(tmp_path, capsys, "load", "list", "--all")
        assert ([load["number"] for load in whole["loads"]], whole["empty_loads"]) == ([1, 2, 3], [2])
        for words, said in (([], "yieldmon: 1 empty load not listed; --all lists it\n"), (["--all"], ""), (["--sums"], "")):
            assert cli.main(["load", "list", *words, "--socket", str(tmp_path / "yieldmon.sock")]) == 0
            assert capsys.readouterr().err == said
        with Store.reading(tmp_path / "yieldmon.sqlite") as store:
            assert [load.number for load in store.loads()] == [1, 2, 3]
        bench.play(5, GRAIN_MV)
        bench.played()
        ask(tmp_path, capsys, "load", "stop")
        kg = ask(tmp_path, capsys, "load", "list")["loads"][-1]["mass_kg"]
        for words in (["2-3", f"{kg}kg"], ["3", f"{kg}kg"]):
            entered = ask(tmp_path, capsys, "ticket", *words)
        assert (entered["replaces"], entered["without_ticket"]) == ([1], []), "there is nothing to weigh of load 2"


def test_loads_tickets_and_names(tmp_path, capsys):
    with running(tmp_path) as bench:
        bench.play(6, GRAIN_MV)
        warm_up(bench)
        answer = ask(tmp_path, capsys, "load", "start", "--field", "north", "--crop", "corn")
        parameters = {"crop": None, "version": 1, "changed": False, "carried_from": ""}
        known = {"parameters": parameters, "crop_known": True, "units": "metric"}
        assert answer == {"load": 2, "field": "north", "crop": "corn", **known}
        bench.play(5, GRAIN_MV)
        bench.played()
        assert ask(tmp_path, capsys, "load", "stop")["load"] == 2
        loads = ask(tmp_path, capsys, "load", "list")["loads"]
        assert [(load["number"], load["field"]) for load in loads] == [(1, ""), (2, "north")]
        weighed = 1.02 * (loads[0]["mass_kg"] + loads[1]["mass_kg"])
        ticket = ask(tmp_path, capsys, "ticket", "1-2", f"{weighed}kg", "--note", "elevator 3")
        assert ticket["factor"] == pytest.approx(1.02)
        assert ticket["is_reference"] is False, "load 1 began in grain, before there was a zero"
        first = ask(tmp_path, capsys, "load", "list")["loads"][0]
        assert first["corrected_mass_kg"] == pytest.approx(1.02 * loads[0]["mass_kg"])
        second = ask(tmp_path, capsys, "ticket", "2", f"{1.02 * loads[1]['mass_kg']}kg")
        assert (second["is_reference"], second["without_ticket"]) == (True, [1])
        assert [mass.load_number for mass in bench.daemon.monitor.reference_masses] == [2]
        after = ask(tmp_path, capsys, "load", "list")["loads"]
        assert [load["mass_kg"] for load in after] == [load["mass_kg"] for load in loads]
        assert [load["ticket_id"] for load in after] == [None, 2]
        assert after[1]["corrected_mass_kg"] == pytest.approx(1.02 * loads[1]["mass_kg"])
        total_before = bench.status["total"]["mass_kg"]
    with running(tmp_path, start_s=START_S + 100) as bench:
        kept = ask(tmp_path, capsys, "load", "list")["loads"]
        assert [load["corrected_mass_kg"] for load in kept] == [load["corrected_mass_kg"] for load in after]
        assert bench.status["total"]["mass_kg"] == pytest.approx(total_before)
        assert bench.status["load"]["open"] is False
        again = ask(tmp_path, capsys, "ticket", "1", "50kg")
        assert (again["is_reference"], again["why_no_reference"]) == (False, "not every second of it was measured")
    with Store(tmp_path / "yieldmon.sqlite") as store:
        assert [ticket.note for ticket in store.tickets()] == ["elevator 3", "", ""]
        rows = store.corrected_loads()
    assert rows[0]["corrected_mass_kg"] == pytest.approx(50.0)


REFUSED = [
    (["ticket", "9", "100kg"], "ticket for load 9: no such load"),
    (["load", "start", "--field", "a\nb"], "field: 'a\\nb'; expected a name"),
]


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_what_cannot_be_done_is_one_line(tmp_path, capsys, words, message):
    with running(tmp_path), pytest.raises(SystemExit) as caught:
        cli.main([*words, "--socket", str(tmp_path / "yieldmon.sock")])
    assert caught.value.code == 1
    assert message in capsys.readouterr().err


def test_zero_and_sweep_commands_reach_the_engine(tmp_path, capsys):
    socket_path = str(tmp_path / "yieldmon.sock")
    with running(tmp_path) as bench:
        warm_up(bench)
        capsys.readouterr()
        assert cli.main(["sweep", "start", "--socket", socket_path]) == 0
        conditions = "a flow of at least 4 kg/s and the elevator speed are steady for 8 s with the plate at home"
        assert capsys.readouterr().out == f"a sweep begins as soon as {conditions}\n"
        bench.play(1.5, GRAIN_MV)
        wait_for(lambda: bench.status["sweep"]["state"] == "waiting", "the sweep to wait for steady flow")
        # It was asked for: when the schedule's next one comes is not when it begins.
        assert cli.main(["status", "--socket", socket_path]) == 0
        rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("sweep ")]
        assert rows[0].split(maxsplit=1)[1].startswith("waiting for steady flow and elevator speed")
        for said in ("sweep ended\n", "sweep is not under way\n"):
            capsys.readouterr()
            assert cli.main(["sweep", "abort", "--socket", socket_path]) == 0
            assert capsys.readouterr().out == said
        assert cli.main(["zero", "--force", "--socket", socket_path]) == 0
        bench.play(1.5, EMPTY_MV)
        wait_for(lambda: bench.status["state"] == "zeroing", "zeroing")


def test_status_is_readable_and_complete(tmp_path, capsys):
    with running(tmp_path) as bench:
        warm_up(bench)
        status = ask(tmp_path, capsys, "status")
        assert problems(status, "status") == []
        assert cli.main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
        text = capsys.readouterr().out
        assert (tmp_path / "yieldmon.sock").stat().st_mode & 0o777 == 0o600
    assert status["zero_mv"] == pytest.approx(ZERO_MV, abs=1.0)
    assert status["store"]["failing"] is None
    assert set(status["parameters"]["values"]) >= {"friction", "density"}
    rows = dict(re.findall(r"^([a-z]+) {2,}(\S.*?) *$", text, re.M))
    assert list(rows) == ["state", "now", "load", "total", "sweep", "parameters", "bus", "store", "configuration"]
    assert rows["state"].startswith("harvesting, running for ")
    assert re.fullmatch(r"\d\.\d\d kg/s ± \d\.\d\d kg/s \(ok\), moisture 15\.5 %", rows["now"])
    assert re.fullmatch(r"1: \S+ kg ± \S+ kg wet, \S+ kg dry, at 15\.5 % moisture", rows["load"])
    assert re.search(r"shape_ratio\s+2,", text)
    assert "no faults" in text


def test_the_yield_shown_is_of_seconds_that_have_a_flow(tmp_path):
    machine = shipped("config/machines/sprocket-8.yaml").read_text()
    (tmp_path / "m.yaml").write_text(f"{machine}\nimplement: {{working_width_m: 9.1}}\n")
    with running(tmp_path, "bus: {transmit_max_age_s: 60}\nmachine_file: m.yaml\n") as bench:

        def play(seconds: int, force_mv: float, **without: bool) -> None:
            for _ in range(10 * seconds):
                driven = {"CompassBearing": 0.0, "NavigationSpeed": 6.0}
                bench.peer.send(encoded(Frame(bench.now_s, frames.VEHICLE_DIRECTION_SPEED, driven)))
                for message in messages(bench.now_s, 0.1, force_mv):
                    if not (without and CODEC.decode(message).message == frames.IMPACT_SENSOR_SAMPLES):
                        bench.peer.send(message)
                bench.now_s += 0.1

        play(14, EMPTY_MV)
        play(12, GRAIN_MV)
        bench.played()
        usual = bench.status["now"]["yield_kg_m2"]
        assert usual > 0.1
        play(3, GRAIN_MV, sensor=False)
        bench.played()
        assert (bench.rows[-1]["quality"], bench.status["now"]["yield_kg_m2"]) == ("not_available", None)
        play(5, GRAIN_MV)
        bench.played()
        assert bench.status["now"]["yield_kg_m2"] == pytest.approx(usual, rel=0.05)


def test_status_without_a_daemon_is_one_line(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["status", "--socket", str(tmp_path / "none.sock")])
    assert caught.value.code == 1
    assert capsys.readouterr().err.endswith("no daemon answers there; is the service running? (`systemctl status yieldmon`)\n")


def test_the_service_manager_is_notified(tmp_path):
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.settimeout(0.2)
    reported = []

    def listen() -> list[str]:
        with suppress(TimeoutError):
            while True:
                reported.append(manager.recv(4096).decode().partition("\n")[0])
        return reported

    with running(tmp_path, notify=manager) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        windows = bench.status["windows"][-1]["number"]
        wait_for(lambda: listen().count("WATCHDOG=1") >= windows, "the watchdog's food")
        bench.daemon.request_reload()
        wait_for(lambda: "RELOADING=1" in listen(), "the reload")
    listen()
    manager.close()
    order = [line for line in reported if line in ("READY=1", "RELOADING=1", "STOPPING=1")]
    assert order == ["READY=1", "RELOADING=1", "READY=1", "STOPPING=1"]
    assert reported.count("WATCHDOG=1") <= windows + 2, "fed by windows, not by a timer"


def test_metrics_file_is_written_and_taken_away(tmp_path, request):
    """Readable by the collector, another user, whatever the unit's umask; in the runtime folder, which others may enter."""
    umask = os.umask(0o077)
    request.addfinalizer(lambda: os.umask(umask))
    text = "status: {prometheus_file: metrics.prom, prometheus_interval_s: 1}"
    with running(tmp_path, text) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        path = tmp_path / "metrics.prom"
        wait_for(lambda: path.exists() and "yieldmon_frames_received_total" in path.read_text(), "metrics")
        lines = path.read_text().splitlines()
        assert 'yieldmon_fault{code="SensorMissing"} 0' in lines
        assert path.stat().st_mode & 0o777 == 0o644
    assert not path.exists()


@pytest.mark.parametrize("part", ["batch", "take"], ids=["at the commit", "at the window"])
def test_an_error_in_the_journal_ends_the_process(tmp_path, monkeypatch, part):
    """The service manager can start another one, but cannot see a process that lives and does nothing."""

    def fail(*_: object) -> None:
        raise ZeroDivisionError("journal")

    with pytest.raises(ZeroDivisionError), running(tmp_path) as bench:  # noqa: PT012 - the end is what is looked at
        bench.play(2, 0.0)
        bench.played()
        monkeypatch.setattr(Journal, part, fail)
        bench.play(2, 0.0)
        wait_for(lambda: bench.failure, "the daemon's end")
        assert bench.thread is not None
        bench.thread.join(60.0)
        assert not bench.thread.is_alive()
        left = {thread.name for thread in threading.enumerate()}
        assert left.isdisjoint({"can-receiver", "can-transmitter", "store-writer", "control"})


def test_no_sweep_is_due_where_none_comes_by_schedule(tmp_path):
    with running(tmp_path, "bus: {transmit_max_age_s: 60}\nsweep: {enabled: false}") as bench:
        bench.play(2.0, 0.0)
        bench.played()
        assert bench.status["sweep"]["due_in_s"] is None
