"""Grain since a parameter file was measured, from the loads that the store knows."""

from __future__ import annotations

from dataclasses import replace

import pytest

from yieldmon import utc
from yieldmon.engine.mass.totals import Totals
from yieldmon.files import parameter_file
from yieldmon.service.history.grain_since import grain_since_kg
from yieldmon.service.storage.batch import Load

DAY_S = 86_400.0
JULY = utc.read("2026-07-01").timestamp()
LOADS = [
    Load(1, "", "corn", JULY, JULY + DAY_S, 10_000.0, None, None, None),
    Load(2, "", "corn", JULY + DAY_S, JULY + 2 * DAY_S, 20_000.0, None, None, None),
    Load(3, "", "corn", JULY + 3 * DAY_S, None, 0.0, None, None, None),
]
TOTALS = replace(Totals(), load_number=3, load_kg=5_000.0, load_open=True)


@pytest.mark.parametrize(
    ("facts", "expected_kg"),
    [
        ({}, 0.0),
        ({"date": "yesterday"}, 0.0),
        ({"date": "2026-06-30"}, 35_000.0),
        ({"date": "2026-07-02T12:00:00Z"}, 15_000.0),
        ({"date": "2026-07-05"}, 0.0),
        # Of loads weighed before the day on which the file was written.
        ({"date": "2026-07-05", "loads_until": "2026-07-02"}, 25_000.0),
    ],
)
def test_loads_after_the_measurement_count(facts: dict[str, str], expected_kg: float) -> None:
    known = replace(parameter_file.load(), provenance=facts)
    assert grain_since_kg(known, LOADS, TOTALS, JULY + 4 * DAY_S) == pytest.approx(expected_kg)


def test_times_of_a_bus_that_counts_from_its_start_say_nothing() -> None:
    known = replace(parameter_file.load(), provenance={"date": "2026-06-30"})
    assert grain_since_kg(known, [replace(LOADS[0], started_s=10.0, ended_s=900.0)], Totals(), JULY) == 0.0
