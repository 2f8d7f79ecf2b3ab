"""Other explanations than the named effects: another law of one of them, one plate angle off by itself, a single angle,
a law without a cause."""

from __future__ import annotations

import numpy as np
import pytest

from studies.hidden_effects import generator
from tests.discrepancy.conftest import GRAIN
from yieldmon.discrepancy import diagnosis, diagnosis_notes
from yieldmon.discrepancy.alternatives import by_powers, chosen_from_all, needed, one_angle_off
from yieldmon.discrepancy.choice import Choice, Step
from yieldmon.discrepancy.fit import fit
from yieldmon.discrepancy.lack_of_fit import lack_of_fit
from yieldmon.discrepancy.merit import left_by_own_law, merit, misfit
from yieldmon.discrepancy.observations import Rows, with_cells
from yieldmon.discrepancy.policy import Policy
from yieldmon.discrepancy.selection import Search
from yieldmon.estimation import model_error
from yieldmon.physics.machine import Machine

NOTHING = diagnosis.Options(policy=Policy(most_effects=0), hold_out="none")
COST = Policy().per_parameter
LAST_RULES = Policy(lack_of_fit_p=0.0, unexplained_share=1e9, unexplained_f=1e9)
"""What is left speaks against nothing."""


def at_angles(rows: Rows, *angles_deg: float) -> Rows:
    """The rows at some plate angles."""
    return with_cells(rows.take(np.isin(np.round(np.degrees(rows.plate_angle_rad)), angles_deg)))


def published(rows: Rows, start) -> tuple:
    """The fit of the published model, and the noise."""
    seen = diagnosis.examine(rows, start, NOTHING)
    return seen.choice.base, seen.noise


def by_speed(effect: str, size: float, tilt: float):
    """An alteration of the generator's force by which an effect acts more the faster the elevator runs."""

    def alter(force, angle, speed, flow):
        without = generator.force(angle, speed, flow, np.full(angle.shape, 15.0), GRAIN, {})
        place = 2.0 * (speed - speed.min()) / np.ptp(speed) - 1.0
        return without + (force - without) * (1.0 + tilt * place)

    return {effect: size}, alter


@pytest.mark.parametrize(("angles_deg", "verdict"), [((80.0,), "unknown"), (tuple(range(40, 91, 10)), "effect")])
def test_rows_of_one_angle_name_nothing(make_rows, start, angles_deg, verdict) -> None:
    rows = at_angles(make_rows({"zero_offset": 4.0}), *angles_deg)
    choice = diagnosis.examine(rows, start, diagnosis.Options(hold_out="none", policy=Policy(most_effects=1))).choice
    assert "zero_offset" in {choice.steps[0].added, *choice.steps[0].equivalent}
    assert choice.verdict == verdict
    assert ("one plate angle" in choice.objection) == (verdict == "unknown")


@pytest.mark.parametrize(
    "error",
    [lambda f, w, q: 0.03 * f.max(), lambda f, w, q: 0.05 * f, lambda f, w, q: -0.06 * f * q / q.max()],
    ids=["a constant", "a share", "a share that rises with the load"],
)
def test_the_angle_whose_rows_are_off_is_found(make_rows, start, error) -> None:
    def alter(force, angle, speed, flow):
        return force + np.where(np.abs(np.degrees(angle) - 60.0) < 1.0, error(force, speed, flow), 0.0)

    base, noise = published(make_rows(alter=alter), start)
    found = one_angle_off(base, 1.0, COST)
    assert found is not None
    assert np.degrees(found.plate_angle_rad) == pytest.approx(60.0)
    wrong = fit(base.frame, ("plate_angle_offset",), base.values)
    steps = (Step("plate_angle_offset", (), (), 1.0, "plate_angle_offset"),)
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=LAST_RULES)
    assert "an error of the rows at 60 deg alone" in search.objections.first(wrong, steps)


def test_one_angle_does_not_stand_in_for_an_effect_that_acts_on_all(make_rows, start) -> None:
    base, _ = published(make_rows({"zero_offset": 4.0}), start)
    right = fit(base.frame, ("zero_offset",), base.values)
    found = one_angle_off(base, misfit([right]), COST)
    assert found is not None
    assert found.merit > merit(right, misfit([right]), Policy()) + 100.0


def test_one_angle_alone_has_no_alternative_to_compare(make_rows, start) -> None:
    assert one_angle_off(published(at_angles(make_rows(), 70.0), start)[0], 1.0, COST) is None


def test_true_effects_need_each_other_whatever_their_laws(make_rows, start) -> None:
    base, noise = published(make_rows({"zero_offset": 4.0, "speed_dependent_shape": -1.0}), start)
    both = fit(base.frame, ("zero_offset", "speed_dependent_shape"), base.values)
    found = needed(both, misfit([both]), COST)
    assert {n.effect for n in found} == {"zero_offset", "speed_dependent_shape"}
    assert min(n.evidence for n in found) > chosen_from_all(COST)
    assert min(n.gain for n in found) > chosen_from_all(COST)
    # Not even where effects that undo each other at all would have to be earned.
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=Policy(most_cancelled=-1.0))
    assert search.objections.first(both, (Step("zero_offset", (), (), 1.0, "zero_offset"),)) == ""


