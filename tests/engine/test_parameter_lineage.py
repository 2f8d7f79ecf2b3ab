"""Where the parameters in use came from, by sets of parameters that are made up."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
import pytest

from yieldmon.engine.self_calibration.parameter_lineage import ParameterLineage
from yieldmon.engine.self_calibration.prior_states import as_prior_state
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.estimation.parameters import ParameterSet


def known(version: int, density: float = 1100.0, sd: float = 50.0) -> ParameterSet:
    values = {"friction": 0.2, "restitution": 0.6, "density": density, "shape_ratio": 2.0}
    return ParameterSet(values, ("density",), np.array([[sd**2]]), version=version)


def mass(load: int) -> ReferenceMass:
    return ReferenceMass(
        source=ReferenceSource.TICKET,
        start_s=100.0 * load,
        end_s=100.0 * load + 50.0,
        reference_kg=500.0,
        std_dev_kg=2.0,
        measured_kg=490.0,
        complete=True,
        load_number=load,
    )


GIVEN, FIRST, SECOND = known(1), known(2, 1150.0, 40.0), known(3, 1150.0, 30.0)
NONE: frozenset[ReferenceMass] = frozenset()
ONE = frozenset({mass(1)})
TWO = frozenset({mass(1), mass(2)})


def updated() -> ParameterLineage:
    """Two masses were weighed with what was given: one led to the first, the other to the second."""
    lineage = ParameterLineage()
    lineage.weighed(GIVEN)
    lineage.replaced(GIVEN, 10.0, FIRST, NONE)
    lineage.weighed(FIRST)
    lineage.replaced(FIRST, 20.0, SECOND, ONE)
    return lineage


def test_what_updates_lead_to_comes_from_where_the_first_came() -> None:
    lineage = updated()
    lineage.weighed(SECOND)
    assert lineage.origin is GIVEN
    lineage.weighed(other := known(4, 900.0))
    assert lineage.origin is other


def test_parameters_are_from_outside_that_no_update_led_to_and_none_before_it_were_like() -> None:
    lineage = updated()
    assert not lineage.from_outside(SECOND)
    assert not lineage.from_outside(replace(GIVEN, version=9)), "an undo brings them back under another version"
    assert lineage.from_outside(known(9, 1000.0))


def test_the_last_eight_sets_are_known_with_their_times() -> None:
    lineage, sets = ParameterLineage(), [known(version, 1000.0 + version) for version in range(12)]
    for number, (before, after) in enumerate(pairwise(sets)):
        lineage.replaced(before, 10.0 * number, after, NONE)
    spans = lineage.spans(sets[-1])
    assert [until_s for until_s, _ in spans] == [*(10.0 * number for number in range(3, 11)), inf]
    assert [parameters.version for _, parameters in spans] == list(range(3, 12))


@pytest.mark.parametrize(
    ("back", "handed"),
    [
        (replace(GIVEN, version=9), NONE),
        (replace(FIRST, version=9), ONE),
        (replace(SECOND, version=9), TWO),
        (known(9, 1150.0, 35.0), NONE),
    ],
    ids=["given", "the first", "the same values known better", "older than all"],
)
def test_what_had_been_handed_over_when_they_were_in_use(back: ParameterSet, handed: frozenset[ReferenceMass]) -> None:
    assert updated().handed_before(back, TWO) == handed


def test_nothing_is_known_before_an_update() -> None:
    assert ParameterLineage().handed_before(GIVEN, ONE) == ONE
    assert ParameterLineage().snapshot() is None
    assert ParameterLineage().leave_crop() is None


def test_sweeps_are_undone_as_long_as_nothing_else_updated() -> None:
    lineage = ParameterLineage()
    lineage.swept(GIVEN)
    assert lineage.undo_sweeps(GIVEN, 5.0, NONE) is None, "they are in use"
    lineage.replaced(GIVEN, 10.0, FIRST, NONE)
    lineage.swept(FIRST)
    back = lineage.undo_sweeps(FIRST, 20.0, NONE)
    assert back is not None
    assert (dict(back.values), back.version) == (dict(GIVEN.values), 3)
    assert [until_s for until_s, _ in lineage.spans(back)] == [10.0, 20.0, inf]
    lineage.forget_given()
    assert lineage.undo_sweeps(known(4), 30.0, NONE) is None


@pytest.mark.parametrize("restart", [False, True])
def test_a_crop_comes_back_with_what_updates_made_of_its_parameters(restart: bool) -> None:
    lineage, in_use = updated(), SECOND
    if restart:
        state, lineage, in_use = lineage.snapshot(), ParameterLineage(), replace(SECOND)
        lineage.restore(state, in_use)
        assert lineage.snapshot() == state, "as it was before the restart"
    origin = lineage.leave_crop()
    assert origin == (as_prior_state(GIVEN) if not restart else replace(as_prior_state(GIVEN), version=3), as_prior_state(SECOND))
    assert lineage.origin is None
    back = replace(SECOND, version=7)
    lineage.return_to_crop(origin, back)
    lineage.weighed(back)
    assert lineage.origin is not None
    assert dict(lineage.origin.values) == dict(GIVEN.values)


def test_other_parameters_than_a_crop_left_are_its_new_origin() -> None:
    lineage = updated()
    origin = lineage.leave_crop()
    lineage.return_to_crop(origin, other := known(8, 900.0))
    lineage.weighed(other)
    assert lineage.origin is other


def test_an_undo_brings_parameters_back_that_come_from_where_the_update_came() -> None:
    lineage, back = updated(), replace(FIRST, version=9)
    lineage.brought_back(back)
    lineage.weighed(back)
    assert lineage.origin is GIVEN
    assert not lineage.from_outside(back)


def test_what_an_undo_brings_back_is_the_origin_where_no_other_is_known() -> None:
    lineage = ParameterLineage()
    lineage.brought_back(GIVEN)
    lineage.weighed(GIVEN)
    assert lineage.origin is GIVEN


def test_the_last_that_were_seen_in_use() -> None:
    lineage = ParameterLineage()
    assert lineage.last is None
    lineage.seen(GIVEN)
    assert lineage.last is GIVEN


def test_an_origin_of_another_version_is_not_that_of_the_parameters_in_use() -> None:
    lineage, state = ParameterLineage(), updated().snapshot()
    lineage.restore(state, replace(SECOND, version=8))
    assert lineage.origin is None


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize(("facts", "kept"), [({"scale": "another crop", "scale_from": "corn"}, True), ({}, False)])
def test_a_curve_of_another_crop_is_where_parameters_come_from_after_a_restart_too(
    facts: dict[str, str], kept: bool, restart: bool
) -> None:
    """A curve of the crop's own loads is none that these could be fitted to anew."""
    curve = replace(GIVEN, values={**GIVEN.values, "load_pattern.exponent": 0.1}, provenance=facts)
    weighed = replace(FIRST, values={**FIRST.values, "load_pattern.exponent": 0.2}, provenance={"scale": "weighed"})
    lineage = ParameterLineage()
    lineage.weighed(curve)
    lineage.replaced(curve, 10.0, weighed, NONE)
    if restart:
        state, lineage = lineage.snapshot(), ParameterLineage()
        assert (state is not None) is kept
        lineage.restore(state, weighed)
    if restart and not kept:
        assert lineage.origin is None
        return
    assert lineage.origin is not None
    assert dict(lineage.origin.values) == dict(curve.values)
    assert lineage.origin.carried_from == ("corn" if kept else "")
