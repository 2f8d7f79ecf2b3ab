"""A stored day measured again, and what `process` says of logs that begin in grain, have gaps, overlap or come twice."""

from __future__ import annotations

import gzip
import itertools
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from math import hypot
from pathlib import Path

import can
import pytest

from tests.schema_check import problems
from tests.service.bench import CODEC, EMPTY_MV, GRAIN_MV, START_S, ZERO_MV, traffic
from tests.service.bench import messages as messages_of
from yieldmon.bus.log_files.logs import read_log
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.frames import OperatingState
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.logs.processing import process_logs
from yieldmon.service.logs.recorded import read_seconds
from yieldmon.service.logs.reprocessing import recomputed
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

LOADED = configuration.load(shipped("config/yieldmon.yaml"))
STORE = Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite"


def write(path: Path, *parts: tuple[float, float, float]) -> Path:
    """A candump log of (start after START_S, duration s, mean mV above the zero)."""
    with can.CanutilsLogWriter(str(path)) as writer:
        for start_s, duration_s, force_mv in parts:
            for frame in traffic(START_S + start_s, duration_s, force_mv):
                message = CODEC.encode(frame)
                message.timestamp, message.channel = frame.time_s, "can0"
                writer.on_message_received(message)
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return {
        "whole": write(folder / "whole.log", (0.0, 14.0, 0.0), (14.0, 8.0, 60.0)),
        "grain": write(folder / "grain.log", (0.0, 8.0, 60.0)),
        "later": write(folder / "later.log", (40.0, 6.0, 60.0)),
    }


def process(capsys, tmp_path, *words: object) -> tuple[int, str, str]:
    code = main(["process", *map(str, words), "--out", str(tmp_path / "out.csv"), "--force", "--jobs", "1"])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def again(capsys, tmp_path, *words: object) -> dict:
    code, out, err = process(capsys, tmp_path, STORE, *words, "--json")
    assert code == 0, err
    document = json.loads(out)
    assert problems(document, "process-store") == []
    return document


@pytest.fixture
def own(tmp_path) -> Path:
    """The parameters that measured the store."""
    shutil.copy(STORE, tmp_path / "s.sqlite")
    with Store(tmp_path / "s.sqlite") as store:
        known = parameter_file.from_document(store.parameter_versions()[-1].document, "")
    parameter_file.save(known, tmp_path / "own.yaml")
    return tmp_path / "own.yaml"


def test_a_store_measured_again_with_its_own_parameters_weighs_the_same(capsys, tmp_path, own) -> None:
    found = again(capsys, tmp_path, "--params", own)
    assert found["before_mass_kg"] == pytest.approx(sum(row.mass_kg for row in read_seconds(STORE)))
    assert found["total_mass_kg"] == pytest.approx(found["before_mass_kg"], rel=2e-3)
    assert sum(load["after_kg"] for load in found["loads"]) == pytest.approx(found["total_mass_kg"])
    rows = read_seconds(tmp_path / "out.csv")
    assert rows[-1].total_kg == pytest.approx(found["total_mass_kg"])
    assert len(rows) == found["windows"]


def test_a_store_measured_again_follows_parameters_zero_and_delay(capsys, tmp_path, own) -> None:
    before = again(capsys, tmp_path, "--params", own)["total_mass_kg"]
    known = parameter_file.load(own)
    heavier = replace(known, values={**known.values, "restitution": known.values["restitution"] - 0.15})
    parameter_file.save(heavier, tmp_path / "heavier.yaml")
    assert again(capsys, tmp_path, "--params", tmp_path / "heavier.yaml")["total_mass_kg"] > 1.05 * before
    zero_mv = next(row.zero_mv for row in read_seconds(STORE) if row.zero_mv is not None and row.mass_kg > 0.0)
    assert again(capsys, tmp_path, "--params", own, "--zero-mv", zero_mv)["total_mass_kg"] == pytest.approx(before, rel=0.02)
    assert again(capsys, tmp_path, "--params", own, "--zero-mv", zero_mv - 5.0)["total_mass_kg"] > before
    again(capsys, tmp_path, "--delay", 7)
    moved, placed = read_seconds(tmp_path / "out.csv"), read_seconds(STORE)
    assert [row.ground_speed_m_s for row in moved[7:20]] == [row.ground_speed_m_s for row in placed[:13]]
    assert moved[0].ground_speed_m_s is None


