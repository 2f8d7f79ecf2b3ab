"""A sensor or converter that hangs for part of a second or some seconds while grain flows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isnan, sin

import numpy as np
import pytest
from engine_bench import Bench, Kept, feed, monitor
from numpy.typing import NDArray
from scipy.signal import lfilter

FLOW_KG_S, EMPTY_S, SECONDS = 10.0, 12.0, 60.0


@dataclass
class Hanging(Bench):
    """Samples from from_s on, for hangs_s, are those of the first of them, or at level_mv."""

    flow: Callable[[float], float] = lambda time_s: FLOW_KG_S if time_s >= 1000.0 + EMPTY_S else 0.0
    scatter: float = 0.07
    from_s: float = 40.0
    hangs_s: float = 0.0
    level_mv: float = float("nan")

    def sample_frames(self, seconds: float) -> dict[str, NDArray[np.float64]]:
        found = super().sample_frames(seconds)
        samples = found["millivolts"].reshape(-1)
        first, last = round(1000.0 * self.from_s), round(1000.0 * (self.from_s + self.hangs_s))
        samples[first:last] = samples[first] if np.isnan(self.level_mv) else self.level_mv
        return found


def measured(bench: Bench, *, one_by_one: bool = False) -> Kept:
    kept = monitor()
    feed(kept, bench.frames(SECONDS) if one_by_one else bench.run(SECONDS))
    return kept


def wrong(kept: Kept) -> list[tuple[float, float, float]]:
    """Seconds of steady grain whose flow is off by more than four standard deviations and a tenth."""
    after = [record for record in kept.records if record.time_s > 1000.0 + EMPTY_S + 3.0]
    return [
        (record.time_s - 1000.0, record.mass_flow_kg_s, record.std_dev_kg_s)
        for record in after
        if abs(record.mass_flow_kg_s - FLOW_KG_S) > max(4.0 * record.std_dev_kg_s, 0.1 * FLOW_KG_S)
    ]


@pytest.mark.parametrize("level_mv", [400.0, 1100.0])
@pytest.mark.parametrize(("from_s", "hangs_s"), [(40.05, 3.0), (40.3, 0.5), (40.6, 1.0), (40.2, 2.75), (40.05, 0.3)])
def test_no_flow_is_made_of_samples_that_hang(from_s: float, hangs_s: float, level_mv: float) -> None:
    kept = measured(Hanging(from_s=from_s, hangs_s=hangs_s, level_mv=level_mv))
    assert wrong(kept) == []
    load = kept.loads[0]
    assert abs(load.measured_kg - FLOW_KG_S * (SECONDS - EMPTY_S)) < 2.0 * load.std_dev_kg


def test_frames_one_by_one_give_the_same() -> None:
    bench = Hanging(from_s=40.05, hangs_s=1.3, level_mv=700.0)
    both = measured(bench), measured(bench, one_by_one=True)
    assert repr(both[0].records) == repr(both[1].records)


@pytest.mark.parametrize(
    "bench",
    [
        Bench(flow=Hanging.flow, noise_mv=0.0),
        Bench(flow=Hanging.flow, noise_mv=0.0, rpm=lambda time_s: 255.0),
        Bench(flow=lambda time_s: 0.3 * (time_s > 1012.0), noise_mv=0.0),
        Bench(flow=lambda time_s: Hanging.flow(time_s) * (time_s % 7.0 < 3.4), noise_mv=0.0),
        Bench(flow=lambda time_s: 28.0 * (time_s > 1012.0), noise_mv=0.0, pulse_std_dev_s=0.03),
    ],
    ids=["no noise", "slow", "little grain", "grain that comes and goes", "pulses that merge"],
)
def test_a_sensor_without_noise_does_not_hang_between_the_pulses(bench: Bench) -> None:
    records = measured(bench).records
    grain = [bench.flow(record.time_s - 0.55) > 0.0 and bench.flow(record.time_s - 1.2) > 0.0 for record in records]
    missing = [
        r.time_s for r, comes in zip(records, grain, strict=True) if comes and r.time_s > 1016.0 and isnan(r.mass_flow_kg_s)
    ]
    assert missing == []


@dataclass
class Filtered(Bench):
    """A sensor behind a low pass of 0.5 s, in steps of 25 mV: no pulse is left, and a wandering flow stays at one step for some
    tenths of a second."""

    flow: Callable[[float], float] = lambda time_s: Hanging.flow(time_s) * (1.0 + 0.4 * sin(1.3 * time_s))

    def sample_frames(self, seconds: float) -> dict[str, NDArray[np.float64]]:
        found = super().sample_frames(seconds)
        samples = found["millivolts"].reshape(-1)
        low = lfilter([0.002], [1.0, -0.998], samples - samples[0]) + samples[0]
        samples[:] = 25.0 * np.round(low / 25.0)
        return found


def test_a_filtered_sensor_of_coarse_steps_does_not_hang() -> None:
    """No second of its grain had a flow. Those that end with half a second at one step still have none."""
    grain = [record for record in measured(Filtered()).records if record.time_s > 1016.0]
    assert sum(isnan(record.mass_flow_kg_s) for record in grain) < 0.5 * len(grain)
