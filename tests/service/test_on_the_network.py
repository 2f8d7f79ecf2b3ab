"""The daemon as a node: nothing before its claim, answers, trouble codes as can-j1939 reads them, a task controller's values."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import can
import j1939
import pytest

from tests.network.task_server import TaskServer, parse_pool
from tests.service.bench import Bench, encoded, running, traffic, wait_for
from yieldmon.bus.log_files.logs import read_log
from yieldmon.bus.receiver import BusEvent, BusEventKind
from yieldmon.cli import main as cli
from yieldmon.network.identifier import (
    ACKNOWLEDGEMENT,
    ADDRESS_CLAIMED,
    REQUEST,
    TRANSPORT_CONNECTION,
    TRANSPORT_DATA,
    Identifier,
)
from yieldmon.network.name import Name
from yieldmon.network.node import Node, NodeSettings
from yieldmon.physics.machine import Implement
from yieldmon.service.config import configuration
from yieldmon.service.traffic.bus_node import BusNode
from yieldmon.service.traffic.link import link_for
from yieldmon.service.traffic.network_link import identity_number

RECORDINGS = sorted((Path(__file__).parent.parent / "data" / "tractor_bus").glob("*.log"))
US = 0x83
TEXT = "bus: {transmit_max_age_s: 60}"


def sent(bench: Bench) -> list[tuple[Identifier, bytes]]:
    return [(Identifier.of(m.arbitration_id), bytes(m.data)) for m in bench.heard()]


def say(bench: Bench, identifier: int, text: str) -> None:
    bench.peer.send(can.Message(arbitration_id=identifier, data=bytes.fromhex(text), is_extended_id=True, timestamp=bench.now_s))


def claimed(bench: Bench) -> None:
    """Plays until the address is claimed, and three seconds more: nothing of what a second brings is sent before."""

    def stands() -> bool:
        bench.play(1, 0.0)
        bench.played()
        return bool(bench.status["network"]["claim"] == "claimed")

    bench.play(1, 0.0)
    wait_for(stands, "the claim")
    bench.play(3, 0.0)
    bench.played()


def test_claims_come_before_anything_else(tmp_path: Path) -> None:
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        wait_for(lambda: len(sent(bench)) > 5, "frames")
        groups = [parts.group for parts, _ in sent(bench)]
        assert groups[:2] == [REQUEST, ADDRESS_CLAIMED]
        assert all(parts.source == US for parts, _ in sent(bench)[1:])
        network = bench.status["network"]
        assert (network["address"], network["claim"]) == (US, "claimed")


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        ((0x18EA8317, "00EE00"), ADDRESS_CLAIMED),
        ((0x18EAFF17, "DAFE00"), TRANSPORT_CONNECTION),
        ((0x18EA8317, "E5FE00"), ACKNOWLEDGEMENT),
        ((0x18EA8317, "16FF00"), 65302),
    ],
    ids=["claim", "software", "not ours", "last mass flow"],
)
def test_requests_are_answered(tmp_path: Path, asked: tuple[int, str], answer: int) -> None:
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        bench.heard().clear()
        say(bench, *asked)
        wait_for(lambda: answer in [parts.group for parts, _ in sent(bench)], "the answer")


def test_requests_for_others_are_not(tmp_path: Path) -> None:
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        bench.heard().clear()
        for text in ("00EE00", "DAFE00", "E5FE00"):
            say(bench, 0x18EA8417, text)
        say(bench, 0x18EA8317, "E5FE00")
        answers = (ADDRESS_CLAIMED, TRANSPORT_CONNECTION, ACKNOWLEDGEMENT)
        wait_for(lambda: ACKNOWLEDGEMENT in [parts.group for parts, _ in sent(bench)], "an answer")
        assert [data[5:8].hex() for parts, data in sent(bench) if parts.group in answers] == ["e5fe00"]


@pytest.mark.parametrize(
    ("name", "conflict"),
    [
        (Name(identity_number=7, function=135, vehicle_system=17, industry_group=2), "MassFlow from another node"),
        # Another monitor of one machine has an instance of its own, and other makers use the group for what they like.
        (Name(identity_number=7, function=135, vehicle_system=17, industry_group=2, function_instance=1), None),
        (Name(identity_number=7, function=135, vehicle_system=17, industry_group=2, manufacturer_code=89), None),
        (None, None),
    ],
    ids=["a second monitor", "another instance", "another maker", "no claim"],
)
def test_a_second_monitor_at_an_address_of_its_own_is_a_conflict(tmp_path: Path, name: Name | None, conflict: str | None) -> None:
    """It has lost ours, or found it taken: displays show the figures of both."""
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        if name is not None:
            say(bench, 0x18EEFF00 | 0xB8, name.data.hex())
        for _ in range(4):
            say(bench, 0x14FF1600 | 0xB8, "0100FFFF7DFFFFFF")
            bench.play(1, 0.0)
            bench.played()
        assert bench.faults.get("OutputConflict") == conflict


def test_an_address_that_is_claimed_anew_was_not_taken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As after the interface was away: the log said that another node took it."""
    (tmp_path / "c.yaml").write_text(TEXT)
    loaded, now_s = configuration.load(tmp_path / "c.yaml", {}), [0.0]
    node = BusNode(
        loaded,
        bus_factory=lambda: can.Bus(interface="virtual", channel="anew"),
        silence_s=1.0,
        listen_s=0.1,
        clock=lambda: now_s[0],
    )

    def polled() -> list[bool]:
        found = []
        for _ in range(20):
            now_s[0] += 0.1
            found.append(node.poll(0.0))
        return found

    with caplog.at_level("INFO", "yieldmon"):
        node.claim_address()
        assert any(polled())
        node.take_event(BusEvent(BusEventKind.INTERFACE_RESTORED, 0.0))
        assert sum(polled()) == 2
    assert [record.getMessage() for record in caplog.records if "address" in record.getMessage()] == [
        f"network: our address is {US}"
    ] * 2


