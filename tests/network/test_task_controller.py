"""The task controller client against a server written from the standard."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise

import pytest

from tests.network.task_server import TaskServer, parse_pool
from yieldmon.network.name import Name
from yieldmon.network.process_data import Command, ProcessData, read
from yieldmon.network.task_controller.client import ClientState, TaskControllerClient
from yieldmon.network.task_controller.combine import Second, combine, raw_values
from yieldmon.network.task_controller.pool import Device
from yieldmon.physics.machine import Implement

SERVER = 0xF7
NAME = Name(identity_number=5, industry_group=2)
FULL = Implement(working_width_m=9.1, header_offset_m=3.2, connector_type=2, grain_delay_s=12.0)
SECOND = Second(
    flow_kg_s=8.0,
    total_kg=1000.0,
    harvesting=True,
    dry_flow_kg_s=7.5,
    dry_total_kg=900.0,
    moisture_pct=18.5,
    ground_speed_m_s=2.0,
)


def device(implement: Implement = FULL) -> Device:
    return combine(implement, NAME, designator="yieldmon", software_version="1.0", serial_number="5")


class Bench:
    """Client and server on a bus without delay, in steps of 0.1 s; a second's values each second."""

    def __init__(self, server: TaskServer | None = None, implement: Implement = FULL) -> None:
        self.server = server or TaskServer()
        self.client = TaskControllerClient(device(implement), implement.working_width_m)
        self.now_s = 0.0
        self.step = 0
        self.second = SECOND
        self.states: list[tuple[float, ClientState]] = []
        self.client.start(0.0)

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s * 10)):
            self.step += 1
            self.now_s = self.step / 10
            out = self.client.poll(self.now_s)
            if self.step % 10 == 0:
                self.second = replace(self.second, total_kg=self.second.total_kg + (self.second.flow_kg_s or 0.0))
                out += self.client.update(self.second, self.now_s)
            self.deliver(out)
            for data in self.server.tick(self.now_s):
                self.deliver(self.client.feed(51968, SERVER, data, self.now_s))
            if not self.states or self.states[-1][1] is not self.client.state:
                self.states.append((self.now_s, self.client.state))

    def deliver(self, out: list) -> None:  # type: ignore[type-arg]
        while out:
            sent = out.pop(0)
            for answer in self.server.hear(sent.group, sent.data, self.now_s):
                out += self.client.feed(51968, SERVER, answer, self.now_s)

    def command(self, command: Command, ddi: int, value: int = 0, element: int = 2) -> None:
        data = TaskServer.command(command, element, ddi, value)
        self.deliver(self.client.feed(51968, SERVER, data, self.now_s))

    def values(self, ddi: int) -> list[tuple[float, int]]:
        return [(t, value) for t, _element, d, value in self.server.values if d == ddi]


def connected(server: TaskServer | None = None, implement: Implement = FULL) -> Bench:
    bench = Bench(server, implement)
    bench.run(9.0)
    assert bench.client.state is ClientState.CONNECTED
    return bench


SEQUENCE = ["master", "technical 0", "technical 1", "structure"]


@pytest.mark.parametrize(
    ("prepare", "expected"),
    [
        pytest.param("nothing", [*SEQUENCE, "ask", "transfer", "activate"], id="first time"),
        pytest.param("known", [*SEQUENCE, "localization", "activate"], id="pool known"),
        pytest.param("other", [*SEQUENCE, "delete", "ask", "transfer", "activate"], id="another pool"),
    ],
)
@pytest.mark.parametrize("version", [2, 3, 4, 5])
def test_sequence(prepare: str, expected: list[str], version: int) -> None:
    server = TaskServer(version=version)
    if prepare != "nothing":
        implement = FULL if prepare == "known" else Implement()
        server.stored = device(implement).pool(min(version, 4))
    bench = connected(server)
    assert sorted(server.said[:3]) == sorted(expected[:3])
    assert server.said[3:] == expected[3:]
    assert server.complaints == []
    assert bench.states[0] == (0.1, ClientState.RESTING)


