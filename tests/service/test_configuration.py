"""The configuration: the shipped file is the model, each wrong key gets its line, and it reaches the engine unchanged."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle
import re
from pathlib import Path

import pytest
import yaml

from tests.in_process import program
from yieldmon.cli import main as cli
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.settings import EngineSettings
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import METHOD, POOLED, SCALE, WEIGHED
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.files import machine_file, parameter_file
from yieldmon.resources import shipped
from yieldmon.service.config import configuration, document_text
from yieldmon.service.config.configuration import ConfigurationError
from yieldmon.service.config.document import Document
from yieldmon.service.config.engine_sections import engine_settings
from yieldmon.service.config.former_keys import FORMER_KEYS
from yieldmon.service.config.section import Section

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {"STATE_DIRECTORY": "/state", "RUNTIME_DIRECTORY": "/run/yieldmon"}


@pytest.fixture
def written(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "c.yaml"
        path.write_text(text)
        return path

    return write


def test_the_shipped_file_is_the_documented_default():
    path = shipped("config/yieldmon.yaml")
    assert path.read_text() == document_text.commented_defaults(), "run: yieldmon check-config --defaults > config/yieldmon.yaml"
    assert configuration.load(path, ENVIRONMENT).document == Document()


def test_every_key_has_a_meaning_and_every_number_a_range_and_unit():
    for name, field in Document.model_fields.items():
        section = field.annotation
        if not (isinstance(section, type) and issubclass(section, Section)):
            assert field.description
            continue
        assert section.__doc__
        for key, inner in section.model_fields.items():
            assert inner.description, f"{name}.{key}"
            if inner.annotation in (int, float, int | None):
                described = section.model_json_schema()["properties"][key]
                (ranged,) = (kind for kind in described.get("anyOf", [described]) if kind["type"] != "null")
                assert ranged["minimum"] < ranged["maximum"], f"{name}.{key}"
                assert inner.json_schema_extra["unit"], f"{name}.{key}"


#: The frames fix these, or they come from a file of their own.
WITHOUT_A_KEY = ("windows.window_s", "plate.command_counter_modulus", "waveform.shape")


@pytest.mark.parametrize("name", [section.name for section in dataclasses.fields(EngineSettings)])
def test_every_setting_of_the_engine_has_a_key(name):
    settings = {field.name for field in dataclasses.fields(getattr(EngineSettings(), name))}
    fixed = {key.partition(".")[2] for key in WITHOUT_A_KEY if key.startswith(f"{name}.")}
    assert set(type(getattr(Document(), name)).model_fields) == settings - fixed


def test_a_document_can_be_sent_to_another_process():
    assert pickle.dumps(Document.model_validate({"sweep": {"angles_deg": [50, 60]}}))


def test_defaults_are_the_engines_own():
    assert engine_settings(Document()) == EngineSettings()
    assert configuration.calibrator_settings(Document()) == CalibratorSettings()


def test_values_reach_the_engine(written):
    loaded = configuration.load(written("sweep: {angles_deg: [50, 60], enabled: false}\nzero: {max_step_mv: 7}"), {})
    assert loaded.engine.sweep == dataclasses.replace(EngineSettings().sweep, angles_deg=(50.0, 60.0), enabled=False)
    assert loaded.engine.zero.max_step_mv == 7.0


@pytest.mark.parametrize("text", ["# nothing\n", "{}"])
def test_a_file_without_keys_is_the_default_and_says_so(written, capsys, text):
    path = written(text)
    assert configuration.load(path, ENVIRONMENT).document == Document()
    assert cli.main(["check-config", str(path)]) == 0
    assert "valid, all defaults; machine" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", " \n"])
def test_a_file_cut_off_to_nothing_is_refused(written, capsys, text):
    path = written(text)
    for verb in (["check-config"], ["run", "--config"]):
        assert cli.main([*verb, str(path)]) == 2
        assert capsys.readouterr().err == f"yieldmon: {path}: is empty; expected keys and values, or {{}} for all defaults\n"


FOLDERS = [
    (ENVIRONMENT, "/state/yieldmon.sqlite", "/run/yieldmon/yieldmon.sock"),
    ({"STATE_DIRECTORY": "/a:/b"}, "/a/yieldmon.sqlite", "/a/yieldmon.sock"),
    (
        {"HOME": "/home/u", "XDG_RUNTIME_DIR": "/run/user/7"},
        "/home/u/.local/state/yieldmon/yieldmon.sqlite",
        "/run/user/7/yieldmon/yieldmon.sock",
    ),
    ({"XDG_STATE_HOME": "/x"}, "/x/yieldmon/yieldmon.sqlite", "/x/yieldmon/yieldmon.sock"),
]


@pytest.mark.parametrize(("environment", "store", "socket"), FOLDERS)
def test_folders_are_the_service_managers_or_the_users(written, environment, store, socket):
    loaded = configuration.load(written("{}"), environment)
    assert (str(loaded.store_path), str(loaded.socket_path)) == (store, socket)


def test_the_metrics_file_is_where_another_user_can_read_it(written):
    """The state folder is the daemon's own (0700); the runtime folder is not."""
    loaded = configuration.load(written("status: {prometheus_file: yieldmon.prom}"), ENVIRONMENT)
    assert loaded.prometheus_path == Path("/run/yieldmon/yieldmon.prom")