def test_a_lower_name_takes_the_address_and_frames_follow(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        say(bench, 0x18EEFF00 | US, Name(identity_number=0, arbitrary_address_capable=False).data.hex())
        wait_for(lambda: bench.status["network"]["address"] not in (None, US), "another address")
        taken = bench.status["network"]["address"]
        bench.heard().clear()
        bench.play(3, 0.0)
        bench.played()
        wait_for(lambda: bool(sent(bench)), "frames")
        assert {parts.source for parts, _ in sent(bench)} == {taken}
        assert f"our address is {taken}, the preferred {US} is another node's" in caplog.text
        assert bench.status["network"]["preferred_address"] == US
        assert cli.main(["status", "--socket", str(tmp_path / "yieldmon.sock")]) == 0
        assert f"address {taken}: another node has the preferred {US}" in capsys.readouterr().out

        def reported() -> bool:
            bench.play(1, 0.0)
            bench.played()
            return f"took our address {US}; ours is {taken}" in bench.faults.get("NetworkFault", "")

        wait_for(reported, "the fault")


def hostile_second(bench: Bench, name: str) -> None:
    """A second of traffic; after each frame four claims of the address that the daemon has claimed last, and a request for its
    claim; each 20 ms a transport session that never goes on, from any node."""
    second, address, seen = int(bench.now_s), US, 0
    for number, frame in enumerate(traffic(bench.now_s, 1.0, 60.0)):
        bench.peer.send(encoded(frame))
        heard = bench.heard()
        address = next((m.arbitration_id & 0xFF for m in reversed(heard[seen:]) if m.arbitration_id >> 8 == 0x18EEFF), address)
        seen = len(heard)
        said = [(0x18EEFF00 | address, name)] * 4 + [(0x18EA0017 | address << 8, "00EE00")]
        if number % 5 == 0:
            said.append((0x18EC0000 | address << 8 | (number + 7 * second) % 254, "10FF0024FF00CB00"))
        for identifier, text in said:
            bench.peer.send(can.Message(arbitration_id=identifier, data=bytes.fromhex(text), timestamp=frame.time_s))
    bench.now_s += 1.0
    bench.played()


@pytest.mark.parametrize("name", ["FFFFFFFFFFFFFFFF", "0000000000000000"], ids=["higher", "lower"])
def test_a_hostile_node_stops_nothing(tmp_path: Path, name: str) -> None:
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        bench.play(10, 0.0)
        for _ in range(8):
            hostile_second(bench, name)
        rows = bench.rows[-7:]
        assert [row["coverage"] for row in rows] == pytest.approx([1.0] * 7, abs=1e-3)
        assert sum(row["lost_frames"] + row["surplus_frames"] + row["repeated_frames"] for row in rows) == 0
        assert all(row["mass_kg"] > 0.0 for row in rows[-4:])

        def reported() -> bool:
            hostile_second(bench, name)
            return "NetworkFault" in bench.faults

        wait_for(reported, "NetworkFault")


def test_network_off_sends_as_the_dbc_says(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "yieldmon"), running(tmp_path, TEXT + "\nnetwork: {enabled: false}") as bench:
        say(bench, 0x18EA8317, "E5FE00")
        bench.play(3, 0.0)
        bench.played()
        wait_for(lambda: bool(sent(bench)), "frames")
        assert {parts.group for parts, _ in sent(bench)}.isdisjoint({ADDRESS_CLAIMED, REQUEST, ACKNOWLEDGEMENT})
        assert {parts.source for parts, _ in sent(bench)} == {US}
    said = [record.getMessage() for record in caplog.records if record.getMessage().startswith("network:")]
    assert said == [f"network: off; frames are sent from the DBC's addresses, DM1 from {US}"]


def test_can_j1939_sees_all_codes_at_once(tmp_path: Path) -> None:
    """Nothing plays, so sensor, speed and feedback are all missing."""
    found: list[list[tuple[int, int]]] = []
    with running(tmp_path, "bus: {transmit_max_age_s: 60, idle_after_s: 0.5}", silence_s=0.15) as bench:
        ecu = j1939.ElectronicControlUnit(send_message=lambda *args, **kwargs: None)
        try:
            reader = j1939.Dm1(ecu.add_ca(name=j1939.Name(arbitrary_address_capable=1, identity_number=3), device_address=0x55))
            reader.subscribe(lambda _source, _lamps, codes, _time: found.append([(c["spn"], c["fmi"]) for c in codes]))
            seen = 0

            def steadily() -> bool:
                nonlocal seen
                for message in bench.heard()[seen:]:
                    ecu.notify(message.arbitration_id, bytearray(message.data), message.timestamp)
                seen = len(bench.heard())
                return sum(len(codes) >= 3 for codes in found) >= 3

            wait_for(steadily, "three DM1 with several codes")
        finally:
            ecu.stop()
    several = [set(codes) for codes in found if len(codes) >= 3]
    assert {(520192, 9), (520194, 9), (520195, 9)} <= several[-1]


@contextmanager
def task_controller(channel: can.BusABC, server: TaskServer) -> Iterator[Node]:
    """The server behind a node of ours on the peer's side of the bus; it answers in a thread of its own."""
    node = Node(NodeSettings(name=Name(identity_number=9, function=130, industry_group=2), preferred_address=0xF7))
    clock = ServerClock()
    ended = threading.Event()

    def put(frames: list) -> None:  # type: ignore[type-arg]
        for f in frames:
            channel.send(can.Message(arbitration_id=f.identifier, data=f.data, is_extended_id=True))

    def body() -> None:
        put(node.start(clock.now_s))
        while not ended.is_set():
            message = channel.recv(0.005)
            put(node.poll(clock.now_s))
            for data in server.tick(clock.now_s) if node.address is not None else []:
                put(node.send(51968, data, clock.now_s, priority=3))
            if message is None:
                continue
            heard = node.feed(message.arbitration_id, bytes(message.data), clock.now_s)
            put(heard.frames)
            parts = Identifier.of(message.arbitration_id)
            received = [(p.group, p.data) for p in heard.payloads if p.destination == node.address]
            if parts.group not in (TRANSPORT_CONNECTION, TRANSPORT_DATA) and parts.group in (51968, 65037):
                received.append((parts.group, bytes(message.data)))
            for group, data in received:
                for answer in server.hear(group, data, clock.now_s):
                    put(node.send(51968, answer, clock.now_s, destination=parts.source, priority=5))

    thread = threading.Thread(target=body)
    thread.start()
    try:
        yield node
    finally:
        ended.set()
        thread.join()


class ServerClock:
    """As fast as the daemon's in `bench`."""

    @property
    def now_s(self) -> float:
        import time

        return 20.0 * time.monotonic()


def test_task_controller_takes_our_pool_and_our_flow(tmp_path: Path) -> None:
    server = TaskServer()
    with running(tmp_path, TEXT + "\nnetwork: {task_controller: true}") as bench:
        name = bench.peer.channel_info.split()[-1]
        with can.Bus(interface="virtual", channel=name) as channel, task_controller(channel, server):
            state = lambda: (bench.status["network"]["task_controller"] or {}).get("state")  # noqa: E731
            bench.play(2, 0.0)

            def connected() -> bool:
                bench.play(1, 0.0)
                bench.played()
                return state() == "connected"

            wait_for(connected, f"the connection on {name}")
            channel.send(
                can.Message(
                    arbitration_id=0x0CCB83F7,
                    data=TaskServer.command(4, 2, 90, 100),
                    is_extended_id=True,
                )
            )

            def reported() -> bool:
                bench.play(1, 0.0)
                bench.played()
                return len(server.values) >= 3

            wait_for(reported, "values")
    assert server.complaints == []
    assert {ddi for _, _, ddi, _ in server.values} == {90}
    assert server.said[-1] == "activate"


def test_a_task_controller_gets_the_device_of_another_header(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("network: {task_controller: true}")
    loaded = configuration.load(tmp_path / "c.yaml", {})
    link, server = link_for(loaded), TaskServer()
    node = Node(NodeSettings(name=Name(identity_number=9, function=130, industry_group=2), preferred_address=0xF7))
    now_s = 0.0
    to_server, to_us = link.start(now_s), node.start(now_s)

    def hear(message: can.Message) -> None:
        heard = node.feed(message.arbitration_id, bytes(message.data), now_s)
        to_us.extend(heard.frames)
        received = [(payload.group, payload.data) for payload in heard.payloads]
        if Identifier.of(message.arbitration_id).group in (51968, 65037):
            received.append((Identifier.of(message.arbitration_id).group, bytes(message.data)))
        for group, data in received:
            for answer in server.hear(group, data, now_s):
                to_us.extend(node.send(51968, answer, now_s, destination=US, priority=5))

    def widths() -> list[object]:
        nonlocal now_s
        for _ in range(400):
            now_s += 0.05
            to_server.extend(link.poll(now_s))
            to_us.extend(node.poll(now_s))
            for data in server.tick(now_s) if node.address is not None else []:
                to_us.extend(node.send(51968, data, now_s, priority=3))
            while to_server or to_us:
                for message in [to_server.pop(0) for _ in range(len(to_server))]:
                    hear(message)
                for frame in [to_us.pop(0) for _ in range(len(to_us))]:
                    to_server.extend(link.receive(can.Message(arbitration_id=frame.identifier, data=frame.data), now_s))
        assert (link.status()["task_controller"] or {})["state"] == "connected"
        pool = parse_pool(server.stored, server.version).values()
        return [values["value"] for table, values in pool if table == "DPT" and values["ddi"] == 67]

    assert widths() == []
    for width_m in (9.1, 12.0):
        machine = replace(loaded.machine, implement=Implement(working_width_m=width_m))
        link.use(machine, loaded.engine.totals, now_s)
        assert widths() == [1000 * width_m]
    assert server.complaints == []


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda p: p.stem)
def test_a_tractors_network_traffic_changes_nothing(tmp_path: Path, path: Path) -> None:
    """Its requests to all may be answered; those to its own nodes are not ours, and nothing of it is a fault."""
    with running(tmp_path, TEXT) as bench:
        claimed(bench)
        bench.heard().clear()
        for message in read_log(path):
            message.timestamp = bench.now_s
            bench.peer.send(message)
        bench.play(3, 0.0)
        bench.played()
        answered = {parts.group for parts, _ in sent(bench)} & {59392, TRANSPORT_CONNECTION, TRANSPORT_DATA}
        assert answered == set()
        assert "NetworkFault" not in bench.faults
        partners = {p["address"]: p["name"] for p in bench.status["network"]["partners"]}
        assert partners == {
            0x00: "200200000429F556",
            0x03: "200203000430744D",
            0x06: "20000E000430744D",
            0x17: "2002130004246E0C",
            0x47: "200234000430744D",
        }


def test_identity_number_is_this_computers(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_text("a" * 32)
    other.write_text("b" * 32)
    assert identity_number(None, one) == identity_number(None, one) != identity_number(None, other)
    assert identity_number(7, one) == 7
    assert 0 <= identity_number(None, tmp_path / "absent") < 1 << 21
