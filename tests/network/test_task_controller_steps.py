"""The task controller client byte by byte: what it says at each step, and each of its waits met exactly and missed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.network.test_task_controller import SECOND, SERVER, device
from yieldmon.network.process_data import Command, Refusal
from yieldmon.network.task_controller.client import ClientState, Outgoing, TaskControllerClient

C = ClientState
PROCESS_DATA, WORKING_SET_MASTER, ACKNOWLEDGEMENT = 51968, 65037, 59392
STATUS = bytes([0xFE, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0xFF])
TASK_STATUS = bytes([0xFE, 0xFF, 0xFF, 0xFF, 1, 0, 0, 0xFF])
BUSY_STATUS = bytes([0xFE, 0xFF, 0xFF, 0xFF, 8, 0, 0, 0xFF])
VERSION = bytes([0x10, 4, 10, 0x01, 0, 0, 0, 0])
NO_LABEL = b"\xff" * 7
BEYOND_S = 1.0 / 1024.0


class Client:
    """A client whose server is the test, at a time of its own."""

    def __init__(self, width_m: float | None = 9.1) -> None:
        self.client = TaskControllerClient(device(), width_m)
        self.now_s = 0.0
        self.client.start(0.0)

    @property
    def state(self) -> ClientState:
        return self.client.state

    def hear(self, data: bytes, group: int = PROCESS_DATA, source: int = SERVER) -> list[Outgoing]:
        return self.client.feed(group, source, data, self.now_s)

    def poll(self, later_s: float) -> list[Outgoing]:
        self.now_s += later_s
        return self.client.poll(self.now_s)

    def status_of(self, later_s: float, status: bytes = STATUS) -> ClientState:
        """Time passes, with the server's status each second."""
        end_s = self.now_s + later_s
        while self.now_s + 1.0 < end_s:
            self.now_s += 1.0
            self.hear(status)
        self.now_s = end_s
        self.client.poll(end_s)
        return self.state


def waiting() -> Client:
    client = Client()
    client.poll(6.0)
    return client


def version() -> Client:
    client = waiting()
    client.hear(STATUS)
    return client


def structure() -> Client:
    client = version()
    client.hear(VERSION)
    return client


def localization() -> Client:
    client = structure()
    client.hear(b"\x11" + device().structure_label(4))
    return client


def deleting() -> Client:
    client = structure()
    client.hear(b"\x11" + b"another")
    return client


def asking() -> Client:
    client = structure()
    client.hear(b"\x11" + NO_LABEL)
    return client


def sending() -> Client:
    client = asking()
    client.hear(b"\x51\x00" + b"\xff" * 6)
    return client


def activating() -> Client:
    client = sending()
    client.hear(b"\x71\x00" + b"\xff" * 6)
    return client


def connected() -> Client:
    client = activating()
    client.hear(b"\x91\x00" + b"\xff" * 6)
    return client


POOL = device().pool(4)
MASTER = Outgoing(WORKING_SET_MASTER, b"\x01" + b"\xff" * 7, 255, 7)
TASK = Outgoing(PROCESS_DATA, b"\xff\xff\xff\xff\x00\x00\x00\x00", SERVER, 3)


def said(data: bytes, priority: int = 5) -> list[Outgoing]:
    return [Outgoing(PROCESS_DATA, data, SERVER, priority)]


