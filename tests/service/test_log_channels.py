"""Recordings of several channels: inputs that come on two at the same times are refused by name, and a channel can be chosen."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.fleet import logs
from tests.service.bench import CODEC
from yieldmon.cli.main import main
from yieldmon.engine.settings import EngineSettings, GateSettings
from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.logs import measured_loads, tap_samples, weighed_waves
from yieldmon.service.logs.processing import process_logs

CONFIGURED = configuration.load(shipped("config/yieldmon.yaml"))
IMPACT, SPEED, MOISTURE = "08FF1081", "0CFF1180", "18FF1380"
ALL = frozenset({IMPACT, SPEED, "0CFF1282", MOISTURE})
LATE_S = 0.0003
SWITCH_S = logs.START_S + 14.0
Row = tuple[float, str, str]


def sent(channel: str, identifiers: frozenset[str] = ALL, first_s: float = 0.0, last_s: float = float("inf")) -> list[Row]:
    """Time, identifier and line of the traffic's frames, on can1 a moment later."""
    rows = []
    for line in logs.text().splitlines():
        time, _, frame = line.split(" ")
        time_s = float(time[1:-1]) + LATE_S * (channel == "can1")
        if frame.partition("#")[0] in identifiers and first_s <= time_s < last_s:
            rows.append((time_s, frame, f"({time_s:.6f}) {channel} {frame}\n"))
    return rows


def written(folder: Path, *files: list[Row]) -> list[str]:
    paths = [folder / f"{number}.log" for number in range(len(files))]
    for path, rows in zip(paths, files, strict=True):
        path.write_text("".join(line for _, _, line in sorted(rows)))
    return list(map(str, paths))


def bridged(folder: Path, identifiers: frozenset[str] = ALL) -> list[str]:
    return written(folder, sent("can0") + sent("can1", identifiers))


