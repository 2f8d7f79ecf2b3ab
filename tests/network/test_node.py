"""The node: claim, requests, diagnostics, and what hostile neighbours get from it. Judged in part by can-j1939."""

from __future__ import annotations

import random
import tracemalloc

import j1939
import pytest

from tests.network.peer import read
from yieldmon.network.claim import ClaimState
from yieldmon.network.diagnostics import Lamp, TroubleCode, TroubleMemory, message
from yieldmon.network.identifier import ADDRESS_CLAIMED, Identifier, RawFrame
from yieldmon.network.name import Name
from yieldmon.network.node import Node, NodeSettings
from yieldmon.network.reassembly import Reassembler

US, PEER = 0x83, 0x17
NAME = Name(identity_number=1000, function=135, vehicle_system=17, industry_group=2)
LOWER, HIGHER = Name(identity_number=999), Name(identity_number=1001, function=200, vehicle_system=17, industry_group=2)
FIXED = Name(identity_number=1000, function=135, arbitrary_address_capable=False)
BELOW_FIXED = Name(identity_number=999, function=135, arbitrary_address_capable=False)


def claim(address: int, name: Name) -> tuple[int, bytes]:
    return 0x18EEFF00 | address, name.data


def node_at(now_s: float = 1.0, name: Name = NAME, **settings: object) -> Node:
    """A node whose claim stands."""
    node = Node(
        NodeSettings(
            name=name,
            software=("yieldmon 1.0",),
            make="yieldmon",
            model="m",
            serial_number="7",
            **settings,  # type: ignore[arg-type]
        )
    )
    node.start(now_s - 1.0)
    node.poll(now_s - 0.7)
    node.poll(now_s - 0.4)
    assert node.address == US
    return node


def shown(frames: list[RawFrame]) -> list[str]:
    return [f"{f.identifier:08X}#{f.data.hex().upper()}" for f in frames]


def answers(node: Node, text: str, now_s: float = 1.0) -> list[str]:
    identifier, data = text.split("#")
    return shown(node.feed(int(identifier, 16), bytes.fromhex(data), now_s).frames)


def test_nothing_but_claims_before_the_claim_stands() -> None:
    node = Node(NodeSettings(name=NAME))
    assert shown(node.start(0.0)) == ["18EAFFFE#00EE00"]
    assert node.send(65302, bytes(8), 0.1) == []
    assert shown(node.poll(0.25)) == [f"18EEFF83#{NAME.data.hex().upper()}"]
    assert node.report_trouble([TroubleCode(520192, 9)], 0.3) == []
    assert answers(node, "18EA8317#DAFE00", 0.3) == []
    assert node.poll(0.49) == []
    assert node.address is None
    node.poll(0.5)
    assert node.address == US
    assert shown(node.send(65302, bytes(8), 0.5, priority=5)) == ["14FF1683#0000000000000000"]


@pytest.mark.parametrize(
    ("name", "rival", "rival_at", "state", "address", "claims"),
    [
        pytest.param(NAME, HIGHER, US, ClaimState.CLAIMED, US, 1, id="wins and says so"),
        pytest.param(NAME, LOWER, US, ClaimState.CLAIMING, None, 1, id="loses and claims another"),
        pytest.param(FIXED, BELOW_FIXED, US, ClaimState.CANNOT_CLAIM, None, 0, id="loses and cannot claim"),
        pytest.param(NAME, LOWER, 0x40, ClaimState.CLAIMED, US, 0, id="another address"),
        pytest.param(NAME, NAME, US, ClaimState.CLAIMED, US, 0, id="our own NAME"),
    ],
)
def test_contention(name: Name, rival: Name, rival_at: int, state: ClaimState, address: int | None, claims: int) -> None:
    node = node_at(name=name)
    frames = node.feed(*claim(rival_at, rival), 1.0).frames
    assert (node.claim_state, node.address, len(frames)) == (state, address, claims)
    assert all(f.data == name.data for f in frames)


def test_loser_gets_another_address_and_keeps_it() -> None:
    node = node_at()
    (sent,) = node.feed(*claim(US, LOWER), 1.0).frames
    taken = sent.identifier & 0xFF
    assert taken != US
    assert 128 <= taken <= 235
    node.poll(1.25)
    assert node.address == taken
    assert [f.identifier & 0xFF for f in node.send(65302, bytes(8), 1.3)] == [taken]