@pytest.mark.parametrize(("step_s", "known"), [(0.0, True), (1.5, True), (60.0, False), (-3600.0, False)])
def test_a_place_is_not_moved_over_a_step_of_the_clock(own, step_s: float, known: bool) -> None:
    rows, loaded = read_seconds(STORE)[:40], configuration.load(shipped("config/yieldmon.yaml"), {})
    rows = [replace(row, time_s=row.time_s + step_s * (i >= 20), ground_speed_m_s=1.0 + i) for i, row in enumerate(rows)]
    found = recomputed(rows, loaded.machine, parameter_file.load(own), loaded.engine, sets={}, delay_s=7)
    assert [row.ground_speed_m_s for row in found.rows[20:27]] == ([14.0 + i for i in range(7)] if known else [None] * 7)
    assert [row.ground_speed_m_s for row in found.rows[27:]] == [21.0 + i for i in range(13)]


def test_a_contested_second_has_no_mass_whatever_the_zero(own) -> None:
    rows, loaded = read_seconds(STORE), configuration.load(shipped("config/yieldmon.yaml"), {})
    place = max(range(len(rows)), key=lambda i: rows[i].mass_kg)
    zero_mv, before_kg = rows[place].zero_mv, rows[place].mass_kg
    for surplus_frames, expected_kg in ((0, pytest.approx(before_kg, rel=0.02)), (3, 0.0)):
        rows[place] = replace(rows[place], surplus_frames=surplus_frames, mass_kg=0.0)
        found = recomputed(rows, loaded.machine, parameter_file.load(own), loaded.engine, sets={}, zero_mv=zero_mv)
        assert found.rows[place].mass_kg == expected_kg


def widened(row: SecondRow, by: float) -> SecondRow:
    """A row whose flow is by so much less sure, relatively, beside its noise."""
    if not (row.std_dev_kg_s and row.mass_flow_kg_s and row.force_n and row.force_std_dev_n):
        return row
    noise_kg_s = row.mass_flow_kg_s * row.force_std_dev_n / row.force_n
    return replace(row, std_dev_kg_s=hypot(row.std_dev_kg_s, by * row.mass_flow_kg_s), noise_std_dev_kg_s=noise_kg_s)


def relative(rows: Sequence[SecondRow]) -> list[float | None]:
    """Standard deviations of the flows of seconds with grain, over the flows."""
    counted = [row for row in rows if row.mass_kg > 1.0 and row.mass_flow_kg_s]
    return [None if row.std_dev_kg_s is None else row.std_dev_kg_s / row.mass_flow_kg_s for row in counted]


def test_what_is_neither_noise_nor_of_the_parameters_is_in_the_new_deviation_too(own) -> None:
    """5 % by zero, moisture and the model, which the rows do not hold apart; without the rows' parameters it is not known."""
    loaded, parameters = configuration.load(shipped("config/yieldmon.yaml"), {}), parameter_file.load(own)
    sets = {row.parameter_version: parameters for row in read_seconds(STORE)}
    plain = recomputed(read_seconds(STORE), loaded.machine, parameters, loaded.engine, sets=sets).rows
    wider = [widened(row, 0.05) for row in plain]
    still = next(i for i, row in enumerate(wider) if not row.mass_kg)
    wider[still] = replace(wider[still], mass_flow_kg_s=0.0, std_dev_kg_s=0.1, noise_std_dev_kg_s=0.05)
    heavier = replace(parameters, values={**parameters.values, "restitution": parameters.values["restitution"] - 0.15})
    for given in (parameters, heavier):
        before = relative(recomputed(plain, loaded.machine, given, loaded.engine, sets=sets).rows)
        after = relative(recomputed(wider, loaded.machine, given, loaded.engine, sets=sets).rows)
        assert after == pytest.approx([hypot(one, 0.05) for one in before], rel=0.01)
        assert set(relative(recomputed(wider, loaded.machine, given, loaded.engine, sets={}).rows)) == {None}


