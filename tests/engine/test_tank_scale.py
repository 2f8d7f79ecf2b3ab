"""A tank scale's stable readings against what was measured between them, step by step."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import pytest
from engine_bench import ZERO_MV, Bench, feed, monitor

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.self_calibration.load_forces import WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.tank_scale import TankScale
from yieldmon.engine.settings import EngineSettings, ReferenceMassSettings
from yieldmon.frames import Frame

SETTINGS = ReferenceMassSettings(min_increment_kg=50.0, unloading_kg=40.0, scale_std_dev_kg=4.0)


class Tank:
    """Seconds of 10 kg, measured unless stated otherwise, and the scale's readings at their ends."""

    def __init__(self) -> None:
        self.scale = TankScale(SETTINGS)
        self.now_s = 0
        self.total_kg = 0.0

    def second(
        self,
        reading_kg: float | None = None,
        mass_kg: float = 10.0,
        measured: bool = True,
        forces: WindowForces | None = None,
        at: float = 1.0,
    ) -> ReferenceMass | None:
        """at: the share of the second at which the reading comes."""
        self.now_s += 1
        if reading_kg is not None:
            self.scale.reading(self.now_s - 1.0 + at, reading_kg)
        found = self.scale.window(self.now_s - 1.0, float(self.now_s), self.total_kg, mass_kg, measured=measured, forces=forces)
        self.total_kg += mass_kg
        return found

    def seconds(self, count: int, reading_kg: float, measured: bool = True) -> ReferenceMass | None:
        for _ in range(count - 1):
            assert self.second(measured=measured) is None
        return self.second(reading_kg, measured=measured)


def test_a_mass_is_the_difference_of_two_readings() -> None:
    tank = Tank()
    assert tank.second(1000.0) is None
    found = tank.seconds(10, 1100.0)
    assert found is not None
    assert (found.start_s, found.end_s, found.reference_kg, found.measured_kg) == (1.0, 11.0, 100.0, 100.0)
    assert (found.complete, found.zero_doubted, found.std_dev_kg) == (True, False, pytest.approx(4.0 * 2**0.5))
    following = tank.seconds(6, 1160.0)
    assert following is not None
    assert (following.start_s, following.reference_kg, following.measured_kg) == (11.0, 60.0, 60.0)


THIN, THICK = (WindowForces(1.0, force_n, 1.22, 41.9, 15.0) for force_n in (40.0, 80.0))


@pytest.mark.parametrize(("at", "thin_s", "thick_s", "later_s"), [(1.0, 4.0, 6.0, 6.0), (0.25, 4.0, 5.25, 6.0)])
def test_a_mass_has_the_forces_between_its_readings_and_no_others(
    at: float, thin_s: float, thick_s: float, later_s: float
) -> None:
    tank = Tank()
    tank.second(mass_kg=500.0, forces=THIN)
    tank.second(1000.0, forces=THIN)
    for _ in range(4):
        tank.second(forces=THIN)
    for _ in range(5):
        tank.second(forces=THICK)
    found = tank.second(1100.0, forces=THICK, at=at)
    assert found is not None
    assert found.forces is not None
    assert found.forces.force_n.tolist() == pytest.approx([40.0, 80.0])
    assert found.forces.duration_s.tolist() == pytest.approx([thin_s, thick_s])
    for _ in range(5):
        tank.second(forces=THICK)
    following = tank.second(1160.0, forces=THICK, at=at)
    assert following is not None
    assert following.forces is not None
    assert following.forces.duration_s.tolist() == pytest.approx([later_s])


def test_a_mass_some_of_which_has_no_known_force_is_taken_as_a_total() -> None:
    tank = Tank()
    tank.second(1000.0)
    for _ in range(8):
        tank.second(forces=THICK)
    tank.second(forces=THICK._replace(force_n=nan))
    found = tank.second(1100.0, forces=THICK)
    assert found is not None
    assert found.forces is None


@pytest.mark.parametrize(("gained_kg", "counts"), [(50.0, True), (49.9, False), (0.0, False), (-10.0, False)])
def test_small_increments_wait_for_more(gained_kg: float, counts: bool) -> None:
    tank = Tank()
    tank.second(1000.0)
    assert (tank.seconds(3, 1000.0 + gained_kg) is not None) is counts
    found = tank.seconds(6, 1090.0)
    if not counts:
        assert found is not None
        assert (found.start_s, found.reference_kg, found.measured_kg) == (1.0, 90.0, 90.0)


@pytest.mark.parametrize(
    ("between", "begins_s", "complete", "doubted"),
    [
        (lambda tank: None, 1.0, True, False),
        (lambda tank: tank.scale.forget(), None, None, None),
        (lambda tank: tank.scale.doubt_zero(), 1.0, False, True),
        (lambda tank: tank.second(measured=False), 1.0, False, False),
        (lambda tank: (tank.second(measured=False), tank.scale.empty_since(1.0)), 1.0, True, False),
        (lambda tank: (tank.second(measured=False), tank.scale.empty_since(1.125)), 1.0, False, False),
        (lambda tank: tank.second(959.0), 6.0, True, False),
    ],
    ids=["nothing", "forgotten", "zero doubted", "not measured", "empty since then", "empty since later", "unloaded"],
)
def test_what_happens_between_two_readings(
    between: Callable[[Tank], object], begins_s: float | None, complete: bool | None, doubted: bool | None
) -> None:
    tank = Tank()
    tank.second(1000.0)
    for _ in range(4):
        tank.second()
    between(tank)
    found = tank.seconds(8, 1080.0)
    if begins_s is None:
        assert found is None, "the first reading after it is the first"
        found = tank.seconds(6, 1140.0)
        assert found is not None
        assert (found.start_s, found.reference_kg) == (13.0, 60.0)
        return
    assert found is not None
    assert (found.start_s, found.complete, found.zero_doubted) == (begins_s, complete, doubted)
    after = tank.seconds(8, 1160.0)
    assert after is not None
    assert (after.complete, after.zero_doubted) == (True, False), "the next one begins anew"


