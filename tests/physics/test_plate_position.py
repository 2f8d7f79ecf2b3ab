"""The plate moved away from the elevator: the forward model, tables, `predict`, and what a position adds to a calibration."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.estimation.fitting.calibration import calibrate
from yieldmon.estimation.fitting.identifiability import report
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import machine_file, table
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
GRAIN = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
MODEL = ForwardModel(MACHINE)
SPEED = 400.0 * RPM


def momentum(angle_deg: object, flow: object, place: object = None, effects: dict[str, float] | None = None) -> np.ndarray:
    values = GRAIN | (effects or {})
    model = MODEL.with_effects({name.partition(".")[0] for name in (effects or {})})
    at = Conditions(np.radians(angle_deg), SPEED, mass_flow_kg_s=flow, plate_position_m=place)
    return np.real(model.paddle_momentum(at, values))


@pytest.mark.parametrize("effects", [{}, {"gravity.acceleration_m_s2": 9.81}])
def test_a_moved_plate_is_a_machine_built_that_way(effects: dict[str, float]) -> None:
    places = np.array([-0.08, 0.0, 0.03, 0.11])
    for place in places:
        built = ForwardModel(
            MACHINE.with_plate_at(float(place)), MODEL.with_effects({k.partition(".")[0] for k in effects}).effects
        )
        at = Conditions(np.radians([40.0, 55.0, 70.0, 90.0]), SPEED, mass_flow_kg_s=np.array([[3.0], [12.0]]))
        expected = np.real(built.paddle_momentum(at, GRAIN | effects))
        found = momentum([40.0, 55.0, 70.0, 90.0], np.array([[3.0], [12.0]]), place, effects)
        assert found == pytest.approx(expected, rel=1e-12)


def test_where_all_grain_lands_the_distance_changes_nothing_without_gravity() -> None:
    # Straight paths: direction and speed at the plate are those at the tip, wherever the plate stands.
    assert momentum(90.0, 3.0, np.array([-0.05, 0.0, 0.05])) == pytest.approx(float(momentum(90.0, 3.0)), rel=1e-12)


def test_where_grain_misses_a_plate_further_away_catches_less() -> None:
    found = momentum(40.0, 15.0, np.array([-0.06, -0.03, 0.0, 0.03, 0.06]))
    assert np.all(np.diff(found) < 0.0)


def test_a_calibration_takes_rows_of_several_positions() -> None:
    angle, flow, place = (v.ravel() for v in np.meshgrid([45.0, 60.0, 70.0], [4.0, 9.0, 16.0, 22.0], [-0.05, 0.0, 0.05]))
    at = Conditions(np.radians(angle), np.full(angle.size, SPEED), mass_flow_kg_s=flow, plate_position_m=place)
    rows = Measurements(at, momentum(angle, flow, place))
    start = {"friction": 0.4, "restitution": 0.3, "density": 1400.0, "shape_ratio": 2.0}
    found = calibrate(MODEL, rows, start, ("friction", "restitution", "density"), starts=3, intervals=False)
    assert [found.parameter_set.values[n] for n in GRAIN] == pytest.approx(list(GRAIN.values()), rel=1e-5)
    assert rows.select(place > 0.0).conditions.plate_position_m == pytest.approx(0.05)
    assert rows.cells()[1].max() == angle.size - 1
    # Told that the plate never moved, no grain explains the rows.
    blind = Measurements(replace(at, plate_position_m=None), rows.momentum)
    wrong = calibrate(MODEL, blind, start, ("friction", "restitution", "density"), starts=3, intervals=False)
    assert wrong.residuals.rms_over_max_pct > 1.0


def test_a_plate_that_moves_is_proposed_where_it_would_help() -> None:
    at = Conditions(np.full(3, np.radians(70.0)), np.full(3, SPEED), mass_flow_kg_s=np.array([2.0, 3.0, 4.0]))
    known = ParameterSet(GRAIN)
    fixed, moving = (
        report(ForwardModel(replace(MACHINE, plate_travel_m=travel)), at, known, ("friction", "density", "restitution"), 0.01)
        for travel in ((0.0, 0.0), (-0.05, 0.1))
    )
    assert not any("plate moved" in remedy.measurement for remedy in fixed.remedies)
    assert any("plate moved by" in remedy.measurement for remedy in moving.remedies)
    assert moving.remedies[0].worst_sd_after <= fixed.remedies[0].worst_sd_after


def test_machine_files_say_how_far_the_plate_moves(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    document = machine_file.to_document(replace(MACHINE, plate_travel_m=(-0.03, 0.05)))
    path.write_text(json.dumps(document))
    assert machine_file.load(path).plate_travel_m == (-0.03, 0.05)
    assert "plate_travel_m" not in machine_file.to_document(MACHINE)
    for wrong, reported in (
        ([0.01, 0.05], "plate_travel_m is (0.01, 0.05), expected [at most 0, at least 0] m"),
        ([-0.3, 0.0], "plate_travel_m lets the plate into the paddles' way"),
        (0.1, "plate_travel_m: is 0.1; expected [towards the elevator, away from it] in m"),
    ):
        path.write_text(json.dumps(document | {"plate_travel_m": wrong}))
        with pytest.raises(InputError) as caught:
            machine_file.load(path)
        assert reported in str(caught.value)


def test_predict_takes_positions(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["predict", "--mass-flow", "15", "--plate-angle", "40", "--plate-position", "0,-0.03,0.03", "--json"]
    assert main(words) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["plate_position_m"] for row in rows] == [0.0, -0.03, 0.03]
    force = [row["force_n"] for row in rows]
    assert force[2] < force[0] < force[1]
    assert main(["predict", "--mass-flow", "15", "--plate-position", "-0.3"]) == 2
    assert "--plate-position: is -0.3; expected above -0.24 m, where the plate clears the paddles" in capsys.readouterr().err


def test_tables_hold_positions_and_verbs_that_cannot_use_several_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "t.csv"
    head = "plate_angle_deg,plate_position_m,mass_flow_kg_s,force_n\n"
    path.write_text(head + "40,0.05,9,30\n70,0.05,9,75\n")
    assert table.load(path).at_one_position(MACHINE).plate_pivot_x_m == pytest.approx(0.45)
    path.write_text(head + "40,0.05,9,30\n70,0,9,75\n")
    for words in (["estimate"], ["self-calibrate"], ["diagnose"]):
        assert main([*words, str(path)]) == 2
        assert "t.csv: plate_position_m: holds 2 positions; expected one, but for `calibrate`" in capsys.readouterr().err
    path.write_text(head + "40,,9,30\n70,0,9,75\n")
    assert main(["estimate", str(path)]) == 2
    assert "line 2, plate_position_m: is unknown; expected a position in m" in capsys.readouterr().err


def test_a_position_that_is_not_known_gives_no_number() -> None:
    found = momentum(70.0, np.array([4.0, 9.0]), np.array([np.nan, 0.0]))
    assert np.isnan(found).tolist() == [True, False]


def test_a_plate_in_the_paddles_way_is_refused_with_the_nearest_position() -> None:
    with pytest.raises(ValueError, match=r"plate_position_m -0\.3: expected above -0\.24 m, where it clears the paddles"):
        momentum(70.0, 4.0, -0.3)
