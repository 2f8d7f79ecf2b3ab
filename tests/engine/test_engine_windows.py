"""Windows: no aliasing, no sample lost or counted twice, losses counted."""

from __future__ import annotations

import json

import numpy as np
import pytest
from engine_bench import MACHINE, Bench, feed, flows, monitor
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.in_process import program
from yieldmon.engine.sampling.aliasing import aliasing_share
from yieldmon.engine.sampling.windows import Window, WindowBuilder
from yieldmon.engine.settings import WindowSettings
from yieldmon.engine.sources import SampleSource
from yieldmon.physics.machine import RPM

NAN = float("nan")


def rows(values: np.ndarray, start_s: float = 0.0, first_counter: int = 0) -> np.ndarray:
    """Sample rows of consecutive frames from values (4 n,)."""
    samples = values.reshape(-1, 4)
    times = start_s + 0.004 * np.arange(1, samples.shape[0] + 1) - 0.0005
    counters = (first_counter + np.arange(times.size)) % 256
    return np.column_stack((times, counters, np.zeros(times.size), samples))


def close_seconds(builder: WindowBuilder, table: np.ndarray, rpm: np.ndarray, extra: int = 2) -> list[Window]:
    """Close a window each second over a table of rows; rpm: one speed a tenth of a second; `extra` empty windows follow."""
    windows = []
    for second in range(len(rpm) // 10 + extra):
        builder.samples.add_block(table[(table[:, 0] >= second) & (table[:, 0] < second + 1)])
        for tenth in range(10 if second < len(rpm) // 10 else 0):
            builder.speed.add(second + 0.1 * tenth, float(rpm[10 * second + tenth]) * RPM)
        windows.append(builder.close(float(second), second + 1.0))
    return windows


def test_constant_flow_gives_constant_results_at_every_speed() -> None:
    done = program("studies.aliasing.__main__", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert [row["rpm"] for row in found["rows"]] == [float(rpm) for rpm in range(300, 501)]
    assert found["worst"]["windows_pct"] < 0.5
    assert found["worst"]["plain_mean_pct"] > 5.0


@pytest.mark.parametrize(("rpm_from", "rpm_to"), [(300.0, 500.0), (500.0, 300.0), (400.0, 380.0)])
def test_constant_flow_while_the_speed_changes(rpm_from: float, rpm_to: float) -> None:
    bench = Bench(
        flow=lambda t: 10.0 if t > 1005 else 0.0,
        rpm=lambda t: float(np.interp(t, [1010.0, 1030.0], [rpm_from, rpm_to])),
        noise_mv=0.0,
        pulse_std_dev_s=0.02,
    )
    found = np.array(flows(feed(monitor(), bench.run(34))))[8:]
    assert np.ptp(found) / found.mean() < 0.02
    assert found.mean() == pytest.approx(10.0, rel=0.005)


@settings(max_examples=60)
@given(
    values=st.lists(st.floats(-100.0, 4000.0), min_size=40, max_size=40),
    rpm=st.lists(st.floats(0.0, 700.0), min_size=40, max_size=40),
    lost=st.sets(st.integers(0, 999), max_size=600),
)
def test_every_sample_counts_exactly_once(values: list[float], rpm: list[float], lost: set[int]) -> None:
    signal = np.repeat(np.array(values), 100)
    table = rows(signal)
    keep = np.array([i not in lost for i in range(table.shape[0])])
    windows = close_seconds(WindowBuilder(WindowSettings(), MACHINE), table[keep], np.array(rpm))
    total = sum(w.mean_mv * w.covered_s for w in windows if w.covered_s > 0.0)
    assert total == pytest.approx(table[keep][:, 3:].sum() * 0.001, abs=1e-6)
    assert sum(w.covered_s for w in windows) == pytest.approx(0.004 * keep.sum(), abs=1e-9)
    assert sum(w.weight_s for w in windows[:-1]) == pytest.approx(len(windows) - 1, abs=0.51)


LOSSES = [
    # (frames lost, lost in all, coverage of the second window at least, at most)
    (set(), 0, 0.999, 1.0),
    ({300}, 1, 0.99, 0.999),
    (set(range(300, 400)), 100, 0.5, 0.65),
    (set(range(260, 500)), 240, 0.0, 0.2),
    (set(range(250, 900)), 650, 0.0, 0.2),
]


@pytest.mark.parametrize(("lost", "count", "low", "high"), LOSSES)
def test_losses_are_counted_by_counter_and_time(lost: set[int], count: int, low: float, high: float) -> None:
    table = rows(np.full(4000, 200.0))
    keep = np.array([i not in lost for i in range(table.shape[0])])
    windows = close_seconds(WindowBuilder(WindowSettings(), MACHINE), table[keep], np.full(40, 400.0))
    assert sum(w.lost_frames for w in windows) == count
    assert low <= windows[1].coverage <= high
    assert all(w.mean_mv == pytest.approx(200.0) for w in windows if w.covered_s > 0.0)


def test_a_frame_sent_twice_counts_once() -> None:
    signal = np.random.default_rng(5).normal(200.0, 20.0, 8000)
    table = rows(signal)
    twice = np.insert(table, 100, table[99], axis=0)
    once = close_seconds(WindowBuilder(WindowSettings(), MACHINE), table, np.full(80, 400.0))
    again = close_seconds(WindowBuilder(WindowSettings(), MACHINE), twice, np.full(80, 400.0))
    np.testing.assert_array_equal([w.mean_mv for w in again], [w.mean_mv for w in once])
    assert sum(w.repeated_frames for w in again) == 1
    assert sum(w.lost_frames + w.surplus_frames for w in again) == 0


def test_a_second_sensor_on_the_bus_is_seen_as_surplus() -> None:
    table = rows(np.full(4000, 200.0))
    forged = table.copy()
    forged[:, 0] += 0.001
    forged[:, 1] = (forged[:, 1] + 97) % 256
    both = np.concatenate((table, forged))
    both = both[np.argsort(both[:, 0], kind="stable")]
    windows = close_seconds(WindowBuilder(WindowSettings(), MACHINE), both, np.full(40, 400.0))
    assert min(w.surplus_frames for w in windows[:3]) > 100


def test_without_counter_losses_are_counted_by_time() -> None:
    table = rows(np.full(4000, 200.0))
    table[:, 1] = NAN
    table = np.delete(table, slice(300, 350), axis=0)
    windows = close_seconds(WindowBuilder(WindowSettings(), MACHINE), table, np.full(40, 400.0))
    assert sum(w.lost_frames for w in windows) == 50


def test_unusable_samples_are_left_out() -> None:
    table = rows(np.full(4000, 200.0))
    table[300, 3:] = [NAN, 1e9, -1e9, 200.0]
    table[310, 2] = 2.0
    windows = close_seconds(WindowBuilder(WindowSettings(), MACHINE), table, np.full(40, 400.0))
    assert windows[1].samples == 1000 - 3 - 4
    assert windows[1].sensor_fault_frames == 1
    assert windows[1].mean_mv == pytest.approx(200.0)


def test_standard_deviation_of_the_mean_matches_the_scatter_of_many_windows() -> None:
    bench = Bench(flow=lambda t: 12.0, scatter=0.07, noise_mv=3.0, seed=11)
    samples = bench.sample_frames(200)
    times = samples["times_s"] - bench.start_s - 0.0005
    table = np.column_stack((times, samples["counters"], samples["statuses"], samples["millivolts"]))
    windows = close_seconds(WindowBuilder(WindowSettings(), MACHINE), table, np.full(2000, 400.0), extra=0)[1:]
    scatter = float(np.std([w.mean_mv for w in windows]))
    stated = float(np.sqrt(np.mean([w.std_dev_mv**2 for w in windows])))
    assert stated == pytest.approx(scatter, rel=0.2)


@pytest.mark.parametrize("rpm", [300.0, 400.0, 500.0])
def test_what_a_slow_sensor_costs(rpm: float) -> None:
    """Nothing from 200 Hz on, much at 10 Hz, less with a filter in the sensor that is slower than the paddles."""
    shares = [
        aliasing_share(SampleSource("Slow", ("Sample",), 1.0 / rate_hz), MACHINE, rpm * RPM) for rate_hz in (10.0, 100.0, 1000.0)
    ]
    assert shares[0] > 0.1
    assert shares[0] > 20.0 * shares[1]
    assert shares[2] == 0.0
    filtered = SampleSource("Slow", ("Sample",), 0.1, time_constant_s=0.3)
    assert aliasing_share(filtered, MACHINE, rpm * RPM) < 0.15 * shares[0]
