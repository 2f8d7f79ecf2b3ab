"""The zero at the end of a quarter of an hour of short passes, where stops are too short for the last grain to be gone."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest
from engine_bench import ZERO_MV, Bench, monitor

from yieldmon.engine.results import records_in

SEED = 918273
PASS_S, TURN_S = (25.0, 35.0), (14.0, 20.0)
DURATION_S = 900.0


def passes(start_s: float) -> list[tuple[float, float]]:
    """Begin and end of each pass, s; the elevator runs empty for the first half minute."""
    rng, found, begin = np.random.default_rng(SEED), [], start_s + 30.0
    while begin < start_s + DURATION_S:
        end = begin + rng.uniform(*PASS_S)
        found.append((begin, end))
        begin = end + rng.uniform(*TURN_S)
    return found


@pytest.mark.parametrize("vibration_mv", [0.0, 6.7])
@pytest.mark.parametrize("decay_s", [0.7, 2.0, 3.0])
def test_grain_that_dies_away_in_short_stops_does_not_raise_the_zero(decay_s: float, vibration_mv: float) -> None:
    """12 kg/s in the passes; after each the flow falls by e in decay_s. 0.15 mV are 0.07 N, 0.1 % of the force of 12 kg/s."""
    bench = Bench(scatter=0.07, noise_mv=3.0, paddle_vibration_mv=vibration_mv, seed=SEED)
    harvested = passes(bench.start_s)

    def flow_kg_s(time_s: float) -> float:
        before = [one for one in harvested if one[0] <= time_s]
        if not before:
            return 0.0
        return 12.0 * exp(-max(0.0, time_s - before[-1][1]) / decay_s)

    bench.flow = flow_kg_s
    zeros_mv = [record.zero_mv for record in records_in(monitor().feed_run(bench.run(DURATION_S)))]
    assert len(zeros_mv) > 0.95 * DURATION_S
    assert zeros_mv[-1] - ZERO_MV == pytest.approx(0.0, abs=0.15)


def test_a_drift_that_a_stop_was_too_short_to_follow_widens_the_standard_deviation() -> None:
    """14 mV in 100 s of harvest, then 20 s without grain: the zero follows by 0.2 mV/s at most."""
    bench = Bench(seed=SEED)
    begin_s, end_s, again_s = (bench.start_s + after_s for after_s in (30.0, 130.0, 150.0))
    bench.zero = lambda time_s: ZERO_MV + 14.0 * min(max((time_s - begin_s) / (end_s - begin_s), 0.0), 1.0)
    bench.flow = lambda time_s: 10.0 if begin_s <= time_s < end_s or time_s >= again_s else 0.0
    records = [record for record in records_in(monitor().feed_run(bench.run(180.0))) if record.time_s > again_s + 2.0]
    assert records[-1].zero_mv - ZERO_MV < 12.0, "the zero has not caught up"
    for record in records:
        assert abs(record.mass_flow_kg_s - 10.0) < 2.0 * record.std_dev_kg_s
