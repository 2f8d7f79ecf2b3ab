"""`setup` from an answers file and through a terminal of 80x24; wrong numbers are named before a file is written."""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path

import pytest
import yaml

from tests.file_limit import files_end_at
from tests.schema_check import problems
from yieldmon.cli._setup.questions import QUESTIONS
from yieldmon.cli.main import main
from yieldmon.files.crops import crops
from yieldmon.service.config import configuration

ANSWERS = {
    "machine_name": "old-green",
    "bus_interface": "virtual",
    "bus_channel": "can7",
    "sprocket_pitch_radius_m": 0.0541,
    "paddle_spacings_m": [0.1656, 0.2071],
    "paddle_length_m": 0.16,
    "paddle_width_m": 0.21,
    "plate_pivot_x_m": 0.4,
    "plate_pivot_above_m": 0.16,
    "plate_length_m": 0.1887,
    "home_plate_angle_deg": 70,
    "min_plate_angle_deg": 40,
    "max_plate_angle_deg": 90,
    "nominal_elevator_speed_rpm": 400,
    "min_elevator_speed_rpm": 250,
    "max_elevator_speed_rpm": 599,
    "largest_flow_kg_s": 25,
    "cell_full_scale_mv": 4000,
    "cell_weights_kg": [0, 5, 10],
    "cell_readings_mv": [500, 597.6, 695.1],
    "plate_measured_deg": [46.5, 86.4],
    "plate_reported_deg": [45, 85],
    "crop": "wheat",
}


def answers(folder: Path, **changes: object) -> str:
    path = folder / "answers.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in (ANSWERS | changes).items() if v is not None}))
    return str(path)


