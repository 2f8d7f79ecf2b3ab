"""Logs in bulk: the rows of the engine fed frame by frame and of the daemon on a bus, to the last bit."""

from __future__ import annotations

import csv
import json
import math
import random
import re
import signal
from collections import Counter
from multiprocessing.context import ForkProcess
from pathlib import Path

import can
import numpy as np
import pytest

from tests.bus.log_files import write
from tests.extras import MF4
from tests.plant_sweeps import window
from tests.service.bench import CODEC, START_S, ZERO_MV, running, traffic
from yieldmon import frames
from yieldmon.bus.bulk import FrameBlock, block_of, concatenate
from yieldmon.bus.codec import Codec
from yieldmon.bus.log_files.doubled_frames import DoubledFrames
from yieldmon.bus.log_files.logs import read_log
from yieldmon.cli import main as cli
from yieldmon.engine.results import PlateCommand, Result, WindowResult
from yieldmon.errors import InputError
from yieldmon.frames import Frame
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.logs.bulk_processing import EndOfLog, process_in_bulk
from yieldmon.service.logs.processing import Summary, hand_over, process_logs
from yieldmon.service.logs.recorded_before import RecordedBefore
from yieldmon.service.logs.tables import COLUMNS
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

LOADED = configuration.load(shipped("config/yieldmon.yaml"))
DURATION_S = 24
DATA = Path(__file__).resolve().parents[1] / "data"


def new_monitor():
    return build_monitor(LOADED.engine, LOADED.machine, LOADED.parameters, LOADED.calibrator)


def messages(duration_s: float = DURATION_S) -> list[can.Message]:
    """Empty, then grain; times as a log keeps them."""
    plan = ((START_S, 14.0, 0.0), (START_S + 14.0, duration_s - 14.0, 60.0))
    found = [CODEC.encode(frame) for start, length, mv in plan for frame in traffic(start, length, mv)]
    for message in found:
        message.channel = "can0"
        message.timestamp = round(message.timestamp, 6)
    return found


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("bulk") / "drive.log", messages())


def rows_of(process, paths, **how):
    rows = []
    summary = process(paths, new_monitor(), CODEC, rows.append, **how)
    return rows, summary


@pytest.mark.parametrize("reads_ahead", [False, True])
def test_the_same_rows_as_frame_by_frame(log, reads_ahead):
    one_by_one, by_one = rows_of(process_logs, [log])
    in_bulk, bulk = rows_of(process_in_bulk, [log], reads_ahead=reads_ahead)
    assert in_bulk == one_by_one
    assert bulk == by_one
    assert in_bulk[-1].total_kg > 1.0


def test_the_same_rows_as_the_daemon_on_a_bus(log, tmp_path):
    in_bulk, _ = rows_of(process_in_bulk, [log])
    with running(tmp_path) as bench:
        for message in read_log(log):
            bench.peer.send(message)
        bench.now_s += DURATION_S
        bench.played()
    with Store(tmp_path / "yieldmon.sqlite") as store:
        live = store.seconds()
    assert len(live) >= DURATION_S - 2
    assert in_bulk[: len(live)] == live