@pytest.mark.parametrize(
    ("name", "holder", "claims_ours"),
    [(NAME, LOWER, False), (NAME, HIGHER, True), (NAME, None, True), (FIXED, BELOW_FIXED, True)],
    ids=["a lower NAME", "a higher NAME", "nobody", "we cannot take another"],
)
def test_the_address_of_a_lower_name_is_not_claimed_at_the_start(name: Name, holder: Name | None, claims_ours: bool) -> None:
    node = Node(NodeSettings(name=name))
    node.start(0.0)
    if holder is not None:
        node.feed(*claim(US, holder), 0.1)
    (sent,) = node.poll(0.25)
    assert sent.data == name.data
    assert ((sent.identifier & 0xFF) == US) is claims_ours


@pytest.mark.parametrize(
    ("frames_s", "reported"), [((2.0,), False), ((2.0, 4.0), True), ((2.0, 14.0), False), ((2.0, 10.0), True)]
)
def test_one_stray_frame_from_our_address_in_ten_seconds_is_no_trouble(frames_s: tuple[float, ...], reported: bool) -> None:
    """A node that has just lost the address may still have had one under way."""
    node = node_at()
    for now_s in frames_s:
        node.feed(0x18FF1600 | US, bytes(8), now_s)
    assert any("sends from our address" in trouble for trouble in node.troubles(frames_s[-1])) is reported


def test_cannot_claim_is_reported_late_and_again_when_asked() -> None:
    node = node_at(name=FIXED)
    assert node.feed(*claim(US, BELOW_FIXED), 1.0).frames == []
    due_s = node.due_s
    assert 1.0 <= due_s <= 1.153
    assert shown(node.poll(due_s)) == [f"18EEFFFE#{FIXED.data.hex().upper()}"]
    assert answers(node, "18EAFF17#00EE00", 2.0) == []
    assert shown(node.poll(2.153)) == [f"18EEFFFE#{FIXED.data.hex().upper()}"]
    assert answers(node, "18EA8317#DAFE00", 2.5) == []
    assert any("no address" in trouble for trouble in node.troubles(2.5))


def test_claim_is_tried_again_when_the_rival_may_have_gone() -> None:
    node = node_at(name=FIXED)
    node.feed(*claim(US, BELOW_FIXED), 1.0)
    now_s = 1.0
    while node.address is None and now_s < 100.0:
        now_s = node.due_s
        node.poll(now_s)
    assert node.address == US
    assert 61.0 <= now_s <= 62.0


def test_a_new_start_forgets_who_may_have_left() -> None:
    node = node_at()
    node.feed(*claim(0x40, HIGHER), 1.0)
    assert node.addresses.address_of(HIGHER) == 0x40
    node.start(2.0)
    assert node.address is None
    assert node.addresses.items() == []


def test_address_violation_is_answered_by_a_claim_every_five_seconds() -> None:
    node = node_at()
    frames = [f for k in range(1000) for f in node.feed(0x18FECA83, bytes(8), 1.0 + k * 0.01).frames]
    assert shown(frames) == [f"18EEFF83#{NAME.data.hex().upper()}"] * 2
    assert any("sends from our address" in trouble for trouble in node.troubles(11.0))


@pytest.mark.parametrize(
    ("request_frame", "expected"),
    [
        pytest.param("18EA8317#00EE00", [f"18EEFF83#{NAME.data.hex().upper()}"], id="address claimed, to us"),
        pytest.param("18EAFF17#00EE00", [f"18EEFF83#{NAME.data.hex().upper()}"], id="address claimed, to all"),
        pytest.param("18EAFFFE#00EE00", [f"18EEFF83#{NAME.data.hex().upper()}"], id="address claimed, by one without address"),
        pytest.param("18EA8417#00EE00", [], id="address claimed, to another"),
        pytest.param("18EA8317#CAFE00", ["18FECA83#00FF00000000FFFF"], id="DM1"),
        pytest.param("18EAFF17#CBFE00", ["18FECB83#00FF00000000FFFF"], id="DM2"),
        pytest.param("18EA8317#DAFE00", ["1CEC1783#100E000202DAFE00".replace("0202", "02FF")], id="software, connection"),
        pytest.param("18EAFF17#DAFE00", ["1CECFF83#200E0002FFDAFE00"], id="software, broadcast"),
        pytest.param("18EA8317#EBFE00", ["1CEC1783#100E0002FFEBFE00"], id="component"),
        pytest.param("18EA8317#CCFE00", ["18E8FF83#00FFFFFF17CCFE00"], id="DM3"),
        pytest.param("18EA8317#D3FE00", ["18E8FF83#00FFFFFF17D3FE00"], id="DM11"),
        pytest.param("18EAFF17#D3FE00", [], id="DM11, to all"),
        pytest.param("18EA8317#16FF00", ["14FF1683#0102030405060708".replace("14FF", "18FF")], id="a group of ours"),
        pytest.param("18EA8317#E5FE00", ["18E8FF83#01FFFFFF17E5FE00"], id="not ours: refused"),
        pytest.param("18EAFF17#E5FE00", [], id="not ours, to all"),
        pytest.param("18EA8417#DAFE00", [], id="to another"),
        pytest.param("18EA8317#CAFE", [], id="too short"),
    ],
)
def test_requests(request_frame: str, expected: list[str]) -> None:
    node = node_at()
    node.answer_with({65302: bytes(range(1, 9))})
    assert answers(node, request_frame) == expected