def test_answers_become_a_configuration_that_the_daemon_takes(tmp_path, capsys):
    assert main(["setup", "--answers", answers(tmp_path), "--out", str(tmp_path / "new"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "setup") == []
    assert found["cell"]["gain_n_per_mv"] == pytest.approx(9.80665 * 10.0 / 195.1, rel=1e-3)
    assert 0.0 < found["cell"]["sd_pct"] < 1.0
    assert found["plate_angle_offset_deg"] == pytest.approx(1.45)
    known = configuration.load(found["files"]["configuration"])
    assert known.machine.sensor.gain_n_per_mv == found["cell"]["gain_n_per_mv"]
    assert known.machine.plate_pivot_y_m == -0.16
    assert known.document.bus.channel == "can7"
    assert known.parameters.provenance["crop"] == "wheat"
    assert known.parameters.values["plate_angle_offset.angle_rad"] == pytest.approx(0.0253, abs=1e-4)
    record = yaml.safe_load(Path(found["files"]["record"]).read_text())
    assert record["answers"]["cell_readings_mv"] == [500, 597.6, 695.1]
    assert record["date"].endswith("Z")
    # A second time nothing is replaced unasked.
    assert main(["setup", "--answers", answers(tmp_path), "--out", str(tmp_path / "new"), "--json"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["setup", "--answers", answers(tmp_path), "--out", str(tmp_path / "new"), "--json", "--force"]) == 0


def test_a_set_up_that_cannot_be_written_leaves_the_earlier_one(tmp_path, capsys):
    """It left new parameters beside the machine file of before."""
    out = tmp_path / "a"
    assert main(["setup", "--answers", answers(tmp_path), "--out", str(out)]) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    path = answers(tmp_path, plate_reported_deg=[44, 84])
    with files_end_at(len(before["wheat.yaml"]) + 50):
        assert main(["setup", "--answers", path, "--out", str(out), "--force"]) == 1
    assert f"{out / 'setup-record.yaml'}: " in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_a_parameter_file_copied_from_another_machine_is_named(tmp_path, capsys):
    """With it the other machine's angle offset is used."""
    for name, spacings_m in (("a", [0.1656, 0.2071]), ("b", [0.19])):
        path = answers(tmp_path, machine_name=name, paddle_spacings_m=spacings_m)
        assert main(["setup", "--answers", path, "--out", str(tmp_path / name)]) == 0
    config = str(tmp_path / "b" / "yieldmon.yaml")
    assert main(["check-config", config]) == 0
    assert "another machine" not in capsys.readouterr().err
    (tmp_path / "b" / "wheat.yaml").write_bytes((tmp_path / "a" / "wheat.yaml").read_bytes())
    assert main(["check-config", config]) == 0
    captured = capsys.readouterr()
    said = "wheat.yaml was made for another machine (other lengths of elevator and plate, the name a, here b)"
    assert said in captured.out + captured.err


def test_the_example_answers_every_question(tmp_path, capsys):
    example = Path(__file__).parents[2] / "examples" / "setup-answers.yaml"
    assert list(yaml.safe_load(example.read_text())) == [question.key for question in QUESTIONS]
    assert main(["setup", "--answers", str(example), "--out", str(tmp_path / "new")]) == 0
    assert "force cell: 0.50265 N/mV" in capsys.readouterr().out


BOLTED = dict.fromkeys(("home_plate_angle_deg", "min_plate_angle_deg", "max_plate_angle_deg"), 55)


@pytest.mark.parametrize(
    "changes",
    [{"crop": name} for name in (*crops(), "Höstvete", "milho")]
    + [BOLTED | {"plate_measured_deg": [55], "plate_reported_deg": None}],
)
def test_what_is_written_passes_check_config(tmp_path, capsys, changes):
    assert main(["setup", "--answers", answers(tmp_path, **changes), "--out", str(tmp_path / "new")]) == 0
    assert main(["check-config", str(tmp_path / "new/yieldmon.yaml")]) == 0


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"paddle_length_m": None}, "has no paddle_length_m; expected an answer to each question"),
        ({"paddle_length_m": 160}, "paddle_length_m: is 160; expected 0.02 to 1 m"),
        ({"padle_length_m": 0.16}, "padle_length_m: is not asked"),
        ({"cell_readings_mv": [500, 402, 305]}, "falls as weight is added"),
        ({"cell_readings_mv": [500, 597, 650]}, "from a straight line"),
        (
            {"cell_readings_mv": [500, 500, 500]},
            "cell_readings_mv: changes by 0 mV, and not with the weight; expected a reading that",
        ),
        ({"cell_readings_mv": [500.2, 499.7, 500.1]}, "cell_readings_mv: changes by 0.5 mV, and not with the weight"),
        ({"cell_readings_mv": [500.1, 499.7, 500.2]}, "cell_readings_mv: changes by 0.5 mV, and not with the weight"),
        (
            {"cell_readings_mv": [0.5, 0.5976, 0.6951], "cell_full_scale_mv": 4},
            "cell_readings_mv: changes by 0.1951 mV, which gives the gain to 362 % only (readings count as right to 0.5 mV); "
            "expected 10 % or less: readings in mV, heavier weights, or an amplifier behind the cell",
        ),
        ({"cell_readings_mv": [500, 597]}, "has 2 values for 3 masses"),
        ({"cell_weights_kg": [5, 10], "cell_readings_mv": [600, 700]}, "has 2 different masses; expected 0 and two weights"),
        ({"plate_reported_deg": [45, 80]}, "the same error within 1 deg at both"),
        ({"plate_reported_deg": [135, 95]}, "plate_reported_deg: falls as the plate's angle rises; expected an angle that rises"),
        ({"crop": "korn"}, "'korn'; expected barley or corn"),
        ({"plate_measured_deg": [20, 60]}, "is it counted from level?"),
        ({"plate_pivot_x_m": 0.15}, "beyond the paddles' tips"),
        ({"plate_pivot_above_m": -0.1}, "a plate that reaches from above the centre"),
        ({"nominal_elevator_speed_rpm": 700}, "between min_elevator_speed_rpm (250) and max_elevator_speed_rpm (599)"),
        ({"sprocket_pitch_radius_m": 0.01, "min_elevator_speed_rpm": 40, "nominal_elevator_speed_rpm": 50}, "paddles a second"),
        ({"largest_flow_kg_s": 90}, "these paddles carry"),
        ({"paddle_spacings_m": [0.1656, 0.4142]}, "is a paddle missing?"),
        ({"paddle_length_m": 0.05}, "longer than the sprocket's pitch radius"),
        (
            {"cell_full_scale_mv": 10000},
            "cell_full_scale_mv: gain_n_per_mv 0.502647 times full_scale_mv 10000 is 5026 N",
        ),
        ({"plate_length_m": "30 mm 40 mm"}, "plate_length_m: is 30 mm 40 mm; expected one number in m"),
        ({"plate_length_m": "0.3 kg"}, "plate_length_m: is kg; expected 0.02 to 2 m (or in m, mm, cm, in"),
        ({"plate_length_m": "300 cm"}, "plate_length_m: is 300 cm; expected 0.02 to 2 m"),
        ({"plate_length_m": "1.234.5"}, "plate_length_m: is 1.234.5; expected 0.02 to 2 m"),
        ({"plate_length_m": "o.3"}, "plate_length_m: is o.3; expected 0.02 to 2 m"),
        ({"crop": "oats"}, "expected one of corn"),
        ({"bus_interface": "socket-can"}, "bus_interface: is 'socket-can'; expected socketcan"),
        ({"bus_interface": "carrier pigeon"}, "bus_interface: is 'carrier pigeon'; expected one of canalystii"),
        (
            {"bus_interface": "socketcan", "bus_channel": "can 0"},
            "bus_channel: is 'can 0'; expected the name of a network device",
        ),
        ({"machine_name": ["old", "green"]}, "machine_name: is ['old', 'green']; expected a word"),
        ({"cell_full_scale_mv": 600}, "cell_full_scale_mv: is 600, but a weight reads 695.1 mV; expected at least 695.1 mV"),
    ],
)
def test_a_wrong_number_is_named_in_one_line_and_nothing_is_written(tmp_path, capsys, monkeypatch, changes, problem):
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    out = tmp_path / "new"
    assert main(["setup", "--answers", answers(tmp_path, **changes), "--out", str(out)]) == 2
    shown, err = capsys.readouterr()
    assert shown == ""
    assert err.count("\n") == 1
    assert problem in err
    assert not list(out.glob("*")) if out.exists() else True