@pytest.mark.parametrize("unknown", ["zero_mv", "force_n"])
def test_a_second_that_another_zero_cannot_measure_again_stays_as_it_was(own, unknown: str) -> None:
    rows, loaded = read_seconds(STORE), configuration.load(shipped("config/yieldmon.yaml"), {})
    place = max(range(len(rows)), key=lambda i: rows[i].mass_kg)
    zero_mv = rows[place].zero_mv
    whole = recomputed(rows, loaded.machine, parameter_file.load(own), loaded.engine, sets={}, zero_mv=zero_mv)
    rows[place] = replace(rows[place], **{unknown: None})
    found = recomputed(rows, loaded.machine, parameter_file.load(own), loaded.engine, sets={}, zero_mv=zero_mv)
    assert found.rows[place].mass_kg == rows[place].mass_kg > 0.0
    assert found.unusable == whole.unusable + 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((STORE,), "is a store, measured already; expected --params, --estimator, --zero-mv or"),
        (
            (STORE, STORE.with_name("x.sqlite"), "--delay", 3),
            "names a store together with other sources; expected one store alone",
        ),
        ((STORE, "--delay", 900), "--delay: is 900; expected 0 to 60 s"),
        ((STORE, "--params", "none.yaml"), "none.yaml"),
        ((STORE, "--zero-mv", -4), "--zero-mv: is -4"),
    ],
)
def test_what_cannot_be_measured_again_is_one_line(capsys, tmp_path, words, said) -> None:
    code, _, err = process(capsys, tmp_path, *words)
    assert (code, err.count("\n")) == (2, 1)
    assert said in err
    assert not (tmp_path / "out.csv").exists()


def test_a_log_whose_empty_plate_shakes_like_grain_says_so_and_takes_a_known_zero(capsys, tmp_path) -> None:
    scenario = tmp_path / "shaken.yaml"
    scenario.write_text(
        "{duration_s: 60, sensor: {vibration_paddle_n: 8.0}, flow: {pieces: [{kind: steady, duration_s: 25, flow_kg_s: 0}, "
        "{kind: steady, duration_s: 35, flow_kg_s: 10}]}}"
    )
    log = tmp_path / "shaken.log"
    assert main(["simulate", "--scenario", str(scenario), "--seed", "417", "--log", str(log)]) == 0
    capsys.readouterr()
    _, _, err = process(capsys, tmp_path, log)
    assert "or its paddles shake the plate too much, so there is no zero; give one with --zero-mv" in err
    _, _, err = process(capsys, tmp_path, log, "--zero-mv", 500)
    assert "no mass" not in err


def test_a_log_that_begins_in_grain_says_why_there_is_no_mass_and_takes_a_known_zero(capsys, tmp_path, logs) -> None:
    _, _, err = process(capsys, tmp_path, logs["grain"])
    assert "no mass: the elevator never runs empty in the log" in err
    assert "header_down or work_state says throughout that the machine cuts" in err
    assert "--zero-mv" in err
    _, _, err = process(capsys, tmp_path, logs["grain"], "--zero-mv", ZERO_MV)
    assert "no mass" not in err
    assert sum(row.mass_kg for row in read_seconds(tmp_path / "out.csv")) > 10.0


def test_whose_machine_and_grain_measured_is_said_where_no_configuration_is_given(capsys, tmp_path, logs, own) -> None:
    own_one = tmp_path / "yieldmon.yaml"
    own_one.write_text("machine_file: null\n")
    log, store = logs["whole"], (STORE, "--delay", 3)
    cases = [
        ((log,), "the shipped machine and crop; for logs"),
        ((log, "--params", own), "the shipped machine; for logs"),
        ((log, "--config", own_one), ""),
        (store, "the shipped machine; for a store"),
        ((*store, "--config", own_one), ""),
    ]
    for words, expected in cases:
        (tmp_path / "out.csv").unlink(missing_ok=True)
        code, _, err = process(capsys, tmp_path, *words)
        assert code == 0, err
        assert (expected in err) if expected else ("the shipped machine" not in err)


def test_a_log_without_times_says_why_there_is_no_mass(capsys, tmp_path, logs) -> None:
    """As a recorder without a clock writes it."""
    path = tmp_path / "still.log"
    path.write_text(re.sub(r"^\(\S+\)", "(0.000000)", logs["whole"].read_text(), flags=re.MULTILINE))
    code, _, err = process(capsys, tmp_path, path)
    assert code == 0
    assert "no mass: the frames' times span less than a second" in err


