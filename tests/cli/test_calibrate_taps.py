"""`calibrate --taps`: a log of taps into the machine file, and what is no such log named in one line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pytest

from tests.estimation.test_tap_response import struck
from tests.service.bench import CODEC
from yieldmon.cli.main import main
from yieldmon.files import machine_file
from yieldmon.frames import ELEVATOR_SPEED, IMPACT_SENSOR_SAMPLES, NOT_AVAILABLE, SAMPLES_PER_FRAME, Frame, Value

TAU_S = 0.0056


def log_of(path: Path, samples: np.ndarray, lost: tuple[int, ...] = (), rpm: Callable[[float], Value] = lambda at_s: 0.0) -> str:
    """rpm: of the elevator, told ten times a second."""
    with can.Logger(str(path)) as log:
        for place in range(0, samples.size - SAMPLES_PER_FRAME, SAMPLES_PER_FRAME):
            frame = place // SAMPLES_PER_FRAME
            if frame in lost:
                continue
            values = {f"Sample{i}": float(samples[place + i]) for i in range(SAMPLES_PER_FRAME)}
            signals = {**values, "SampleCounter": frame % 256, "SensorStatus": 0}
            message = CODEC.encode(Frame(1e9 + 1e-3 * (place + SAMPLES_PER_FRAME - 1), IMPACT_SENSOR_SAMPLES, signals))
            message.channel = "can0"
            log.on_message_received(message)
            if frame % (100 // SAMPLES_PER_FRAME) == 0:
                speed = {"ElevatorSpeed": rpm(1e-3 * place)}
                message = CODEC.encode(Frame(message.timestamp + 1e-4, ELEVATOR_SPEED, speed))
                message.channel = "can0"
                log.on_message_received(message)
    return str(path)


def test_a_log_of_taps_becomes_a_machine_file(tmp_path, capsys):
    log, out = log_of(tmp_path / "taps.log", struck(TAU_S)), tmp_path / "machine.yaml"
    assert main(["calibrate", "--taps", log, "--out", str(out)]) == 0
    assert "8 taps\nresponse_s: 5.6" in capsys.readouterr().out
    written, shipped = machine_file.load(out), machine_file.load()
    assert written.sensor.response_s == pytest.approx(TAU_S, rel=0.03)
    assert written.paddle_spacings_m == shipped.paddle_spacings_m
    assert main(["calibrate", "--taps", log, "--machine", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["before_s"] == written.sensor.response_s
    assert document["response_s"] == pytest.approx(TAU_S, rel=0.03)


def test_a_lost_frame_costs_its_tap_alone(tmp_path, capsys):
    samples = struck(TAU_S)
    tap = int(np.argmax(samples[:400]))
    log = log_of(tmp_path / "taps.log", samples, lost=(tap // SAMPLES_PER_FRAME,))
    assert main(["calibrate", "--taps", log, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["taps"] == 7
    assert document["response_s"] == pytest.approx(TAU_S, rel=0.03)


def test_taps_on_a_turning_elevator_are_refused(tmp_path, capsys):
    log, out = log_of(tmp_path / "taps.log", struck(TAU_S), rpm=lambda at_s: 400.0), tmp_path / "machine.yaml"
    assert main(["calibrate", "--taps", log, "--out", str(out)]) == 2
    told = f"yieldmon: {log}: the elevator turns, at up to 400 rpm; expected taps while the elevator rests\n"
    assert capsys.readouterr().err == told
    assert not out.exists()


def test_taps_count_while_the_elevator_rests_alone(tmp_path, capsys):
    whole = log_of(tmp_path / "whole.log", struck(TAU_S, taps=14))
    assert main(["calibrate", "--taps", whole, "--json"]) == 0
    captured = capsys.readouterr()
    assert (json.loads(captured.out)["taps"], captured.err) == (14, "")
    log = log_of(tmp_path / "taps.log", struck(TAU_S, taps=14), rpm=lambda at_s: 400.0 if at_s < 1.2 else 0.0)
    assert main(["calibrate", "--taps", log, "--json"]) == 0
    captured = capsys.readouterr()
    assert 5 <= json.loads(captured.out)["taps"] < 14
    assert re.search(r"^yieldmon: \S*taps.log: 2\.[12] s with a turning elevator are left out\n$", captured.err)


def test_a_log_that_does_not_tell_the_speed_is_named(tmp_path, capsys):
    log = log_of(tmp_path / "taps.log", struck(TAU_S), rpm=lambda at_s: NOT_AVAILABLE)
    assert main(["calibrate", "--taps", log]) == 0
    assert "taps.log: holds no elevator speed; the taps count as given while the elevator rested\n" in capsys.readouterr().err


def test_a_plate_that_rings_writes_nothing_and_ends_with_1(tmp_path, capsys):
    log, out = log_of(tmp_path / "taps.log", struck(TAU_S, damping=0.1, height_mv=300.0)), tmp_path / "machine.yaml"
    assert main(["calibrate", "--taps", log, "--out", str(out)]) == 1
    assert "refused: plate and cell do not answer a tap" in capsys.readouterr().out
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["quiet.log"], "quiet.log: 0 taps that count; expected 5 or more, a second apart"),
        (["speed.log"], "speed.log: holds no sample of the impact sensor"),
        (["missing.log"], "missing.log: No such file"),
        (["quiet.log", "copy.log"], "copy.log: "),
        (["quiet.log", "--robust"], "--robust: applies to a table"),
        (["quiet.log", "--seed", "0"], "--seed: applies to a table"),
        (["quiet.log", "--pulse-shape"], "--pulse-shape: is given together with --taps"),
        (["quiet.log", "--out", "quiet.log"], "quiet.log: "),
    ],
)
def test_what_is_no_log_of_taps_is_named_in_one_line(tmp_path, monkeypatch, capsys, words, problem):
    monkeypatch.chdir(tmp_path)
    log_of(tmp_path / "quiet.log", np.full(4000, 500.0))
    with can.Logger("speed.log") as log:
        message = CODEC.encode(Frame(1e9, ELEVATOR_SPEED, {"ElevatorSpeed": 400.0}))
        message.channel = "can0"
        log.on_message_received(message)
    kept = Path("quiet.log").read_bytes()
    Path("copy.log").write_bytes(kept)
    assert main(["calibrate", "--taps", *words]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert problem in err
    assert Path("quiet.log").read_bytes() == kept
