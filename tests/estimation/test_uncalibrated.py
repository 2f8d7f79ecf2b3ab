"""Parameters that nothing of this machine has calibrated state what a machine unlike the model may be off by."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from yieldmon.cli.main import main
from yieldmon.estimation.force_deviation import force_std_dev
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import NOT_CALIBRATED, SCALE, WEIGHED, ParameterSet
from yieldmon.files import calibrated_machine, machine_file, parameter_file
from yieldmon.files.crops import crop
from yieldmon.physics.machine import RPM, ImpactSensor, Machine
from yieldmon.physics.model import Conditions, ForwardModel

DATA = Path(__file__).parent.parent / "data"
MACHINE = Machine()
HOME_RAD, SPEED = MACHINE.home_plate_angle_rad, 400.0 * RPM
MOST_KG_S = 26.0


def of(known: ParameterSet) -> OpenLoop:
    return OpenLoop(ForwardModel(MACHINE, known.effects), known)


def relative(known: ParameterSet) -> float:
    found = of(known).estimate(90.0, HOME_RAD, SPEED)
    return float(found.std_dev_kg_s / found.mass_flow_kg_s)


@pytest.mark.parametrize("name", ["corn", "soybean", "wheat", "barley", "rapeseed", "sorghum"])
@pytest.mark.parametrize("table", ["dem_campaign", "dem_clumps"])
def test_flows_of_simulated_kernels_are_within_what_a_crop_states(table: str, name: str) -> None:
    """A discrete-element simulation of this elevator, in which grain strikes grain; z was 4 to 6 with 8 % stated."""
    with (DATA / f"{table}.csv").open() as lines:
        rows = [row for row in csv.DictReader(lines) if float(row["plate_angle_deg"]) == 70.0]
    speed, mass, momentum = (
        np.array([float(row[key]) for row in rows]) for key in ("elevator_speed_rpm", "paddle_mass_kg", "momentum_total_kg_m_s")
    )
    passes = MACHINE.passes_per_s(speed * RPM)
    found = of(crop(name).parameters()).estimate(momentum * passes, HOME_RAD, speed * RPM)
    z = ((found.mass_flow_kg_s - mass * passes) / found.std_dev_kg_s)[mass * passes < MOST_KG_S]
    assert z.size > 10
    assert float(np.sqrt(np.mean(z**2))) < 1.6


def test_what_was_calibrated_on_the_machine_is_stated_by_its_own_covariance() -> None:
    known = parameter_file.load()
    weighed, elsewhere = (replace(known, provenance={SCALE: scale}) for scale in (WEIGHED, NOT_CALIBRATED))
    assert known.scale_error == weighed.scale_error == 0.0
    assert relative(known) == relative(weighed) < 0.01
    assert relative(elsewhere) > 0.3
    published = crop("wheat").parameters()
    assert published.scale_error > 0.3
    assert replace(published, provenance={**published.provenance, SCALE: WEIGHED}).scale_error == 0.0


def test_a_predicted_force_is_as_unsure() -> None:
    known, conditions = parameter_file.load(), Conditions(HOME_RAD, SPEED, mass_flow_kg_s=np.array([3.0, 15.0]))
    model = ForwardModel(MACHINE, known.effects)
    force = model.force(conditions, known.values)
    assert np.all(force_std_dev(model, parameter_file.not_calibrated(known), conditions) > 0.3 * force)
    assert np.all(force_std_dev(model, known, conditions) < 0.01 * force)


def test_the_shipped_corn_is_calibrated_on_the_shipped_geometry_alone() -> None:
    known, other = parameter_file.load(), replace(MACHINE, paddle_width_m=0.2)
    assert parameter_file.on_a_machine(known, MACHINE) == known
    fixed = replace(MACHINE, name="bolted", min_plate_angle_rad=HOME_RAD, max_plate_angle_rad=HOME_RAD)
    assert parameter_file.on_a_machine(known, fixed) == known
    marked = parameter_file.on_a_machine(known, other)
    assert marked.scale_error > 0.0
    assert parameter_file.digest(marked) == parameter_file.digest(known), "a store goes on with what it has learnt"
    own = replace(known, values={**known.values, "friction": 0.25}, provenance={"data": "facility.csv"})
    assert parameter_file.on_a_machine(own, other) == own
    assert parameter_file.on_a_machine(crop("rice").parameters(), other) == crop("rice").parameters()


@pytest.mark.parametrize("command", [["predict", "--mass-flow", "10"], ["estimate", "forces.csv"]])
@pytest.mark.parametrize(("width_m", "said"), [(0.21, False), (0.25, True)])
def test_an_uncalibrated_machine_is_said_to_be_one(
    command: list[str], width_m: float, said: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """With the shipped corn, whose calibration holds for the shipped geometry alone."""
    monkeypatch.chdir(tmp_path)
    Path("forces.csv").write_text("force_n,plate_angle_deg,elevator_speed_rpm\n80,70,400\n")
    Path("machine.yaml").write_text(yaml.safe_dump(machine_file.to_document(replace(Machine(), paddle_width_m=width_m))))
    assert main([*command, "--machine", "machine.yaml"]) == 0
    assert ("not calibrated on this machine" in capsys.readouterr().err) is said


@pytest.mark.parametrize(
    ("other", "is_marked", "said"),
    [
        ({}, False, ""),
        ({"paddle_width_m": 0.212}, False, ""),
        ({"paddle_width_m": 0.23}, True, "other lengths of elevator and plate"),
        ({"paddle_spacings_m": (0.19,)}, True, "other lengths of elevator and plate"),
        ({"sensor": ImpactSensor(gain_n_per_mv=0.9)}, False, "a force cell of 0.4448 N/mV, here 0.9"),
        ({"name": "second"}, False, "the name sprocket-8, here second"),
    ],
    ids=["the same", "measured anew", "another width", "another chain", "another cell", "another name"],
)
def test_parameters_of_weighed_loads_hold_on_their_machine(other: dict[str, Any], is_marked: bool, said: str) -> None:
    """They were taken for calibrated on whatever machine their file was copied to."""
    known = replace(parameter_file.load(), provenance={SCALE: WEIGHED, **calibrated_machine.facts(MACHINE)})
    here = replace(MACHINE, **other)
    found = parameter_file.on_a_machine(known, here)
    assert (found.scale_error > 0.3) == is_marked
    assert calibrated_machine.difference(known, here) == said
    assert parameter_file.digest(found) == parameter_file.digest(known), "a store goes on with what it has learnt"
