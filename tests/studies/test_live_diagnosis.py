"""The daemon beside a virtual combine in simulated time, and how a live run is judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from studies.live_diagnosis import cases as live
from studies.live_diagnosis.stepped_daemon import SteppedDaemon
from tests.plant_sweeps import MACHINE, STRONG, shown_force, sweep_windows, window
from yieldmon.estimation.estimators import estimator_of
from yieldmon.files import parameter_file
from yieldmon.service.storage.rows import SecondRow, second_row
from yieldmon.service.storage.store import Store

CONTROL = live.CASES[0]
SHIPPED = parameter_file.load()


def configured(folder: Path) -> Path:
    parameter_file.save(SHIPPED, folder / "parameters.yaml")
    path = folder / "c.yaml"
    path.write_text(
        "parameter_file: parameters.yaml\nbus: {transmit_max_age_s: 60}\nlogging: {level: error}\n"
        "sweep: {first_after_s: 35, angles_deg: [40, 90], steady_windows: 4}\n"
    )
    return path


def seconds(folder: Path) -> list[SecondRow]:
    with Store(folder / "yieldmon.sqlite") as store:
        return store.seconds()


def test_a_run_repeats_itself_with_its_sweep(tmp_path: Path) -> None:
    """90 s, with a whole sweep of the plate in them: every stored second is the same, whatever the threads did."""
    found = []
    for name in ("one", "other"):
        folder = tmp_path / name
        folder.mkdir()
        with SteppedDaemon(live.combine_of(CONTROL, MACHINE, 0.025, seed=3), configured(folder), folder) as stepped:
            stepped.run_until(90.0)
        found.append(seconds(folder))
    assert found[0] == found[1]
    assert len(found[0]) == 89
    assert found[0][-1].time_s - SteppedDaemon.START_S == pytest.approx(89.1)
    assert {row.sweep_step for row in found[0] if row.usable_for_calibration} == {0, 1, 2, 3}


def test_adopted_parameters_are_taken_on_reload_and_the_fault_goes(tmp_path: Path) -> None:
    path = configured(tmp_path)
    adopted = replace(SHIPPED, values={**SHIPPED.values, "plate_friction.coefficient": 0.15})
    with SteppedDaemon(live.combine_of(CONTROL, MACHINE, 0.02, seed=3), path, tmp_path) as stepped:
        stepped.run_until(35.0)
        engine = stepped.daemon.monitor
        for seed in range(12):
            windows = sweep_windows(MACHINE, shown_force(MACHINE, STRONG), flow_kg_s=6.0 + 4.0 * (seed % 4), seed=seed)
            engine.disagreement.add(windows, engine.estimator.parameters)
        stepped.run_until(40.0)
        assert stepped.reload() == "taken"
        stepped.run_until(42.0)
        assert stepped.daemon.monitor.disagreement.present
        parameter_file.save(adopted, tmp_path / "parameters.yaml")
        assert stepped.reload() == "taken"
        stepped.run_until(50.0)
    rows = seconds(tmp_path)
    shown = [row.time_s - SteppedDaemon.START_S for row in rows if "ModelDisagrees" in row.faults.split()]
    assert shown[0] == pytest.approx(35.1)
    assert shown[-1] == pytest.approx(41.1)
    assert [row.parameter_version for row in rows if row.time_s - SteppedDaemon.START_S > 42.5] == [2] * 7
    with Store(tmp_path / "yieldmon.sqlite") as store:
        last = store.parameter_versions()[-1]
    assert (last.version, last.origin) == (2, "file")
    assert last.document["effects"]["plate_friction"] == {"coefficient": 0.15}


def test_a_daemon_that_ends_is_no_endless_wait(tmp_path: Path) -> None:
    path = configured(tmp_path)
    stepped = SteppedDaemon(live.combine_of(CONTROL, MACHINE, 0.01, seed=3), path, tmp_path)
    with stepped:
        stepped.daemon.request_stop()
        with pytest.raises(RuntimeError, match="has ended"):
            stepped.run_until(30.0)


def test_flow_errors_by_where_the_plate_was() -> None:
    """Flow of 10 kg/s, measured 10 % too high at home and 20 % too low away; a second without a figure and one of 2 kg/s."""
    delay_s = 0.5 * MACHINE.pattern_length_m / MACHINE.paddle_speed_m_s(400.0 * 2.0 * np.pi / 60.0)
    combine = SimpleNamespace(
        machine=MACHINE,
        scenario=SimpleNamespace(elevator=SimpleNamespace(speed_rpm=400.0)),
        delivered_kg=lambda at_s: np.interp(at_s, [0.0, 5.0, 6.0], [0.0, 50.0, 52.0]),
    )
    plan = [(70.0, 11.0), (70.0, 11.0), (40.0, 8.0), (70.0, float("nan")), (90.0, 8.0), (70.0, 9.0)]
    rows = [
        second_row(i, window(time_s=100.0 + i + delay_s, mass_flow_kg_s=flow, plate_angle_rad=float(np.radians(angle))))
        for i, (angle, flow) in enumerate(plan, 1)
    ]
    found = live.flow_errors(rows, combine, 100.0, 70.0)  # type: ignore[arg-type]
    assert {name: error.seconds for name, error in found.items()} == {"home": 2, "away": 2, "all": 4}
    assert found["home"].bias_pct == pytest.approx(10.0)
    assert found["away"].bias_pct == pytest.approx(-20.0)
    assert found["all"].mean_abs_pct == pytest.approx(15.0)


def test_a_calibration_at_home_is_right_at_home_whatever_the_effect() -> None:
    case = live.Case("strong", STRONG)
    found = live.calibrated_at_home(case, MACHINE, SHIPPED, seed=1)
    assert found.effects == ("gravity",)
    assert found.covariance_names == ("friction", "density", "restitution")
    flow = np.array([6.0, 10.0, 16.0])
    speed = MACHINE.nominal_elevator_speed_rad_s
    loop = estimator_of(MACHINE, found)
    for angle_deg, limit in ((70.0, 0.02), (40.0, 0.5)):
        angle = np.full(3, np.radians(angle_deg))
        measured = loop.invert(shown_force(MACHINE, STRONG)(flow, angle), angle, np.full(3, speed))
        assert np.all(np.abs(measured / flow - 1.0) < limit)
    assert np.all(measured / flow > 1.1)
