"""Limits that nothing else would notice missing: each test fails for one small change of the code."""

from __future__ import annotations

import json
import socket
import sqlite3
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from tests.service.bench import CODEC, PATIENCE_S, START_S, running, traffic, wait_for
from tests.service.test_store import batch, second
from yieldmon import frames
from yieldmon.bus.receiver import BusEvent, BusEventKind
from yieldmon.engine.faults import FaultCode
from yieldmon.service.operator import control
from yieldmon.service.operator.control import ControlServer, Pace
from yieldmon.service.operator.control_client import ask
from yieldmon.service.storage.batch import Batch, Load
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreDamagedError, StoreError
from yieldmon.service.storage.writer import StoreHealth, StoreWriter
from yieldmon.service.traffic.service_faults import ServiceFaults
from yieldmon.service.traffic.transmit import TransmitCounters


def bus_error_at(faults: ServiceFaults, now_s: float) -> str:
    """What is said of the bus then, where nothing else is wrong."""
    faults.report_all_anew()
    found = faults.changes(
        now_s, sent=TransmitCounters(), hangs_s={"receive": 0.0}, store=StoreHealth(), store_note="", network=()
    )
    assert set(found) <= {FaultCode.BUS_ERROR}
    return found.get(FaultCode.BUS_ERROR, "")


def test_bus_off_lasts_until_the_restart_and_then_ends():
    faults = ServiceFaults()
    faults.bus_event(BusEvent(BusEventKind.BUS_OFF, 0.0), 1000.0)
    assert "bus off" in bus_error_at(faults, 9000.0)
    faults.bus_event(BusEvent(BusEventKind.BUS_RESTARTED, 0.0), 9000.0)
    assert "bus restarted" in bus_error_at(faults, 9001.0)
    assert bus_error_at(faults, 9010.0) == ""


def test_a_restart_does_not_hide_the_bus_off_behind_it():
    faults = ServiceFaults()
    faults.bus_event(BusEvent(BusEventKind.BUS_RESTARTED, 0.0), 1000.0)
    faults.bus_event(BusEvent(BusEventKind.BUS_OFF, 0.0), 1000.0)
    assert "bus off" in bus_error_at(faults, 1e9)


def test_an_interface_that_is_back_takes_its_bus_off_along():
    faults = ServiceFaults()
    faults.bus_event(BusEvent(BusEventKind.BUS_OFF, 0.0), 1000.0)
    faults.bus_event(BusEvent(BusEventKind.INTERFACE_LOST, 0.0), 1000.0)
    assert "interface lost" in bus_error_at(faults, 5000.0)
    faults.bus_event(BusEvent(BusEventKind.INTERFACE_RESTORED, 0.0), 5000.0)
    assert bus_error_at(faults, 5010.0) == ""


def test_a_fault_is_reported_once_and_again_to_another_monitor():
    faults = ServiceFaults()
    how = {"sent": TransmitCounters(), "hangs_s": {}, "store": StoreHealth(), "store_note": "provoked"}
    assert faults.changes(0.0, **how, network=["cannot claim"]) == {
        FaultCode.STORE_FAILING: "provoked",
        FaultCode.NETWORK_FAULT: "cannot claim",
    }
    assert faults.changes(1.0, **how, network=["cannot claim"]) == {}
    assert faults.changes(2.0, **how, network=[]) == {FaultCode.NETWORK_FAULT: ""}
    faults.report_all_anew()
    assert faults.changes(3.0, **how, network=[]) == {FaultCode.STORE_FAILING: "provoked"}


def test_a_fault_that_lasts_is_reported_to_the_monitor_of_a_reload(tmp_path: Path):
    (tmp_path / "yieldmon.sqlite").write_bytes(b"SQLite format 3\x00" + b"\xaa" * 5000)
    with running(tmp_path) as bench:
        bench.play(3, 0.0)
        bench.played()
        # Shown with the first window that closes after the daemon has looked at its store.
        while "StoreFailing" not in bench.faults:
            bench.play(1, 0.0)
            bench.played()
            assert bench.now_s < START_S + 30
        bench.daemon.request_reload()
        wait_for(lambda: bench.status["configuration"]["reloads"] == 1, "the reload")
        bench.play(4, 0.0)
        bench.played()
        assert "set aside" in bench.faults["StoreFailing"]


@pytest.mark.parametrize("capacity", [1, 2])
def test_the_newest_counters_are_kept_when_records_are_given_up(tmp_path: Path, capacity: int):
    def refuse() -> Store:
        raise StoreError("no disk")

    openings = [refuse]

    def open_store() -> Store:
        return openings[-1]()

    writer = StoreWriter(open_store, capacity)
    for number in range(1, 11):
        writer.submit(batch(number, counters={"frames": number}))
    openings.append(lambda: Store(tmp_path / "s"))
    assert writer.work()
    writer.close()
    with Store(tmp_path / "s") as store:
        assert store.counters() == {"frames": 10}


def test_room_is_made_a_little_at_a_time(tmp_path: Path):
    with Store(tmp_path / "s", Retention(record_hours=1.0 / 3600.0)) as store:
        store.commit([Batch(1, 1.0, {}, seconds=tuple(second(n) for n in range(1, 5001)))])
        gone = []
        while (count := store.prune()) and len(gone) < 10:
            gone.append(count)
    assert sum(gone) == 4999
    assert max(gone) <= 2000