def disturbed(kind: str) -> list[can.Message]:
    """A log whose recorder or bus had its troubles."""
    frames = messages()
    half = len(frames) // 2
    dice = random.Random(20261121)
    if kind == "clock set forward and back":
        for message in frames[half:]:
            message.timestamp += 5000.0
        for message in frames[half + 1500 :]:
            message.timestamp -= 7000.0
    elif kind == "out of order":
        for place in dice.sample(range(len(frames) - 5), 200):
            frames[place], frames[place + 4] = frames[place + 4], frames[place]
    elif kind == "gaps":
        frames = frames[: half // 2] + frames[half : half + 900] + frames[half + 1600 :]
    elif kind == "wrong lengths and not available":
        for place in dice.sample(range(len(frames)), 300):
            data = frames[place].data[:3] if place % 2 else b"\xff" * 8
            frames[place] = can.Message(
                timestamp=frames[place].timestamp, arbitration_id=frames[place].arbitration_id, data=data, channel="can0"
            )
    else:
        frames = [message for message in frames if dice.random() < 0.5]
    return frames


@pytest.mark.parametrize(
    "kind",
    ["clock set forward and back", "out of order", "gaps", "wrong lengths and not available", "half the frames lost"],
)
def test_trouble_changes_nothing_of_that(kind, tmp_path):
    path = write(tmp_path / "bad.log", disturbed(kind))
    assert rows_of(process_in_bulk, [path]) == rows_of(process_logs, [path])


@pytest.mark.parametrize("times", [2, 3])
def test_a_log_whose_every_frame_stands_there_several_times_counts_each_once(times, log, tmp_path):
    """It had no zero and no mass, as if frames were lost."""
    path = write(tmp_path / "copied.log", [message for message in messages() for _ in range(times)])
    rows, summary = rows_of(process_in_bulk, [path])
    assert rows == rows_of(process_in_bulk, [log])[0]
    assert (rows, summary) == rows_of(process_logs, [path])
    assert summary.damages == [f"{path}: each frame stands there again at the same time with the same bytes, and counts once"]
    assert rows[-1].total_kg > 1.0


@pytest.mark.parametrize(("from_s", "to_s", "frames"), [(6.0, 10.0, 1000), (18.0, math.inf, 1500)])
def test_samples_of_a_recorder_whose_clock_stood_are_named(from_s, to_s, frames, tmp_path):
    """Half the mass was missing without a word. python-can's logger gives one time to all frames after the clock was set back."""
    stood = messages()
    for message in stood:
        if START_S + from_s <= message.timestamp < START_S + to_s:
            message.timestamp = START_S + from_s
    path = write(tmp_path / "stood.log", stood)
    rows, summary = rows_of(process_in_bulk, [path])
    assert (rows, summary) == rows_of(process_logs, [path])
    (said,) = summary.damages
    found = re.fullmatch(
        rf"{path}: (\d+) frames of ImpactSensorSamples, \d s of samples, have one time, {START_S + from_s:.3f} s: "
        "the recorder's clock stood, and they are not measured",
        said,
    )
    assert found, said
    assert int(found[1]) == pytest.approx(frames, abs=2)


@pytest.mark.parametrize("step_s", [0.001, 0.1, 1.0])
def test_coarse_times_of_a_recorder_are_no_clock_that_stood(step_s, tmp_path):
    coarse = messages()
    for message in coarse:
        message.timestamp = math.floor(message.timestamp / step_s) * step_s
    _, summary = rows_of(process_in_bulk, [write(tmp_path / "coarse.log", coarse)])
    assert not [line for line in summary.damages if "clock" in line]


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.5), (0.5, 1.0), (0.3, 0.4)])
def test_copies_of_part_of_a_log_count_once(first, last, log, tmp_path):
    """That part had no mass, and only copies at the beginning were found."""
    whole = messages()
    first, last = int(first * len(whole)), int(last * len(whole))
    path = write(tmp_path / "partly.log", [m for k, m in enumerate(whole) for _ in range(2 if first <= k < last else 1)])
    rows, summary = rows_of(process_in_bulk, [path])
    assert rows == rows_of(process_in_bulk, [log])[0]
    assert (rows, summary) == rows_of(process_logs, [path])
    said = "part of the frames stand there again at the same time with the same bytes, and count once"
    assert summary.damages == [f"{path}: {said}"]


@pytest.mark.parametrize("size", [1, 7, 1999, 2000, 2001, 10**6])
def test_copies_are_found_whatever_the_blocks(size):
    whole = messages(16)
    partly = [m for k, m in enumerate(whole) for _ in range(2 if 1000 <= k < 1100 or 1150 <= k < 3500 else 1)][:3000]
    expected = [m for k, m in enumerate(partly) if not k or m is not partly[k - 1]]
    block, doubled = block_of(partly), DoubledFrames()
    found = concatenate(list(doubled.blocks(block.take(slice(k, k + size)) for k in range(0, len(block), size))))
    for column in ("time_s", "can_id", "length", "payload", "channel"):
        assert getattr(found, column).tolist() == getattr(block_of(expected), column).tolist()
    assert list(DoubledFrames().messages(iter(partly))) == expected


