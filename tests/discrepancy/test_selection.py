"""The rules of the choice, each on its own: other starts, levels of significance, what counts as complete."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np
import pytest

from studies.hidden_effects import law_cases
from yieldmon.discrepancy import candidates, diagnosis
from yieldmon.discrepancy.candidates import Score
from yieldmon.discrepancy.choice import Candidate, Step
from yieldmon.discrepancy.confidence import MOST_AT_BOUND
from yieldmon.discrepancy.fit import Fit, fit
from yieldmon.discrepancy.merit import parameter_costs
from yieldmon.discrepancy.policy import Policy
from yieldmon.discrepancy.selection import Search
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects import laws

USUAL = Policy()
NAMED_NOTHING = diagnosis.Options(policy=Policy(most_effects=0), hold_out="none")


@pytest.fixture(scope="module")
def published(make_rows, start):
    """published(effects): the fit of the published model to rows that hide them, and the noise; made once for each."""
    made = {}

    def make(effects: dict[str, float]):
        key = tuple(effects.items())
        if key not in made:
            seen = diagnosis.examine(make_rows(effects), start, NAMED_NOTHING)
            made[key] = seen.choice.base, seen.noise
        return made[key]

    return make


def test_an_effect_that_stuck_at_nothing_is_found_again_from_where_it_was(published) -> None:
    """A spread of the stream acts by its square: from zero no derivative leads away."""
    base, _ = published({"stream_spread": 0.15, "release_angle": -0.12})
    whole = fit(base.frame, ("stream_spread", "release_angle"), base.values | {"stream_spread.spread_rad": 0.2})
    stuck = fit(base.frame, ("stream_spread",), base.values | {"stream_spread.spread_rad": 0.0})
    assert stuck.values["stream_spread.spread_rad"] == 0.0
    wanted = Score("release_angle", 0.0, {"release_angle.angle_rad": -0.1})
    alone = candidates.refit(stuck, wanted)
    helped = candidates.refit(stuck, wanted, beside=whole.values)
    assert helped.chi2 == pytest.approx(whole.chi2, abs=0.1)
    assert helped.chi2 < alone.chi2 - 50.0


def test_a_law_that_a_few_steps_leave_behind_another_may_be_the_better_one(monkeypatch) -> None:
    """Free layers fitted as all that lies beyond the tip's reach are ahead after six steps, and far behind at the end.

    Of the laws of one size alone: the one of free shape is better than either.
    """
    monkeypatch.setattr(candidates, "laws", lambda effect: [law for law in laws(effect) if not law.endswith("-gradual")])
    case = np.random.default_rng([zlib.crc32(b"third/unpushed_layers/0"), 940117])
    rows, _, _ = law_cases.rows_of("third", "unpushed_layers", case)
    seen = diagnosis.examine(rows, ParameterSet(values=law_cases.START), replace(NAMED_NOTHING, hold_out="cells"))
    base = seen.choice.base
    found = search(base, seen.noise).candidates(base, ("unpushed_layers",), 1)
    assert found[0].effect == "unpushed_layers"
    ours, other = (candidates.score(base, candidates.signature(base, law)) for law in laws("unpushed_layers")[:2])
    rough, ahead = (candidates.refit(base, s, iterations=USUAL.short_search) for s in (ours, other))
    assert ahead.chi2 < rough.chi2
    assert found[0].fit.chi2 < 0.8 * candidates.polished(ahead).chi2


def test_an_effect_that_leaves_a_gap_gives_way_to_no_pair_that_leaves_more(monkeypatch) -> None:
    """An even fan by the normal law leaves a misfit beside which nothing is found; the best pair without it explains far less."""
    monkeypatch.setattr(candidates, "laws", lambda effect: [law for law in laws(effect) if not law.endswith("-even")])
    case = np.random.default_rng([zlib.crc32(b"combine/stream_spread/0"), 377051])
    rows, known, _ = law_cases.rows_of("combine", "stream_spread", case)
    start = ParameterSet(values=law_cases.START | known)
    found = diagnosis.examine(rows, start, diagnosis.Options(keep_effects=True)).choice
    alone = fit(found.base.frame, ("stream_spread",), found.base.values | {"stream_spread.spread_rad": 0.15})
    assert found.steps[0].added == "stream_spread"
    assert found.best.integrated[0] <= alone.integrated[0] * 1.001


def test_what_the_top_edge_cuts_is_stream_rise_and_no_narrow_fan() -> None:
    """With a fan that the top edge cuts as well among the laws of stream_spread this was that, with a spread of 0.02 rad."""
    case = np.random.default_rng([zlib.crc32(b"third/stream_rise/1"), 862041])
    rows, _, _ = law_cases.rows_of("third", "stream_rise", case)
    seen = diagnosis.examine(rows, ParameterSet(values=law_cases.START), diagnosis.Options())
    assert seen.choice.named == ("stream_rise",)


def test_one_effect_beside_grains_restitution_goes_before_two_beside_exchange_coefficients() -> None:
    """A cell that softens brings the published restitution to 0.2, so that k1 and k2 are searched too; with it it is 0.52."""
    case = np.random.default_rng([zlib.crc32(b"third/cell_nonlinearity/0"), 508117])
    rows, _, _ = law_cases.rows_of("third", "cell_nonlinearity", case)
    seen = diagnosis.examine(rows, ParameterSet(values=law_cases.START), diagnosis.Options())
    assert seen.choice.named == ("cell_nonlinearity",)
    assert seen.form == "restitution"


def test_another_form_of_the_same_cause_needs_no_second_effect() -> None:
    """Leakage by the fill to 1.5 over the speed squared was paddle_leakage with a wrong second effect that mends its law."""
    case = np.random.default_rng([zlib.crc32(b"third/paddle_leakage/1"), 480317])
    rows, _, _ = law_cases.rows_of("third", "paddle_leakage", case)
    options = diagnosis.Options(without=("speed_dependent_friction", "speed_dependent_shape", "gravity", "air_drag"))
    seen = diagnosis.examine(rows, ParameterSet(values=law_cases.START), options)
    assert seen.choice.named == ("paddle_leakage",)
    assert seen.choice.lack_of_fit_after.f < 1.3


def test_a_shape_that_the_rows_leave_open_costs_little(published) -> None:
    """A power of fill that leakage goes with is settled where much is lost, and open where next to nothing is."""
    name = "paddle_leakage-by_powers"
    costs = []
    for loss in (0.6, 0.002):
        base, _ = published({"paddle_leakage": loss})
        found = fit(base.frame, (name,), base.values | {f"{name}.loss_at_full": loss})
        shapes, cost = found.shapes, parameter_costs(found, USUAL.per_parameter)
        assert [found.parameters[i].name for i in shapes] == [f"{name}.fill_power", f"{name}.time_power"]
        assert all(c == USUAL.per_parameter for i, c in enumerate(cost) if i not in shapes)
        costs.append(sum(cost[i] for i in shapes))
    assert costs[0] == pytest.approx(2.0 * USUAL.per_parameter, abs=1.0)
    assert costs[1] < 0.7 * costs[0]


def test_an_effect_that_does_nothing_here_promises_nothing(published) -> None:
    """What rounding leaves of its change has directions as well, of which no gain may come."""
    base, _ = published({"zero_offset": 4.0})
    drawn = candidates.signature(base, "paddle_leakage-by_powers")
    silent = replace(drawn, change=1e-14 * np.random.default_rng(1).standard_normal(drawn.change.shape))
    assert candidates.score(base, drawn).gain > 0.0
    assert candidates.score(base, silent).gain == 0.0


def test_other_starts_leave_a_poor_minimum_and_never_make_a_fit_worse(published) -> None:
    base, _ = published({"speed_dependent_shape": -1.0, "unpushed_layers": 4.0})
    effects = ("speed_dependent_shape", "unpushed_layers")
    best = candidates.refit_from_restarts(fit(base.frame, effects, base.values))
    poor = fit(base.frame, effects, base.values | {"unpushed_layers.rate_per_rad": 15.0}, iterations=1)
    assert candidates.refit_from_restarts(poor).chi2 == pytest.approx(best.chi2, rel=0.02)
    assert candidates.refit_from_restarts(poor).chi2 < 0.5 * poor.chi2
    assert candidates.refit_from_restarts(best).chi2 <= best.chi2


def test_other_starts_take_no_effect_to_its_bound(published) -> None:
    base, _ = published({"zero_offset": -3.0})
    weight = "plate_buildup.weight_n"
    found = fit(base.frame, ("plate_buildup",), base.values | {weight: 1.0}, iterations=0)
    assert weight in fit(base.frame, ("plate_buildup",), found.values).at_bound
    assert weight not in candidates.refit_from_restarts(found).at_bound


def search(base: Fit, noise, policy: Policy = USUAL, *, excess: float | None = None, effects=()) -> Search:
    """A search whose published model is `excess` above its degrees of freedom in chi-square."""
    known = base if excess is None else replace(base, chi2=base.dof + excess)
    return Search(base=known, noise=noise, effects=effects, rng=np.random.default_rng(8), policy=policy)


def _scaled(found: Fit, f: float) -> Fit:
    """The same fit with residuals that leave a lack of fit of `f`."""
    times = np.sqrt(f * found.dof / found.chi2)
    return replace(found, chi2=times**2 * found.chi2, residual=times * found.residual)


@pytest.mark.parametrize(
    ("left_f", "p_value", "enough"),
    [(3.0, 0.01, True), (3.0, 0.03, False), (1.0, 0.01, False), (1.0, 0.001, True), (1.9, 0.01, False)],
)
def test_a_further_effect_needs_less_where_the_model_so_far_is_refuted(published, left_f, p_value, enough) -> None:
    base, noise = published({"zero_offset": 4.0})
    current = _scaled(fit(base.frame, ("zero_offset",), base.values), left_f)
    further = fit(base.frame, ("zero_offset", "release_angle"), base.values)
    found = (Candidate("release_angle", further, 1e6, p_value, 0.0),)
    good = search(base, noise, excess=1.0).admissible(found, current)
    assert [c.effect for c in good] == (["release_angle"] if enough else [])


@pytest.mark.parametrize(
    ("p_value", "gain", "error", "refused"),
    [(0.03, 50.0, 0.5, ""), (0.001, 50.0, 99.0, ""), (0.001, 1.0, 0.5, ""), (0.001, 50.0, 0.5, "at a bound")],
)
def test_a_further_effect_must_be_significant_large_predictive_and_within_bounds(
    published, p_value, gain, error, refused
) -> None:
    base, noise = published({"zero_offset": 4.0})
    current = _scaled(fit(base.frame, ("zero_offset",), base.values), 3.0)
    found = Candidate("release_angle", current, 50.0, 0.001, 0.0)
    assert search(base, noise, excess=1000.0).admissible((found,), current) == [found]
    spoilt = replace(found, p_value=p_value, gain=gain, cross_validated=error, refused=refused)
    assert search(base, noise, excess=1000.0).admissible((spoilt,), current) == []


def beside_a_zero(base: Fit, noise) -> list[str]:
    """Effects that may be added to a zero offset."""
    current = fit(base.frame, ("zero_offset",), base.values | {"zero_offset.force_n": 8.0})
    look = search(base, noise, effects=("heap_shape", "air_drag", "release_angle", "paddle_leakage"))
    return [c.effect for c in look.admissible(look.candidates(current, look.effects, 4), current)]


def test_what_a_giant_law_may_be_off_hides_no_small_effect_of_another_form(published) -> None:
    """A tenth of the giant, of any smooth form, is larger by far; what none of these forms can be is seen beside it."""
    assert beside_a_zero(*published({"zero_offset": 8.0, "heap_shape": 0.5})) == ["heap_shape"]


def test_another_form_of_a_giant_law_is_no_further_effect(make_rows, start) -> None:
    """A zero that changes with angle and speed by as much as an effect's law may."""

    def alter(force, angle, speed, flow):
        return force + 8.0 * (1.0 + 0.1 * (angle - angle.mean()) / np.ptp(angle) - 0.1 * (speed - speed.mean()) / np.ptp(speed))

    seen = diagnosis.examine(make_rows(alter=alter), start, NAMED_NOTHING)
    assert beside_a_zero(seen.choice.base, seen.noise) == []