ASK_POOL = said(b"\x41" + len(POOL).to_bytes(4, "little") + b"\xff" * 3)
ACTIVATE = said(b"\x81\xff" + b"\xff" * 6)
STEPS = [
    # from, what the server says, what is said, the state after it
    (waiting, STATUS, [MASTER, TASK, *said(b"\x00" + b"\xff" * 7)], C.VERSION),
    (version, VERSION, said(b"\x01" + b"\xff" * 7), C.STRUCTURE),
    (version, b"\x00" + b"\xff" * 7, said(b"\x10\x04\xff\x01\x00\x00\x00\x00"), C.VERSION),
    (connected, b"\x00" + b"\xff" * 7, said(b"\x10\x04\xff\x01\x00\x00\x00\x00"), C.CONNECTED),
    (connected, VERSION, [], C.CONNECTED),
    (structure, b"\x11" + device().structure_label(4), said(b"\x21" + b"\xff" * 7), C.LOCALIZATION),
    (structure, b"\x11" + NO_LABEL, ASK_POOL, C.ASKING_TO_SEND),
    (structure, b"\x11another", said(b"\xa1" + b"\xff" * 7), C.DELETING),
    (structure, b"\x31" + NO_LABEL, [], C.STRUCTURE),
    (localization, b"\x31en\x40\x00\x00\x00\xff", ACTIVATE, C.ACTIVATING),
    (localization, b"\x31de\x40\x00\x00\x00\xff", said(b"\xa1" + b"\xff" * 7), C.DELETING),
    (localization, b"\x31" + NO_LABEL, ASK_POOL, C.ASKING_TO_SEND),
    (deleting, b"\xb1\x01" + b"\xff" * 6, ASK_POOL, C.ASKING_TO_SEND),
    (asking, b"\x51\x00" + b"\xff" * 6, said(b"\x61" + POOL), C.SENDING),
    (asking, b"\x51\x01" + b"\xff" * 6, [], C.RESTING),
    (sending, b"\x71\x00" + b"\xff" * 6, ACTIVATE, C.ACTIVATING),
    (sending, b"\x71\x01" + b"\xff" * 6, [], C.RESTING),
    (activating, b"\x91\x00" + b"\xff" * 6, [], C.CONNECTED),
    (activating, b"\x91\x01\x02\x00\x03\x00\xff\xff", [], C.RESTING),
]


@pytest.mark.parametrize(("start", "heard", "answer", "state"), STEPS)
def test_step(start: Callable[[], Client], heard: bytes, answer: list[Outgoing], state: ClientState) -> None:
    client = start()
    assert client.hear(heard) == answer
    assert client.state is state
    assert client.client.server == (SERVER if state is not C.RESTING else None)


PROBLEMS = {
    asking: (b"\x51\x01" + b"\xff" * 6, "the server has no memory for our device description"),
    sending: (b"\x71\x07" + b"\xff" * 6, "the server did not take our device description, error 7"),
    activating: (b"\x91\x01\x02\x01\x03\x02\xff\xff", "the server rejects object 515 under 258 of our device description"),
}


@pytest.mark.parametrize("start", PROBLEMS)
def test_a_refusal_is_reported_and_tried_again_after_a_minute(start: Callable[[], Client]) -> None:
    heard, problem = PROBLEMS[start]
    for later_s, state in ((60.0 - BEYOND_S, C.RESTING), (60.0, C.WAITING_FOR_SERVER)):
        client = start()
        assert client.client.problem == ""
        client.hear(heard)
        assert client.client.problem == problem
        client.poll(later_s)
        assert client.state is state


def test_a_refusal_for_lack_of_anything_else_is_tried_again_after_six_seconds_and_forgotten_once_connected() -> None:
    client = connected()
    for data in (
        b"\x00\xff\xff\xff\xff\x00\xcb\x00", b"\x01\xff\xff\xff\xff\x01\xcb\x00", b"\x01\xff\xff\xff\xff\x00\xcb",
        b"\x02\xff\xff\xff\xff\x00\xcb\x00",
    ):  # fmt: skip
        client.hear(data, ACKNOWLEDGEMENT)
        assert client.state is C.CONNECTED
    refused = b"\x01\xff\xff\xff\xff\x00\xcb\x00"
    client.hear(refused, ACKNOWLEDGEMENT, source=0x20)
    assert client.state is C.CONNECTED
    client.hear(refused, ACKNOWLEDGEMENT)
    assert (client.state, client.client.problem) == (C.RESTING, "the server refuses our messages")
    client.poll(6.0 - BEYOND_S)
    assert client.state is C.RESTING
    client.poll(BEYOND_S)
    for heard in (STATUS, VERSION, b"\x11" + NO_LABEL, b"\x51\x00" + b"\xff" * 6, b"\x71\x00" + b"\xff" * 6):
        client.hear(heard)
    assert client.client.problem != ""
    client.hear(b"\x91\x00" + b"\xff" * 6)
    assert (client.state, client.client.problem) == (C.CONNECTED, "")