def test_frames_of_a_coarse_clock_are_no_copies(tmp_path):
    """An empty plate's samples can be the same from frame to frame, and a clock of 0.1 s gives them one time."""
    frames = messages(16)
    still = next(message.data for message in frames if message.dlc == 8)
    for message in frames:
        message.timestamp = math.floor(10.0 * message.timestamp) / 10.0
    identifier = max(Counter(message.arbitration_id for message in frames).items(), key=lambda item: item[1])[0]
    for message in frames:
        if message.arbitration_id == identifier:
            message.data = still
    path = write(tmp_path / "coarse.log", frames)
    summary = rows_of(process_in_bulk, [path])[1]
    assert summary.ours == len(frames)
    assert not summary.damages


FORMATS = [
    *(".asc", ".blf", ".csv", ".db", ".trc", ".log.gz"),
    pytest.param(".mf4", marks=MF4),
]


@pytest.mark.parametrize("ending", FORMATS)
def test_every_format(ending, tmp_path):
    path = write(tmp_path / f"drive{ending}", messages(16))
    in_bulk, summary = rows_of(process_in_bulk, [path])
    assert in_bulk == rows_of(process_logs, [path])[0]
    assert summary.ours == len(messages(16))


def test_traffic_of_others_is_counted_and_changes_nothing(tmp_path):
    ours, others = messages(16), list(read_log(DATA / "tractor_bus" / "start1.log"))
    others += [can.Message(is_error_frame=True, dlc=8, data=bytes(8)), can.Message(arbitration_id=0x123, is_extended_id=False)]
    for place, message in enumerate(others):
        message.timestamp, message.channel = round(START_S + 16.0 * place / len(others), 6), "can0"
    path = write(tmp_path / "tractor.log", sorted(ours + others, key=lambda message: message.timestamp))
    assert cli.main(["pack", str(path), "--out", str(tmp_path / "tractor.parquet")]) == 0
    expected = rows_of(process_logs, [path])
    assert expected[0] == rows_of(process_in_bulk, [write(tmp_path / "ours.log", ours)])[0]
    assert expected[1].frames == len(ours) + len(others)
    assert rows_of(process_in_bulk, [path]) == expected
    assert rows_of(process_in_bulk, [tmp_path / "tractor.parquet"]) == expected


def test_several_logs_are_one_record(log, tmp_path):
    whole = messages()
    parts = [write(tmp_path / "1.log", whole[:2000]), write(tmp_path / "2.log", whole[2000:])]
    assert rows_of(process_in_bulk, parts, reads_ahead=True)[0] == rows_of(process_in_bulk, [log])[0]


@pytest.mark.parametrize("process", [process_logs, process_in_bulk])
def test_a_pause_between_two_logs_is_no_fault(process, tmp_path):
    """Each day with a break had ClockJumped and FramesLost, as where the logger's clock fails and the bus is overloaded."""
    paths = []
    for start_s in (1.79e9, 1.79e9 + 1801.0):
        paths.append(tmp_path / f"{start_s:.0f}.log")
        with can.Logger(str(paths[-1])) as writer:
            for frame in traffic(start_s, 13.0, 0.0):
                writer.on_message_received(CODEC.encode(frame))
    rows, summary = rows_of(process, paths)
    assert summary.windows == len(rows) == 25
    assert not any("ClockJumped" in row.faults or "FramesLost" in row.faults for row in rows)


@pytest.mark.parametrize("process", [process_logs, process_in_bulk])
def test_a_zero_grows_older_between_two_logs(process, log, tmp_path):
    """Grain ten hours after the zero had the deviation of grain ten seconds after it."""
    deviations = []
    for pause_s in (100.0, 36_000.0):
        later = [CODEC.encode(frame) for frame in traffic(START_S + DURATION_S + pause_s, 6.0, 60.0)]
        for message in later:
            message.channel = "can0"
        rows, _ = rows_of(process, [log, write(tmp_path / f"{pause_s:.0f}.log", later)])
        deviations.append(rows[-1].std_dev_kg_s)
    near, far = deviations
    assert 1.01 * near < far < 3.0 * near


