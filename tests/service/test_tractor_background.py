"""A recorded tractor's bus as background while the daemon measures: at its own pace and at ten times that nothing changes."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import can
import pytest

from tests.service.bench import CODEC, START_S, Bench, running, traffic
from yieldmon.bus.log_files.logs import read_log
from yieldmon.network.identifier import Identifier

RECORDING = Path(__file__).parent.parent / "data" / "tractor_bus" / "in_gear_5s.log.gz"
EMPTY_S, GRAIN_S, GRAIN_MV = 5.0, 12.0, 150.0
US = 0x83


def background(speed: float, duration_s: float) -> list[can.Message]:
    """The recording again and again for so long, `speed` times as fast, in the drive's time."""
    recorded = list(read_log(str(RECORDING)))
    first_s, span_s = recorded[0].timestamp, recorded[-1].timestamp - recorded[0].timestamp + 0.01
    found = []
    for turn in range(int(duration_s * speed / span_s) + 1):
        for message in recorded:
            at_s = START_S + (turn * span_s + message.timestamp - first_s) / speed
            if at_s < START_S + duration_s:
                found.append(
                    can.Message(
                        timestamp=at_s, arbitration_id=message.arbitration_id, is_extended_id=message.is_extended_id,
                        data=message.data,
                    )
                )  # fmt: skip
    return found


def measured(folder: Path, speed: float) -> tuple[dict, set[int], set[int], set[int]]:
    """Status after the drive; groups and addresses that the daemon sent, and to whom."""
    folder.mkdir()
    duration_s = EMPTY_S + GRAIN_S
    drive = [
        *(CODEC.encode(frame) for frame in traffic(START_S, EMPTY_S, 0.0)),
        *(CODEC.encode(frame) for frame in traffic(START_S + EMPTY_S, GRAIN_S, GRAIN_MV)),
    ]
    messages = sorted([*drive, *(background(speed, duration_s) if speed else [])], key=lambda message: message.timestamp)
    with running(folder) as bench:
        for second, part in groupby(messages, key=lambda message: int(message.timestamp - START_S)):
            for message in part:
                bench.peer.send(message)
            # The daemon's queue is made for a bus's pace, not for a drive at once.
            bench.now_s = START_S + second + 1.0
            if second > 1:
                bench.played()
        assert bench.status["bus"]["dropped"] == 0
        sent = _sent(bench)
        return bench.status, {i.group for i in sent}, {i.source for i in sent[1:]}, {i.destination for i in sent}


def _sent(bench: Bench) -> list[Identifier]:
    return [Identifier.of(message.arbitration_id) for message in bench.heard()]


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, set[int], set[int], set[int]]:
    return measured(tmp_path_factory.mktemp("alone") / "d", 0.0)


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_nothing_is_lost_wrong_or_answered(
    speed: float, tmp_path: Path, alone: tuple[dict, set[int], set[int], set[int]]
) -> None:
    status, groups, sources, destinations = measured(tmp_path / "d", speed)
    quiet, quiet_groups, quiet_sources, quiet_destinations = alone
    assert {fault["code"] for fault in status["faults"]} == {fault["code"] for fault in quiet["faults"]}
    assert [row["lost_frames"] for row in status["windows"]] == [0] * len(status["windows"])
    assert {row["coverage"] for row in status["windows"]} == {1.0}
    assert status["total"]["mass_kg"] == pytest.approx(quiet["total"]["mass_kg"], rel=1e-9)
    assert status["total"]["mass_kg"] > 10.0
    assert sources == quiet_sources == {US}
    assert groups <= quiet_groups | {0xFECA}
    assert destinations == quiet_destinations
