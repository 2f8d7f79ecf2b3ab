"""Other nodes that send what sensor, elevator, actuator and tank scale send: said within two seconds, the mass apart."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import pytest
from engine_bench import Bench, feed, monitor, sample_frame

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.bus.layout import load_layouts
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.settings import EngineSettings, TotalsSettings
from yieldmon.engine.sources import DEFAULT_SOURCES
from yieldmon.frames import Frame

START_S, BEGIN_S, END_S, SECONDS = 1000.0, 1014.0, 1019.0, 24
BENCH = Bench(flow=lambda t: 10.0 if t >= START_S + 5.0 else 0.0, scatter=0.05, noise_mv=2.0, start_s=START_S)


def tank(time_s: float, mass_kg: float) -> Frame:
    return Frame(time_s, bus.TANK_SCALE, {"TankMass": mass_kg, "TankScaleStatus": 0})


def tank_kg(time_s: float) -> float:
    return 2000.0 + 10.0 * max(0.0, time_s - START_S - 5.0)


TRUE = sorted(
    [*BENCH.frames(SECONDS), *(tank(START_S + 0.3 + k, tank_kg(START_S + k)) for k in range(SECONDS))], key=lambda f: f.time_s
)


def of(message: str) -> list[Frame]:
    return [f for f in TRUE if f.message == message and BEGIN_S <= f.time_s < END_S]


def samples(frame: Frame, factor: float, *, counter: int | None = None, ahead_s: float = 0.0015) -> Frame:
    values = [factor * float(frame.signals[f"Sample{k}"]) for k in range(bus.SAMPLES_PER_FRAME)]  # type: ignore[arg-type]
    kept = int(frame.signals["SampleCounter"]) if counter is None else counter  # type: ignore[call-overload]
    return sample_frame(frame.time_s - ahead_s, values, kept)


def ahead() -> Iterable[Frame]:
    return (samples(f, 1.5) for f in of(bus.IMPACT_SENSOR_SAMPLES))


def one_in_fifty() -> Iterable[Frame]:
    return (samples(f, 8.0) for f in of(bus.IMPACT_SENSOR_SAMPLES)[::50])


def with_the_next_counter() -> Iterable[Frame]:
    return (samples(f, 3.0, counter=(int(f.signals["SampleCounter"]) + 1) % 256) for f in of(bus.IMPACT_SENSOR_SAMPLES)[::10])  # type: ignore[call-overload]


def ten_times_the_rate() -> Iterable[Frame]:
    for number, f in enumerate(of(bus.IMPACT_SENSOR_SAMPLES)):
        for k in range(1, 10):
            yield samples(f, 1.0, counter=(9 * number + k) % 256, ahead_s=-0.0004 * k)


def replay() -> Iterable[Frame]:
    """What the sensor sent a while ago, at another load, with the counters of then."""
    earlier = replace(BENCH, flow=lambda t: 25.0, seed=9).sample_frames(8.0)
    begin = BEGIN_S - START_S
    for k, (t, mv) in enumerate(zip(earlier["times_s"], earlier["millivolts"], strict=True)):
        if t - START_S < END_S - BEGIN_S:
            yield sample_frame(t + begin + 0.0007, mv.tolist(), (k + 77) % 256)


def copies_later() -> Iterable[Frame]:
    """The sensor's own frames once more, a tenth of a second after."""
    return (f._replace(time_s=f.time_s + 0.1002) for f in of(bus.IMPACT_SENSOR_SAMPLES))


def few_copies_later() -> Iterable[Frame]:
    return (f._replace(time_s=f.time_s + 0.1002) for f in of(bus.IMPACT_SENSOR_SAMPLES)[::40])


def speeds(every: int, rpm: float, late_s: float = 0.03) -> Iterable[Frame]:
    found = of(bus.ELEVATOR_SPEED)[::every]
    return (Frame(f.time_s + late_s, bus.ELEVATOR_SPEED, {"ElevatorSpeed": rpm}) for f in found)


def speed_once_a_second_for_long() -> Iterable[Frame]:
    for f in of(bus.ELEVATOR_SPEED)[::10]:
        yield from (Frame(f.time_s + d, bus.ELEVATOR_SPEED, {"ElevatorSpeed": 250.0}) for d in (0.03, 0.06))