def test_the_same_log_twice_is_refused_however_it_is_packed(capsys, tmp_path, logs) -> None:
    content = logs["whole"].read_bytes()
    copies = {"copy.log": content, "packed.log.gz": gzip.compress(content), "again.log.gz": gzip.compress(content, 1, mtime=1)}
    for name, written in copies.items():
        (tmp_path / name).write_bytes(written)
    for one, other in itertools.combinations([logs["whole"], *(tmp_path / name for name in copies)], 2):
        code, _, err = process(capsys, tmp_path, one, other)
        assert (code, err.count("\n")) == (2, 1)
        assert f"{other}: is the same log as {one}" in err
        assert ("one of them gzipped" in err) == (one.suffix != other.suffix)
        assert not (tmp_path / "out.csv").exists()


def test_logs_that_overlap_count_once_and_two_that_cannot_be_read_are_not_the_same(capsys, tmp_path, logs) -> None:
    lines = logs["whole"].read_bytes().splitlines(keepends=True)
    later = tmp_path / "later.log"
    later.write_bytes(b"".join(lines[len(lines) // 2 :]))
    code, _, err = process(capsys, tmp_path, logs["whole"], later)
    assert code == 0
    assert f"{later}: up to 20" in err
    assert f"it holds the frames of {logs['whole']} again (+0 ms); left out" in err
    assert "overlap: " not in err
    broken = [tmp_path / f"broken{n}.log.gz" for n in (1, 2)]
    for path in broken:
        path.write_bytes(b"no gzip")
    assert "same log" not in process(capsys, tmp_path, *broken)[2]


def test_gaps_and_missing_inputs_are_named(capsys, tmp_path, logs) -> None:
    _, _, err = process(capsys, tmp_path, logs["whole"])
    assert "gaps" not in err
    assert "missing: position in 100 % of the seconds" in err
    code, out, _ = process(capsys, tmp_path, logs["whole"], logs["later"], "--json")
    document = json.loads(out)
    assert code == 0
    assert document["overlap_s"] == 0.0
    assert document["missing"]["position"] == 1.0
    assert "moisture" not in document["missing"]
    assert (document["gaps"], document["gap_s"]) == (1, pytest.approx(17.0, abs=1.01))


def test_parameters_of_a_file_measure_a_log(capsys, tmp_path, logs, own) -> None:
    process(capsys, tmp_path, logs["whole"], "--params", own)
    first = read_seconds(tmp_path / "out.csv")[-1].total_kg
    known = parameter_file.load(own)
    parameter_file.save(replace(known, values={**known.values, "restitution": known.values["restitution"] - 0.15}), own)
    process(capsys, tmp_path, logs["whole"], "--params", own)
    assert read_seconds(tmp_path / "out.csv")[-1].total_kg > 1.05 * first


def test_a_log_whose_plate_stays_at_home_has_no_fault_about_commands_that_were_not_sent(capsys, tmp_path) -> None:
    config = tmp_path / "soon.yaml"
    config.write_text("sweep: {first_after_s: 0}\n", encoding="utf-8")
    log = write(tmp_path / "home.log", (0.0, 14.0, 0.0), (14.0, 22.0, 120.0))
    code, out, err = process(capsys, tmp_path, log, "--config", config, "--json")
    assert code == 0, err
    assert json.loads(out)["faults"] == {}
    states = {row.operating_state for row in read_seconds(tmp_path / "out.csv") if row.mass_kg > 0.0}
    assert states == {OperatingState.HARVESTING}


def test_a_bus_log_in_a_database_is_no_store(capsys, tmp_path) -> None:
    (tmp_path / "s.yaml").write_text(
        json.dumps({"duration_s": 12, "flow": {"pieces": [{"kind": "steady", "duration_s": 12, "flow_kg_s": 9}]}})
    )
    found = {}
    for suffix in (".log", ".db"):
        log = str(tmp_path / f"day{suffix}")
        assert main(["simulate", "--scenario", str(tmp_path / "s.yaml"), "--seed", "1", "--log", log]) == 0
        capsys.readouterr()
        assert main(["process", log, "--out", str(tmp_path / f"{suffix[1:]}.csv"), "--zero-mv", "500", "--json"]) == 0
        found[suffix] = json.loads(capsys.readouterr().out)
    assert found[".db"]["total_mass_kg"] == pytest.approx(found[".log"]["total_mass_kg"], rel=1e-5)
    assert found[".db"]["total_mass_kg"] > 50.0


def test_a_log_that_lacks_samples_in_each_second_says_so(capsys, tmp_path, logs) -> None:
    """Of every third frame none: such seconds give no zero, and the log was said to begin in grain."""
    lines = logs["whole"].read_text().splitlines(keepends=True)
    (tmp_path / "lossy.log").write_text("".join(line for number, line in enumerate(lines) if number % 3))
    code, _, err = process(capsys, tmp_path, tmp_path / "lossy.log")
    assert code == 0
    assert "no mass: every second lacks samples (FramesLost)" in err
    assert "never runs empty" not in err


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1e-3, "no mass: the log's times are 1000 times too near each other: a sensor frame every 4e-06 s"),
        (7.0, "no mass: a sensor frame every 0.028 s, by the mapping every 0.004 s: rate_hz of the mapping, or the log's times"),
    ],
)  # fmt: skip
def test_a_log_of_times_in_another_unit_says_so(capsys, tmp_path, logs, factor: float, says: str) -> None:
    """ "No frame reports the elevator speed", it said of milliseconds."""
    lines = (line.split() for line in logs["grain"].read_text().splitlines())
    moved = (f"({(float(time[1:-1]) - START_S) * factor:.9f}) {' '.join(rest)}\n" for time, *rest in lines)
    (tmp_path / "ms.log").write_text("".join(moved))
    code, _, err = process(capsys, tmp_path, tmp_path / "ms.log")
    assert code == 0
    assert says in err
    document = json.loads(process(capsys, tmp_path, tmp_path / "ms.log", "--json")[1])
    assert problems(document, "process") == []
    assert document["sensor_interval_s"] == pytest.approx(factor * document["mapped_interval_s"], rel=0.01)


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1e3, "the log's times are 1000 times too far apart, as of milliseconds that stand for seconds: a sensor frame "
              "every 4 s, by the mapping every 0.004 s; expected times in seconds"),
        (1e6, "the log's times are 1000000 times too far apart, as of microseconds that stand for seconds"),
    ],
)  # fmt: skip
def test_a_log_of_times_in_milliseconds_is_refused_at_its_beginning(capsys, tmp_path, logs, factor: float, says: str) -> None:
    """It was measured second by second, a thousand times as many: an hour of harvest for hours."""
    lines = [line.split() for line in logs["grain"].read_text().splitlines()]
    moved = [f"({(float(time[1:-1]) - START_S) * factor:.9f}) {' '.join(rest)}\n" for time, *rest in lines]
    (tmp_path / "ms.log").write_text("".join(moved))
    code, _, err = process(capsys, tmp_path, tmp_path / "ms.log")
    assert code == 2
    assert f"ms.log: {says}" in err
    monitor = build_monitor(LOADED.engine, LOADED.machine, LOADED.parameters)
    rows: list[SecondRow] = []
    with pytest.raises(InputError, match=r"too far apart"):
        process_logs([tmp_path / "ms.log"], monitor, CODEC, rows.append)
    assert len(rows) < 500
    (tmp_path / "tickets.csv").write_text("load,weighed_kg\nms,900\n")
    (tmp_path / "c.yaml").write_text("{}\n")
    assert main(["calibrate", "--loads", str(tmp_path / "ms.log"), "--tickets", str(tmp_path / "tickets.csv")]) == 2
    assert f"ms.log: {says[:45]}" in capsys.readouterr().err
    assert main(["check-config", str(tmp_path / "c.yaml"), "--log", str(tmp_path / "ms.log")]) == 2
    assert f"as mapped; {says[:45]}" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", [10.0, 1e3])