def test_nothing_is_reported_for_six_seconds_nor_before_the_server() -> None:
    bench = Bench(TaskServer(silent=True))
    bench.run(20.0)
    assert bench.client.state is ClientState.WAITING_FOR_SERVER
    early = Bench()
    early.run(5.9)
    assert early.server.said == []


def test_client_task_every_two_seconds() -> None:
    bench = connected()
    bench.run(20.0)
    times = bench.server.client_task_at_s
    gaps = [b - a for a, b in pairwise(times[1:])]
    assert gaps
    assert all(abs(gap - 2.0) < 0.15 for gap in gaps)


def test_pool_says_what_the_machine_file_says() -> None:
    objects = parse_pool(device().pool(4), 4)
    properties = {v["ddi"]: v["value"] for table, v in objects.values() if table == "DPT"}
    assert properties == {134: 3200, 135: 0, 67: 9100, 143: -12000, 157: 2}
    variables = {v["ddi"]: v for table, v in objects.values() if table == "DPD"}
    assert set(variables) == {84, 87, 90, 99, 116, 119, 181, 182, 183, 239, 57343}
    assert {ddi for ddi, v in variables.items() if v["properties"] & 2} == {90, 116, 119, 183}
    assert {ddi for ddi, v in variables.items() if v["triggers"] & 16} == {90, 116, 119, 183, 57343}
    elements = {v["element"]: (v["kind"], v["parent"]) for table, v in objects.values() if table == "DET"}
    assert elements == {0: (1, 0), 1: (6, 1), 2: (2, 1)}
    assert objects[0][1]["name"] == int(NAME)


def test_pool_without_a_width_offers_no_area() -> None:
    objects = parse_pool(device(Implement()).pool(3), 3)
    variables = {v["ddi"] for table, v in objects.values() if table == "DPD"}
    assert variables == {87, 90, 99, 119, 182, 183, 239, 57343}


def test_label_changes_with_the_pool_and_with_nothing_else() -> None:
    assert device().structure_label(4) == device().structure_label(4)
    assert device().structure_label(4) != device(replace(FULL, working_width_m=9.2)).structure_label(4)
    assert len(device().pool(4)) < 1785


def test_values_by_time_at_one_hertz() -> None:
    bench = connected()
    bench.command(Command.TIME_INTERVAL, 87, 1000)
    bench.run(30.0)
    times = [t for t, _ in bench.values(87)]
    assert len(times) == 30
    assert {value for _, value in bench.values(87)} == {8_000_000}
    bench.command(Command.TIME_INTERVAL, 87, 0)
    bench.run(5.0)
    assert len(bench.values(87)) == 30


@pytest.mark.parametrize(
    ("command", "ddi", "value", "expected"),
    [
        pytest.param(Command.DISTANCE_INTERVAL, 87, 10_000, 4, id="every 10 m at 2 m/s for 20 s"),
        pytest.param(Command.CHANGE_THRESHOLD, 87, 1, 1, id="a steady flow changes once"),
        pytest.param(Command.CHANGE_THRESHOLD, 119, 5, 4, id="time by 5 s"),
        pytest.param(Command.MINIMUM_WITHIN_THRESHOLD, 87, 5_000_000, 1, id="above 5 kg/s"),
        pytest.param(Command.MINIMUM_WITHIN_THRESHOLD, 87, 9_000_000, 0, id="above 9 kg/s"),
        pytest.param(Command.MAXIMUM_WITHIN_THRESHOLD, 87, 9_000_000, 1, id="below 9 kg/s"),
    ],
)
def test_measurement_commands(command: Command, ddi: int, value: int, expected: int) -> None:
    bench = connected()
    bench.command(command, ddi, value)
    bench.run(20.0)
    # A distance or a count of seconds may begin anywhere in its interval.
    spare = int(command is Command.DISTANCE_INTERVAL or ddi == 119)
    assert abs(len(bench.values(ddi)) - expected) <= spare
    assert bench.server.refusals == []


def test_threshold_speaks_again_when_it_is_crossed_again() -> None:
    bench = connected()
    bench.command(Command.MINIMUM_WITHIN_THRESHOLD, 87, 5_000_000)
    for flow in (8.0, 2.0, 8.0, 2.0):
        bench.second = replace(bench.second, flow_kg_s=flow)
        bench.run(3.0)
    assert [value for _, value in bench.values(87)] == [8_000_000, 8_000_000]