def test_long_answer_reaches_the_requester() -> None:
    node, peer = node_at(), Node(NodeSettings(name=Name(identity_number=5), preferred_address=PEER))
    peer.start(0.0)
    peer.poll(0.3)
    peer.poll(0.6)
    to_us = [RawFrame(0x18EA8317, bytes.fromhex("DAFE00"))]
    got = []
    while to_us:
        to_peer = [f for sent in to_us for f in node.feed(sent.identifier, sent.data, 1.0).frames]
        heard = [peer.feed(sent.identifier, sent.data, 1.0) for sent in to_peer]
        to_us = [f for h in heard for f in h.frames]
        got += [p for h in heard for p in h.payloads]
    assert [(p.group, p.source, p.destination, p.data) for p in got] == [(65242, US, PEER, b"\x01yieldmon 1.0*")]


@pytest.mark.parametrize(("allowed", "name", "expected"), [(False, NAME, US), (True, NAME, 0x90), (True, HIGHER, US)])
def test_commanded_address_only_where_allowed(allowed: bool, name: Name, expected: int) -> None:
    node = node_at(obeys_commanded_address=allowed)
    command = name.data + b"\x90"
    node.feed(0x1CECFF17, bytes.fromhex("20090002FFD8FE00"), 1.0)
    node.feed(0x1CEBFF17, b"\x01" + command[:7], 1.06)
    node.feed(0x1CEBFF17, b"\x02" + command[7:].ljust(7, b"\xff"), 1.12)
    node.poll(1.5)
    assert node.address == expected


CODES = (TroubleCode(520192, 9, Lamp.AMBER_WARNING), TroubleCode(520196, 31), TroubleCode(520204, 19, Lamp.AMBER_WARNING))


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        ((), "00FF00000000FFFF"),
        (CODES[:1], "04FF00F0E901FFFF"),
        (CODES, "04FF00F0E90104F0FF010CF0F301"),
    ],
)
def test_diagnostic_message(codes: tuple[TroubleCode, ...], expected: str) -> None:
    assert message(codes).hex().upper() == expected
    assert [(c.spn, c.fmi) for c in read(message(codes))] == [(c.spn, c.fmi) for c in codes]


def test_codes_become_previously_active_and_are_cleared() -> None:
    memory = TroubleMemory()
    memory.update(CODES[:2])
    memory.update(CODES[1:])
    memory.update(CODES[:2])
    assert [(c.spn, c.occurrences) for c in memory.active] == [(520196, 1), (520192, 2)]
    assert [c.spn for c in memory.previous] == [520204]
    memory.clear_previous()
    assert memory.previous == ()
    memory.clear_active()
    assert [(c.spn, c.occurrences) for c in memory.active] == [(520196, 1), (520192, 1)]


def test_memory_of_codes_is_bounded() -> None:
    memory = TroubleMemory()
    for spn in range(10_000):
        memory.update([TroubleCode(spn + 1, 31)])
    assert len(memory.previous) == 64


def run(node: Node, frames: list[RawFrame], now_s: float) -> list[RawFrame]:
    """The frames and those that fall due after them."""
    sent = list(frames)
    while node.due_s < float("inf"):
        now_s = node.due_s
        sent += node.poll(now_s)
    return sent


def test_several_codes_as_can_j1939_sees_them() -> None:
    node = node_at()
    sent = run(node, node.report_trouble(CODES, 1.0), 1.0)
    sent += run(node, node.report_trouble(CODES[:1], 3.0), 3.0)
    found: list[list[tuple[int, int, int]]] = []
    ecu = j1939.ElectronicControlUnit(send_message=lambda *args, **kwargs: None)
    try:
        other = ecu.add_ca(name=j1939.Name(arbitrary_address_capable=1, identity_number=3), device_address=0x55)
        reader = j1939.Dm1(other)
        reader.subscribe(lambda _source, _lamps, codes, _time: found.append([(c["spn"], c["fmi"], c["oc"]) for c in codes]))
        for frame in sent:
            ecu.notify(frame.identifier, bytearray(frame.data), 0.0)
    finally:
        ecu.stop()
    assert found == [[(c.spn, c.fmi, 1) for c in CODES], [(520192, 9, 1)]]