def test_a_log_of_two_loggers_is_not_one_of_another_unit(capsys, tmp_path, logs, seconds: float) -> None:
    """The time between the two loggers was held against the mapping: of 0.0001 s it said that times or mapping are not right."""
    lines = [line.split(maxsplit=1) for line in logs["grain"].read_text().splitlines(keepends=True)]
    both = [(float(time[1:-1]), rest) for time, rest in lines]
    both += [(time_s + 0.000123, rest) for time_s, rest in both if time_s < START_S + seconds]
    (tmp_path / "two.log").write_text("".join(f"({time_s:.6f}) {rest}" for time_s, rest in sorted(both)))
    code, _, err = process(capsys, tmp_path, tmp_path / "two.log")
    assert code == 0
    assert "sensor frame every" not in err
    assert "two nodes or channels send them, or the log has some twice; logs of two loggers count once if they are given" in err


def test_a_log_whose_first_time_is_damaged_does_not_run_backwards(capsys, tmp_path, logs) -> None:
    first, *rest = logs["whole"].read_text().splitlines(keepends=True)
    (tmp_path / "d.log").write_text("".join([f"(9999999999.000000){first.partition(')')[2]}", *rest]))
    assert process(capsys, tmp_path, tmp_path / "d.log")[0] == 0


def test_signals_counts_frames_that_stand_there_twice_once(capsys, tmp_path, logs) -> None:
    """Its rate would be that of a mapping."""
    rates = []
    for name, times in (("once", 1), ("twice", 2)):
        lines = logs["grain"].read_text().splitlines(keepends=True)
        (tmp_path / f"{name}.log").write_text("".join(line for line in lines for _ in range(times)))
        assert main(["signals", str(tmp_path / f"{name}.log"), "--json"]) == 0
        said = capsys.readouterr()
        rates.append([message["rate_hz"] for message in json.loads(said.out)["messages"]])
    assert rates[1] == rates[0]
    assert "each frame stands there again" in said.err
    (tmp_path / "c.yaml").write_text("{}\n")
    main(["check-config", str(tmp_path / "c.yaml"), "--log", str(tmp_path / "twice.log")])
    assert "twice.log: each frame stands there again" in capsys.readouterr().out


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".csv"])
@pytest.mark.parametrize("start_s", [0.0, START_S])
def test_a_log_that_begins_with_its_end_is_called_that(capsys, tmp_path, logs, suffix: str, start_s: float) -> None:
    """Its recorder was said to have no clock."""
    frames = list(read_log(logs["whole"]))
    for frame in frames:
        frame.timestamp += start_s - START_S
    with can.Logger(tmp_path / f"on{suffix}") as writer:
        for frame in frames[::-1] if suffix == ".csv" else frames:
            writer(frame)
    written = (tmp_path / f"on{suffix}").read_bytes()
    if suffix == ".log":
        written = b"".join(reversed(written.splitlines(keepends=True)))
    elif suffix == ".log.gz":
        written = gzip.compress(b"".join(reversed(gzip.decompress(written).splitlines(keepends=True))))
    (tmp_path / f"back{suffix}").write_bytes(written)
    code, _, err = process(capsys, tmp_path, tmp_path / f"back{suffix}")
    assert code == 2
    assert f"back{suffix}: its times run backwards from frame to frame: the log begins with its end; expected" in err
    assert main(["signals", str(tmp_path / f"back{suffix}")]) == 2


