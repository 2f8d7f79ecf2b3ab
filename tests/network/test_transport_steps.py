"""SAE J1939-21 step by step: each answer by its bytes, each wait and each limit met exactly and missed by a little."""

from __future__ import annotations

from math import inf

import pytest

from tests.network.test_transport import PEER, US, feed, shown
from yieldmon.network.identifier import Identifier
from yieldmon.network.receiving import TransportReceiver
from yieldmon.network.sending import TransportSender

BEYOND_S = 1.0 / 1024.0
T1_S, T2_S, T3_S, T4_S = 0.75, 1.25, 1.25, 1.05
"""J1939-21, 5.10.3.5."""
GROUP = "DAFE00"
OTHER = 0x40


def request_to_send(size: int, at_a_time: int = 255, peer: int = PEER, us: int = US) -> str:
    parts = (size + 6) // 7
    return f"1CEC{us:02X}{peer:02X}#10{size.to_bytes(2, 'little').hex()}{parts:02X}{at_a_time:02X}{GROUP}"


def broadcast(size: int, peer: int = PEER) -> str:
    return f"1CECFF{peer:02X}#20{size.to_bytes(2, 'little').hex()}{(size + 6) // 7:02X}FF{GROUP}"


def part(number: int, peer: int = PEER, us: int = US) -> str:
    return f"1CEB{us:02X}{peer:02X}#{number:02X}01020304050607"


def clear_to_send(count: int, first: int) -> str:
    return f"1CEC1783#11{count:02X}{first:02X}FFFF{GROUP}"


def abort(reason: int) -> str:
    return f"1CEC1783#FF{reason:02X}FFFFFF{GROUP}"


@pytest.mark.parametrize(
    ("size", "answer"),
    [(8, [abort(2)]), (9, [clear_to_send(2, 1)]), (1785, [clear_to_send(16, 1)]), (1786, [abort(2)])],
)
def test_messages_have_9_to_1785_bytes(size: int, answer: list[str]) -> None:
    text = request_to_send(size) if size < 1786 else f"1CEC8317#10{size.to_bytes(2, 'little').hex()}FFFF{GROUP}"
    assert feed(TransportReceiver(), text)[0] == answer


@pytest.mark.parametrize(("at_a_time", "windows"), [(0, [16, 4]), (1, [1] * 20), (15, [15, 5]), (16, [16, 4]), (255, [16, 4])])
def test_a_sender_is_let_through_window_by_window(at_a_time: int, windows: list[int]) -> None:
    receiver, number = TransportReceiver(), 1
    answers, data = feed(receiver, request_to_send(140, at_a_time))
    for count in windows:
        assert answers == [clear_to_send(count, number)]
        for place in range(count):
            answers, data = feed(receiver, part(number + place))
            assert place == count - 1 or answers == []
        number += count
    assert answers == [f"1CEC1783#138C0014FF{GROUP}"]
    assert data == bytes(range(1, 8)) * 20


def overheard(receiver: TransportReceiver, now_s: float = 0.0) -> None:
    feed(receiver, request_to_send(20, us=OTHER), now_s)


WAITS = {
    "our first part": ([request_to_send(20)], T2_S, [abort(3)]),
    "our next part": ([request_to_send(20), part(1)], T1_S, [abort(3)]),
    "our next window": ([request_to_send(20, 1), part(1)], T2_S, [abort(3)]),
    "others' first part": ([request_to_send(20, us=OTHER)], T2_S, []),
    "others' next part": ([request_to_send(20, us=OTHER), part(1, us=OTHER)], T2_S, []),
    "others that are made to wait": ([request_to_send(20, us=OTHER), f"1CEC1740#1100FFFFFF{GROUP}"], T2_S, []),
    "others of another group": ([request_to_send(20, us=OTHER), "1CEC1740#1100FFFFFFEBFE00"], T2_S - 1.0, []),
    "a broadcast's first part": ([broadcast(20)], T1_S, []),
    "a broadcast's next part": ([broadcast(20), part(1, us=0xFF)], T1_S, []),
}


@pytest.mark.parametrize("name", WAITS)
def test_a_part_is_waited_for_so_long(name: str) -> None:
    frames, wait_s, answers = WAITS[name]
    receiver = TransportReceiver()
    assert receiver.due_s == inf
    for number, frame in enumerate(frames):
        feed(receiver, frame, 1.0 + number)
    begun_s = float(len(frames))
    assert receiver.due_s == begun_s + wait_s
    assert (receiver.poll(begun_s + wait_s - BEYOND_S), len(receiver), receiver.abandoned) == ([], 1, 0)
    assert [shown(f) for f in receiver.poll(begun_s + wait_s)] == answers
    assert (len(receiver), receiver.abandoned, receiver.aborted, receiver.refused, receiver.due_s) == (0, 1, 0, 0, inf)


def test_a_session_begun_anew_takes_the_place_of_the_one_before() -> None:
    receiver = TransportReceiver()
    feed(receiver, request_to_send(20))
    feed(receiver, part(1))
    assert feed(receiver, request_to_send(20))[0] == [clear_to_send(3, 1)]
    assert (len(receiver), receiver.abandoned) == (1, 1)