def test_a_code_that_comes_and_goes_during_a_transfer_is_sent() -> None:
    node, listener = node_at(), Reassembler()
    short = TroubleCode(520200, 31)
    sent = node.report_trouble(CODES, 1.0)
    assert node.report_trouble([*CODES, short], 1.01) == []
    assert node.report_trouble(CODES, 1.02) == []
    sent += run(node, [], 1.03)
    reported = [[c.spn for c in read(p.data)] for f in sent for p in listener.feed(f.identifier, f.data, 1.0)]
    assert reported == [[c.spn for c in CODES], [*[c.spn for c in CODES], short.spn]]
    last = run(node, node.report_trouble(CODES, 5.0), 5.0)
    reported = [[c.spn for c in read(p.data)] for f in last for p in listener.feed(f.identifier, f.data, 5.0)]
    assert reported == [[c.spn for c in CODES]]


def test_peers_that_ask_and_do_not_answer_keep_no_trouble_code_back() -> None:
    node, listener = node_at(), Reassembler()
    for peer in range(40, 60):
        assert len(answers(node, f"18EA83{peer:02X}#DAFE00")) == (peer < 56)
    sent = run(node, node.report_trouble(CODES, 1.0), 1.0)
    reported = [[c.spn for c in read(p.data)] for f in sent for p in listener.feed(f.identifier, f.data, 1.0)]
    assert reported == [[c.spn for c in CODES]]


def test_cleared_codes_go_to_dm2_and_away() -> None:
    node, listener = node_at(), Reassembler()
    run(node, node.report_trouble(CODES, 1.0), 1.0)
    run(node, node.report_trouble([], 3.0), 3.0)
    frames = run(node, node.feed(0x18EAFF17, bytes.fromhex("CBFE00"), 4.0).frames, 4.0)
    (previous,) = [p for f in frames for p in listener.feed(f.identifier, f.data, 4.0)]
    assert [c.spn for c in read(previous.data)] == [c.spn for c in CODES]
    answers(node, "18EA8317#CCFE00", 5.0)
    assert answers(node, "18EA8317#CBFE00", 5.0) == ["18FECB83#00FF00000000FFFF"]


def test_claims_without_end_by_a_higher_name() -> None:
    node = node_at()
    sent = []
    for k in range(10_000):
        sent += node.feed(*claim(US, HIGHER), 1.0 + k * 0.001).frames
    assert node.address == US
    assert len(sent) <= 10.0 / 0.02 + 1
    assert any("contested without end" in trouble for trouble in node.troubles(11.0))


def test_a_lower_name_that_follows_us_everywhere_silences_us_until_it_stops() -> None:
    node, now_s = node_at(), 1.0
    answers = node.feed(*claim(US, LOWER), now_s).frames
    sent = 0
    while node.claim_state is not ClaimState.CANNOT_CLAIM and now_s < 60.0:
        now_s += 0.001
        sent += len(answers)
        claimed = [frame.identifier & 0xFF for frame in answers]
        answers = node.poll(now_s) + [f for address in claimed for f in node.feed(*claim(address, LOWER), now_s).frames]
    assert node.claim_state is ClaimState.CANNOT_CLAIM
    assert sent < 300
    assert node.send(65302, bytes(8), now_s) == []
    while node.address is None and now_s < 300.0:
        now_s = node.due_s
        node.poll(now_s)
    assert node.address is not None


def test_requests_without_end() -> None:
    node = node_at()
    sent = [f for k in range(20_000) for f in node.feed(0x18EA8317, bytes.fromhex("E5FE00"), 1.0 + k * 0.0005).frames]
    assert 400 <= len(sent) <= 600
    assert any("more requests than we answer" in trouble for trouble in node.troubles(11.0))
    assert node.troubles(20.0) == ()


def test_sessions_without_end() -> None:
    node = node_at()
    for k in range(20_000):
        source = k % 120
        kind, to = ("20", 0xFF) if k % 2 else ("10", US)
        node.feed(0x1CEC0000 | to << 8 | source, bytes.fromhex(kind + "F906FFFFDAFE00"), 1.0 + k * 0.0005)
        assert node.held <= 64
    assert any("never end" in trouble for trouble in node.troubles(11.0))