def test_default_data_on_request() -> None:
    bench = connected()
    bench.command(Command.REQUEST_VALUE, 57343, element=0)
    bench.run(10.0)
    seen = {ddi for _, _, ddi, _ in bench.server.values}
    assert seen == {84, 87, 90, 99, 116, 119, 181, 182, 183, 239}
    assert len(bench.values(84)) == 10
    assert bench.values(84)[0][1] == round(8.0 / (9.1 * 2.0) * 1e6)


@pytest.mark.parametrize(
    ("command", "element", "ddi", "value", "error"),
    [
        (Command.REQUEST_VALUE, 2, 85, 0, 4),
        (Command.REQUEST_VALUE, 9, 84, 0, 2),
        (Command.VALUE, 2, 87, 5, 16),
        (Command.SET_AND_ACKNOWLEDGE, 2, 90, 5, 0),
        (Command.SET_AND_ACKNOWLEDGE, 2, 87, 5, 16),
        (Command.TIME_INTERVAL, 0, 57343, 1000, 8),
        (Command.TIME_INTERVAL, 2, 87, -5, 32),
        (Command.DISTANCE_INTERVAL, 2, 90, 5, 8),
        (Command.CHANGE_THRESHOLD, 2, 500, 5, 4),
    ],
)
def test_what_is_refused_and_acknowledged(command: Command, element: int, ddi: int, value: int, error: int) -> None:
    bench = connected()
    bench.command(command, ddi, value, element)
    assert bench.server.refusals == [(element, ddi, error, command)]


def test_totals_are_the_tasks() -> None:
    bench = connected()
    bench.server.task = True
    bench.run(4.0)
    bench.command(Command.VALUE, 90, 500)
    bench.run(10.0)
    bench.command(Command.REQUEST_VALUE, 90)
    assert bench.values(90)[-1][1] == pytest.approx(580, abs=1)
    bench.server.task = False
    bench.run(4.0)
    assert {ddi for t, _, ddi, _ in bench.server.values if t > 20.0} == {90, 116, 119, 183}


def test_a_server_without_a_task_hears_totals_from_its_connection_on() -> None:
    bench = connected()
    at_s, before_kg = bench.states[-1][0], bench.second.total_kg
    bench.command(Command.REQUEST_VALUE, 90)
    since_kg = (bench.now_s - at_s + 1.0) * (bench.second.flow_kg_s or 0.0)
    assert bench.values(90)[-1][1] <= since_kg < before_kg


@pytest.mark.parametrize(
    ("changes", "implement", "area_m2", "time_s"),
    [
        pytest.param({}, FULL, 182, 10, id="9.1 m at 2 m/s for 10 s"),
        pytest.param({"ground_speed_m_s": 3.0}, FULL, 273, 10, id="faster"),
        pytest.param({"ground_speed_m_s": None}, FULL, 0, 10, id="speed not known"),
        pytest.param({"harvesting": False}, FULL, 0, 0, id="not harvesting"),
        pytest.param({}, Implement(), None, 10, id="width not known"),
    ],
)
def test_area_and_time_are_counted_while_harvesting(
    changes: dict[str, object], implement: Implement, area_m2: int | None, time_s: int
) -> None:
    bench = connected(implement=implement)
    bench.server.task = True
    bench.run(4.0)
    bench.second = replace(bench.second, **changes)  # type: ignore[arg-type]
    seen = []
    for _ in range(2):
        bench.command(Command.REQUEST_VALUE, 116)
        bench.command(Command.REQUEST_VALUE, 119)
        seen.append([bench.values(ddi)[-1][1] if bench.values(ddi) else None for ddi in (116, 119)])
        bench.run(10.0)
    (area_before, time_before), (area, time) = seen
    assert (area is None if area_m2 is None else area - area_before == pytest.approx(area_m2, abs=1)) is True
    assert time - time_before == time_s