@pytest.mark.parametrize(
    ("frame", "ends"),
    [
        (f"1CEC8317#FF01FFFFFF{GROUP}", True),
        (f"1CEC1783#FF01FFFFFF{GROUP}", False),
        (f"1CEC8340#FF01FFFFFF{GROUP}", False),
        (f"1CEC8317#1301FFFFFF{GROUP}", False),
        ("1CEC8317#FF01FFFFFFEBFE00", False),
        (f"1CEC8317#FF01FFFF{GROUP}", False),
    ],
)
def test_a_sender_ends_its_session(frame: str, ends: bool) -> None:
    """Our own frames come back from some interfaces and are passed over."""
    receiver = TransportReceiver()
    feed(receiver, request_to_send(20))
    assert feed(receiver, frame) == ([], None)
    assert (len(receiver), receiver.aborted) == ((0, 1) if ends else (1, 0))


@pytest.mark.parametrize("by", ["1CEC4017", "1CEC1740"])
def test_either_side_ends_a_session_of_others(by: str) -> None:
    receiver = TransportReceiver()
    overheard(receiver)
    feed(receiver, f"{by}#FF01FFFFFF{GROUP}")
    assert (len(receiver), receiver.aborted) == (0, 1)


def test_a_session_of_others_is_read_without_a_word() -> None:
    receiver = TransportReceiver()
    overheard(receiver)
    assert feed(receiver, part(2, us=OTHER)) == ([], None)
    assert feed(receiver, part(1, us=OTHER)) == ([], None)
    answers, data = feed(receiver, part(3, us=OTHER))
    assert (answers, data) == ([], (bytes(range(1, 8)) * 3)[:20])


def test_a_broadcast_that_lost_a_part_is_dropped() -> None:
    receiver = TransportReceiver()
    feed(receiver, broadcast(20))
    feed(receiver, part(1, us=0xFF))
    assert feed(receiver, part(3, us=0xFF)) == ([], None)
    assert (len(receiver), receiver.abandoned) == (0, 1)
    assert feed(receiver, part(2, us=0xFF)) == ([], None)


def test_a_part_that_comes_again_is_passed_over_and_a_lost_one_asked_for_twice() -> None:
    receiver = TransportReceiver()
    feed(receiver, request_to_send(70))
    steps = [
        (part(1), []), (part(1), []), (part(3), [clear_to_send(9, 2)]), (part(4), []), (part(2), []),
        (part(5), [clear_to_send(8, 3)]), (part(3), []), (part(6), [abort(7)]),
    ]  # fmt: skip
    for frame, answers in steps:
        assert feed(receiver, frame)[0] == answers
    assert len(receiver) == 0


@pytest.mark.parametrize(("groups", "taken"), [(None, 1), ({0xFEDA}, 1), ({0xFEDB}, 0), (set(), 0)])
def test_only_wanted_groups_are_taken(groups: set[int] | None, taken: int) -> None:
    receiver = TransportReceiver(groups=groups)
    assert len(feed(receiver, request_to_send(20))[0]) == taken
    assert len(receiver) == taken


def test_sessions_with_us_end_with_our_address() -> None:
    receiver = TransportReceiver()
    feed(receiver, request_to_send(20))
    overheard(receiver)
    receiver.forget_ours()
    assert len(receiver) == 1
    assert feed(receiver, part(1, us=OTHER)) == ([], None)


def test_a_frame_of_the_transport_protocol_has_eight_bytes() -> None:
    receiver = TransportReceiver()
    assert feed(receiver, "1CEC8317#1014000303DAFE") == ([], None)
    assert feed(receiver, "18FEDA17#1014000303DAFE00") == ([], None)
    assert len(receiver) == 0


# Sending


def answered(sender: TransportSender, text: str, now_s: float = 0.0) -> list[str]:
    identifier, data = text.split("#")
    return [shown(f) for f in sender.feed(Identifier.of(int(identifier, 16)), bytes.fromhex(data), US, now_s)]


def opened(size: int = 40, now_s: float = 0.0) -> TransportSender:
    sender = TransportSender()
    sent = sender.submit(0xFEDA, bytes(range(size)), US, PEER, now_s)
    assert [shown(f) for f in sent] == [f"1CEC1783#10{size.to_bytes(2, 'little').hex().upper()}{(size + 6) // 7:02X}FF{GROUP}"]
    return sender


def allowed(count: int, first: int) -> str:
    return f"1CEC8317#11{count:02X}{first:02X}FFFF{GROUP}"


def parts(first: int, last: int, size: int = 40) -> list[str]:
    data = bytes(range(size))
    return [f"1CEB1783#{n:02X}" + data[7 * n - 7 : 7 * n].ljust(7, b"\xff").hex().upper() for n in range(first, last + 1)]