def test_a_rival_that_misses_a_tie_by_little_is_fitted_again(published) -> None:
    base, noise = published({"zero_offset": 4.0})
    current = fit(base.frame, ("zero_offset",), base.values)
    worse = fit(
        base.frame,
        ("zero_offset",),
        base.values | {"zero_offset.force_n": current.values["zero_offset.force_n"] + 0.35},
        iterations=0,
    )
    policy = Policy(tie=1.0, near=1e6)
    rival = Candidate("plate_buildup", worse, 0.0, 0.5, 0.0)
    assert worse.chi2 > current.chi2 + 10.0
    (again,) = search(base, noise, policy).refined((rival,), "zero_offset", current)
    assert again.fit.chi2 == pytest.approx(current.chi2, abs=0.5)
    assert again.gain == pytest.approx(worse.chi2 - again.fit.chi2)
    for left in (replace(policy, near=0.0), policy):
        kept = rival if left is not policy else replace(rival, refused="at a bound")
        assert search(base, noise, left).refined((kept,), "zero_offset", current) == (kept,)


def test_a_pair_hidden_behind_each_other_is_named(make_rows, start) -> None:
    """Each of the two alone is a compromise of both; the exchange takes it apart."""
    rows = make_rows({"miss_capture": 0.5, "residual_radial_speed": 0.14})
    choice = diagnosis.examine(rows, start, diagnosis.Options(policy=Policy(refits=12, beam=1))).choice
    classes = [{s.added, *s.equivalent} for s in choice.steps]
    assert choice.verdict == "effect"
    assert any("miss_capture" in c for c in classes)
    assert any("residual_radial_speed" in c for c in classes)
    assert choice.lack_of_fit_after.f < 2.0


