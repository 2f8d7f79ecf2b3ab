"""A crop on a machine that was weighed in another one begins with that one's scale and curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.load_pattern import NAMES
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import CARRIED, CARRIED_FROM, SCALE, WEIGHED, ParameterSet
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.estimation.weighing.other_crop import carried
from yieldmon.files.crops import crop
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
HOME_RAD, SPEED = MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s
CORN, WHEAT = crop("corn").parameters(), crop("wheat").parameters()
LIGHTER, POWER = 0.75, 0.85
"""What the machine does to the force of each crop: a share of it, and a power of the flow beside the model's curve."""


def force_n(known: ParameterSet, flow_kg_s: np.ndarray) -> np.ndarray:
    at = Conditions(np.full(flow_kg_s.shape, HOME_RAD), np.full(flow_kg_s.shape, SPEED), mass_flow_kg_s=flow_kg_s)
    return np.real(ForwardModel(MACHINE, known.effects).force(at, known.values))


def load(grain: ParameterSet, mean_kg_s: float) -> WeighedLoad:
    flow = mean_kg_s * np.linspace(0.8, 1.2, 60)
    force = LIGHTER * force_n(grain, flow) * (flow / 10.0) ** (POWER - 1.0)
    columns = (np.full(60, value) for value in (HOME_RAD, SPEED))
    return WeighedLoad(f"{mean_kg_s:g}", 10.0 * flow.sum(), 0.003 * 10.0 * flow.sum(), np.full(60, 10.0), force, *columns)


def weighed(grain: ParameterSet, *flows_kg_s: float) -> ParameterSet:
    loads = [load(grain, flow) for flow in flows_kg_s]
    found = calibrate_loads(ForwardModel(MACHINE, grain.effects), grain, loads).parameter_set
    return replace(found, provenance={SCALE: WEIGHED, "crop": "corn"})


def begun(*flows_kg_s: float) -> ParameterSet:
    known = carried(WHEAT, weighed(CORN, *flows_kg_s), CORN, "corn")
    assert known is not None
    return known


def errors(known: ParameterSet, *flows_kg_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Relative, of loads of wheat, and their standard deviations."""
    loop = OpenLoop(ForwardModel(MACHINE, known.effects), known)
    found = [loop.estimate(load(WHEAT, flow).force_n, HOME_RAD, SPEED) for flow in flows_kg_s]
    truth = np.array(flows_kg_s)
    return np.array([f.mass_flow_kg_s.mean() for f in found]) / truth - 1.0, np.array(
        [f.std_dev_kg_s.mean() for f in found]
    ) / truth


def test_what_the_machine_does_to_one_crop_it_does_to_the_other() -> None:
    error, std_dev = errors(begun(5.0, 10.0, 16.0), 6.0, 10.0, 14.0)
    assert np.all(np.abs(error) < 0.05)
    assert np.all((std_dev > 0.12) & (std_dev < 0.3)), "12 % of a force that rises less than the flow"
    assert np.all(errors(WHEAT, 6.0, 10.0, 14.0)[0] < -0.2)


def test_it_says_where_the_scale_comes_from_until_the_crop_itself_is_weighed() -> None:
    known = begun(5.0, 10.0, 16.0)
    assert (known.carried_from, known.scale_error) == ("corn", 0.12)
    assert known.provenance["crop"] == "wheat"
    assert replace(known, provenance={**known.provenance, SCALE: WEIGHED}).carried_from == ""
    assert replace(known, provenance={**known.provenance, SCALE: WEIGHED}).scale_error == 0.0
    assert (WHEAT.carried_from, CORN.carried_from) == ("", "")


def test_friction_is_that_of_the_crop() -> None:
    known = begun(5.0, 10.0, 16.0)
    assert known.values["friction"] == WHEAT.values["friction"]
    assert known.standard_deviation("friction") == WHEAT.standard_deviation("friction")
    assert np.all(known.covariance_of(("friction", *known.covariance_names))[0, 2:] == 0.0)


def test_the_curve_is_less_sure_than_that_of_the_crop_that_was_weighed() -> None:
    known, other = begun(5.0, 10.0, 16.0), weighed(CORN, 5.0, 10.0, 16.0)
    assert [known.values[name] for name in NAMES] == [other.values[name] for name in NAMES]
    assert all(known.standard_deviation(name) > np.hypot(other.standard_deviation(name), 0.04) for name in NAMES)


@pytest.mark.parametrize(("flows", "most"), [((10.0,), 0.1), ((7.0, 13.0), 0.01)])
def test_the_first_loads_of_the_crop_find_the_curve_that_the_other_one_had(flows: tuple[float, ...], most: float) -> None:
    """By published properties alone they leave it open."""
    model, loads = ForwardModel(MACHINE, WHEAT.effects), [load(WHEAT, flow) for flow in flows]
    ways = [calibrate_loads(model, start, loads) for start in (WHEAT, begun(5.0, 10.0, 16.0))]
    assert not any(found.refused for found in ways)
    (off, sd), (less, narrower) = (errors(found.parameter_set, 5.0, 16.0) for found in ways)
    assert np.max(np.abs(less)) < most
    assert np.max(np.abs(less)) < 0.75 * np.max(np.abs(off))
    assert np.max(narrower) < 0.5 * np.max(sd)


def test_the_curve_of_another_crop_is_no_certainty() -> None:
    """As far as its own deviation allows, loads of the crop move it."""
    sure = begun(5.0, 10.0, 16.0)
    loads = [load(WHEAT, flow) for flow in (6.0, 14.0)]
    bent = [replace(one, force_n=one.force_n * (one.force_n / loads[0].force_n[0]) ** 0.1) for one in loads]
    model = ForwardModel(MACHINE, WHEAT.effects)
    mark = replace(sure, provenance={"crop": "wheat"})
    moves = [calibrate_loads(model, start, bent).next_load_sd for start in (sure, mark)]
    assert moves[0] != moves[1]


@pytest.mark.parametrize(
    "values",
    [{"plate_friction.coefficient": 0.1}, {"k1": 0.2, "k2": 1.4}],
    ids=["another effect", "a gain that goes with the load"],
)
def test_nothing_is_carried_from_parameters_of_another_form(values: dict[str, float]) -> None:
    known = weighed(CORN, 5.0, 10.0, 16.0)
    kept = {name: value for name, value in known.values.items() if not (name in ("restitution", "k1", "k2") and "k1" in values)}
    other = ParameterSet({**kept, **values}, provenance={SCALE: WEIGHED})
    assert carried(WHEAT, other, CORN, "corn") is None


def test_a_gain_below_one_is_carried() -> None:
    values = {**CORN.values, "restitution": 0.0}
    low = replace(CORN, values=values, provenance={SCALE: WEIGHED})
    known = carried(WHEAT, low, CORN, "corn")
    assert known is not None
    assert known.values["k2"] == pytest.approx((1.0 + WHEAT.values["restitution"]) / (1.0 + CORN.values["restitution"]))
    assert (known.provenance[SCALE], known.provenance[CARRIED_FROM]) == (CARRIED, "corn")
    assert "k2" in known.covariance_names