def test_server_that_goes_and_comes_back() -> None:
    bench = connected()
    bench.command(Command.TIME_INTERVAL, 87, 1000)
    bench.run(5.0)
    bench.server.silent = True
    bench.run(7.0)
    assert bench.client.state in (ClientState.RESTING, ClientState.WAITING_FOR_SERVER)
    before = len(bench.server.values)
    bench.server.silent, bench.server.client_known = False, False
    bench.run(12.0)
    assert bench.client.state is ClientState.CONNECTED
    assert len(bench.server.values) == before
    assert bench.server.complaints == []


@pytest.mark.parametrize(
    ("server", "problem"),
    [
        (TaskServer(memory=False), "no memory"),
        (TaskServer(accepts=1), "rejects object"),
        (TaskServer(answers_version=False), "no answer while asked for the version"),
    ],
    ids=["no memory", "pool rejected", "no version"],
)
def test_server_that_does_not_take_us(server: TaskServer, problem: str) -> None:
    bench = Bench(server)
    bench.run(30.0)
    assert bench.client.state is not ClientState.CONNECTED
    assert problem in bench.client.problem
    server.memory, server.accepts, server.answers_version = True, 0, True
    bench.run(90.0)
    assert bench.client.state is ClientState.CONNECTED
    assert bench.client.problem == ""


def test_server_that_refuses_our_messages() -> None:
    bench = connected()
    bench.client.feed(59392, SERVER, b"\x01\xff\xff\xff\x83\x00\xcb\x00", bench.now_s)
    assert bench.client.state is ClientState.RESTING


def test_another_node_does_not_command_us() -> None:
    bench = connected()
    asked = ProcessData(Command.REQUEST_VALUE, 2, 87, 0).data
    assert bench.client.feed(51968, 0x20, asked, bench.now_s) == []
    assert len(bench.client.feed(51968, SERVER, asked, bench.now_s)) == 1


def test_process_data_round_trip() -> None:
    for element, ddi, value in ((0, 0, 0), (4095, 57343, -1), (2, 87, 2**31 - 1)):
        item = ProcessData(Command.VALUE, element, ddi, value)
        assert read(item.data) == item


def test_unknown_values_are_left_out() -> None:
    second = Second(flow_kg_s=None, total_kg=5.0, harvesting=False)
    assert raw_values(second, 9.1) == {90: 5, 239: 1}
    assert raw_values(replace(SECOND, ground_speed_m_s=0.1), 9.1).keys() == raw_values(SECOND, None).keys()


def test_a_total_that_the_server_sets_near_the_end_of_its_range_is_reported_as_far_as_it_fits() -> None:
    bench = connected()
    bench.command(Command.SET_AND_ACKNOWLEDGE, 90, 2**31 - 10)
    bench.command(Command.TIME_INTERVAL, 90, 1000)
    bench.run(5.0)
    assert [value for _, value in bench.values(90)] == [2**31 - 10, 2**31 - 2]
    bench.command(Command.SET_AND_ACKNOWLEDGE, 90, 5)
    bench.run(2.0)
    assert [value for _, value in bench.values(90)[2:]] == [5, 13]


def test_totals_of_ours_that_begin_anew_leave_those_of_the_task() -> None:
    bench = connected()
    for ddi in (90, 183):
        bench.command(Command.TIME_INTERVAL, ddi, 1000)
    bench.run(5.0)
    before, dry_before = bench.values(90)[-1][1], bench.values(183)[-1][1]
    bench.second = replace(bench.second, total_kg=0.0, dry_total_kg=0.0, first_load=7)
    bench.run(3.0)
    assert bench.values(90)[-1][1] == before + 24
    assert bench.values(183)[-1][1] == dry_before


def test_any_stream_from_the_server_is_survived() -> None:
    draw = random.Random(3)
    bench = connected()
    for _ in range(20_000):
        data = draw.randbytes(draw.choice((8, 8, 8, 3, 20)))
        if data[0] & 15 == 14:
            continue
        out = bench.client.feed(draw.choice((51968, 59392)), SERVER, data, bench.now_s)
        assert len(out) <= 12
    bench.run(70.0)
    assert bench.client.state is ClientState.CONNECTED
