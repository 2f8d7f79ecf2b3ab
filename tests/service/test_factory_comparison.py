"""The factory's monitor where people look: monitor, plot flow, process --json."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import can
import pytest

from tests.schema_check import problems
from tests.service.bench import CODEC, START_S, traffic
from yieldmon.bus.log_files.log_writing import writing
from yieldmon.cli import main as cli
from yieldmon.screen.traffic import Traffic
from yieldmon.service.logs.factory_comparison import FactoryComparison


class Row:
    """Of a second's row what the comparison takes."""

    def __init__(self, ours: float | None, theirs: float | None) -> None:
        self.mass_flow_kg_s, self.factory_mass_flow_kg_s = ours, theirs


def factory(time_s: float, flow_kg_s: float) -> can.Message:
    data = struct.pack("<HHHH", round(flow_kg_s * 1000), 49, 1283, 6708)
    return can.Message(timestamp=time_s, arbitration_id=0x18FF6990, data=data, is_extended_id=True, channel="can0")


@pytest.mark.parametrize(
    ("pairs", "expected"),
    [
        ([(None, 5.0), (5.0, None)], None),
        ([(4.0, 5.0), (8.0, 10.0), (None, 3.0)], (2, 6.0, 7.5, 25.0, 1.0)),
        ([(4.0, 8.0), (8.0, 4.0)], (2, 6.0, 6.0, 0.0, -1.0)),
        ([(4.0, 4.0), (4.0, 4.0)], (2, 4.0, 4.0, 0.0, None)),
    ],
)
def test_comparison(pairs: list[tuple[float | None, float | None]], expected: tuple[float, ...] | None) -> None:
    comparison = FactoryComparison()
    for ours, theirs in pairs:
        comparison.take(Row(ours, theirs))  # type: ignore[arg-type]
    if expected is None:
        assert comparison.document is None
    else:
        assert comparison.document is not None
        assert tuple(comparison.document.values()) == pytest.approx(expected)


def test_screen_shows_it_while_it_speaks() -> None:
    traffic_seen = Traffic(CODEC)
    traffic_seen.observe(factory(100.0, 7.5))
    assert traffic_seen.factory_kg_s == 7.5
    assert [row.name for row in traffic_seen.sorted_rows("id")] == ["CaseGrainFlow"]
    traffic_seen.mark(106.0)
    assert traffic_seen.factory_kg_s is None


def test_verbs_show_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, table, picture = tmp_path / "drive.log", tmp_path / "drive.csv", tmp_path / "drive.svg"
    frames = [*(CODEC.encode(f) for s, d, mv in ((0.0, 14.0, 0.0), (14.0, 14.0, 60.0)) for f in traffic(START_S + s, d, mv))]
    frames += [factory(START_S + k / 2 + 0.01, 9.0) for k in range(56)]
    with writing(log) as logger:
        for message in sorted(frames, key=lambda m: m.timestamp):
            message.channel = "can0"
            logger.on_message_received(message)
    assert cli.main(["process", str(log), "--out", str(table), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert problems(document, "process") == []
    reported = document["factory"]
    assert reported["factory_mean_kg_s"] == 9.0
    assert reported["seconds"] >= 5
    assert reported["our_mean_kg_s"] > 0.0
    assert cli.main(["plot", "flow", str(table), "--out", str(picture)]) == 0
    assert "factory monitor" in picture.read_text()
    capsys.readouterr()
    assert cli.main(["monitor", str(log), "--once", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["factory_mass_flow_kg_s"] == 9.0