@pytest.mark.parametrize("process", [process_logs, process_in_bulk])
def test_what_two_loggers_recorded_of_one_bus_counts_once(process, log, tmp_path):
    """The second one from the middle on, by a clock that is 3 ms late."""
    early, late = messages(), messages()
    for message in late:
        message.timestamp = round(message.timestamp + 0.003, 6)
    parts = [write(tmp_path / "1.log", early[:6000]), write(tmp_path / "2.log", late[3500:])]
    rows, summary = rows_of(process, parts)
    whole, _ = rows_of(process, [log])
    assert rows[-1].total_kg == pytest.approx(whole[-1].total_kg, rel=5e-3)
    assert len(rows) == len(whole)
    (said,) = summary.damages
    assert f"it holds the frames of {parts[0]} again (+3 ms); left out" in said


@pytest.mark.parametrize("process", [process_logs, process_in_bulk])
@pytest.mark.parametrize("dated", [True, False], ids=["dated", "recorders without a clock"])
def test_a_second_logger_that_stamps_unsteadily_adds_nothing(process, dated, log, tmp_path):
    """Its clock is 21 s late; nothing of what it holds comes after the end of the first."""
    rng = np.random.default_rng(77)
    early, late = messages(), messages()
    begun_s = 0.0 if dated else float(np.floor(early[0].timestamp))
    for message in early:
        message.timestamp = round(message.timestamp - begun_s, 6)
    for message in late:
        message.timestamp = round(message.timestamp - begun_s + 21.0 + rng.uniform(0.0, 2e-4), 6)
    parts = [write(tmp_path / "1.log", early), write(tmp_path / "2.log", late)]
    rows, summary = rows_of(process, parts)
    whole, _ = rows_of(process, parts[:1])
    assert (len(rows), rows[-1].total_kg) == (len(whole), pytest.approx(whole[-1].total_kg, rel=1e-9))
    (said,) = summary.damages
    assert f"it holds the frames of {parts[0]} again (+21000 ms); left out" in said


@pytest.mark.parametrize("process", [process_logs, process_in_bulk])
@pytest.mark.parametrize(("apart_s", "clock"), [(3600.7, "3601 s later"), (-7200.2, "7200 s earlier")])
def test_a_second_logger_whose_clock_is_far_off_is_named(process, apart_s, clock, tmp_path):
    """It records from the middle on and its clock runs 50 ppm fast; which clock is right is not known, so nothing is left out."""
    early, late = messages(60.0), messages(60.0)
    begun_s = late[0].timestamp
    for message in late:
        message.timestamp = round(message.timestamp + apart_s + 50e-6 * (message.timestamp - begun_s), 6)
    parts = [write(tmp_path / "1.log", early[:12000]), write(tmp_path / "2.log", late[4000:])]
    rows, summary = rows_of(process, parts)
    each = [rows_of(process, [part])[0] for part in parts]
    assert len(rows) == pytest.approx(sum(map(len, each)), abs=2)
    (said,) = summary.damages
    assert re.fullmatch(
        rf"{parts[1]}: from \S+Z to \S+Z it holds the frames of {parts[0]} again, by its clock {clock}; one clock is wrong, and "
        "both are measured: leave one out, or correct its times",
        said,
    )