@pytest.mark.parametrize(
    ("policy", "says"),
    [
        (LAST_RULES, "another law of the other effects is as likely as speed_dependent_shape"),
        (
            Policy(lack_of_fit_p=0.0, unexplained_share=1e9, unexplained_f=1e9, least_evidence=-1e9, most_cancelled=-1.0),
            "cancels out",
        ),
    ],
    ids=["evidence", "terms of a series"],
)
def test_an_effect_that_only_corrects_the_law_of_another_is_none(make_rows, start, policy, says) -> None:
    """A zero that moves by 40 % with the speed (warm bearings, say) is taken for a zero and a shape that depends on speed."""
    effects, alter = by_speed("zero_offset", 4.0, 0.4)
    base, noise = published(make_rows(effects, alter=alter), start)
    alone = fit(base.frame, ("zero_offset",), base.values)
    both = fit(base.frame, ("zero_offset", "speed_dependent_shape"), base.values)
    assert both.chi2 < alone.chi2 - chosen_from_all(COST)
    by_effect = {n.effect: n for n in needed(both, misfit([both]), COST)}
    assert by_effect["speed_dependent_shape"].evidence < 0.0 < by_effect["zero_offset"].evidence
    assert by_effect["speed_dependent_shape"].gain < chosen_from_all(COST) < by_effect["zero_offset"].gain
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=policy)
    assert says in search.objections.first(both, (Step("zero_offset", (), (), 1.0, "zero_offset"),))


def test_one_effect_has_no_others_whose_law_could_differ(make_rows, start) -> None:
    base, _ = published(make_rows({"zero_offset": 4.0}), start)
    assert needed(fit(base.frame, ("zero_offset",), base.values), 1.0, COST) == []


@pytest.mark.parametrize(
    ("margin", "share", "refused"),
    [(50.0, 0.2, False), (15.0, 0.2, True), (50.0, 0.05, True)],
    ids=["far ahead", "a rival is near", "too much is left"],
)
def test_one_effect_far_ahead_may_have_another_shape_of_its_law(make_rows, start, margin, share, refused) -> None:
    """A zero that moves by 30 % with the speed leaves a misfit, 17 % of the excess."""
    effects, alter = by_speed("zero_offset", 4.0, 0.3)
    base, noise = published(make_rows(effects, alter=alter), start)
    alone = fit(base.frame, ("zero_offset",), base.values)
    assert lack_of_fit(alone, noise).p_value < Policy().lack_of_fit_p
    steps = (Step("zero_offset", (), (), 1.0, "zero_offset", margin=margin),)
    policy = Policy(own_law_share=share, unexplained_share=0.3)
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=policy)
    assert ("something else is missing" in search.objections.first(alone, steps)) == refused
    seen = Choice("effect", base, alone, lack_of_fit(base, noise), lack_of_fit(alone, noise), steps, (), 0.0)
    notes = diagnosis_notes.of_own_law(seen, noise, policy)
    assert [n.startswith("zero_offset leaves a misfit (F = ") for n in notes] == ([] if refused else [True])


def test_no_other_shape_of_a_wrong_law_explains(make_rows, start) -> None:
    base, noise = published(make_rows({"zero_offset": 4.0}), start)
    wrong = fit(base.frame, ("stream_spread",), base.values)
    steps = (Step("stream_spread", (), (), 1.0, "stream_spread", margin=1e3),)
    policy = Policy(own_law_share=1.0, unexplained_share=1.0)
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=policy)
    assert "something else is missing" in search.objections.first(wrong, steps)


def test_own_error_of_the_model_is_no_gap_of_a_law(make_rows, start) -> None:
    """Rows so exact that the model's own error makes much of the chi-square: the law of an effect need not answer for it."""
    effects, alter = by_speed("zero_offset", 4.0, 0.05)
    base, noise = published(make_rows(effects, alter=alter, noise=0.0005), start)
    alone = fit(base.frame, ("zero_offset",), base.values)
    own = float(np.sum(model_error.off(alone.own_error, alone.tangent()) ** 2))
    excess = base.chi2 - base.dof
    share = (alone.chi2 - alone.dof - 0.5 * own) / excess
    assert own > 0.05 * alone.chi2
    steps = (Step("zero_offset", (), (), 1.0, "zero_offset", margin=50.0),)
    assert left_by_own_law(alone, steps, noise, excess, Policy(own_law_share=share))
    assert not left_by_own_law(alone, steps, noise, excess, Policy(own_law_share=share - own / excess))