WAITS = {
    # how long an answer may take
    version: 6.0, structure: 6.0, localization: 6.0, deleting: 6.0, asking: 6.0, sending: 30.0, activating: 6.0,
}  # fmt: skip


@pytest.mark.parametrize("start", WAITS)
def test_an_answer_is_waited_for_so_long(start: Callable[[], Client]) -> None:
    client = start()
    before = client.state
    assert client.status_of(WAITS[start] - BEYOND_S) is before
    client = start()
    assert client.status_of(WAITS[start]) is C.RESTING
    assert client.client.problem == f"no answer while {before.value}"


def test_a_server_that_says_it_is_busy_is_waited_for() -> None:
    """From each such word on six seconds, and never less than was left: 30 s for a pool."""
    client = structure()
    assert client.status_of(20.0, BUSY_STATUS) is C.STRUCTURE
    assert client.status_of(5.0 - BEYOND_S) is C.STRUCTURE, "six seconds from the last such word, at 19 s"
    assert client.status_of(BEYOND_S) is C.RESTING
    client = sending()
    client.hear(BUSY_STATUS)
    assert client.status_of(30.0 - BEYOND_S) is C.SENDING
    client = connected()
    client.hear(BUSY_STATUS)
    assert client.status_of(7.0) is C.CONNECTED


def test_a_server_that_is_silent_for_six_seconds_has_gone() -> None:
    client = connected()
    client.hear(STATUS)
    client.now_s += 5.0
    client.hear(TASK_STATUS, source=0x20)
    assert not client.client.task_active, "another server's task"
    client.poll(1.0)
    assert client.state is C.CONNECTED
    client.hear(TASK_STATUS)
    client.poll(6.0 + BEYOND_S)
    assert (client.state, client.client.server, client.client.task_active) == (C.RESTING, None, False)


def test_the_client_task_is_sent_every_two_seconds_with_the_servers_task() -> None:
    client = connected()
    for _ in range(2):
        assert client.poll(2.0 - BEYOND_S) == []
        assert client.poll(BEYOND_S) == [TASK]
        client.hear(STATUS)
    client.hear(TASK_STATUS)
    assert client.poll(2.0) == [replace(TASK, data=b"\xff\xff\xff\xff\x01\x00\x00\x00")]
    assert Client().poll(100.0) == [], "nobody is there"


def test_after_the_address_has_gone_nothing_is_reported() -> None:
    client = connected()
    client.client.stop()
    assert (client.state, client.poll(1000.0), client.hear(STATUS)) == (C.RESTING, [], [])


@pytest.mark.parametrize("reported", [0, 1, 2, 3, 4, 5, 255])
def test_the_pool_is_of_the_older_version(reported: int) -> None:
    client = version()
    client.hear(bytes([0x10, reported, 10, 0x01, 0, 0, 0, 0]))
    client.hear(b"\x11" + NO_LABEL)
    assert client.hear(b"\x51\x00" + b"\xff" * 6) == said(b"\x61" + device().pool(min(max(reported, 1), 4)))


@pytest.mark.parametrize("length", [0, 1, 7])
def test_short_messages_are_passed_over(length: int) -> None:
    for start in (waiting, version, connected):
        client = start()
        before = client.state
        assert (client.hear(STATUS[:length]), client.hear(VERSION[:length]), client.state) == ([], [], before)


