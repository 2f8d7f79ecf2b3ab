"""The Bayes classifier by the generator's own laws: it names what was hidden, and leaves noise alone."""

from __future__ import annotations

import numpy as np

from studies.hidden_effects import generator as g
from studies.hidden_effects import oracle


def test_the_generator_explains_its_own_table_by_what_is_hidden_in_it() -> None:
    table, grain = oracle.table_of("third", "zero_offset", 0, 1)
    start = np.array([grain[name] for name in oracle.BASE])
    layers = g.LAYERS
    with oracle.coarse():
        found = oracle.explained(table, [("zero_offset",), ("plate_buildup",), ("paddle_leakage",)], start)
    assert layers == g.LAYERS
    assert found[0].effects == ("zero_offset",)
    dof = len(table.mean) - 4
    assert abs(found[0].chi2 - dof) < 4.0 * np.sqrt(2.0 * dof)
    assert all(f.evidence > found[0].evidence + oracle.TIE for f in found[1:])