@pytest.mark.parametrize(
    ("signals", "says"),
    [
        (
            "plate_angle: {message: PlateActuatorFeedback, signal: PlateAngle, range: [80, 90]}",
            "no mass: no frame reports the plate angle",
        ),
        (
            "plate_angle: {message: PlateActuatorFeedback, signal: PlateAngle, scale: -1, offset: 90}",
            "no mass: the plate is away from home by its reported angle, and the zero needs it there: "
            "check unit, scale and offset",
        ),
        (
            "elevator_speed: {message: ElevatorSpeed, signal: ElevatorSpeed, range: [500, 590]}",
            "no mass: no frame reports the elevator speed",
        ),
        (
            "impact_voltage: {message: ImpactSensorSamples, signals: [Sample0, Sample1, Sample2, Sample3], "
            "rate_hz: 1000, scale: -1, offset: 1000}",
            "no mass: the zero drifted (ZeroDrifted): if there was grain, check the sensor's sign;",
        ),
    ],
)
def test_a_mapping_that_gives_no_mass_says_so(capsys, tmp_path, signals: str, says: str) -> None:
    log = write(tmp_path / "day.log", (0.0, 14.0, 0.0), (14.0, 40.0, 200.0))
    (tmp_path / "c.yaml").write_text(f"signals: {{{signals}}}\n")
    code, _, err = process(capsys, tmp_path, log, "--config", tmp_path / "c.yaml")
    assert code == 0, err
    assert says in err
    assert "never runs empty" not in err


