"""Confidence as a probability: learning, its error, the shipped map, and what is done with a doubtful name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from studies.hidden_effects.confidence_map import expected_calibration_error, learnt, to_document
from yieldmon.discrepancy import confidence, diagnosis, report
from yieldmon.discrepancy.choice import Step
from yieldmon.discrepancy.fit import fit
from yieldmon.discrepancy.policy import Policy


def _cases(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Names whose chance of being right rises with the margin and falls with the misfit, and with nothing else."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((count, len(confidence.FEATURES)))
    margin, misfit = (confidence.FEATURES.index(name) for name in ("margin", "misfit"))
    p = 1.0 / (1.0 + np.exp(-(0.5 + 1.5 * rows[:, margin] - rows[:, misfit])))
    return rows, (rng.random(count) < p).astype(float)


def test_learnt_on_some_cases_it_is_calibrated_on_others() -> None:
    found = learnt(*_cases(1500, 1))
    rows, right = _cases(4000, 2)
    assert expected_calibration_error(found(rows), right) < 0.05
    assert expected_calibration_error(np.ones(len(right)), right) > 0.3


def test_the_error_of_known_statements() -> None:
    stated, right = np.array([0.95] * 20 + [0.55] * 20), np.array([1.0] * 15 + [0.0] * 5 + [1.0] * 11 + [0.0] * 9)
    assert expected_calibration_error(stated, right) == pytest.approx(0.5 * 0.2)


def test_all_right_is_no_proof_of_certainty() -> None:
    rows, _ = _cases(30, 3)
    assert learnt(rows, np.ones(30))(rows).max() < 0.99


def test_a_map_survives_its_file() -> None:
    shipped = confidence.shipped()
    again = confidence.from_document(to_document(shipped))
    rows, _ = _cases(20, 4)
    np.testing.assert_array_equal(again.within(rows), shipped.within(rows))
    np.testing.assert_array_equal(again.name(rows), shipped.name(rows))
    assert {"generators", "cases", "commit", "salt"} <= set(shipped.provenance)


def test_shipped_texts_never_say_certain() -> None:
    best = {
        "stability": 1.0, "margin": np.log1p(60.0), "misfit": 0.0, "left_share": 0.0, "strength": 4.0, "ties": 0.0,
        "further": 0.0, "effects": 1.0, "against": 0.0,
    }  # fmt: skip
    assert 0.5 < confidence.shipped().within(confidence.as_rows([best]))[0] < 0.995


def test_a_doubtful_name_is_a_partial_candidate(make_rows, start) -> None:
    rows = make_rows({"zero_offset": 4.0}, speeds_rpm=(400.0,))
    quick = Policy(refits=8, exchanges=4, beam=2)
    sure = diagnosis.examine(rows, start, diagnosis.Options(policy=quick))
    assert sure.choice.named[0] == "zero_offset"
    assert 0.5 < sure.choice.steps[0].confidence < 1.0
    unsure = diagnosis.examine(rows, start, diagnosis.Options(policy=replace(quick, least_confidence=1.0)))
    assert unsure.choice.verdict == "unknown"
    assert unsure.choice.steps[0].added == "zero_offset"
    assert any("of 100 cases" in note for note in unsure.notes)


@pytest.mark.parametrize(
    ("at_bound", "stated", "most"),
    [
        ((), 0.9, 0.9),
        (("friction",), 0.9, confidence.MOST_BESIDE_BOUND),
        (("friction",), 0.3, 0.3),
        (("friction", "density"), 0.9, confidence.MOST_AT_BOUND),
        (("plate_friction.coefficient",), 0.9, confidence.MOST_AT_BOUND),
        (("density", "plate_friction.coefficient"), 0.9, confidence.MOST_AT_BOUND),
    ],
)
def test_parameters_at_a_bound_limit_what_is_stated(make_rows, start, at_bound, stated, most) -> None:
    """The grain's parameters and the size of the effect."""
    options = diagnosis.Options(policy=Policy(most_effects=0), hold_out="none")
    choice = diagnosis.examine(make_rows(), start, options).choice
    found = fit(choice.base.frame, ("plate_friction",), choice.base.values)
    ended = np.array([p.upper if p.name in at_bound else 0.5 * (p.lower + p.upper) for p in found.parameters])
    step = Step("plate_friction", (), ("gravity",), stated, "plate_friction", name_confidence=0.5 * stated)
    said = confidence.limited(replace(choice, steps=(step,)), replace(found, x=ended))
    assert said.steps[0].confidence == pytest.approx(most)
    assert said.steps[0].name_confidence == pytest.approx(0.5 * most)


def test_an_uncertain_name_is_called_possible_and_why_it_is_given(make_rows, start) -> None:
    rows = make_rows({"zero_offset": 4.0}, speeds_rpm=(400.0,))
    quick = Policy(refits=8, exchanges=4, beam=2)
    found = diagnosis.diagnose_rows(rows, start, diagnosis.Options(policy=quick))
    assert report.summary(found).count("Cause (") == 1
    steps = (replace(found.choice.steps[0], confidence=0.4), *found.choice.steps[1:])
    said = report.summary(replace(found, choice=replace(found.choice, steps=steps)))
    assert "Possible cause (0.40)" in said
    assert "They are given since with them the model predicts rows left out of the fits better" in said