@pytest.mark.parametrize("process", [process_logs, process_in_bulk])
@pytest.mark.parametrize(
    "cut", [(3000, 3000, 0.0), (3000, 3000, 7200.0), (4000, 3500, 0.003)], ids=["at once", "paused", "again"]
)
def test_packed_logs_are_measured_as_the_logs(process, cut, tmp_path):
    """Logs that follow each other at once or after hours, or overlap as two loggers' do, packed twice over: the same rows."""
    end, begin, later_s = cut
    early, late = messages(), messages()
    for message in late:
        message.timestamp = round(message.timestamp + later_s, 6)
    parts = [str(write(tmp_path / "1.log", early[:end])), str(write(tmp_path / "2.log", late[begin:]))]
    packed, again = (str(tmp_path / f"{name}.parquet") for name in ("packed", "again"))
    assert cli.main(["pack", *parts, "--out", packed]) == 0
    assert cli.main(["pack", packed, "--out", again]) == 0
    rows, summary = rows_of(process, parts)
    for file in (packed, again):
        found, known = rows_of(process, [file])
        assert found == rows
        assert known.frames == summary.frames
        said = [text.replace(f"{file}, log 2", parts[1]).replace(file, parts[0]) for text in known.damages]
        assert said == summary.damages


@pytest.mark.parametrize(("noise", "said"), [(0, 0), (64, 1)])
def test_a_counter_beside_samples_that_stand_still_is_no_second_recording(noise, said):
    """A sensor that is off sends the same with each count of 16 bits."""
    count = np.arange(30_000, dtype=np.uint64)
    samples = np.random.default_rng(5).integers(0, noise + 1, (3, count.size)).astype(np.uint64)
    payload = count | samples[0] << np.uint64(16) | samples[1] << np.uint64(32) | samples[2] << np.uint64(48)
    recorded, lines = RecordedBefore(), []
    for place in (0, 1):
        times_s = START_S + 36_000.0 * place + 0.01 * count
        can_id, length, channel = (np.full(count.size, *of) for of in ((0x123, np.uint32), (8, np.uint8), (0, np.int32)))
        block = FrameBlock(times_s, can_id, length, payload, channel, ("can0",))
        recorded.begin(f"{place}.log")
        recorded.take(block, np.arange(count.size))
        lines += recorded.at_other_times()
    assert len(lines) == said


@pytest.mark.parametrize("reads_ahead", [False, True])
def test_a_log_that_cannot_be_read(tmp_path, reads_ahead):
    with pytest.raises(InputError, match=r"gone\.log"):
        rows_of(process_in_bulk, [tmp_path / "gone.log"], reads_ahead=reads_ahead)


def not_ours() -> list[can.Message]:
    return [can.Message(timestamp=float(n), arbitration_id=0x123, is_extended_id=False, data=b"x") for n in range(3)]


def of_wrong_length() -> list[can.Message]:
    return [can.Message(timestamp=m.timestamp, arbitration_id=m.arbitration_id, data=m.data[:3]) for m in messages()[:2]]


NOTHING = [
    (list, "no frame at all"),
    (not_ours, "none of 3 frames is one that yieldmon takes in"),
    (of_wrong_length, "none of 2 frames is one that yieldmon takes in, 2 of wrong length"),
]


@pytest.mark.parametrize("ending", [".log", ".blf", ".csv"])
@pytest.mark.parametrize(("content", "problem"), NOTHING)
def test_a_log_with_nothing_to_measure_is_refused(content, problem, ending, tmp_path, capsys):
    path = write(tmp_path / f"nothing{ending}", content())
    out = tmp_path / "out.csv"
    assert cli.main(["process", str(path), "--out", str(out)]) == 2
    assert capsys.readouterr().err == f"yieldmon: {path}: {problem}; expected a log with sensor, speed and plate frames\n"
    assert not out.exists()
    with pytest.raises(InputError, match=problem):
        rows_of(process_logs, [path])


def tractor() -> list[can.Message]:
    """Position and speed of a tractor, and an elevator's speed, but no impact sensor."""
    position = [can.Message(timestamp=float(n), arbitration_id=0x18FEF31C, data=bytes(range(8))) for n in range(20)]
    speed = [Frame(float(n), frames.ELEVATOR_SPEED, {"ElevatorSpeed": 400.0}) for n in range(20)]
    return position + [Codec().encode(frame) for frame in speed]


