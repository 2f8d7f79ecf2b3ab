"""`estimator_file`: a curve gives the flow of daemon and logs; nothing is learnt, and nothing pretends to be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from studies.waveform.frame_runs import run_of
from yieldmon.cli.main import main
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import WindowResult, windows_in
from yieldmon.errors import InputError
from yieldmon.files import flow_curve_file, parameter_file
from yieldmon.frames import NOT_AVAILABLE, EstimateQuality, Frame
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory
from yieldmon.service.operator import commands

TABLE = Path(__file__).parents[1] / "data" / "corn_facility.csv"
FLOW_KG_S = 9.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both curves, calibrated at home by the command on the shipped facility table, and a configuration for each."""
    folder = tmp_path_factory.mktemp("curves")
    for kind in ("alpha_beta", "table"):
        words = ["calibrate", str(TABLE), "--estimator", kind, "--plate-angle", "70", "--out", str(folder / f"{kind}.yaml")]
        assert main(words) == 0
        (folder / f"with-{kind}.yaml").write_text(f"estimator_file: {kind}.yaml\n")
    return folder


@cache
def traffic() -> tuple[Frame, ...]:
    pieces = [{"kind": "steady", "duration_s": 12, "flow_kg_s": 0}, {"kind": "steady", "duration_s": 20, "flow_kg_s": FLOW_KG_S}]
    return tuple(VirtualCombine(from_mapping({"duration_s": 30, "flow": {"pieces": pieces}}, "test"), seed=5).frames_until(30.0))


def windows(monitor: Monitor) -> list[WindowResult]:
    return windows_in(monitor.feed_run(run_of(traffic())))


def started(path: Path) -> tuple[Monitor, Journal]:
    known = configuration.load(path)
    return monitor_of(known), Journal(Memory(), known.parameters, now_s=0.0)


@pytest.mark.parametrize("kind", ["alpha_beta", "table"])
def test_the_flow_is_the_curves_and_its_deviation_is_stated(kind: str, folder: Path) -> None:
    monitor = monitor_of(configuration.load(folder / f"with-{kind}.yaml"))
    last = windows(monitor)[-10:]
    flow = np.array([window.record.mass_flow_kg_s for window in last])
    sd = np.array([window.record.std_dev_kg_s for window in last])
    assert np.all(np.abs(flow - FLOW_KG_S) < 2.0 * sd)
    assert np.all(sd < 0.15 * flow)
    # Paddles scatter by themselves: part of the deviation averages out.
    assert all(0.0 < window.record.noise_std_dev_kg_s < window.record.std_dev_kg_s for window in last)
    assert {window.record.quality for window in last} == {EstimateQuality.OK}
    assert not any(window.record.faults for window in last)
    frame = next(frame for frame in last[-1].frames if frame.message == "SelfCalibrationStatus")
    assert frame.signals["Friction"] is NOT_AVAILABLE
    assert frame.signals["ImpactGain"] is NOT_AVAILABLE


def test_a_weighed_load_that_contradicts_is_reported_and_changes_nothing(folder: Path) -> None:
    monitor = monitor_of(configuration.load(folder / "with-table.yaml"))
    before = monitor.estimator
    for frame in traffic():
        if frame.time_s > 11.0 and monitor.totals.load_number == 1:
            monitor.start_load()  # The zero is known by now.
        monitor.feed(frame)
    monitor.stop_load()
    load = monitor.loads[-1]
    assert load.complete
    monitor.ticket(load.number, 1.5 * load.measured_kg, 0.005 * load.measured_kg)
    for second in (31.5, 32.5, 33.5):
        monitor.tick(second)
    assert monitor.estimator is before
    assert FaultCode.SCALE_DISAGREES in monitor.faults.active


def test_what_a_curve_cannot_do_is_refused(folder: Path) -> None:
    monitor, journal = started(folder / "with-alpha_beta.yaml")
    before = monitor.estimator
    answer = commands.execute({"command": "load-start", "crop": "wheat"}, monitor, journal, 1.7e9)
    assert not answer["crop_known"]
    assert monitor.estimator is before
    with pytest.raises(InputError, match="sweep: updates nothing"):
        commands.execute({"command": "sweep-start"}, monitor, journal, 1.7e9)
    with pytest.raises(InputError, match="the flow comes from estimator_file"):
        commands.execute({"command": "calibration-undo", "version": 1}, monitor, journal, 1.7e9)


def test_check_config_says_what_the_curve_ends(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-config", str(folder / "with-table.yaml")]) == 0
    note, valid = capsys.readouterr().out.splitlines()
    assert note.startswith("note: the flow comes from table.yaml (table, standard deviation ")
    assert note.endswith("%): no sweep runs and weighed loads change nothing")
    assert "valid" in valid
    known = configuration.load(folder / "with-table.yaml")
    assert known.calibrator is None
    assert not known.engine.sweep.enabled


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        ("estimator_file: gone.yaml\n", "gone.yaml: No such file or directory"),
        (
            "estimator_file: params.yaml\n",
            "params.yaml: is a parameter file; expected a curve that",
        ),
        (
            "parameter_file: table.yaml\n",
            "table.yaml: is a curve (table); expected a parameter file;",
        ),
        (
            "estimator_file: table.yaml\nplate: {fixed_angle_deg: 60}\n",
            "table.yaml: plate_angle_deg: calibrated at 70 deg; expe",
        ),
        ("estimator: table\n", "estimator: unknown key; expected estimator_file"),
    ],
)
def test_a_wrong_estimator_file_costs_a_line(
    content: str, reported: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flow_curve_file.save(flow_curve_file.load(folder / "table.yaml"), tmp_path / "table.yaml")
    parameter_file.save(parameter_file.load(), tmp_path / "params.yaml")
    (tmp_path / "c.yaml").write_text(content)
    assert main(["check-config", str(tmp_path / "c.yaml")]) == 2
    err = capsys.readouterr().err
    assert reported in err
    assert err.count("\n") == 1


def test_a_log_is_processed_by_the_curve_that_is_named(folder: Path) -> None:
    plain = configuration.load(folder / "with-table.yaml")
    named = configuration.with_estimator(replace(plain, parameters=parameter_file.load()), folder / "table.yaml")
    assert [w.record.mass_kg for w in windows(monitor_of(named))] == [w.record.mass_kg for w in windows(monitor_of(plain))]
