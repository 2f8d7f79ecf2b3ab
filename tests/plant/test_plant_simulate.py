"""The verb simulate: into logs, onto a bus, and its refusals."""

from __future__ import annotations

import csv
import json
import threading

import can
import pytest

from yieldmon.bus.codec import Codec
from yieldmon.cli.main import main
from yieldmon.frames import PLATE_ACTUATOR_COMMAND, PLATE_ACTUATOR_FEEDBACK, CommandMode, Frame
from yieldmon.plant.combine import TRUTH_COLUMNS

SCENARIO = """
duration_s: 4
flow: {pieces: [{kind: steady, duration_s: 10, flow_kg_s: 9}]}
"""


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SCENARIO)
    return str(path)


def decoded(path):
    codec = Codec()
    with can.LogReader(path) as reader:
        return [codec.decode(message) for message in reader]


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc", ".db"])
def test_a_log_holds_every_frame_and_the_truth_stands_beside_it(scenario, tmp_path, capsys, suffix):
    log, truth = tmp_path / f"run{suffix}", tmp_path / "truth.csv"
    assert main(["simulate", "--scenario", scenario, "--log", str(log), "--truth", str(truth), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    stream = decoded(log)
    assert len(stream) == sum(summary["frames"].values())
    assert summary["frames"]["ImpactSensorSamples"] == 1000
    with open(truth, newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(TRUTH_COLUMNS)
    assert len(rows) == 4
    assert float(rows[-1]["total_mass_kg"]) == pytest.approx(summary["total_mass_kg"], rel=1e-8)


def test_a_log_is_the_same_twice_and_another_with_another_seed(scenario, tmp_path):
    content = []
    for name, seed in (("a.log", "3"), ("b.log", "3"), ("c.log", "4")):
        assert main(["simulate", "--scenario", scenario, "--log", str(tmp_path / name), "--seed", seed]) == 0
        content.append((tmp_path / name).read_bytes())
    assert content[0] == content[1] != content[2]


def test_duration_and_start_time(scenario, tmp_path):
    log = tmp_path / "run.log"
    assert main(["simulate", "--scenario", scenario, "--log", str(log), "--duration", "2", "--start-time", "1000"]) == 0
    times = [frame.time_s for frame in decoded(log)]
    assert times[0] == pytest.approx(1000.004)
    assert times[-1] == pytest.approx(1002.0)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--scenario", "no-such"], ["no-such", "neither a file nor shipped"]),
        (["--scenario", "missing.yaml"], ["missing.yaml"]),
        (["--duration", "0", "--log", "x.log"], ["--duration", "is 0"]),
        (["--seed", "-1", "--log", "x.log"], ["--seed", "-1"]),
        (["--machine", "sprocket-99", "--log", "x.log"], ["sprocket-99"]),
        (["--log", "x.wav", "--duration", "1"], ["x.wav"]),
    ],
)
def test_what_cannot_be_used_gets_one_line_and_exit_2(arguments, parts, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    for part in parts:
        assert part in captured.err


def test_on_a_bus_it_keeps_time_and_follows_commands(scenario, capsys):
    codec = Codec()
    done = threading.Event()
    received: list[can.Message] = []
    with can.Bus(interface="virtual", channel="simulate-test") as bus:

        def follow():
            sent = 0
            while not done.is_set():
                message = bus.recv(timeout=0.05)
                if message is None:
                    continue
                received.append(message)
                frame = codec.decode(message)
                if frame is not None and frame.message == PLATE_ACTUATOR_FEEDBACK:
                    signals = {
                        "TargetPlateAngle": 60.0,
                        "CommandMode": int(CommandMode.GO_TO_ANGLE),
                        "CommandCounter": sent % 256,
                    }
                    bus.send(codec.encode(Frame(0.0, PLATE_ACTUATOR_COMMAND, signals)))
                    sent += 1

        listener = threading.Thread(target=follow)
        listener.start()
        try:
            code = main(
                [
                    "simulate",
                    "--scenario",
                    scenario,
                    "--duration",
                    "3",
                    "-i",
                    "virtual",
                    "-c",
                    "simulate-test",
                    "--json",
                ]
            )
        finally:
            done.set()
            listener.join()
    assert code == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["frames"]["ImpactSensorSamples"] == 750
    angles = [f.signals["PlateAngle"] for f in map(codec.decode, received) if f and f.message == PLATE_ACTUATOR_FEEDBACK]
    assert angles[0] == pytest.approx(70.0, abs=0.5)
    assert angles[-1] == pytest.approx(60.0, abs=0.5)