def speeds_in_a_flood() -> Iterable[Frame]:
    times = (BEGIN_S + 0.003 * k for k in range(round((END_S - BEGIN_S) / 0.003)))
    return (Frame(t, bus.ELEVATOR_SPEED, {"ElevatorSpeed": 380.0}) for t in times)


def angles(every: int, angle_deg: float) -> Iterable[Frame]:
    found = of(bus.PLATE_ACTUATOR_FEEDBACK)[::every]
    signals = {"PlateAngle": angle_deg, "ActuatorState": 0}
    return (Frame(f.time_s + 0.02, bus.PLATE_ACTUATOR_FEEDBACK, signals) for f in found)


FORGERIES: dict[str, Callable[[], Iterable[Frame]]] = {
    "same counter, ahead": ahead,
    "one in fifty, same counter": one_in_fifty,
    "one in ten, the next counter": with_the_next_counter,
    "ten times the rate": ten_times_the_rate,
    "recording of an hour ago": replay,
    "copies a tenth of a second later": copies_later,
    "few copies later": few_copies_later,
    "speed, as often as the true one": lambda: speeds(1, 300.0),
    "speed, nearly the true one": lambda: speeds(1, 396.0),
    "speed, half as often": lambda: speeds(2, 370.0),
    "speed, once a second": lambda: speeds(10, 300.0),
    "speed, twice in a row once a second": speed_once_a_second_for_long,
    "speed, in a flood": speeds_in_a_flood,
    "angle, as often as the true one": lambda: angles(1, 60.0),
    "angle, nearly the true one": lambda: angles(1, 69.0),
    "angle, twice a second": lambda: angles(10, 55.0),
}


def forged(name: str) -> list[Frame]:
    return sorted([*TRUE, *FORGERIES[name]()], key=lambda f: f.time_s)


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forgery_is_reported_within_two_seconds_and_its_mass_is_apart(name: str) -> None:
    target = monitor()
    feed(target, forged(name))
    begun = [e.time_s for e in target.fault_events if e.code is FaultCode.FRAMES_LOST and e.active]
    assert begun
    assert BEGIN_S < begun[0] <= BEGIN_S + 2.2
    # Said in one second, it belongs to that and those after it; what follows the attack counts again.
    during = [r for r in target.records if begun[0] <= r.time_s <= END_S]
    assert sum(r.mass_kg for r in during) == 0.0
    assert all(r.quality is not bus.EstimateQuality.OK for r in during)
    totals = target.totals
    assert totals.total_contested_kg > 15.0
    assert sum(r.mass_kg for r in target.records) == pytest.approx(totals.total_kg)
    after = [r for r in target.records if r.time_s > END_S + 2.0]
    assert [r.mass_kg for r in after] == pytest.approx([10.0] * len(after), rel=0.2)


@pytest.mark.parametrize("name", ["speed, once a second", "angle, twice a second", "copies a tenth of a second later"])
def test_whole_logs_are_judged_alike(name: str) -> None:
    one_by_one, in_runs = monitor(), monitor()
    feed(one_by_one, forged(name))
    in_runs.feed_run(run_of(forged(name)))
    assert repr(in_runs.records) == repr(one_by_one.records)


def test_no_zero_is_learnt_from_contested_seconds() -> None:
    """An elevator that runs empty while somebody adds 20 mV to every sample."""
    empty = replace(BENCH, flow=lambda t: 0.0)
    target, alone = monitor(), monitor()
    true = empty.frames(40)
    added = [samples(f, 1.13) for f in true if f.message == bus.IMPACT_SENSOR_SAMPLES and f.time_s > 1006.0]
    feed(alone, true)
    feed(target, sorted([*true, *added], key=lambda f: f.time_s))
    assert target.records[-1].zero_mv == pytest.approx(alone.records[4].zero_mv, abs=0.2)


def by_scale(kind: str = "tank_scale") -> EngineSettings:
    return replace(EngineSettings(), totals=TotalsSettings(new_load=kind))


