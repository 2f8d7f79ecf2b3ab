"""The shipped crops are usable as they are, and say how little is known of them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from yieldmon.errors import InputError
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import SCALE, WEIGHED
from yieldmon.files import parameter_file
from yieldmon.files.crops import crop, crops
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

NAMES = ("corn", "soybean", "wheat", "barley", "rapeseed", "sorghum", "sunflower", "rice")
BUSHELS_LB = {"corn": 56, "soybean": 60, "wheat": 60, "barley": 48, "rapeseed": 50, "sorghum": 56, "rice": 45}


def test_all_eight_are_there():
    assert set(crops()) == set(NAMES)
    for name, pounds in BUSHELS_LB.items():
        assert crop(name).bushel_kg == pytest.approx(pounds * 0.45359237)
    with pytest.raises(InputError, match=r"crop: 'oats'; expected one of corn, soybean"):
        crop("oats")


@pytest.mark.parametrize("name", NAMES)
def test_a_crop_measures_within_its_stated_uncertainty_and_outlives_its_file(name, tmp_path):
    known = crop(name).parameters()
    machine = Machine()
    model = ForwardModel(machine, known.effects)
    at = (machine.home_plate_angle_rad, machine.nominal_elevator_speed_rad_s)
    force = float(model.force(Conditions(*at, mass_flow_kg_s=8.0), known.values).real)
    found = OpenLoop(model, known).estimate(force, *at)
    assert float(found.mass_flow_kg_s) == pytest.approx(8.0, rel=1e-6)
    assert float(found.std_dev_kg_s) / 8.0 > 0.4, "nothing is known of the machine"
    of_grain = OpenLoop(model, replace(known, provenance={SCALE: WEIGHED})).estimate(force, *at)
    assert 0.05 < float(of_grain.std_dev_kg_s) / 8.0 < 0.5
    parameter_file.save(known, tmp_path / "p.yaml")
    assert parameter_file.load(tmp_path / "p.yaml").values == known.values
    # A bushel is 35.239 litres: the test weight is that of the bushel's legal weight, sunflower's range aside.
    assert crop(name).test_weight_kg_m3 == pytest.approx(crop(name).bushel_kg / 0.0352391, rel=0.01)
    assert 8.0 <= crop(name).market_moisture_pct <= 16.0