def test_a_log_that_lacks_some_samples_in_each_second_has_its_mass(capsys, tmp_path, logs) -> None:
    lines = logs["whole"].read_text().splitlines(keepends=True)
    (tmp_path / "lossy.log").write_text("".join(line for number, line in enumerate(lines) if number % 30))
    masses = []
    for log in (logs["whole"], tmp_path / "lossy.log"):
        assert process(capsys, tmp_path, log, "--json", "--force")[0] == 0
        masses.append(json.loads(process(capsys, tmp_path, log, "--json", "--force")[1])["total_mass_kg"])
    assert masses[1] == pytest.approx(masses[0], rel=0.01)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"frames, they say " * 99, "file is not a database; reading stopped; no frame in the whole file"),
        (b"", "frame 1: no table 'messages' as python-can's SqliteWriter makes it; reading stopped; no frame in the whole file"),
        (b"SQLite format 3\0" + bytes(4080), "file is not a database; expected a daemon's store"),
    ],
    ids=["text", "empty", "begins as a database does"],
)
@pytest.mark.parametrize("options", [[], ["--zero-mv", "500"]], ids=["plain", "again"])
def test_what_is_called_db_and_is_neither_log_nor_store_is_not_called_one(capsys, tmp_path, content, said, options) -> None:
    (tmp_path / "day.db").write_bytes(content)
    assert main(["process", str(tmp_path / "day.db"), "--out", str(tmp_path / "o.csv"), *options]) == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def test_mass_that_two_recorders_contest_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ten seconds of a harvest that a log has twice: their mass is in no total."""
    frames = [*messages_of(START_S, 14, EMPTY_MV), *messages_of(START_S + 14, 26, GRAIN_MV)]
    again = [message for message in frames if 20.0 <= message.timestamp - START_S < 30.0]
    masses = {}
    for name, sent in (("once", frames), ("twice", sorted(frames + again, key=lambda message: message.timestamp))):
        log = tmp_path / f"{name}.log"
        lines = (f"({m.timestamp:.6f}) can0 {m.arbitration_id:08X}#{m.data.hex()}\n" for m in sent)
        log.write_text("".join(lines))
        words = ["process", str(log), "--out", str(tmp_path / f"{name}.csv")]
        assert main([*words, "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        masses[name] = document["total_mass_kg"], document.get("contested_kg", 0.0)
        assert main([*words, "--force"]) == 0
        assert ("contested: " in capsys.readouterr().err) == (name == "twice")
    (once, nothing), (counted, contested) = masses["once"], masses["twice"]
    assert nothing == 0.0 < contested
    assert counted + contested == pytest.approx(once, rel=0.01)


def test_logs_of_two_machines_at_the_same_times_are_named(capsys, tmp_path, logs) -> None:
    """They were taken for two loggers' logs in one file, with the advice to give them as two."""
    other = write(tmp_path / "other.log", (4.0, 11.0, 0.0), (15.0, 9.0, 75.0))
    code, _, err = process(capsys, tmp_path, logs["whole"], other)
    assert code == 0
    assert f"count as well: {other} and {logs['whole']} have different frames at the same times, as of two machines" in err
    assert "joined into one file" not in err
    document = json.loads(process(capsys, tmp_path, logs["whole"], other, "--json")[1])
    assert problems(document, "process") == []
    assert document["same_times"] == [{"log": str(other), "other": str(logs["whole"]), "seconds": pytest.approx(18, abs=1)}]


@pytest.mark.parametrize(("start_s", "said"), [(4.0, True), (100.0, False)])
def test_weighed_loads_of_two_machines_at_the_same_times_are_named(capsys, tmp_path, logs, start_s: float, said: bool) -> None:
    other = write(tmp_path / "other.log", (start_s, 11.0, 0.0), (start_s + 11.0, 9.0, 75.0))
    (tmp_path / "t.csv").write_text("load,weighed_kg\n1,20.6\n2,29.5\n")
    assert main(["calibrate", "--loads", str(logs["whole"]), str(other), "--tickets", str(tmp_path / "t.csv")]) == 0
    err = capsys.readouterr().err
    assert (f"{other} and {logs['whole']} have different frames at the same times" in err) == said


def test_a_log_that_follows_another_shares_no_times_with_it(capsys, tmp_path, logs) -> None:
    follows = write(tmp_path / "follows.log", (21.0, 6.0, 60.0))
    assert "same_times" not in json.loads(process(capsys, tmp_path, logs["whole"], follows, "--json")[1])


@pytest.mark.parametrize("kind", [str, Path])
def test_a_single_path_is_no_list_of_logs(tmp_path: Path, kind: type) -> None:
    monitor = build_monitor(LOADED.engine, LOADED.machine, LOADED.parameters)
    with pytest.raises(ValueError, match=r"^paths: is '.*a\.log'; expected a list of paths, such as \['.*a\.log'\]$"):
        process_logs(kind(tmp_path / "a.log"), monitor, CODEC, [].append)