@pytest.mark.parametrize(("left_f", "gain", "enough"), [(3.0, 90.0, True), (3.0, 30.0, False), (1.0, 90.0, False)])
def test_beside_a_giant_a_further_effect_must_explain_half_of_what_is_left(published, left_f, gain, enough) -> None:
    """Next to the excess of a first effect, one that is plainly there may be small."""
    base, noise = published({"zero_offset": 4.0})
    current = _scaled(fit(base.frame, ("zero_offset",), base.values), left_f)
    found = (Candidate("release_angle", current, gain, 0.001, 0.0),)
    good = search(base, noise, excess=1e6).admissible(found, current)
    assert [c.effect for c in good] == (["release_angle"] if enough else [])
    assert left_f == 1.0 or 0.25 * (current.chi2 - current.dof) < 60.0 < 0.75 * (current.chi2 - current.dof)


@pytest.mark.parametrize(("complete_f", "lack_of_fit_p", "left"), [(2.0, 0.01, ("zero_offset",)), (0.0, 2.0, None)])
def test_a_further_effect_with_too_many_ties_is_pruned_unless_the_data_refute_it(
    published, complete_f, lack_of_fit_p, left
) -> None:
    base, noise = published({"zero_offset": 4.0})
    policy = Policy(tie=1e9, largest_class=2, complete_f=complete_f, lack_of_fit_p=lack_of_fit_p, exchanges=3)
    pair = ("release_angle", "zero_offset")
    current = fit(base.frame, pair, base.values)
    library = ("gravity", "lever_arm", "plate_friction", "release_angle")
    reduced = fit(base.frame, ("zero_offset",), current.values)
    looking = search(base, noise, policy, excess=1e6, effects=(*library, "zero_offset"))
    places = {"release_angle": looking.candidates(reduced, library, 4), "zero_offset": ()}
    found = looking.prune_ambiguous(current, ["zero_offset", "release_angle"], places, 0.0)
    assert tuple(sorted(found.fit.effects)) == (left or pair)
    assert {s.added for s in found.steps} == set(found.fit.effects)