@pytest.mark.parametrize(
    ("changes", "key", "meant"),
    [
        ({"bus_interface": "SocketCAN"}, "bus_interface", "socketcan"),
        ({"cell_readings_mv": "500,597.6,695.1"}, "cell_readings_mv", [500.0, 597.6, 695.1]),
        ({"cell_weights_kg": "0,5,10"}, "cell_weights_kg", [0.0, 5.0, 10.0]),
        ({"cell_weights_kg": "0,5000,10000 g"}, "cell_weights_kg", [0.0, 5.0, 10.0]),
        ({"paddle_spacings_m": "165.6,207.1 mm"}, "paddle_spacings_m", [0.1656, 0.2071]),
        ({"cell_readings_mv": "500; 597,6; 695,1"}, "cell_readings_mv", [500.0, 597.6, 695.1]),
        ({"paddle_spacings_m": "0,19"}, "paddle_spacings_m", [0.19]),
        ({"paddle_spacings_m": "165.6 207,1 mm"}, "paddle_spacings_m", [0.1656, 0.2071]),
        ({"paddle_spacings_m": "16.56cm; 0.2071"}, "paddle_spacings_m", [0.1656, 0.2071]),
        ({"plate_length_m": '10"'}, "plate_length_m", 0.254),
        ({"paddle_width_m": "215 mm"}, "paddle_width_m", 0.215),
        ({"cell_weights_kg": "0, 11.023113 22.046226 lb"}, "cell_weights_kg", [0.0, pytest.approx(5.0), pytest.approx(10.0)]),
        ({"cell_full_scale_mv": "4 V"}, "cell_full_scale_mv", 4000.0),
        ({"largest_flow_kg_s": "90 t/h"}, "largest_flow_kg_s", pytest.approx(25.0)),
        ({"home_plate_angle_deg": "70°"}, "home_plate_angle_deg", 70.0),
    ],
)
def test_answers_are_taken_as_people_write_them(tmp_path, capsys, changes, key, meant):
    assert main(["setup", "--answers", answers(tmp_path, **changes), "--out", str(tmp_path / "new"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["answers"][key] == meant


def test_a_word_without_a_value_is_no_word(tmp_path, capsys):
    path = Path(answers(tmp_path, bus_channel=None))
    path.write_text(path.read_text() + "bus_channel:\n")
    assert main(["setup", "--answers", str(path), "--out", str(tmp_path / "new")]) == 2
    assert "bus_channel: is None; expected a word" in capsys.readouterr().err


def test_a_folder_in_the_place_of_one_file_keeps_the_others(tmp_path, capsys):
    new = tmp_path / "new"
    (new / "wheat.yaml").mkdir(parents=True)
    (new / "machine.yaml").write_text("mine")
    assert main(["setup", "--answers", answers(tmp_path), "--out", str(new), "--force"]) == 2
    assert "wheat.yaml: is a folder" in capsys.readouterr().err
    assert (new / "machine.yaml").read_text() == "mine"


def test_files_are_for_the_services_user_whatever_the_umask(tmp_path, capsys):
    folder = tmp_path / "etc" / "yieldmon"
    before = os.umask(0o077)
    try:
        assert main(["setup", "--answers", answers(tmp_path), "--out", str(folder), "--json"]) == 0
    finally:
        os.umask(before)
    written = [Path(name) for name in json.loads(capsys.readouterr().out)["files"].values()]
    assert len(written) >= 3
    assert {path.stat().st_mode & 0o777 for path in written} == {0o644}
    assert {path.stat().st_mode & 0o777 for path in (folder, folder.parent)} == {0o755}


def test_through_a_terminal_of_80_by_24_with_a_break_between(tmp_path):
    pexpect, pyte = pytest.importorskip("pexpect"), pytest.importorskip("pyte")
    lines = [" ".join(map(str, value)) if isinstance(value, list) else str(value) for value in ANSWERS.values()]
    seen = []

    def session(given: list[str], end: str) -> object:
        terminal = pexpect.spawn(
            # Ctrl-C ends it also where the tests run in the background, which ignore it.
            "env",
            ["--default-signal=INT", sys.executable, "-m", "yieldmon.cli.main", "setup", "--out", str(tmp_path / "new")],
            dimensions=(24, 80),
            encoding="utf-8",
            timeout=60,
            env={**os.environ, "TERM": "xterm"},
        )
        screen = pyte.Screen(80, 24)
        stream = pyte.Stream(screen)
        for line in given:
            terminal.expect(r"\d+/23 [^\n]*: $")
            stream.feed(terminal.before + terminal.after)
            seen.append("\n".join(screen.display))
            terminal.sendline(line)
        terminal.expect(end)
        stream.feed(terminal.before)
        seen.append("\n".join(screen.display))
        return terminal

    first = session(["9 m", *lines[1:3], "sixty", "back", *lines[2:6]], r"\d+/23 [^\n]*: $")
    assert any("sprocket_pitch_radius_m: is sixty; expected 0.01 to 1 m" in page for page in seen)
    # Python misses a signal that comes between its last look and the wait for a line; a person presses again.
    for _ in range(6):
        first.sendintr()
        if first.expect([pexpect.EOF, pexpect.TIMEOUT], timeout=10) == 0:
            break
    assert not first.isalive()
    second = session(lines[6:], pexpect.EOF)
    second.close()
    assert second.exitstatus == 0
    assert any("continuing with" in page for page in seen)
    assert any("plate pivot" in page for page in seen)
    known = configuration.load(tmp_path / "new" / "yieldmon.yaml")
    assert known.machine.name == "9 m"
    assert known.machine.paddle_spacings_m == (0.1656, 0.2071)
    assert (tmp_path / "new" / "wheat.yaml").is_file()


def test_files_in_the_way_are_named_before_the_first_question(tmp_path, capsys, monkeypatch):
    """Such as the configuration that `yieldmon install` has put there."""
    (tmp_path / "yieldmon.yaml").write_text("bus: {channel: can0}\n")
    asked = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda prompt="": asked.append(prompt))
    assert main(["setup", "--out", str(tmp_path)]) == 2
    assert "yieldmon.yaml: exists already; expected another folder for --out, or --force" in capsys.readouterr().err
    assert asked == []
    assert (tmp_path / "yieldmon.yaml").read_text() == "bus: {channel: can0}\n"


BOLTED = {"min_plate_angle_deg": 70, "max_plate_angle_deg": 70, "plate_measured_deg": [69.4], "plate_reported_deg": None}


def test_a_bolted_plate_has_one_angle_and_no_actuator_to_ask(tmp_path, capsys):
    new = tmp_path / "new"
    assert main(["setup", "--answers", answers(tmp_path, **BOLTED), "--out", str(new)]) == 0
    assert "plate: bolted at 69.4 deg" in capsys.readouterr().out
    known = configuration.load(new / "yieldmon.yaml")
    assert known.document.plate.fixed_angle_deg == 69.4
    assert not known.document.sweep.enabled
    machine = known.machine
    angles = (machine.min_plate_angle_rad, machine.home_plate_angle_rad, machine.max_plate_angle_rad)
    assert angles == (pytest.approx(math.radians(69.4)),) * 3
    assert "plate_angle_offset.angle_rad" not in known.parameters.values


def test_a_bolted_plate_is_asked_one_angle_and_going_back_leaves_out_what_is_not_asked():
    from yieldmon.cli._setup import session

    known = {
        key: value for key, value in (ANSWERS | BOLTED).items() if key not in ("plate_measured_deg", "plate_reported_deg", "crop")
    }
    said, asked, given = [], [], iter(["70", "back", "69.4", "wheat"])
    found = session.ask(known, lambda prompt: (asked.append(prompt), next(given))[1], said.append, lambda now: None)
    assert [prompt.split(" ", 1)[1] for prompt in asked] == [
        "Plate angle by inclinometer [deg]: ", "Crop (corn): ", "Plate angle by inclinometer [deg]: ", "Crop (corn): ",
    ]  # fmt: skip
    assert said == []
    assert (found["plate_measured_deg"], found["crop"]) == ([69.4], "wheat")


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"plate_measured_deg": [69.4, 85.0]}, "plate_measured_deg: has 2 values for a plate that does not turn; expected one"),
        ({"plate_measured_deg": [60.0]}, "plate_measured_deg: is 60, but home_plate_angle_deg is 70; expected the same angle"),
        ({"plate_reported_deg": [70.0]}, "plate_reported_deg: is given for a plate that does not turn"),
    ],
)
def test_answers_that_a_bolted_plate_cannot_have_are_named(tmp_path, capsys, changes, problem):
    assert main(["setup", "--answers", answers(tmp_path, **BOLTED | changes), "--out", str(tmp_path / "new")]) == 2
    assert problem in capsys.readouterr().err
    assert not (tmp_path / "new" / "yieldmon.yaml").exists()