@pytest.mark.parametrize(("margin", "refused"), [(50.0, False), (15.0, True)], ids=["far ahead", "a rival is near"])
def test_own_error_of_the_model_is_no_excess_that_an_effect_far_ahead_leaves(make_rows, start, margin, refused) -> None:
    effects, alter = by_speed("zero_offset", 4.0, 0.02)
    base, noise = published(make_rows(effects, alter=alter, noise=0.0005), start)
    alone = fit(base.frame, ("zero_offset",), base.values)
    own = float(np.sum(model_error.off(alone.own_error, alone.tangent()) ** 2))
    most = (alone.chi2 - alone.dof - 0.5 * own) / (base.chi2 - base.dof)
    policy = Policy(lack_of_fit_p=0.0, unexplained_share=most, unexplained_f=1e9)
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=policy)
    found = search.objections.first(alone, (Step("zero_offset", (), (), 1.0, "zero_offset", margin=margin),))
    assert ("of the excess is left" in found) == refused


@pytest.mark.parametrize(("own_law_share", "left"), [(0.3, ("zero_offset",)), (0.01, None)], ids=["a name", "too much is left"])
def test_an_effect_that_only_mends_the_law_of_another_is_left_out(make_rows, start, own_law_share, left) -> None:
    effects, alter = by_speed("zero_offset", 4.0, 0.4)
    base, noise = published(make_rows(effects, alter=alter), start)
    library = ("zero_offset", "speed_dependent_shape")
    both = fit(base.frame, library, base.values)
    policy = Policy(own_law_share=own_law_share, unexplained_share=0.4)
    search = Search(base=base, noise=noise, effects=library, rng=np.random.default_rng(1), policy=policy)
    fewer = search.without_unneeded(both, 0.0)
    assert (fewer and fewer.fit.effects) == left


def test_no_effect_is_left_out_that_is_needed(make_rows, start) -> None:
    base, noise = published(make_rows({"zero_offset": 4.0, "speed_dependent_shape": -1.0}), start)
    library = ("zero_offset", "speed_dependent_shape")
    search = Search(base=base, noise=noise, effects=library, rng=np.random.default_rng(1))
    assert search.without_unneeded(fit(base.frame, library, base.values), 0.0) is None


def test_a_law_of_powers_has_no_cause(make_rows, start) -> None:
    """Two effects with sizes at will follow it to 0.7 % of the largest reading; the laws' errors cover the rest."""

    angle, speed, flow, trial = (
        a.ravel()
        for a in np.meshgrid(
            np.radians(np.arange(40.0, 91.0, 10.0)),
            np.array([340.0, 400.0, 460.0]) * generator.RPM,
            [2.0, 5.0, 9.0, 13.0, 18.0],
            [1, 2, 3],
            indexing="ij",
        )
    )
    force = 160.0 * (flow / 10.0) ** 0.93 * (speed / (400.0 * generator.RPM)) ** 0.8 * np.sin(angle) ** 1.6
    sd = 0.01 * np.hypot(force, 0.15 * force.max())
    nothing = np.full(len(force), np.nan)
    rows = Rows(
        Machine(), "mass_flow_kg_s", "force", True, angle, speed, flow, nothing,
        force + sd * np.random.default_rng(1).standard_normal(force.shape), nothing, tuple(map(str, trial)),
        np.zeros(len(force), dtype=np.int64),
    )  # fmt: skip
    choice = diagnosis.examine(with_cells(rows), start).choice
    assert choice.steps
    assert choice.verdict == "unknown"
    assert "without a cause" in choice.objection


def test_powers_that_change_with_the_plate_angle_have_no_cause(start) -> None:
    """Three effects follow such a law to within the noise."""
    flow, angle, trial = (
        a.ravel()
        for a in np.meshgrid([2.0, 5.0, 9.0, 14.0, 19.0], np.radians(np.arange(42.0, 91.0, 8.0)), [1, 2, 3], indexing="ij")
    )
    force = 11.0 * flow ** (0.85 + 0.3 * np.log(np.sin(angle))) * np.sin(angle) ** 1.5
    share, offset_n = np.random.default_rng(2).normal(0.0, (0.01, 0.2), (len(force), 2)).T
    reading, nothing = force * (1.0 + share) + offset_n, np.full(len(force), np.nan)
    rows = Rows(
        Machine(), "mass_flow_kg_s", "force", True, angle, np.full(len(force), 400.0 * generator.RPM), flow, nothing,
        reading, nothing, tuple(map(str, trial)), np.zeros(len(force), dtype=np.int64),
    )  # fmt: skip
    choice = diagnosis.examine(with_cells(rows), start).choice
    assert choice.verdict == "unknown"
    assert "without a cause" in choice.objection


@pytest.mark.parametrize("effects", [{}, {"zero_offset": 4.0}, {"plate_friction": 0.3}, {"jet_shielding": 0.5}], ids=str)
@pytest.mark.parametrize("speeds_rpm", [(400.0,), (340.0, 400.0, 460.0)], ids=["one speed", "three"])
def test_grain_follows_no_law_of_powers(make_rows, start, effects, speeds_rpm) -> None:
    base, _ = published(make_rows(effects, speeds_rpm=speeds_rpm, noise=0.03), start)
    found = fit(base.frame, tuple(effects), base.values)
    assert by_powers(base, misfit([found]), COST) > merit(found, misfit([found]), Policy())
