"""Wrong tickets among two, three and four weighed loads: refused and named, on machines of laws that the model does not have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from shipped_grain import MACHINE, MODEL, SHIPPED

from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.load_outcome import LoadCalibration
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.estimation.weighing.wrong_tickets import contradicted, known_slip

FLOWS, MASSES_KG = (11.0, 5.5, 17.5, 8.0), (6200.0, 3400.0, 8100.0, 4300.0)
LAWS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "power 0.9 with an offset": lambda flow: 79.0 * (flow / 10.0) ** 0.9 + 0.8,
    "saturating": lambda flow: 224.0 * flow / (22.0 + flow),
    "bent at 12 kg/s": lambda flow: 9.0 * (np.minimum(flow, 12.0) + 0.75 * np.maximum(flow - 12.0, 0.0)),
}


def loads(law: str, count: int, seed: int) -> list[WeighedLoad]:
    """Named a, b, c, d; the flow swings and scatters, the elevator is up to 1 % off, tickets are good to 0.3 %."""
    rng, out = np.random.default_rng([4417, seed, count]), []
    for name, flow, mass_kg in list(zip("abcd", FLOWS, MASSES_KG, strict=True))[:count]:
        seconds = int(mass_kg / flow)
        swing = 0.15 * np.sin(np.arange(seconds) / 7.5 + rng.uniform(0.0, 6.0)) + 0.1 * rng.standard_normal(seconds)
        each = np.clip(flow * (1.0 + swing), 0.3 * flow, 1.6 * flow)
        faster = 1.0 + 0.01 * rng.uniform(-1.0, 1.0)
        force = LAWS[law](each) * faster**1.1 * (1.0 + 0.03 * rng.standard_normal(seconds))
        kg = float(each.sum())
        angle = np.full(seconds, MACHINE.home_plate_angle_rad)
        speed = np.full(seconds, MACHINE.nominal_elevator_speed_rad_s * faster)
        weighed_kg = kg * (1.0 + 0.003 * rng.standard_normal())
        out.append(WeighedLoad(name, weighed_kg, 0.005 * kg, np.ones(seconds), force, angle, speed, noise_sd=0.002))
    return out


def weighing(load: WeighedLoad, kg: float) -> WeighedLoad:
    return replace(load, weighed_kg=kg, std_dev_kg=0.005 * kg)


def said(found: LoadCalibration) -> str:
    return " ".join(found.sentences)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("factor", [1.0 / 0.45359237, 0.45359237])
def test_a_ticket_of_two_or_three_in_another_unit_updates_nothing_and_is_named(law: str, count: int, factor: float) -> None:
    right = loads(law, count, 1)
    found = calibrate_loads(MODEL, SHIPPED, [weighing(right[0], factor * right[0].weighed_kg), *right[1:]])
    assert found.refused
    assert found.parameter_set is SHIPPED
    assert found.wrong_ticket is not None
    assert "a" in found.wrong_ticket.loads
    assert "Check the tickets" in said(found)
    assert (count == 2) == ("weigh a third load" in said(found))


@pytest.mark.parametrize("law", LAWS)
def test_pounds_among_three_or_four_are_reported_to_be_pounds(law: str) -> None:
    for count in (3, 4):
        right = loads(law, count, 2)
        found = calibrate_loads(MODEL, SHIPPED, [weighing(right[0], right[0].weighed_kg / 0.45359237), *right[1:]])
        assert "as if pounds were taken for kilograms" in said(found)
        assert found.refused is (count == 3)


@pytest.mark.parametrize("law", LAWS)
def test_pounds_on_the_fastest_of_three_are_no_sensor_that_saturates_unasked(law: str) -> None:
    *slower, fastest = loads(law, 3, 9)
    found = calibrate_loads(MODEL, SHIPPED, [*slower, weighing(fastest, fastest.weighed_kg / 0.45359237)])
    assert found.wrong_ticket is not None
    assert found.wrong_ticket.loads[0] == "c"


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("tare_kg", [2500.0])
def test_a_tare_in_all_of_four_tickets_is_refused_and_named(law: str, tare_kg: float) -> None:
    found = calibrate_loads(MODEL, SHIPPED, [weighing(one, one.weighed_kg + tare_kg) for one in loads(law, 4, 10)])
    assert found.refused
    assert found.wrong_ticket is not None
    assert found.wrong_ticket.loads == ("a", "b", "c", "d")
    assert found.wrong_ticket.apart_kg == pytest.approx(tare_kg, rel=0.3)
    assert "as if the tare was not taken off" in said(found)


@pytest.mark.parametrize("law", LAWS)
def test_another_load_on_the_same_ticket_is_named(law: str) -> None:
    first, second, *others = loads(law, 4, 11)
    found = calibrate_loads(MODEL, SHIPPED, [weighing(first, first.weighed_kg + second.weighed_kg), second, *others])
    assert found.outliers == ("a",)
    assert "as if load b is on its ticket too; correct the ticket" in said(found)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("factor", "what"), [(1.0 / 0.45359237, "pounds were taken for kilograms"), (1.27, "")])
def test_what_explains_a_fourth_ticket_that_others_contradict(law: str, factor: float, what: str) -> None:
    *before, fourth = loads(law, 4, 12)
    assert known_slip(MODEL, SHIPPED, before, weighing(fourth, factor * fourth.weighed_kg)) == what


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("count", [3, 4])
def test_two_exchanged_tickets_update_nothing(law: str, count: int) -> None:
    right = loads(law, count, 3)
    wrong = [weighing(right[0], right[-1].weighed_kg), *right[1:-1], weighing(right[-1], right[0].weighed_kg)]
    found = calibrate_loads(MODEL, SHIPPED, wrong)
    assert found.refused
    assert found.wrong_ticket is not None
    assert {"a", right[-1].name} & set(found.wrong_ticket.loads)


@pytest.mark.parametrize("law", LAWS)
def test_digits_exchanged_in_one_of_four_are_named_with_the_mass_that_was_meant(law: str) -> None:
    right = loads(law, 4, 4)
    meant = f"{right[0].weighed_kg:.0f}"
    found = calibrate_loads(MODEL, SHIPPED, [weighing(right[0], float(meant[1] + meant[0] + meant[2:])), *right[1:]])
    assert found.outliers == ("a",)
    assert f"as if two digits of {meant} kg were exchanged; correct the ticket" in said(found)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_right_tickets_are_accepted(law: str, count: int) -> None:
    found = calibrate_loads(MODEL, SHIPPED, loads(law, count, 5))
    assert not found.refused
    assert found.outliers == ()
    assert found.wrong_ticket is None
    for one in found.loads:
        assert one.after_kg == pytest.approx(one.weighed_kg, rel=0.02)


def test_so_few_loads_say_that_another_curve_may_be_a_wrong_ticket() -> None:
    """A tare of 1.2 t on the lightest of three looks like another curve."""
    right = loads("saturating", 3, 6)
    found = calibrate_loads(MODEL, SHIPPED, [right[0], weighing(right[1], right[1].weighed_kg + 1200.0), right[2]])
    assert found.refused
    assert said(found).startswith("refused: a ticket is wrong (probability ")
    assert "load b" in said(found)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", [5, 7])
def test_right_tickets_of_three_loads_are_not_asked_about(law: str, seed: int) -> None:
    found = calibrate_loads(MODEL, SHIPPED, loads(law, 3, seed))
    assert not found.refused
    assert found.wrong_ticket is None
    assert "may be wrong" not in said(found)


@pytest.mark.parametrize("law", LAWS)
def test_a_fifth_missing_from_one_of_three_is_found(law: str) -> None:
    first, second, third = loads(law, 3, 7)
    found = calibrate_loads(MODEL, SHIPPED, [first, second, weighing(third, 0.8 * third.weighed_kg)])
    assert found.refused
    assert found.wrong_ticket is not None
    assert "c" in found.wrong_ticket.loads


@pytest.mark.parametrize("law", LAWS)
def test_a_fourth_load_that_others_contradict_is_doubted_and_a_right_one_is_not(law: str) -> None:
    *before, fourth = loads(law, 4, 8)
    assert contradicted(MODEL, SHIPPED, before, fourth) is None
    error = contradicted(MODEL, SHIPPED, before, weighing(fourth, 1.25 * fourth.weighed_kg))
    assert error == pytest.approx(0.25, abs=0.08)
