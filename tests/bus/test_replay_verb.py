"""The verb replay, run as the command line runs it, onto virtual buses."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import can
import pytest

from yieldmon.cli.main import main

FRAMES = 200


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """200 frames 1 ms apart, every second one on can1; ids count up."""
    path = tmp_path / "drive.log"
    path.write_text(
        "".join(f"({1_700_000_000 + k / 1000:.6f}) can{k % 2} {0x18FF8000 + k:08X}#{k:016X}\n" for k in range(FRAMES))
    )
    return path


def received(bus: can.BusABC) -> list[int]:
    ids = []
    while (message := bus.recv(0)) is not None:
        ids.append(message.arbitration_id - 0x18FF8000)
    return ids


def test_every_frame_arrives_once_and_in_order(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with can.Bus("verb-1", interface="virtual") as listener:
        assert main(["replay", str(drive), "-i", "virtual", "-c", "verb-1", "--json"]) == 0
        assert received(listener) == list(range(FRAMES))
    summary = json.loads(capsys.readouterr().out)
    assert summary["frames"] == FRAMES
    assert summary["elapsed_s"] >= 0.199


def test_data_arrive_unchanged(drive: Path) -> None:
    with can.Bus("verb-2", interface="virtual") as listener:
        assert main(["replay", str(drive), "-i", "virtual", "-c", "verb-2", "--speed", "0", "--to", "0.0205"]) == 0
        last = [listener.recv(0) for _ in range(21)][-1]
    assert (last.arbitration_id, last.is_extended_id, bytes(last.data)) == (
        0x18FF8000 + 20,
        True,
        (20).to_bytes(8, "big"),
    )


def test_channel_map(drive: Path) -> None:
    options = ["-i", "virtual", "--speed", "0", "--map", "can0=verb-a", "--map", "can1=verb-b"]
    with can.Bus("verb-a", interface="virtual") as a, can.Bus("verb-b", interface="virtual") as b:
        assert main(["replay", str(drive), *options]) == 0
        assert received(a) == list(range(0, FRAMES, 2))
        assert received(b) == list(range(1, FRAMES, 2))


def test_several_logs_one_after_the_other(drive: Path) -> None:
    with can.Bus("verb-3", interface="virtual") as listener:
        assert main(["replay", str(drive), str(drive), "-i", "virtual", "-c", "verb-3", "--speed", "0"]) == 0
        assert received(listener) == list(range(FRAMES)) * 2


def test_loop_until_interrupted(drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Ctrl-C in the third pass: the summary is printed, the exit code says interrupted."""
    remaining = iter(range(2 * FRAMES + 50))

    def send(self, message, timeout=None) -> None:
        if next(remaining, None) is None:
            raise KeyboardInterrupt

    monkeypatch.setattr(can.interfaces.virtual.VirtualBus, "send", send)
    assert main(["replay", str(drive), "-i", "virtual", "-c", "verb-4", "--loop", "--speed", "0", "--json"]) == 130
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary["passes"]) == (2 * FRAMES + 50, 2)


