"""Every two effects screened together."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from yieldmon.discrepancy import diagnosis, pairs
from yieldmon.discrepancy.candidates import score, signature
from yieldmon.discrepancy.policy import Policy

NAMED_NOTHING = diagnosis.Options(policy=Policy(most_effects=0), hold_out="none")


@pytest.mark.parametrize("seed", range(5))
def test_the_best_of_two_is_that_of_a_bounded_least_squares(seed) -> None:
    rng = np.random.default_rng([seed, 61])
    vectors = rng.standard_normal((6, 8))
    vectors[1] = vectors[0] + 0.05 * vectors[1]
    wanted = 2.0 * rng.standard_normal(8)
    gain, taken = pairs.best_of_two(vectors @ vectors.T, vectors @ wanted)
    for i, j in product(range(6), range(6)):
        if i == j:
            continue
        exact = lsq_linear(vectors[[i, j]].T, wanted, (0.0, pairs.LONGEST), tol=1e-14)
        assert gain[i, j] == pytest.approx(float(wanted @ wanted) - 2.0 * exact.cost, abs=1e-6)
        assert gain[i, j] == pytest.approx(gain[j, i], abs=1e-9)
        assert taken[i, j] == pytest.approx(exact.x[0], abs=1e-4)


def test_screening_offers_every_pair_once_and_the_right_one_early(make_rows, start) -> None:
    rows = make_rows({"zero_offset": 3.0, "release_angle": -0.08})
    base = diagnosis.examine(rows, start, NAMED_NOTHING).choice.base
    library = ("gravity", "lever_arm", "plate_friction", "release_angle", "resting_grain", "zero_offset")
    drawn = [signature(base, e) for e in library]
    found = pairs.screen(base, drawn, [])
    assert len({p.effects for p in found}) == len(found) <= 15
    assert [p.chi2 for p in found] == sorted(p.chi2 for p in found)
    assert ("release_angle", "zero_offset") in [p.effects for p in found[:3]]
    single = max(score(base, s).gain for s in drawn)
    assert found[0].chi2 < base.chi2 - single
