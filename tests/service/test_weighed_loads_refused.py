"""Weighed loads that cannot update the parameters: why, in one line."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.service.test_remeasuring import MACHINE, known, rows
from yieldmon.errors import InputError
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.service.logs.measured_loads import measured_loads
from yieldmon.service.logs.weighed_loads import match

TICKET = WeighedTicket("1", "1", 200.0, 1.0, "line 2")


def test_a_load_of_parameters_that_are_gone_is_refused() -> None:
    loads = measured_loads(rows(1, 0.0, version=3, seconds=20), {1: known()})
    with pytest.raises(InputError, match="line 2: load 1 was measured with parameters version 3; expected a store that still"):
        match(loads, [TICKET], MACHINE)


@pytest.mark.parametrize(("unknown", "share"), [(2, None), (3, 85), (19, 5)])
def test_nine_tenths_of_a_load_rest_on_a_known_force(unknown: int, share: int | None) -> None:
    seconds = [replace(row, force_n=None if i < unknown else row.force_n) for i, row in enumerate(rows(1, 0.0, seconds=20))]
    loads = measured_loads(seconds, {1: known()})
    if share is None:
        (load,) = match(loads, [TICKET], MACHINE)
        assert load.duration_s.sum() == pytest.approx(20.0, rel=1e-6), "the rest is taken to go with it"
        return
    with pytest.raises(InputError, match=f"of load 1 only {share} % rests on a known force, angle and speed; expected 90 %"):
        match(loads, [TICKET], MACHINE)