def test_a_bound_that_the_data_do_not_refute_is_no_reason_to_refuse(make_rows, start) -> None:
    """The law's form takes the share past 1, yet at 1 no misfit is left."""
    options = diagnosis.Options(policy=Policy(most_effects=1), hold_out="none")
    rows = make_rows({"secondary_impact": 0.95})
    seen = diagnosis.examine(rows, start, options)
    choice = seen.choice
    (candidate,) = [c for c in choice.looked_at if c.effect == "secondary_impact"]
    assert "secondary_impact.share" in candidate.fit.at_bound
    assert candidates.only_at_bound(candidate.fit, "secondary_impact", 4.0)
    assert candidate.refused == ""
    assert choice.named == ("secondary_impact",)
    notes = diagnosis.conclude(seen, rows, options).notes
    limited, said = sorted((note for note in notes if note.startswith("with ")), key=len, reverse=True)
    assert said.startswith("with secondary_impact, secondary_impact.share is at its upper bound 1:")
    assert "secondary_impact.share ends at a bound" in limited
    assert choice.steps[0].confidence <= MOST_AT_BOUND


def test_a_pair_whose_first_step_misleads_is_found_by_screening(make_rows, start) -> None:
    rows = make_rows({"residual_radial_speed": 0.06, "secondary_impact": 0.8})
    # By one of its laws miss_capture alone explains the two so far that no pair is looked for.
    options = diagnosis.Options(policy=Policy(refits=12, beam=3, pairs=6), hold_out="none", without=("miss_capture",))
    choice = diagnosis.examine(rows, start, options).choice
    classes = [{s.added, *s.equivalent} for s in choice.steps]
    assert any("residual_radial_speed" in c for c in classes)
    assert any("secondary_impact" in c for c in classes)
    # The two turn the force against each other, as terms of a series for a third effect would.
    assert choice.best.cancelled > 0.9
    assert choice.verdict == "unknown"
    assert "cancels out" in choice.objection