@pytest.mark.parametrize(
    ("count", "first", "sent"),
    [
        (6, 1, (1, 6)),
        (2, 1, (1, 2)),
        (255, 1, (1, 6)),
        (2, 5, (5, 6)),
        (1, 6, (6, 6)),
        (3, 6, (6, 6)),
        (1, 7, None),
        (1, 0, None),
    ],
)
def test_parts_go_out_as_they_are_asked_for(count: int, first: int, sent: tuple[int, int] | None) -> None:
    assert answered(opened(), allowed(count, first)) == (parts(*sent) if sent else [])
    assert answered(opened(), allowed(count, 0)) == [], "parts count from 1"


@pytest.mark.parametrize("size", [0, 8, 1786])
def test_a_message_of_another_size_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"message of {size} bytes, expected 9 to 1785"):
        TransportSender().submit(0xFEDA, bytes(size), US, PEER, 0.0)


@pytest.mark.parametrize(
    ("frames", "wait_s"),
    [([], T3_S), ([allowed(2, 1)], T3_S), ([allowed(0, 255)], T4_S), ([allowed(2, 1), allowed(0, 255)], T4_S)],
    ids=["the first answer", "after parts", "held", "held after parts"],
)
def test_an_answer_is_waited_for_so_long(frames: list[str], wait_s: float) -> None:
    sender = opened(now_s=1.0)
    for number, frame in enumerate(frames):
        answered(sender, frame, 2.0 + number)
    begun_s = 1.0 + len(frames)
    assert sender.due_s == begun_s + wait_s
    assert sender.poll(US, begun_s + wait_s - BEYOND_S) == []
    assert [shown(f) for f in sender.poll(US, begun_s + wait_s)] == [abort(3)]
    assert (len(sender), sender.failed, sender.due_s) == (0, 1, inf)


@pytest.mark.parametrize(
    ("frame", "failed"),
    [(f"1CEC8317#13280006FF{GROUP}", 0), (f"1CEC8317#FF01FFFFFF{GROUP}", 1)],
    ids=["taken", "aborted"],
)
def test_the_next_message_is_announced_when_one_has_ended(frame: str, failed: int) -> None:
    sender = opened()
    assert sender.submit(0xFEDB, bytes(9), US, PEER, 0.0) == []
    assert (sender.busy_with(0xFEDB, PEER), sender.busy_with(0xFEDC, PEER), sender.busy_with(0xFEDB)) == (True, False, False)
    assert answered(sender, frame, 5.0) == ["1CEC1783#10090002FFDBFE00"]
    assert (len(sender), sender.failed, sender.due_s) == (1, failed, 5.0 + T3_S)
    assert answered(sender, frame.replace(GROUP, "DBFE00"), 6.0) == []
    assert (len(sender), sender.failed, sender.due_s) == (0, 2 * failed, inf)


@pytest.mark.parametrize(
    "frame",
    [
        allowed(1, 1).replace(GROUP, "DBFE00"),
        allowed(1, 1).replace("1CEC83", "1CEC84"),
        allowed(1, 1).replace("8317#", "8318#"),
        allowed(1, 1).replace("1CEC", "1CEB"),
        allowed(1, 1)[:-2],
        f"1CEC8317#10280006FF{GROUP}",
    ],
    ids=["another group", "to another", "from another", "no connection management", "short", "no answer"],
)
def test_what_is_no_answer_to_us_changes_nothing(frame: str) -> None:
    sender = opened()
    assert answered(sender, frame, 1.0) == []
    assert (len(sender), sender.failed, sender.due_s) == (1, 0, T3_S)


@pytest.mark.parametrize(("again", "left"), [(8, 1), (9, 0)])
def test_parts_are_sent_again_eight_times(again: int, left: int) -> None:
    sender = opened()
    answered(sender, allowed(6, 1))
    for _ in range(again):
        answered(sender, allowed(1, 1))
        answered(sender, allowed(5, 2))
    assert (len(sender), sender.failed) == (left, 1 - left)


def test_a_broadcast_part_by_part() -> None:
    """50 ms from its announcement to the first part, between parts, and to the next announcement."""
    sender = TransportSender()
    assert [shown(f) for f in sender.submit(0xFEDA, bytes(range(9)), US, 255, 0.0)] == [f"1CECFF83#20090002FF{GROUP}"]
    assert sender.submit(0xFEDB, bytes(9), US, 255, 0.0) == []
    assert sender.busy_with(0xFEDA)
    seen = []
    for _ in range(6):
        due_s = min(sender.due_s, 1.0)
        assert sender.poll(US, due_s - BEYOND_S) == []
        seen += [(round(due_s, 6), shown(f)) for f in sender.poll(US, due_s)]
    assert seen == [
        (0.05, "1CEBFF83#0100010203040506"), (0.1, "1CEBFF83#020708FFFFFFFFFF"), (0.15, "1CECFF83#20090002FFDBFE00"),
        (0.2, "1CEBFF83#0100000000000000"), (0.25, "1CEBFF83#020000FFFFFFFFFF"),
    ]  # fmt: skip
    assert (len(sender), sender.due_s, sender.busy_with(0xFEDA)) == (0, inf, False)


def test_all_that_waits_is_forgotten_with_our_address() -> None:
    sender = opened()
    sender.clear()
    assert (len(sender), sender.due_s, sender.failed) == (0, inf, 0)