def test_files_are_found_beside_the_configuration(written, tmp_path):
    (tmp_path / "m.yaml").write_text(shipped("config/machines/sprocket-10.yaml").read_text())
    loaded = configuration.load(written("machine_file: m.yaml"), {})
    assert loaded.machine_path == tmp_path / "m.yaml"
    assert loaded.machine.sprocket_pitch_radius_m == 0.067


CONFLICTS = [
    ("status: {prometheus_file: c.yaml}", "status.prometheus_file: HERE/c.yaml is read for the configuration"),
    ("status: {prometheus_file: link.prom}", "status.prometheus_file: HERE/link.prom is read for the configuration"),
    (
        "machine_file: m.yaml\nstatus: {prometheus_file: ./m.yaml}",
        "status.prometheus_file: HERE/m.yaml is read for the configuration",
    ),
    ("status: {prometheus_file: yieldmon.sqlite}", "status.prometheus_file: HERE/yieldmon.sqlite is the store, or one beside it"),
    *(
        (f"store: {{path: s}}\nstatus: {{{key}: s{suffix}}}", f"status.{key}: HERE/s{suffix} is the store, or one beside it")
        for key in ("socket", "prometheus_file")
        for suffix in ("", "-wal", "-shm", "-journal", ".lock", ".last", ".ready", ".being-made", ".mended-wal")
    ),
    ("status: {prometheus_file: yieldmon.sock}", "status.prometheus_file: HERE/yieldmon.sock is status.socket"),
]


@pytest.mark.parametrize(("text", "problem"), CONFLICTS)
def test_what_the_service_writes_overwrites_nothing(tmp_path, text, problem):
    """A metrics file in the place of the configuration replaced it, and took it away at the stop."""
    (tmp_path / "m.yaml").write_text(shipped("config/machines/sprocket-10.yaml").read_text())
    (tmp_path / "link.prom").symlink_to("c.yaml")
    path = tmp_path / "c.yaml"
    path.write_text(text)
    folder = str(tmp_path)
    with pytest.raises(InputError) as raised:
        configuration.load(path, {"STATE_DIRECTORY": folder, "RUNTIME_DIRECTORY": folder})
    assert str(raised.value) == f"{path}: {problem.replace('HERE', folder)}; expected a file of its own"