def processed(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str) -> dict[str, Any]:
    assert main(["process", *arguments, "--out", str(folder / "o.csv"), "--force", "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([sent("can0") + sent("can1")], "ImpactSensorSamples"),
        ([sent("can0"), sent("can1")], "ImpactSensorSamples"),
    ],
    ids=["bridged", "files of two loggers"],
)
def test_inputs_on_two_channels_are_refused_and_one_can_be_chosen(
    files: list[list[Row]], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bridged buses gave 0 kg, the files of two loggers twice the mass."""
    paths = written(tmp_path, *files)
    said = f"{message} comes on channels can0 and can1 at the same times"
    assert main(["process", *paths, "--out", str(tmp_path / "o.csv")]) == 2
    error = capsys.readouterr().err
    assert f"{paths[-1]}: {said}" in error
    assert "--channel can0 or can1" in error
    with pytest.raises(InputError, match=said):
        process_logs(paths, monitor_of(CONFIGURED, drives_plate=False), CODEC, lambda row: None)
    alone = processed(capsys, tmp_path, logs.write(tmp_path / "alone" / "a.log").as_posix())["total_mass_kg"]
    assert alone > 10.0
    assert processed(capsys, tmp_path, *paths, "--channel", "can0")["total_mass_kg"] == alone
    by_frame = process_logs(
        paths, chosen := monitor_of(CONFIGURED, drives_plate=False), CODEC, lambda row: None, channels=["can0"]
    )
    assert chosen.totals.total_kg == alone
    assert by_frame.ours == len(sent("can0"))


@pytest.mark.parametrize(
    "files",
    [
        [sent("can0", ALL - {IMPACT}) + sent("can1", frozenset({IMPACT}))],
        [sent("can0", last_s=SWITCH_S) + sent("can1", first_s=SWITCH_S)],
        [sent("can0", last_s=SWITCH_S), sent("can1", first_s=SWITCH_S)],
        [sent("can0") + sent("can1", frozenset({MOISTURE}))],
    ],
    ids=["sensor on a bus of its own", "another name in the middle", "another name in the next log", "moisture forwarded"],
)
def test_other_recordings_of_two_channels_are_measured(
    files: list[list[Row]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = processed(capsys, tmp_path, logs.write(tmp_path / "alone" / "a.log").as_posix())["total_mass_kg"]
    assert processed(capsys, tmp_path, *written(tmp_path, *files))["total_mass_kg"] == pytest.approx(alone, rel=2e-3)


def test_a_speed_that_a_gateway_forwards_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An engine's speed gives the total that it gives alone, one of a stated rate none."""
    (tmp_path / "c.yaml").write_text(
        "signals:\n  elevator_speed: {dbc: j1939.dbc, message: EEC1, signal: EngineSpeed, ratio: 0.2}\n"
    )
    engine = [
        (at, "", line.partition(SPEED)[0] + "0CF00400#F0FFFF803EFFFFFF\n") for at, _, line in sent("can0", frozenset({SPEED}))
    ]
    rest = sent("can0", ALL - {SPEED})
    forwarded = [(at + LATE_S, "", line.replace("can0", "can1")) for at, _, line in engine]
    (log,) = written(tmp_path, [*rest, *engine, *forwarded])
    found = processed(capsys, tmp_path, log, "--config", str(tmp_path / "c.yaml"))
    assert found["damages"] == [f"{log}: EEC1 comes on channels can0 and can1 at the same times; --channel takes one"]
    one = processed(capsys, tmp_path, log, "--config", str(tmp_path / "c.yaml"), "-c", "can0")
    assert one["damages"] == []
    assert found["total_mass_kg"] == pytest.approx(one["total_mass_kg"], rel=2e-3)
    assert one["total_mass_kg"] > 10.0
    (log,) = bridged(tmp_path, frozenset({SPEED}))
    said = [f"{log}: ElevatorSpeed comes on channels can0 and can1 at the same times; --channel takes one"]
    assert processed(capsys, tmp_path, log)["damages"] == said
    by_frame = process_logs([log], monitor_of(CONFIGURED, drives_plate=False), CODEC, lambda row: None)
    assert by_frame.damages == said


def test_inputs_in_logs_apart_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One candump for each interface: they were read one after the other, and gave 0 kg for want of a speed."""
    paths = written(tmp_path, sent("can0", ALL - {IMPACT}), sent("can1", frozenset({IMPACT})))
    said = f"{paths[1]}: has ImpactSensorSamples and no ElevatorSpeed, which {paths[0]} has at the same times"
    assert main(["process", *paths, "--out", str(tmp_path / "o.csv")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert f"sort -m {paths[0]} {paths[1]} > both.log" in error
    with pytest.raises(InputError, match="has ImpactSensorSamples and no ElevatorSpeed"):
        process_logs(paths, monitor_of(CONFIGURED, drives_plate=False), CODEC, lambda row: None)
    first, later = sent("can0", last_s=SWITCH_S), sent("can0", ALL - {IMPACT}, first_s=SWITCH_S)
    assert main(["process", *written(tmp_path, first, later), "--out", str(tmp_path / "o.csv")]) == 0


#: These logs are of a harvest.
ALWAYS_AT_REST = EngineSettings(gate=GateSettings(min_turning_rpm=1000.0))
READERS: dict[str, Callable[[list[str], configuration.Configuration], object]] = {
    "weighed loads": measured_loads.read,
    "waves": weighed_waves.read,
    "taps": lambda paths, configured: tap_samples.read(paths, configured.signals, configured.log_channels, ALWAYS_AT_REST),
}


@pytest.mark.parametrize("reader", READERS)
def test_what_learns_from_logs_takes_the_configurations_channel(reader: str, tmp_path: Path) -> None:
    paths = bridged(tmp_path)
    with pytest.raises(InputError, match="ImpactSensorSamples comes on channels can0 and can1"):
        READERS[reader](paths, CONFIGURED)
    (tmp_path / "c.yaml").write_text("bus: {log_channels: [can1]}")
    assert READERS[reader](paths, configuration.load(tmp_path / "c.yaml"))


def test_a_channel_that_is_not_there_is_refused_with_those_that_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for verb in (
        ["process", *bridged(tmp_path), "--out", str(tmp_path / "o.csv")],
        ["pack", *bridged(tmp_path), "--out", "o.parquet"],
    ):
        assert main([*verb, "-c", "can7"]) == 2
        error = capsys.readouterr().err
        assert "channel can7" in error
        assert verb[0] == "pack" or "the frames are of can0, can1" in error


def test_check_config_takes_a_channel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (log,) = bridged(tmp_path)
    assert main(["check-config", "--log", log]) == 2
    assert "ImpactSensorSamples comes on channels can0 and can1" in capsys.readouterr().err
    assert main(["check-config", "--log", log, "-c", "can1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["signals"]["impact"]["rate_hz"] == pytest.approx(1000.0, rel=1e-3)


@pytest.mark.parametrize("verb", ["signals", "monitor"])
def test_rates_are_said_to_be_of_several_channels(verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def rate_hz(*arguments: str) -> tuple[float, str]:
        assert main([verb, *bridged(tmp_path), *(["--once"] if verb == "monitor" else []), "--json", *arguments]) == 0
        said = capsys.readouterr()
        rows: Sequence[dict[str, Any]] = json.loads(said.out)["messages" if verb == "signals" else "rows"]
        return next(row["rate_hz"] for row in rows if row["id"].endswith("8FF1081")), said.err

    both_hz, said = rate_hz()
    assert both_hz == pytest.approx(500.0, rel=0.02)
    assert "4 identifiers appear on several channels (can0, can1)" in said
    one_hz, said = rate_hz("-c", "can1")
    assert one_hz == pytest.approx(250.0, rel=0.02)
    assert said == ""


def test_a_mapping_is_written_of_one_channel(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of two the impact sensor's rate was twice its own."""
    (log,), out = bridged(tmp_path), tmp_path / "m.yaml"
    assert main(["signals", log, "--write", str(out)]) == 2
    assert "appear on several channels (can0, can1), which would make the rates wrong" in capsys.readouterr().err
    assert not out.exists()
    assert main(["signals", log, "--write", str(out), "-c", "can0"]) == 0


def test_a_channel_of_a_log_is_packed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyarrow")
    out = str(tmp_path / "o.parquet")
    assert main(["pack", *bridged(tmp_path), "--out", out, "-c", "can1"]) == 0
    assert processed(capsys, tmp_path, out)["frames"] == len(sent("can1"))


def test_a_fleet_measures_one_of_two_loggers_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("dask")
    day = tmp_path / "logs" / "m" / "d"
    day.mkdir(parents=True)
    written(day, sent("can0"), sent("can1"))
    run = ["fleet", "run", str(tmp_path / "logs"), "--workers", "0", "--json", "--out"]
    assert main([*run, str(tmp_path / "a")]) == 1
    document = json.loads(capsys.readouterr().out)
    assert ["comes on channels can0 and can1" in item["problem"] for item in document["poisoned"]] == [True]
    assert document["done"] == 1
    assert main([*run, str(tmp_path / "b"), "--channel", "can1"]) == 0
