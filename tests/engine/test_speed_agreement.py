"""A reported elevator speed that the grain's pulses contradict: on a train of pulses that knows nothing of the engine."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isnan

import pytest
from engine_bench import Bench, Kept, feed, monitor

from yieldmon import frames as bus
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.records import WindowRecord
from yieldmon.frames import Frame

EMPTY_S, SECONDS, FLOW_KG_S = 12.0, 80.0, 10.0
WRONG = range(50, 53)
"""Seconds in which the reported speed is wrong, where it is."""


def harvest(time_s: float) -> float:
    return FLOW_KG_S if time_s >= 1000.0 + EMPTY_S else 0.0


def in_wrong(time_s: float) -> bool:
    return WRONG.start <= time_s - 1000.0 < WRONG.stop


@dataclass
class Misreported(Bench):
    """A bench whose speed frames carry another speed than that of the chain."""

    flow: Callable[[float], float] = harvest
    reported: Callable[[float], float] = lambda time_s: 400.0
    scatter: float = 0.07

    def slow_frames(self, seconds: float) -> Iterator[Frame]:
        for frame in super().slow_frames(seconds):
            if frame.message == bus.ELEVATOR_SPEED:
                yield frame._replace(signals={"ElevatorSpeed": self.reported(frame.time_s)})
            else:
                yield frame


def measured(bench: Bench, *, one_by_one: bool = False) -> Kept:
    kept = monitor()
    feed(kept, bench.frames(SECONDS) if one_by_one else bench.run(SECONDS))
    return kept


def missing(kept: Kept) -> list[int]:
    """Seconds with grain that have no flow, by their beginning."""
    seconds = (round(record.time_s - 1001.0) for record in kept.records if isnan(record.mass_flow_kg_s))
    return [second for second in seconds if second > EMPTY_S]


def shown(kept: Kept) -> list[str]:
    return [event.detail for event in kept.fault_events if event.code == "SpeedMissing" and event.active]


def lost_teeth(time_s: float) -> float:
    return 300.0 if in_wrong(time_s) else 400.0


@pytest.mark.parametrize("one_by_one", [False, True], ids=["run", "frame by frame"])
def test_seconds_in_which_the_speed_sensor_loses_teeth_are_not_measured_and_said(one_by_one: bool) -> None:
    kept = measured(Misreported(reported=lost_teeth), one_by_one=one_by_one)
    assert set(WRONG) <= set(missing(kept)) <= {*WRONG, WRONG.start - 1, WRONG.stop}
    assert [detail.split(", but ")[1] for detail in shown(kept)] == ["the pulses of the grain come at another rate"]
    last: WindowRecord = kept.records[-1]
    harvested_kg = FLOW_KG_S * (SECONDS - EMPTY_S)
    assert last.load_kg < harvested_kg
    assert harvested_kg - last.load_kg < 3.0 * last.load_std_dev_kg


@pytest.mark.parametrize("share", [0.5, 0.67, 0.75, 0.9, 1.1, 1.33, 1.5])
def test_a_speed_wrong_by_a_tenth_or_more_is_seen(share: float) -> None:
    kept = measured(Misreported(reported=lambda time_s: 400.0 * share if in_wrong(time_s) else 400.0))
    assert set(WRONG) <= set(missing(kept))


def test_a_reported_speed_that_stays_while_the_chain_slows_down_is_seen() -> None:
    kept = measured(Misreported(rpm=lambda time_s: 350.0 if in_wrong(time_s) else 400.0))
    assert {*WRONG} - {WRONG.start} <= set(missing(kept))
    assert shown(kept)


def sagging(time_s: float) -> float:
    return 400.0 - 90.0 * max(0.0, 1.0 - abs(time_s - 1051.0))


def faster(time_s: float) -> float:
    return 300.0 + 50.0 * min(max(time_s - 1045.0, 0.0), 5.0)


OTHERWISE = {
    "nothing": Misreported(),
    "uneven paddles": Misreported(scatter=0.2),
    "little grain": Misreported(flow=lambda time_s: 0.2 * harvest(time_s)),
    "much grain": Misreported(flow=lambda time_s: 2.4 * harvest(time_s)),
    "broad pulses": Misreported(pulse_std_dev_s=0.022),
    "grain in bursts": Misreported(flow=lambda time_s: harvest(time_s) * (1.0 if (time_s % 2.0) < 1.3 else 0.05)),
    "uneven pulses that merge": Misreported(rpm=faster, reported=faster, pulse_std_dev_s=0.028, scatter=0.2, seed=3),
    "very uneven pulses that merge": Misreported(rpm=faster, reported=faster, pulse_std_dev_s=0.022, scatter=0.3),
    "grain that begins in mid-second": Misreported(flow=lambda time_s: harvest(time_s) * (not 1050.4 < time_s < 1056.6)),
    "a speed that is as reported": Misreported(rpm=lost_teeth, reported=lost_teeth),
    "a sag that is as reported": Misreported(rpm=sagging, reported=sagging),
    "a plate that moves": Misreported(angle=lambda time_s: 70.0 - 25.0 * in_wrong(time_s)),
    "something wedged": Misreported(zero=lambda time_s: 150.0 + 200.0 * (time_s > 1050.0)),
    "another plate once the grain has gone": Misreported(
        zero=lambda time_s: 150.0 + 100.0 * (time_s > 1051.0), flow=lambda time_s: harvest(time_s) * (time_s < 1050.0)
    ),
    "something wedged while the shaft shakes the empty plate": Misreported(
        zero=lambda time_s: 150.0 + 60.0 * (time_s > 1051.0),
        flow=lambda time_s: harvest(time_s) * (time_s < 1050.0),
        shaft_vibration_mv=6.0,
    ),
    "vibration": Misreported(paddle_vibration_mv=4.0, shaft_vibration_mv=6.0, noise_mv=3.0),
}


@pytest.mark.parametrize("bench", OTHERWISE.values(), ids=OTHERWISE.keys())
def test_nothing_else_contradicts_the_speed(bench: Misreported) -> None:
    assert shown(measured(bench)) == []


def test_a_wrong_sample_is_no_wrong_speed() -> None:
    bench = Misreported()
    run = bench.run(SECONDS)
    sample = run.samples[0]
    rows = sample.rows.copy()
    for second in WRONG:
        rows[250 * second + 100, 3] = 2400.0
    kept = monitor()
    feed(kept, replace(run, samples=[replace(sample, rows=rows)]))
    assert shown(kept) == []


def test_before_ten_seconds_of_grain_nothing_is_said() -> None:
    kept = measured(Misreported(reported=lambda time_s: 300.0 if 1018.0 <= time_s < 1021.0 else 400.0))
    assert shown(kept) == []


def test_after_twelve_seconds_of_grain_it_is_said() -> None:
    kept = measured(Misreported(reported=lambda time_s: 300.0 if 1025.0 <= time_s < 1028.0 else 400.0))
    assert {25, 26, 27} <= set(missing(kept))


def doubted(kept: Kept) -> list[str]:
    events = [event for event in kept.fault_events if event.code == "WaveformContradicts"]
    return [event.detail.split(" rpm")[0] if event.active else "gone" for event in events]


@pytest.mark.parametrize("share", [0.8, 0.86, 0.9, 0.92, 0.94, 1.06, 1.08, 1.1, 1.2])
def test_a_speed_that_is_wrong_from_the_beginning_is_said(share: float) -> None:
    """A chain that slips looks the same, and tickets correct what it does to the flow: grain is measured."""
    kept = measured(Misreported(reported=lambda time_s: 400.0 * share))
    assert doubted(kept) == [f"the pulses of the grain do not come at the rate of {400.0 * share:.0f}"]
    assert (shown(kept), missing(kept)) == ([], [])


@pytest.mark.parametrize("share", [0.97, 1.0, 1.03])
def test_an_error_as_of_a_machine_file_is_no_wrong_speed(share: float) -> None:
    assert doubted(measured(Misreported(reported=lambda time_s: 400.0 * share))) == []


@pytest.mark.parametrize("bench", OTHERWISE.values(), ids=OTHERWISE.keys())
def test_nothing_else_puts_the_speed_in_doubt(bench: Misreported) -> None:
    assert doubted(measured(bench)) == []


def test_a_speed_that_becomes_right_is_in_doubt_no_more() -> None:
    kept = measured(Misreported(reported=lambda time_s: 400.0 if time_s >= 1050.0 else 440.0))
    assert doubted(kept)[1:] == ["gone"]


def slipping(share: float) -> Callable[[float], float]:
    """The chain from 1045 s on, which the speed frames do not follow."""
    return lambda time_s: 400.0 * (share if time_s >= 1045.0 else 1.0)


def doubts(kept: Kept) -> list[str]:
    return [event.detail for event in kept.fault_events if event.code == "WaveformContradicts" and event.active]


@pytest.mark.parametrize("share", [0.95, 0.97, 0.98, 1.03, 1.05])
def test_a_chain_that_begins_to_slip_is_said_and_widens_the_flow(share: float) -> None:
    kept = measured(Misreported(rpm=slipping(share)))
    (event,) = [event for event in kept.fault_events if event.code == "WaveformContradicts"]
    assert 1050.0 < event.time_s < 1062.0
    shown = re.fullmatch(
        r"at 400 rpm the pulses of the grain come (\d\.\d) % (slower|faster) than they did at first: check chain or belt "
        "slip and the speed sensor",
        kept.faults.detail(FaultCode.WAVEFORM_CONTRADICTS),
    )
    assert shown
    assert float(shown[1]) == pytest.approx(100.0 * abs(1.0 - share), abs=0.3)
    assert shown[2] == ("slower" if share < 1.0 else "faster")
    before, after = (next(r for r in kept.records if r.time_s > at_s) for at_s in (1043.0, 1063.0))
    assert (after.std_dev_kg_s**2 - before.std_dev_kg_s**2) ** 0.5 == pytest.approx(FLOW_KG_S * abs(1.0 - share), rel=0.2)


def test_a_reported_speed_that_stays_while_the_elevator_droops_is_said() -> None:
    kept = measured(Misreported(rpm=lambda time_s: 400.0 - min(max(time_s - 1040.0, 0.0), 10.0)))
    assert len(doubts(kept)) == 1


def test_a_change_that_goes_back_is_gone() -> None:
    course = lambda time_s: 400.0 * (0.97 if 1045.0 <= time_s < 1058.0 else 1.0)  # noqa: E731
    kept = measured(Misreported(rpm=course))
    assert [event.active for event in kept.fault_events if event.code == "WaveformContradicts"] == [True, False]


@pytest.mark.parametrize("share", [0.988, 1.012])
def test_a_change_of_little_more_than_a_percent_is_none(share: float) -> None:
    assert doubts(measured(Misreported(rpm=slipping(share)))) == []


def in_passes(time_s: float) -> float:
    return harvest(time_s) * ((time_s - 1012.0) % 30.0 < 18.0)


def test_a_doubt_stays_from_pass_to_pass_with_the_speed_it_was_seen_at() -> None:
    """Between them the elevator stands."""
    turning = lambda time_s: 400.0 if in_passes(time_s) or time_s < 1012.0 else 0.5  # noqa: E731
    bench = Misreported(flow=in_passes, rpm=turning, reported=lambda time_s: 1.1 * turning(time_s))
    kept = measured(bench)
    assert doubted(kept) == ["the pulses of the grain do not come at the rate of 440"]
    assert "rate of 440 rpm" in kept.faults.detail(FaultCode.WAVEFORM_CONTRADICTS)