def test_a_stream_of_anything_leaves_memory_bounded() -> None:
    node, draw = node_at(), random.Random(7)
    groups = (0xEEFF, 0xEAFF, 0xEA83, 0xECFF, 0xEC83, 0xEBFF, 0xEB83, 0xE8FF, 0x1F805, 0x1F801, 0xCB83, 0xFECA)
    spoken = 0

    def some(count: int, at_s: float) -> float:
        nonlocal spoken
        for _ in range(count):
            at_s += draw.choice((0.0, 0.0005, 0.01))
            identifier = draw.randrange(8) << 26 | draw.choice(groups) << 8 | draw.randrange(256)
            data = draw.randbytes(draw.choice((8, 8, 8, draw.randrange(9))))
            if data and draw.random() < 0.5:
                data = bytes([draw.choice((16, 17, 19, 32, 255))]) + data[1:]
            for frame in node.feed(identifier, data, at_s).frames:
                parts = Identifier.of(frame.identifier)
                if parts.group != ADDRESS_CLAIMED:
                    spoken += 1
                    assert parts.source in (node.address, 254)
        return at_s

    at_s = some(5_000, 2.0)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    some(15_000, at_s)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 200_000
    assert node.held <= 64
    assert spoken > 0


def test_a_fast_packet_reaches_whoever_listens_to_the_node() -> None:
    node = node_at()
    data = bytes(range(20))
    frames = [bytes([0, 20, *data[:6]]), bytes([1, *data[6:13]]), bytes([2, *data[13:20]])]
    heard = [node.feed(0x0DF80517, one, 2.0 + 0.01 * number) for number, one in enumerate(frames)]
    assert [p.data for h in heard for p in h.payloads] == [data]
    assert heard[-1].payloads[0].group == 129029


def test_groups_of_one_frame_are_taken_for_no_part_of_anything() -> None:
    node = node_at()
    for number in range(64):
        heard = node.feed(0x0CF00400 + 0x17 + (number << 8 & 0x300), bytes([number, 8, *range(6)]), 2.0 + 0.01 * number)
        assert (heard.frames, heard.payloads, node.held) == ([], [], 0)


def test_who_clears_codes_on_the_network_clears_what_the_request_names() -> None:
    """DM3 clears the previously active codes alone; DM11 also begins the counts of the active ones anew (J1939-73)."""
    node = node_at()
    for seconds, codes in enumerate((CODES[:2], CODES[1:2], CODES[:1], CODES[:2], ())):
        run(node, node.report_trouble(codes, 1.0 + seconds), 1.0 + seconds)
    run(node, node.report_trouble(CODES[:1], 9.0), 9.0)

    def counts(request: str) -> list[tuple[int, int]]:
        [answer] = node.feed(0x18EAFF17, bytes.fromhex(request), 20.0).frames
        return [(code.spn, code.occurrences) for code in read(answer.data)]

    active, previous = "CAFE00", "CBFE00"
    assert counts(active) == [(520192, 3)]
    assert [spn for spn, _ in counts(previous)] == [520196]
    assert shown(node.feed(0x18EA8317, bytes.fromhex("CCFE00"), 21.0).frames) == ["18E8FF83#00FFFFFF17CCFE00"]
    assert (counts(active), counts(previous)) == ([(520192, 3)], [])
    assert shown(node.feed(0x18EA8317, bytes.fromhex("D3FE00"), 22.0).frames) == ["18E8FF83#00FFFFFF17D3FE00"]
    assert (counts(active), counts(previous)) == ([(520192, 1)], [])


def test_a_listener_keeps_sixty_four_messages_under_way_and_counts_one_more_as_incomplete() -> None:
    """Of both transports; the one that has no place costs none of the others."""
    broadcast, fast = Reassembler(), Reassembler()
    for source in range(65):
        broadcast.feed(0x1CECFF00 | source, bytes.fromhex("200A0002FF16FF00"), 1.0)
        fast.feed(0x09F80500 | source, bytes.fromhex("000A000102030405"), 1.0)
    assert (broadcast.under_way, broadcast.incomplete) == (64, 1)
    assert (fast.under_way, fast.incomplete) == (64, 1)
    for last, reassembler in ((0x1CEBFF00, broadcast), (0x09F80500, fast)):
        whole = 0
        for source in range(65):
            parts = ("0100112233445566", "02778899FFFFFFFF") if reassembler is broadcast else ("0106070809FFFFFF",)
            whole += sum(len(reassembler.feed(last | source, bytes.fromhex(part), 1.1)) for part in parts)
        assert whole == 64
        assert reassembler.under_way == 0