@pytest.mark.parametrize("table", ["load", "counter", "state", "parameter_set", "ticket", "mark", "fault", "sweep"])
def test_every_small_table_is_looked_at_when_a_store_is_opened(tmp_path: Path, table: str):
    path = tmp_path / "s"
    with Store(path) as store:
        store.commit([batch(1, counters={"a": 1})])
    database = sqlite3.connect(path)
    (root,) = database.execute("SELECT rootpage FROM sqlite_schema WHERE name = ?", (table,)).fetchone()
    database.close()
    content = bytearray(path.read_bytes())
    content[(root - 1) * 4096 : (root - 1) * 4096 + 12] = b"\x55" * 12
    path.write_bytes(content)
    with pytest.raises(StoreDamagedError):
        Store(path)


def test_loads_that_are_out_of_order_are_found_when_a_store_is_opened(tmp_path: Path):
    """Each row is as it was written, and an update by number would go astray: the key of an inner page is wrong."""
    path = tmp_path / "s"
    with Store(path) as store:
        store.commit([Batch(1, 1.0, {}, loads=tuple(Load(n, "f", "corn", 1.0, 2.0, 10.0, None) for n in range(1, 400)))])
    database = sqlite3.connect(path)
    (root,) = database.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'load'").fetchone()
    database.close()
    content = bytearray(path.read_bytes())
    page = (root - 1) * 4096
    assert content[page] == 5, "an inner page"
    cell = page + int.from_bytes(content[page + 12 : page + 14], "big")
    # A child's number in four bytes, then the largest key below it, seven bits a byte.
    key = cell + 4
    while content[key] & 0x80:
        key += 1
    content[key] -= 5
    path.write_bytes(content)
    with pytest.raises(StoreDamagedError):
        Store(path)


def test_a_peer_that_dribbles_its_request_is_cut_off_after_the_whole_time(tmp_path: Path, monkeypatch):
    """A byte now and then does not begin the time anew."""
    now_s = [0.0]
    monkeypatch.setattr(control, "monotonic", lambda: now_s[0])
    server = ControlServer(tmp_path / "s.sock", None, lambda request: {"fine": True})
    server.start()
    with socket.socket(socket.AF_UNIX) as peer:
        peer.settimeout(PATIENCE_S)
        peer.connect(str(tmp_path / "s.sock"))
        peer.sendall(b"{")
        # Connections are taken in their order: with the next one answered this one's time has begun.
        assert ask(tmp_path / "s.sock", {"command": "status"}) == {"fine": True}
        now_s[0] = 4.0
        peer.sendall(b'"')
        now_s[0] = 6.0
        said = b""
        # Where the server had not read the last byte, the end comes as a reset.
        with suppress(ConnectionResetError):
            while more := peer.recv(4096):
                said += more
        assert b"no line feed in 5 s" in said
    server.stop()


def test_peers_that_ask_nothing_leave_room_for_others_and_take_no_threads(tmp_path: Path):
    server = ControlServer(tmp_path / "s.sock", None, lambda request: {"fine": True}, pace=Pace(crowded_pause_s=0.001))
    server.start()
    before = threading.active_count()
    peers = [socket.socket(socket.AF_UNIX) for _ in range(150)]
    for peer in peers:
        peer.connect(str(tmp_path / "s.sock"))
    assert ask(tmp_path / "s.sock", {"command": "status"}) == {"fine": True}
    assert threading.active_count() <= before + 1
    for peer in peers:
        peer.close()
    server.stop()


def test_a_request_has_64_kib_at_most(tmp_path: Path):
    server = ControlServer(tmp_path / "s.sock", None, lambda request: {"fine": True})
    server.start()
    try:
        for size, fine in ((60_000, True), (200_000, False)):
            with socket.socket(socket.AF_UNIX) as peer:
                peer.settimeout(PATIENCE_S)
                peer.connect(str(tmp_path / "s.sock"))
                try:
                    peer.sendall(json.dumps({"command": "x", "pad": "y" * size}).encode() + b"\n")
                    answer = json.loads(peer.makefile("rb").readline() or b'{"ok": false}')
                except (ConnectionError, BrokenPipeError):
                    answer = {"ok": False}
                assert answer["ok"] is fine
    finally:
        server.stop()


def test_a_speed_that_falls_silent_is_missing_after_a_second_and_a_bit(tmp_path: Path):
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.play(4, 60.0)
        bench.played()
        silent_s = bench.now_s
        for frame in traffic(silent_s, 4.0, 60.0):
            if frame.message != frames.ELEVATOR_SPEED:
                bench.peer.send(CODEC.encode(frame))
        bench.now_s += 4.0
        bench.played()
        first = next(row for row in bench.rows if "SpeedMissing" in row["faults"])
    assert silent_s < first["time_s"] <= silent_s + 2.5


@pytest.mark.parametrize(("every", "missing"), [(3, False), (1, True)])
def test_a_sensor_counts_as_missing_when_most_of_its_frames_say_fault(tmp_path: Path, every: int, missing: bool):
    with running(tmp_path) as bench:
        bench.play(4, 0.0)
        for number, frame in enumerate(traffic(bench.now_s, 4.0, 0.0)):
            if frame.message == frames.IMPACT_SENSOR_SAMPLES and number % every == 0:
                frame = frame._replace(signals={**frame.signals, "SensorStatus": 2})  # noqa: PLW2901
            bench.peer.send(CODEC.encode(frame))
        bench.now_s += 4.0
        bench.played()
        assert ("SensorMissing" in bench.faults) is missing