def test_a_log_without_an_impact_sensor_is_refused(tmp_path, capsys):
    path, out = write(tmp_path / "tractor.log", tractor()), tmp_path / "out.csv"
    assert cli.main(["process", str(path), "--out", str(out)]) == 2
    problem = f"yieldmon: {path}: no impact sensor: none of 40 frames brings its samples; expected `signals` in the configuration"
    assert capsys.readouterr().err.startswith(problem)
    assert not out.exists()
    with pytest.raises(InputError, match="no impact sensor"):
        rows_of(process_logs, [path])


def test_ctrl_c_is_left_to_the_parent_from_the_readers_first_moment(log, monkeypatch):
    """A terminal sends it to both; the reader would end with a traceback."""
    begin = ForkProcess.run

    def interrupted(process):
        signal.raise_signal(signal.SIGINT)
        begin(process)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(ForkProcess, "run", interrupted)
    try:
        assert rows_of(process_in_bulk, [log], reads_ahead=True)[1].damages == []
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_empty_log_among_others_changes_nothing(log, tmp_path):
    empty = write(tmp_path / "empty.log", [])
    assert rows_of(process_in_bulk, [empty, log, empty])[0] == rows_of(process_in_bulk, [log])[0]


def test_progress_is_reported(log):
    seen = []
    _, summary = rows_of(process_in_bulk, [log], progress=seen.append)
    assert sum(item.frames for item in seen if not isinstance(item, EndOfLog)) == summary.frames
    assert seen[-1] == EndOfLog(str(log), [])


def test_each_log_for_itself(log, tmp_path, capsys):
    other = write(tmp_path / "short.log", messages(16))
    out = tmp_path / "tables"
    assert cli.main(["process", str(log), str(other), "--separate", "--jobs", "2", "--out", str(out), "--json"]) == 0
    summaries = json.loads(capsys.readouterr().out)
    assert [summary["windows"] for summary in summaries.values()] == [DURATION_S - 1, 15]
    alone = tmp_path / "alone.csv"
    assert cli.main(["process", str(log), "--jobs", "1", "--out", str(alone)]) == 0
    assert (out / "drive.csv").read_bytes() == alone.read_bytes()


WRONG = [
    (["--jobs", "0", "--out", "x.csv"], "yieldmon: --jobs: is 0; expected a whole number from 1"),
    (["--separate", "--out", "-"], "yieldmon: --out: is standard output; expected a folder, with --separate"),
    (["--json", "--out", "-"], "yieldmon: --json: standard output is taken by --out -; expected a file for --out"),
]


@pytest.mark.parametrize(("words", "line"), WRONG)
def test_bad_usage(log, words, line, capsys):
    assert cli.main(["process", str(log), *words]) == 2
    assert capsys.readouterr().err.strip() == line


def test_kinds_of_table_say_the_same(log, tmp_path):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    paths = [tmp_path / f"t{ending}" for ending in (".csv", ".jsonl", ".parquet")]
    for path in paths:
        assert cli.main(["process", str(log), "--out", str(path)]) == 0
    lines = [json.loads(line) for line in paths[1].read_text(encoding="utf-8").splitlines()]
    assert pyarrow.read_table(paths[2]).to_pylist() == lines
    with paths[0].open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    assert [float(row["total_kg"]) for row in rows] == [line["total_kg"] for line in lines]
    assert lines[-1]["zero_mv"] == pytest.approx(ZERO_MV, abs=2.0)


def test_all_that_the_monitor_hands_back_can_be_asked_for_beside_the_rows() -> None:
    results: list[Result] = [WindowResult(window(mass_kg=3.0)), PlateCommand(()), WindowResult(window(mass_kg=4.0))]
    taken: list[SecondRow] = []
    seen: list[Result] = []
    summary = Summary()
    hand_over(results, taken.append, summary, seen.extend)
    assert seen == results
    assert [(row.number, row.mass_kg) for row in taken] == [(1, 3.0), (2, 4.0)]
    assert summary.windows == 2
    hand_over(results, taken.append, summary)
    assert [row.number for row in taken] == [1, 2, 3, 4]