def test_damage_is_reported_and_skipped(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = drive.read_text().splitlines(keepends=True)
    drive.write_text("".join([*lines[:10], *["junk\n"] * 15, *lines[10:]]))
    assert main(["replay", str(drive), "-i", "virtual", "-c", "verb-5", "--speed", "0"]) == 0
    out, err = capsys.readouterr()
    assert f"{FRAMES} frames" in out
    assert "15 damaged records" in out
    assert f"{drive}:11: 'junk' is not a candump line" in err
    assert len(err.splitlines()) == 11


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["absent.log"], "absent.log: No such file or directory; expected a readable CAN log"),
        (["drive.erf"], "drive.erf: unknown log format"),
        (["{}", "--speed", "-1"], "--speed: is -1; expected a number of at least 0"),
        (["{}", "--speed", "nan"], "--speed: is nan"),
        (["{}", "--skip-gaps", "-1"], "--skip-gaps: is -1"),
        (["{}", "--from", "5", "--to", "5"], "--to: is 5; expected more than --from, 5"),
        (["{}", "--map", "can0"], "--map: 'can0'; expected FROM=TO"),
        (["{}", "--inputs-only"], "no frame to send"),
        (["{}", "--from", "1000"], "no frame to send"),
        (["{}", "--config", "c.yaml"], "--config: needs --inputs-only; expected both, or neither"),
    ],
)
def test_bad_input_is_one_line(drive: Path, options: list[str], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [option.format(drive) for option in options]
    assert main(["replay", *words, "-i", "virtual", "-c", "verb-6"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert problem in err
    assert len(err.splitlines()) == 1


OWN_DBC = """\
VERSION ""
BU_: Node
BO_ 384 Cell: 2 Node
 SG_ Force : 0|16@1+ (1,0) [0|0] "mV" Node
"""
OWN = "signals: {impact_voltage: {dbc: own.dbc, message: Cell, signal: Force, rate_hz: 100}}"


@pytest.mark.parametrize(
    ("configuration", "sent"),
    [
        (None, [0x08FF1081, 0x0CFF1180, 0x09F8011C, 0x18FEF31C, 0x0CFE49F0]),
        (OWN, [0x180, 0x0CFF1180, 0x09F8011C, 0x18FEF31C, 0x0CFE49F0]),
    ],
)
def test_inputs_only_sends_what_the_daemon_takes(configuration: str | None, sent: list[int], tmp_path: Path) -> None:
    """Standard position and speed were left out, and so was the whole of a mapped sensor."""
    (tmp_path / "own.dbc").write_text(OWN_DBC)
    (tmp_path / "c.yaml").write_text(configuration or "")
    on_the_bus = ("180", "08FF1081", "181", "0CFF1180", "18FEF500", "09F8011C", "18FEF31C", "18FF1583", "0CFE49F0", "18FECA83")
    lines = [f"({1_700_000_000 + k / 100:.6f}) can0 {identifier}#{'00' * 8}\n" for k, identifier in enumerate(on_the_bus)]
    (tmp_path / "drive.log").write_text("".join(lines))
    options = ["--config", str(tmp_path / "c.yaml")] if configuration is not None else []
    with can.Bus("verb-9", interface="virtual") as listener:
        assert main(["replay", str(tmp_path / "drive.log"), "-i", "virtual", "-c", "verb-9", "--inputs-only", *options]) == 0
        found = [message.arbitration_id for message in iter(lambda: listener.recv(0), None)]
    assert sorted(found) == sorted(sent)


def test_a_missing_second_log_is_reported_before_the_first_is_sent(drive: Path) -> None:
    with can.Bus("verb-7", interface="virtual") as listener:
        assert main(["replay", str(drive), "absent.log", "-i", "virtual", "-c", "verb-7"]) == 2
        assert received(listener) == []


def test_frames_are_spread_over_the_time_of_the_log(drive: Path) -> None:
    """The listener's own timestamps span the log's 199 ms; a burst would not."""
    stamps: list[float] = []
    with can.Bus("verb-8", interface="virtual") as listener:
        reader = threading.Thread(
            target=lambda: stamps.extend(m.timestamp for m in (listener.recv(10) for _ in range(FRAMES)) if m)
        )
        reader.start()
        assert main(["replay", str(drive), "-i", "virtual", "-c", "verb-8"]) == 0
        reader.join()
    assert stamps[-1] - stamps[0] >= 0.19


@pytest.mark.parametrize(("options", "sent", "not_sent"), [([], 2, 2), (["--fd"], 4, None), (["--to", "0.0015"], 1, 1)])
def test_frames_of_can_fd_that_are_not_sent_are_counted(
    options: list[str], sent: int, not_sent: int | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were missing without a word."""
    log = tmp_path / "fd.log"
    log.write_text("".join(f"(1.{k:03d}000) can0 18FF8000#{'#1' if k % 2 else ''}0102\n" for k in range(4)))
    given = ["replay", str(log), "-i", "virtual", "-c", "verb-fd", "--speed", "0", *options]
    assert main([*given, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary.get("fd_not_sent")) == (sent, not_sent)
    assert main(given) == 0
    assert (f"; {not_sent} CAN FD frame{'s' if not_sent != 1 else ''} not sent" in capsys.readouterr().out) is (
        not_sent is not None
    )
    log.write_text("(1.0) can0 18FF8000##10102\n")
    assert main(given) == (0 if "--fd" in options else 2)
    assert ("no frame to send but 1 of CAN FD; expected --fd" in capsys.readouterr().err) is ("--fd" not in options)