@pytest.mark.parametrize("forged_kg", [8000.0, 500.0])
@pytest.mark.parametrize("in_runs", [False, True])
def test_a_second_tank_scale_is_reported_and_weighs_nothing(forged_kg: float, in_runs: bool) -> None:
    added = [tank(START_S + 0.8 + k, forged_kg) for k in range(14, 19)]
    frames = sorted([*TRUE, *added], key=lambda f: f.time_s)
    target = monitor(by_scale())
    if in_runs:
        target.feed_run(run_of(frames))
    else:
        feed(target, frames)
    begun = next(e for e in target.fault_events if e.code is FaultCode.FRAMES_LOST)
    assert begun.time_s <= START_S + 14.8 + 2.2
    assert "tank mass" in begun.detail
    assert target.totals.load_number == 1
    assert all(reference.reference_kg < 200.0 for reference in target.reference_masses)
    assert target.totals.total_contested_kg == 0.0


def held_up(frames: Sequence[Frame], begin_s: float, end_s: float) -> list[Frame]:
    """What is sent from begin_s on is received at end_s, one frame close behind the other, as after a busy computer's pause."""
    waiting = [f for f in frames if begin_s <= f.time_s < end_s]
    received = [f._replace(time_s=end_s + 2e-5 * k) for k, f in enumerate(waiting)]
    return sorted([*(f for f in frames if not begin_s <= f.time_s < end_s), *received], key=lambda f: f.time_s)


@pytest.mark.parametrize("pause_s", [0.15, 0.3, 0.45])
@pytest.mark.parametrize("in_runs", [False, True])
def test_frames_that_come_late_are_no_second_sensor(pause_s: float, in_runs: bool) -> None:
    # Windows end a tenth of a second after the full second of bus time: the pause lies before an edge, its frames behind it.
    frames = held_up(TRUE, START_S + 14.105 - pause_s, START_S + 14.105)
    target = monitor()
    if in_runs:
        target.feed_run(run_of(frames))
    else:
        feed(target, frames)
    assert target.totals.total_contested_kg == 0.0
    assert not [e for e in target.fault_events if e.code is FaultCode.FRAMES_LOST and e.active]


def jittered(frames: Sequence[Frame], late_s: float, seed: int) -> list[Frame]:
    """Each frame up to so much later, those of one message in order, as a busy bus has them."""
    rng, last = random.Random(seed), dict[str, float]()
    out = []
    for f in frames:
        last[f.message] = max(last.get(f.message, 0.0), f.time_s + late_s * rng.random())
        out.append(f._replace(time_s=last[f.message]))
    return sorted(out, key=lambda f: f.time_s)


def braked(time_s: float) -> float:
    """Stopped in a second and brought back in another, with slip."""
    return max(0.0, 400.0 * min(1.0, abs(time_s - 1012.0) / 1.2)) * (1.0 + 0.05 * (int(time_s * 7) % 2))


HONEST: dict[str, Callable[[], list[Frame]]] = {
    "late by up to 15 ms": lambda: jittered(TRUE, 0.015, 1),
    "elevator stopped and started": lambda: replace(BENCH, rpm=braked).frames(20),
    "plate driven to and fro": lambda: replace(BENCH, angle=lambda t: 60.0 + 10.0 * abs((t % 1.0) / 0.5 - 1.0)).frames(20),
    "tank unloaded on the move": lambda: sorted(
        [*BENCH.frames(20), *(tank(START_S + k, 8000.0 - 120.0 * max(0, k - 5)) for k in range(20))], key=lambda f: f.time_s
    ),
}


@pytest.mark.parametrize("name", HONEST)
def test_one_sender_each_is_none_too_many(name: str) -> None:
    target = monitor()
    feed(target, HONEST[name]())
    assert all(r.surplus_frames == 0 for r in target.records)
    assert target.faults.occurrences(FaultCode.FRAMES_LOST) == 0
    assert target.totals.total_contested_kg == 0.0


def test_intervals_are_those_of_the_dbc() -> None:
    layouts = load_layouts()
    known = [source for source in DEFAULT_SOURCES.inputs if source.interval_s == source.interval_s]
    assert [source.quantity for source in known] == ["elevator_speed", "plate_angle"]
    assert all(source.interval_s == layouts[source.message].cycle_time_s for source in known)