@pytest.mark.parametrize("key", ["store.path", "status.socket", "status.prometheus_file"])
@pytest.mark.parametrize("name", ["/", "", ".", "..", "a/", "a/.", "/var/.."])
def test_what_the_service_writes_has_a_name(written, key: str, name: str) -> None:
    section, _, last = key.partition(".")
    with pytest.raises(InputError, match=rf"{re.escape(f': {key}: {name!r}')}; expected the name of a file$"):
        configuration.load(written(f"{section}: {{{last}: '{name}'}}"), ENVIRONMENT)


@pytest.mark.parametrize("word", ["off", "no", "none", "false"])
def test_a_quantity_is_switched_off_by_null(written, word: str) -> None:
    with pytest.raises(
        InputError, match=r"signals\.moisture: \S+; expected null to switch it off, or a mapping with dbc, message"
    ):
        configuration.load(written(f"signals: {{moisture: {word}}}"), ENVIRONMENT)


def test_a_home_folder_is_the_shells(written) -> None:
    with pytest.raises(InputError, match=r"store\.path: '~/y\.sqlite'; expected a path without ~, which only a shell"):
        configuration.load(written("store: {path: ~/y.sqlite}"), ENVIRONMENT)


@pytest.mark.parametrize(("text", "decimal"), [("0x83", 131), ("0o203", 131), ("0b101", 5)])
def test_a_number_of_another_base_is_told_in_decimal(written, text: str, decimal: int) -> None:
    with pytest.raises(InputError, match=rf"'{text}'; expected a whole number from 0 to 253 \(in decimal: {decimal}\)$"):
        configuration.load(written(f"network: {{preferred_address: {text}}}"), ENVIRONMENT)


@pytest.mark.parametrize("socket", ["/" + "s" * 106, "s"])
def test_a_socket_has_a_path_of_107_bytes(written, socket):
    assert configuration.load(written(f"status: {{socket: {socket}}}"), ENVIRONMENT).socket_path.name == socket.strip("/")


