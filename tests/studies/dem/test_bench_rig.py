"""The bench rig's sequence, edge by edge, and its summed response."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.dem.bench_rig import BenchOptics, BenchRig, BenchSensor, BenchSettings, BenchState, response, simulate

SEED = 20100


def spun(rig: BenchRig, turns: int, period_s: float = 0.15) -> float:
    """Turns the rig cleanly; the time of the last edge."""
    rig.start(0.0)
    for turn in range(turns):
        rig.optical_edge((turn + 1) * period_s)
    return turns * period_s


def test_the_solenoid_waits_for_the_fortieth_revolution() -> None:
    rig = BenchRig(BenchSettings())
    spun(rig, 39)
    assert (rig.state, rig.revolutions, rig.solenoid_on) == (BenchState.COUNTING, 39, False)
    rig.optical_edge(40 * 0.15)
    assert (rig.state, rig.revolutions, rig.solenoid_on) == (BenchState.RELEASING, 40, True)
    assert rig.release_s == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("after_s", "state", "on"),
    [
        (0.0, BenchState.RELEASING, True),
        (0.999, BenchState.RELEASING, True),
        (1.001, BenchState.RECORDING, False),
        (1.499, BenchState.RECORDING, False),
        (1.501, BenchState.DONE, False),
    ],
)
def test_the_solenoid_is_held_one_second_and_the_record_outlasts_it(after_s: float, state: BenchState, on: bool) -> None:
    rig = BenchRig(BenchSettings(recording_s=1.5))
    released = spun(rig, 40)
    assert rig.tick(released + after_s) is state
    assert rig.solenoid_on is on


@pytest.mark.parametrize(
    ("gap_s", "counts"), [(0.0, False), (0.0099, False), (0.0101, True)], ids=["same time", "inside debounce", "outside"]
)
def test_debounce_is_ten_milliseconds(gap_s: float, counts: bool) -> None:
    rig = BenchRig(BenchSettings())
    rig.start(0.0)
    assert rig.optical_edge(0.1)
    assert rig.optical_edge(0.1 + gap_s) is counts


def test_bounce_does_not_stretch_the_lockout() -> None:
    rig = BenchRig(BenchSettings())
    rig.start(0.0)
    counted = [rig.optical_edge(t) for t in (0.100, 0.106, 0.112)]
    assert counted == [True, False, True]


@given(st.lists(st.floats(0.0, 0.0095), max_size=4), st.floats(0.05, 0.3))
def test_any_bounce_inside_the_debounce_leaves_the_count_alone(bounces: list[float], period_s: float) -> None:
    rig = BenchRig(BenchSettings())
    rig.start(0.0)
    for turn in range(10):
        for offset in sorted([0.0, *bounces]):
            rig.optical_edge((turn + 1) * period_s + offset)
    assert rig.revolutions == 10
    speed = rig.elevator_speed_rad_s
    assert speed is not None
    assert speed == pytest.approx(2.0 * np.pi / period_s, rel=1e-9)


@pytest.mark.parametrize(("turns", "text"), [(0, "after 0 of 40"), (7, "after 7 of 40")])
def test_a_stalled_elevator_ends_in_a_fault_and_never_releases(turns: int, text: str) -> None:
    rig = BenchRig(BenchSettings())
    last = spun(rig, turns)
    assert rig.tick(last + 1.01) is BenchState.FAULT
    assert text in rig.fault
    assert not rig.optical_edge(last + 1.1)
    assert rig.release_s is None


def test_a_second_throw_starts_from_zero() -> None:
    rig = BenchRig(BenchSettings())
    released = spun(rig, 40)
    with pytest.raises(RuntimeError, match="releasing"):
        rig.start(released + 0.5)
    rig.tick(released + 2.0)
    rig.start(released + 3.0)
    assert (rig.revolutions, rig.release_s, rig.state) == (0, None, BenchState.COUNTING)


def test_time_never_goes_back() -> None:
    rig = BenchRig(BenchSettings())
    rig.start(1.0)
    with pytest.raises(ValueError, match="went back"):
        rig.tick(0.5)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"release_after_revolutions": 0}, "release_after_revolutions is 0"),
        ({"sampling_hz": 0.0}, "sampling_hz is 0.0"),
        ({"debounce_s": 2.0}, "debounce_s is 2.0"),
    ],
)
def test_settings_name_the_bad_value(change: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        BenchSettings(**change)  # type: ignore[arg-type]


def test_response_takes_the_no_load_mean_off_and_sums() -> None:
    settings = BenchSettings(sampling_hz=1000.0, no_load_s=0.1, recording_s=0.2)
    samples = np.full(500, 3.0)
    samples[250:260] += 2.0
    result = response(samples, first_s=0.0, release_s=0.2, settings=settings)
    assert result.zero == 3.0
    assert result.sum == pytest.approx(20.0)
    assert result.impulse == pytest.approx(0.02)


@pytest.mark.parametrize("release_s", [0.05, 0.45])
def test_a_record_too_short_is_refused(release_s: float) -> None:
    settings = BenchSettings(sampling_hz=1000.0, no_load_s=0.1, recording_s=0.2)
    with pytest.raises(ValueError, match="expected 100 before it and 200 after"):
        response(np.zeros(500), 0.0, release_s, settings)


def test_the_simulated_rig_returns_the_impulse_and_the_speed() -> None:
    settings = BenchSettings()
    time = np.arange(6000) / settings.sampling_hz
    force = 80.0 * np.sin(np.pi * time / time[-1]) ** 2
    sensor = BenchSensor(noise_v=0.02)
    throw = simulate(force, 41.9, np.random.default_rng(SEED), settings, sensor, BenchOptics(bounces=3))
    assert throw.revolutions == 40
    assert throw.elevator_speed_rad_s == pytest.approx(41.9, rel=1e-9)
    # White noise over 1e5 samples summed, and the zero from 5e4: sd of impulse = 0.02 V / 0.01 V/N * sqrt(1e5 (1 + 2)) * 1e-5 s.
    assert throw.response.impulse / sensor.volt_per_n == pytest.approx(throw.true_impulse_n_s, abs=4 * 0.011)
    assert throw.response.saturated == 0


def test_a_force_beyond_full_scale_is_counted() -> None:
    throw = simulate(np.full(500, 2000.0), 41.9, np.random.default_rng(SEED))
    assert throw.response.saturated >= 500