@pytest.mark.parametrize(
    ("left_f", "excess", "says"),
    [(1.0, 1e4, ""), (4.0, 1e4, "something else is missing"), (1.2, 40.0, "of the excess is left"), (1.2, 1e4, "")],
)
def test_a_cause_leaves_no_gap_and_a_small_share(published, left_f, excess, says) -> None:
    base, noise = published({"zero_offset": 4.0})
    current = _scaled(fit(base.frame, ("zero_offset",), base.values), left_f)
    steps = (Step("zero_offset", (), (), 1.0, "zero_offset"),)
    found = search(base, noise, excess=excess).objections.first(current, steps)
    assert says in found
    assert bool(found) == bool(says)


@pytest.mark.parametrize(("cells", "says"), [((5,), ""), ((5, 20), "something else is missing")])
def test_one_bad_cell_does_not_refute_a_cause(published, cells, says) -> None:
    base, noise = published({"zero_offset": 4.0})
    sound = _scaled(fit(base.frame, ("zero_offset",), base.values), 1.0)
    residual = sound.residual.copy()
    residual[list(cells)] = 12.0
    current = replace(sound, residual=residual, chi2=float(residual @ residual))
    steps = (Step("zero_offset", (), (), 1.0, "zero_offset"),)
    found = search(base, noise, excess=1e5).objections.first(current, steps)
    assert says in found
    assert bool(found) == bool(says)


@pytest.mark.parametrize(("sizes", "undone"), [((1.0,), 0.0), ((1.0, 1.0), 0.0), ((1.0, -0.9), 1.0 - 0.01 / 1.81)])
def test_what_effects_undo_among_themselves(published, monkeypatch, sizes, undone) -> None:
    """Multiples of one change, in the place of what effects do."""
    base, _ = published({"zero_offset": 4.0})
    change = np.outer(sizes, fit(base.frame, ("zero_offset",), base.values).changes[0])
    monkeypatch.setattr(Fit, "changes", change)
    assert replace(base).cancelled == pytest.approx(undone, abs=1e-9)


def test_grain_that_slides_along_the_plate_without_rolling_is_no_turned_plate(make_rows, start) -> None:
    """Kernels that their neighbours hold do not roll: Coulomb friction goes with all of the impulse, 1 + mu cot(angle)."""
    rows = make_rows(alter=lambda force, angle, speed, flow: force * (1.0 + 0.2 / np.tan(angle)))
    choice = diagnosis.examine(rows, start).choice
    assert choice.verdict == "effect"
    assert [step.added for step in choice.steps] == ["plate_friction"]
    assert choice.best.values[f"{choice.steps[0].law}.coefficient"] == pytest.approx(0.2, abs=0.03)