def test_the_recorded_session_of_the_docs_is_what_its_command_records():
    from studies.setup import session

    assert session.TARGET.read_text(encoding="utf-8") == session.record(), "python -m studies.setup.session"
    header, *events = (json.loads(line) for line in session.TARGET.read_text(encoding="utf-8").splitlines())
    assert (header["width"], header["height"]) == (80, 24)
    assert max(len(line) for _, _, text in events for line in text.split("\r\n")) <= 80


def in_a_terminal(monkeypatch: pytest.MonkeyPatch, given: list[str]) -> list[str]:
    """Standard input as a terminal in which these lines are typed, then Ctrl-D; returns the prompts."""
    prompts: list[str] = []

    def typed(prompt: str) -> str:
        prompts.append(prompt)
        if len(prompts) > len(given):
            raise EOFError
        return given[len(prompts) - 1]

    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", typed)
    return prompts


@pytest.mark.parametrize(
    ("changes", "given", "reported"),
    [
        ({"plate_pivot_x_m": 0.15}, ["0.4"], "beyond the paddles' tips"),
        ({"cell_readings_mv": [500, 402, 305]}, ["500 597.6 695.1"], "falls as weight is added"),
        ({"cell_readings_mv": None}, ["500 597 650", "500 597.6 695.1"], "departs by 9.8 % from a straight line"),
        ({"plate_reported_deg": None}, ["45 80", "45 85"], "the same error within 1 deg at both"),
        ({"cell_weights_kg": None}, ["0 5", "0 5 10"], "cell_weights_kg: has 2 different masses"),
        ({"plate_measured_deg": None}, ["46.5", "46.5 86.4"], "plate_measured_deg: has 1 value; expected two positions"),
    ],
    ids=[
        *("with others", "by itself, from a file", "by itself, at once", "of the actuator, at once"),
        *("one weight, at once", "one position, at once"),
    ],
)
def test_in_a_terminal_an_answer_that_does_not_fit_is_asked_again(tmp_path, capsys, monkeypatch, changes, given, reported):
    prompts = in_a_terminal(monkeypatch, given)
    assert main(["setup", "--answers", answers(tmp_path, **changes), "--out", str(tmp_path / "new")]) == 0
    assert len(prompts) == len(given)
    shown = capsys.readouterr().out
    assert reported in " ".join(shown.split())
    assert max(map(len, shown.partition("force cell:")[0].splitlines())) < 80
    known = configuration.load(tmp_path / "new" / "yieldmon.yaml")
    assert known.machine.plate_pivot_x_m == 0.4
    assert known.machine.sensor.gain_n_per_mv == pytest.approx(9.80665 * 10.0 / 195.1, rel=1e-3)