WRONG = [
    ("sweep: {interval_s: 5}", "sweep.interval_s: 5; expected a number from 60 to 1000000 s"),
    ("sweep: {interval_s: '900'}", "sweep.interval_s: '900'; expected a number from 60 to 1000000 s"),
    ("sweep: {interval_s: true}", "sweep.interval_s: True; expected a number from 60 to 1000000 s"),
    ("sweep: {home_every: 2.5}", "sweep.home_every: 2.5; expected a whole number from 1 to 50 angles"),
    ("sweep: {enabled: yes}", "sweep.enabled: 'yes'; expected true or false"),
    ("sweep: {angles_deg: [40, fifty]}", "sweep.angles_deg[1]: 'fifty'; expected a list of numbers, deg"),
    ("bus: {log_channels: [1]}", "bus.log_channels[0]: 1; expected a list of words (a number in quotes)"),
    ("sweep: {angles_deg: []}", "sweep.angles_deg: []; expected a list of numbers, deg"),
    (
        "sweep: {windows_per_step: 20}",
        "sweep.measure_timeout_s: 12; expected at least 22 s for sweep.windows_per_step, 20; no sweep would end",
    ),
    ("sweep: {angles_deg: [40, 20]}", "sweep.angles_deg[1]: 20; expected 40 to 90 deg, the range of sprocket-8"),
    ("store: {size_mb: .nan}", "store.size_mb: nan; expected a number from 16 to 100000 MB"),
    ("store: {siz_mb: 20}", "store.siz_mb: unknown key; expected size_mb"),
    ("stroe: {}", "stroe: unknown key; expected store"),
    ("status: 7", "status: 7; expected keys socket, group, prometheus_file, prometheus_interval_s"),
    ('machine_file: "a\\x00b"', r"machine_file: 'a\x00b'; expected a word or null"),
    ("status: {socket: \"a\\nb\"}", "status.socket: 'a\\nb'; expected a word"),
    (
        f"status: {{socket: /{'s' * 107}}}",
        "status.socket: has 108 bytes; expected at most 107, which is what a socket's address has room for",
    ),
    ("bus: {bitrate_bit_s: fast}", "bus.bitrate_bit_s: 'fast'; expected a whole number from 10000 to 1000000 bit/s or null"),
    ("bus: {options: {a: [1]}}", "bus.options.a: [1]; expected keys with plain values"),
    ("bus: {interface: sockcan}", "bus.interface: 'sockcan'; expected one of"),
    ("bus: {channel: can 0}", "bus.channel: is 'can 0'; expected the name of a network device"),
    ("bus: {channel: can0-of-the-header}", "bus.channel: is 'can0-of-the-header'; expected the name of a network device"),
    ("logging: {level: loud}", "logging.level: 'loud'; expected one of debug, info, warning, error"),
    ("gate: {grain_on_n: 0.1}", "gate.grain_off_n: 0.5; expected at most gate.grain_on_n, 0.1 N"),
    ("network: {enabled: false, task_controller: true}", "network.task_controller: true; expected network.enabled: true"),
    ("network: {preferred_address: 254}", "network.preferred_address: 254; expected a whole number from 0 to 253"),
    (f"status: {{socket: /run/{'x' * 103}}}", "status.socket: has 108 bytes; expected at most 107"),
    ("gate: {certain_force_n: 0.5}", "gate.certain_force_n: 0.5; expected at least gate.grain_on_n, 1 N"),
    ("windows: {min_coverage: 1}", "windows.min_coverage: 1; expected at most windows.full_coverage, 0.98"),
    ("[]", "[]; expected keys machine_file, parameter_file, estimator_file, moisture_map_file, pulse_shape_file, units"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line"), WRONG)
def test_a_wrong_key_gets_file_key_value_and_what_was_expected(written, text, line):
    path = written(text)
    with pytest.raises(ConfigurationError) as caught:
        configuration.load(path, {})
    assert str(caught.value).startswith(f"{path}: {line}")
    assert len(caught.value.problems) == 1


def test_grain_may_come_and_go_at_one_force(written):
    assert (
        configuration.load(written("gate: {grain_on_n: 2, grain_off_n: 2, certain_force_n: 2}"), {}).document.gate.grain_off_n
        == 2
    )


def test_all_problems_are_reported_at_once(written, capsys):
    path = written("store: {size_mb: -1, siz_mb: 3}\nlogging: {level: loud}")
    assert cli.main(["check-config", str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert [line.split(": ")[2] for line in captured.err.splitlines()] == ["store.size_mb", "store.siz_mb", "logging.level"]


def test_check_config_json(written, capsys):
    path = written("sweep: {interval_s: 5}")
    assert cli.main(["check-config", "--json", str(path)]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert answer["valid"] is False
    assert answer["problems"] == [
        {"where": f"{path}: sweep.interval_s", "problem": "5", "expected": "a number from 60 to 1000000 s"}
    ]
    assert cli.main(["check-config", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["configuration"]["sweep"]["interval_s"] == EngineSettings().sweep.interval_s


def test_check_config_prints_the_default(capsys):
    assert cli.main(["check-config", "--defaults"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["bus"]["interface"] == "socketcan"


@pytest.mark.parametrize("key", ["machine_file", "parameter_file", "moisture_map_file", "pulse_shape_file"])
def test_a_missing_file_that_the_configuration_names_is_one_line(written, key, tmp_path):
    with pytest.raises(InputError, match="No such file"):
        configuration.load(written(f"{key}: absent.yaml"), {})


def test_parameters_in_a_unit_of_the_reading_give_no_flow_and_are_refused(written, tmp_path):
    text = (ROOT / "config" / "parameters" / "corn.yaml").read_text(encoding="utf-8")
    (tmp_path / "bench.yaml").write_text(text.replace("response_unit: N", "response_unit: response"), encoding="utf-8")
    with pytest.raises(InputError, match=r"bench\.yaml: response_unit: is 'response'; expected 'N'"):
        configuration.load(written(f"parameter_file: {tmp_path / 'bench.yaml'}"), {})


def test_moisture_map_and_drift_reach_the_self_calibration(written, tmp_path):
    (tmp_path / "map.yaml").write_text("moisture_pct: [14, 20]\nvalues: {friction: [0.2, 0.3]}\n", encoding="utf-8")
    text = f"moisture_map_file: {tmp_path / 'map.yaml'}\ndrift_per_root_hour: {{friction: 0.07}}\ndrift_limit: {{density: 0.3}}"
    found = configuration.load(written(text), {}).calibrator
    assert found.moisture_map.at("friction", 17.0) == pytest.approx(0.25)
    assert found.drift.per_root_hour["friction"] == 0.07
    assert found.drift.limit["density"] == 0.3
    assert found.drift.per_root_kilotonne == DriftRates().per_root_kilotonne


def test_plate_range_of_the_machine_is_taken_exactly(written):
    loaded = configuration.load(written("sweep: {angles_deg: [40, 90]}"), {})
    assert math.degrees(loaded.machine.max_plate_angle_rad) == pytest.approx(90.0)


def test_a_plate_that_is_bolted_on_needs_no_angles_to_sweep(written, tmp_path):
    machine = (ROOT / "config/machines/sprocket-8.yaml").read_text()
    machine = machine.replace("min_plate_angle_deg: 40", "min_plate_angle_deg: 70").replace(
        "max_plate_angle_deg: 90", "max_plate_angle_deg: 70"
    )
    (tmp_path / "bolted.yaml").write_text(machine)
    assert configuration.load(written("machine_file: bolted.yaml\nplate: {fixed_angle_deg: 70}"), {}).document.sweep.enabled
    with pytest.raises(InputError, match="expected 70 to 70 deg"):
        configuration.load(written("machine_file: bolted.yaml"), {})


def test_mutated_files_give_a_line_or_a_configuration():
    finished = program("tests.robustness.__main__", "fuzz-config", "--count", 100, "--seed", 1, "--json")
    assert finished.returncode == 0, finished.stderr
    counts = json.loads(finished.stdout)
    assert counts["escapes"] == 0
    assert min(counts["accepted"], counts["refused"]) > 7, "mutations must reach both sides"


def test_defaults_are_within_their_own_ranges():
    assert Document.model_validate(Document().model_dump()) == Document()


@pytest.mark.parametrize(("section", "former", "present"), [(*key, present) for key, present in FORMER_KEYS.items()])
def test_a_former_key_is_read_with_a_note(section, former, present, written):
    default = getattr(getattr(Document(), section), present)
    value = not default if isinstance(default, bool) else type(default)(0.5 * default)
    found = configuration.load(written(json.dumps({section: {former: value}})), ENVIRONMENT)
    assert getattr(getattr(found.document, section), present) == value
    assert f"{section}.{former} is now called {section}.{present}" in found.notes[0]
    assert configuration.load(written(json.dumps({section: {present: value}})), ENVIRONMENT).notes == ()


def test_a_key_under_both_names_is_refused(written):
    path = written("sweep: {lying_ratio: 0.4, feedback_plausibility_force_ratio: 0.5}\n")
    with pytest.raises(ConfigurationError, match=r"sweep\.lying_ratio: is given together with"):
        configuration.load(path, ENVIRONMENT)


def test_check_config_shows_the_note(written, capsys):
    assert cli.main(["check-config", str(written("sweep: {lying_spread: 0.1}\n"))]) == 0
    assert "note: " in (shown := capsys.readouterr().out)
    assert "sweep.feedback_plausibility_flow_spread" in shown


@pytest.mark.parametrize(
    ("rate_hz", "given", "timeout_s"),
    [
        (1000, "", EngineSettings().inputs.sensor_timeout_s),
        (10, "", 1.0),
        (25, "", 0.4),
        (10, "inputs: {sensor_timeout_s: 0.3}", 0.3),
    ],
)
def test_a_slow_sensor_is_waited_for_ten_frames_unless_a_time_is_set(written, tmp_path, rate_hz, given, timeout_s):
    (tmp_path / "a.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: N\nBO_ 417 Force: 2 N\n SG_ F : 0|16@1+ (0.1,0) [0|0] "N" N\n', encoding="utf-8"
    )
    path = written(f"signals:\n  impact_force: {{dbc: a.dbc, message: Force, signal: F, rate_hz: {rate_hz}}}\n{given}\n")
    assert configuration.load(path, {}).engine.inputs.sensor_timeout_s == pytest.approx(timeout_s)


LENGTHS = {
    # key, a file with so many items; an item; fewest and most
    "angles_deg": ("sweep: {{angles_deg: [{items}]}}", "50", 1, 50),
    "signals": ("signals: {{impact_force: {{message: M, signals: [{items}], rate_hz: 100}}}}", "S{n}", 1, 64),
    "not_available": ("signals: {{moisture: {{message: M, signal: S, not_available: [{items}]}}}}", "7", 0, 64),
    "range": ("signals: {{moisture: {{message: M, signal: S, range: [{items}]}}}}", "{n}", 2, 2),
}


@pytest.mark.parametrize("key", LENGTHS)
def test_lists_have_so_many_items(written, key):
    text, item, fewest, most = LENGTHS[key]

    def refused(count: int) -> bool:
        items = ", ".join(item.format(n=n) for n in range(count))
        try:
            configuration.load(written(text.format(items=items)), ENVIRONMENT)
        except InputError as error:
            return f"{key}: [" in str(error)
        return False

    assert [refused(count) for count in (fewest, most, most + 1)] == [False, False, True]
    assert fewest == 0 or refused(fewest - 1)


def test_the_shipped_corn_is_no_calibration_of_another_machine(written, tmp_path, capsys):
    """It states 0.4 % of the flow by its own covariance; 24 machines with laws of their own were 33 % off."""
    assert configuration.load(written("{}")).parameters.scale_error == 0.0
    other = dataclasses.replace(machine_file.load(), paddle_width_m=0.2)
    (tmp_path / "machine.yaml").write_text(yaml.safe_dump(machine_file.to_document(other)))
    plain = written("machine_file: machine.yaml")
    assert configuration.load(plain).parameters.scale_error > 0.3
    assert cli.main(["check-config", str(plain)]) == 0
    assert "note: the parameters are not calibrated on this machine: its force is known to 45 %" in capsys.readouterr().out
    own = dataclasses.replace(parameter_file.load(), provenance={"data": "facility.csv"})
    parameter_file.save(own, tmp_path / "own.yaml")
    calibrated = written("machine_file: machine.yaml\nparameter_file: own.yaml")
    assert configuration.load(calibrated).parameters == own
    assert cli.main(["check-config", str(calibrated)]) == 0
    assert "not calibrated" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("provenance", "model_error", "enabled", "said"),
    [
        ({METHOD: POOLED}, 0.0, "true", "no sweep runs by schedule: the loads of other machines do not show"),
        ({METHOD: POOLED, SCALE: WEIGHED}, 0.0, "true", ""),
        ({METHOD: POOLED}, 0.0, "false", ""),
        ({}, 0.03, "true", "no sweep runs by schedule: the calibration missed angles and loads that it left out by 3 %"),
    ],
)
def test_check_config_says_why_no_sweep_runs(written, tmp_path, capsys, provenance, model_error, enabled, said):
    known = dataclasses.replace(parameter_file.load(), provenance=provenance, model_error=model_error)
    parameter_file.save(known, tmp_path / "p.yaml")
    assert cli.main(["check-config", str(written(f"parameter_file: p.yaml\nsweep: {{enabled: {enabled}}}"))]) == 0
    shown = capsys.readouterr().out
    assert ("no sweep runs" in shown) is bool(said)
    assert said in shown