def test_a_reading_that_waits_is_forgotten_too() -> None:
    tank = Tank()
    tank.second(1000.0)
    tank.scale.reading(2.0, 1100.0)
    tank.scale.forget()
    assert tank.second() is None
    assert tank.seconds(9, 1100.0) is None
    found = tank.seconds(6, 1160.0)
    assert found is not None
    assert found.reference_kg == 60.0


def test_mass_that_was_counted_without_being_measured_is_on_both_sides() -> None:
    tank = Tank()
    tank.scale.counted(5.0)
    tank.second(1000.0)
    tank.scale.counted(30.0)
    tank.total_kg += 30.0
    found = tank.seconds(10, 1100.0)
    assert found is not None
    assert (found.reference_kg, found.measured_kg) == (100.0, 100.0)


def test_what_was_not_measured_and_weighs_nothing_held_no_grain() -> None:
    """Four standard deviations of a reading either way, 16 kg; then counting begins there."""
    for gained_kg, begins_s in ((0.0, 6.0), (8.0, 6.0), (-8.0, 6.0), (17.0, 1.0), (-17.0, 1.0)):
        tank = Tank()
        tank.second(1000.0)
        for _ in range(4):
            tank.second(mass_kg=0.0, measured=False)
        tank.second(1000.0 + gained_kg, mass_kg=0.0, measured=False)
        found = tank.seconds(8, 1000.0 + gained_kg + 80.0)
        assert found is not None
        assert (found.start_s, found.complete) == (begins_s, begins_s == 6.0)


def test_readings_are_kept_up_to_a_number() -> None:
    tank = Tank()
    for k in range(SETTINGS.keep + 3):
        tank.seconds(6, 1000.0 + 60.0 * k)
    assert len(tank.scale.masses) == SETTINGS.keep


@pytest.mark.parametrize("change", [Monitor.reset_totals, Monitor.undo_zero], ids=["reset", "zero undone"])
def test_a_total_that_is_changed_between_two_readings_is_no_mass_measured_between_them(
    change: Callable[[Monitor], object],
) -> None:
    bench = Bench(
        flow=lambda t: 14.0 if t >= 1026.0 else 0.0,
        zero=lambda t: ZERO_MV - (20.0 if t >= 1012.0 else 0.0),
        scatter=0.05,
        noise_mv=2.0,
    )
    readings = [
        Frame(time_s, bus.TANK_SCALE, {"TankMass": 2000.0 + 14.0 * max(0.0, time_s - 1026.0), "TankScaleStatus": 0})
        for time_s in (1001.5 + 5.0 * k for k in range(17))
    ]
    frames = sorted([*bench.frames(85), *readings], key=lambda frame: frame.time_s)
    target = monitor(EngineSettings(reference_masses=ReferenceMassSettings(min_increment_kg=150.0)))
    feed(target, run_of([frame for frame in frames if frame.time_s < 1012.0]))
    target.calibrate_zero()
    feed(target, run_of([frame for frame in frames if 1012.0 <= frame.time_s < 1055.0]))
    change(target)
    feed(target, run_of([frame for frame in frames if frame.time_s >= 1055.0]))
    before = [reference for reference in target.reference_masses if reference.end_s < 1055.0]
    assert before
    assert all(reference.measured_kg == pytest.approx(reference.reference_kg, rel=0.05) for reference in before)
    later = [reference for reference in target.reference_masses if reference.end_s > 1055.0]
    assert later
    assert all(reference.start_s > 1055.0 for reference in later)


@pytest.mark.parametrize("as_run", [False, True])
def test_the_monitor_keeps_the_forces_over_what_a_tank_scale_weighs(as_run: bool) -> None:
    """Thin and thick streams in one mass, ten seconds each."""
    bench = Bench(
        flow=lambda t: (9.0 if t % 20.0 < 10.0 else 16.0) if t >= 1016.0 else 0.0,
        zero=lambda _: ZERO_MV,
        scatter=0.02,
        noise_mv=2.0,
    )
    masses = ((time_s, 12.5 * max(0.0, time_s - 1016.0)) for time_s in (1010.0 + 10.0 * k for k in range(19)))
    readings = [Frame(time_s + 0.5, bus.TANK_SCALE, {"TankMass": mass, "TankScaleStatus": 0}) for time_s, mass in masses]
    frames = sorted([*bench.frames(200), *readings], key=lambda frame: frame.time_s)
    target = monitor(EngineSettings(reference_masses=ReferenceMassSettings(min_increment_kg=1000.0)))
    feed(target, run_of(frames) if as_run else frames)
    [reference] = [reference for reference in target.reference_masses if reference.start_s > 1016.0]
    forces = reference.forces
    assert forces is not None
    assert forces.duration_s.sum() == pytest.approx(reference.end_s - reference.start_s, abs=0.1)
    steady = forces.duration_s > 10.0
    assert sorted(forces.force_n[steady])[-1] / sorted(forces.force_n[steady])[0] == pytest.approx(16.0 / 9.0, rel=0.1)