@pytest.mark.parametrize(
    ("typed", "mend"),
    [
        ("15 3/4 in", "15.75 in"),
        ("3/4 in", "0.75 in"),
        ("15¾ in", "15.75 in"),
        ("1' 2\"", "14 in"),
        ("1 ft 2.5 in", "14.5 in"),
        ("6½ 8 1/4 in", "6.5 8.25 in"),
    ],
)
@pytest.mark.parametrize("key", ["paddle_width_m", "paddle_spacings_m"])
def test_fractions_and_two_units_of_a_length_are_given_back_in_decimals(tmp_path, capsys, typed, mend, key):
    assert main(["setup", "--answers", answers(tmp_path, **{key: typed}), "--out", str(tmp_path / "new")]) == 2
    assert f"{key}: is {typed}; expected decimal numbers of one unit: {mend}\n" in capsys.readouterr().err


@pytest.mark.parametrize("typed", ["0x10", "12x", "0.1 0x10"])
def test_a_word_that_is_no_number_is_named_whole(tmp_path, capsys, typed):
    """0x10 was called x10."""
    assert main(["setup", "--answers", answers(tmp_path, paddle_spacings_m=typed), "--out", str(tmp_path / "new")]) == 2
    assert f"paddle_spacings_m: is {typed.split()[-1]};" in capsys.readouterr().err


def test_ctrl_d_keeps_the_answers_as_ctrl_c_does(tmp_path, capsys, monkeypatch):
    prompts = in_a_terminal(monkeypatch, ["blue", "virtual"])
    assert main(["setup", "--out", str(tmp_path / "new")]) == 130
    assert len(prompts) == 3
    assert yaml.safe_load((tmp_path / "new" / "setup-answers.yaml").read_text()) == {
        "machine_name": "blue",
        "bus_interface": "virtual",
    }


def test_a_set_up_that_is_done_says_how_a_question_is_asked_again(tmp_path, capsys):
    words = ["setup", "--answers", answers(tmp_path), "--out", str(tmp_path / "new")]
    assert main(words) == 0
    capsys.readouterr()
    assert main(words) == 2
    assert "what is taken out of setup-answers.yaml is asked again" in capsys.readouterr().err