def test_what_is_known_and_not_there_is_answered_when_it_comes() -> None:
    client = connected()
    ask_flow = b"\x22\x00\x57\x00\x00\x00\x00\x00"
    assert client.hear(ask_flow) == []
    client.client.update(SECOND, client.now_s)
    assert client.hear(ask_flow) == said(b"\x23\x00\x57\x00" + (8_000_000).to_bytes(4, "little"), 3)
    early = asking()
    early.client.update(SECOND, early.now_s)
    assert early.hear(ask_flow) == [], "before the connection stands"


@pytest.mark.parametrize(("element", "error"), [(0, 4), (1, 4), (2, 4), (3, 2), (4095, 2)])
@pytest.mark.parametrize("command", [2, 3, 4, 5, 6, 7, 8, 10])
def test_what_is_not_there_is_refused_with_its_reason(command: int, element: int, error: int) -> None:
    """DDI 85 is nowhere; there are three elements."""
    asked = bytes([command | (element & 15) << 4, element >> 4, 85, 0, 1, 0, 0, 0])
    answer = bytes([0xD | (element & 15) << 4, element >> 4, 85, 0, error, command, 0xFF, 0xFF])
    assert connected().hear(asked) == said(answer, 4)


@pytest.mark.parametrize(("ddi", "value"), [(90, 500), (119, 60), (116, 1000), (183, 20)])
def test_totals_are_set_by_the_server_and_count_on(ddi: int, value: int) -> None:
    client = connected()
    client.client.update(SECOND, client.now_s)
    set_total = bytes([0x2A, 0, ddi, 0]) + value.to_bytes(4, "little")
    assert client.hear(set_total) == said(bytes([0x2D, 0, ddi, 0, 0, 10, 0xFF, 0xFF]), 4)
    ask = bytes([0x22, 0, ddi, 0, 0, 0, 0, 0])
    assert client.hear(ask) == said(bytes([0x23, 0, ddi, 0]) + value.to_bytes(4, "little"), 3)
    grown = {90: 8, 119: 2, 116: 36, 183: 5}[ddi]
    second = replace(SECOND, total_kg=1008.0, dry_total_kg=905.0)
    client.client.update(second, client.now_s, 2.0)
    assert client.hear(ask)[0].data[4:] in {(value + grown + more).to_bytes(4, "little") for more in (0, 1)}


@pytest.mark.parametrize("change", [TASK_STATUS, STATUS])
def test_totals_begin_with_a_task_and_are_sent_at_its_end(change: bytes) -> None:
    client = connected()
    client.client.update(SECOND, client.now_s)
    client.hear(b"\x23\x00\x5a\x00" + (500).to_bytes(4, "little"))
    assert client.hear(STATUS) == [], "no task before and none now"
    assert client.hear(TASK_STATUS) == []
    ask = b"\x22\x00\x5a\x00" + bytes(4)
    assert client.hear(ask)[0].data[4:] == bytes(4), "a task begins at 0"
    reported = client.hear(change)
    assert [out.data[2] for out in reported] == ([] if change is TASK_STATUS else [90, 183, 116, 119])
    assert {out.priority for out in reported} <= {3}


def test_commands_and_refusals_have_the_standards_numbers() -> None:
    """ISO 11783-10, table B.1 and the acknowledgement's error codes."""
    assert {name: int(command) for name, command in Command.__members__.items()} == {
        "TECHNICAL": 0, "DEVICE_DESCRIPTOR": 1, "REQUEST_VALUE": 2, "VALUE": 3, "TIME_INTERVAL": 4, "DISTANCE_INTERVAL": 5,
        "MINIMUM_WITHIN_THRESHOLD": 6, "MAXIMUM_WITHIN_THRESHOLD": 7, "CHANGE_THRESHOLD": 8, "PEER_CONTROL": 9,
        "SET_AND_ACKNOWLEDGE": 10, "ACKNOWLEDGE": 13, "SERVER_STATUS": 14, "CLIENT_TASK": 15,
    }  # fmt: skip
    assert [int(refusal) for refusal in Refusal] == [0, 1, 2, 4, 8, 16, 32]
