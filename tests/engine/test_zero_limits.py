"""The zero's arithmetic and each of its limits, met exactly and missed by a 1,024th, on windows of round numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import inf

import pytest

from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.sampling.zero import ZeroState, ZeroTracker
from yieldmon.engine.settings import ZeroSettings

SETTINGS = ZeroSettings(
    first_zero_windows=2, first_pulse_limit_mv=8.0, level_range_mv=4.0, settle_windows=4, pulse_margin_mv=1.0, pulse_margin=0.25,
    window_pulse_margin_mv=2.0, window_pulse_margin=1.5, follow_time_s=16.0, max_rate_mv_s=0.25, max_step_mv=16.0,
    drift_limit_mv=32.0,
)  # fmt: skip
ZERO_MV, SPEED = 128.0, 32.0
BEYOND = 1.0 / 1024.0
PLAIN = dict.fromkeys(Window.__dataclass_fields__, 0.0)


class Machine:
    """A tracker and windows of one second."""

    def __init__(self) -> None:
        self.tracker = ZeroTracker(SETTINGS)
        self.now_s = 100.0

    def sees(
        self,
        *levels_mv: float,
        harmonics: tuple[complex, ...] = (),
        pulse_mv: float = 0.0,
        speed: float = SPEED,
        empty: bool = True,
    ) -> Machine:
        for level_mv in levels_mv:
            self.tracker.see(self.window(level_mv, harmonics, pulse_mv, speed), empty)
            self.now_s += 1.0
        return self

    def window(self, level_mv: float, harmonics: tuple[complex, ...], pulse_mv: float, speed: float = SPEED) -> Window:
        given = {"start_s": self.now_s, "end_s": self.now_s + 1.0, "mean_mv": level_mv, "harmonics_mv": harmonics}
        return Window(**PLAIN | given | {"pulse_mv": pulse_mv, "speed_rad_s": speed})  # type: ignore[arg-type]

    @property
    def zero_mv(self) -> float | None:
        return None if self.tracker.state is None else self.tracker.state.zero_mv


def known(harmonics: tuple[complex, ...] = (4.0, 16.0), pulse_mv: float = 4.0) -> Machine:
    """Zero and vibration are learnt by the operator's word."""
    machine = Machine()
    machine.tracker.calibrate()
    return machine.sees(*[ZERO_MV] * 4, harmonics=harmonics, pulse_mv=pulse_mv)


def test_the_first_zero_is_the_mean_of_its_windows() -> None:
    machine = Machine()
    assert (machine.tracker.progress, machine.tracker.refusal, machine.tracker.known_s) == ((0, 2), None, None)
    machine.sees(ZERO_MV, pulse_mv=3.0)
    assert (machine.zero_mv, machine.tracker.progress) == (None, (1, 2))
    machine.sees(ZERO_MV + 4.0, pulse_mv=2.0, speed=SPEED + 2.0)
    assert machine.tracker.state == ZeroState(ZERO_MV + 2.0, ZERO_MV + 2.0, SPEED + 1.0, 3.0)
    assert (machine.tracker.progress, machine.tracker.known_s, machine.tracker.taken_from_s) == ((0, 0), 102.0, 100.0)


def test_a_calibration_learns_zero_and_vibration_of_all_its_windows() -> None:
    machine = Machine()
    machine.tracker.calibrate()
    for number, speed in enumerate((30.0, 32.0, 34.0)):
        assert (machine.tracker.progress, machine.tracker.calibrating) == ((number, 4), True)
        machine.sees(ZERO_MV + number, harmonics=(4.0, 2.0j), pulse_mv=5.0 - number, speed=speed)
    machine.sees(ZERO_MV + 9.0, harmonics=(4.0, -2.0j), speed=36.0, empty=False)
    assert machine.tracker.state == ZeroState(ZERO_MV + 3.0, ZERO_MV + 3.0, 33.0, 5.0, (4.0, 1.0))
    assert (machine.tracker.calibrating, machine.tracker.known_s, machine.tracker.taken_from_s) == (False, 104.0, 100.0)
    machine.tracker.undo()
    assert machine.tracker.state is None


def test_an_undo_brings_back_a_zero_that_is_as_old_as_it_was() -> None:
    machine = known()
    assert machine.tracker.known_s == 104.0
    machine.now_s = 4000.0
    for _ in range(2):
        machine.tracker.calibrate(against_signs=True)
        machine.sees(*[ZERO_MV + 60.0] * 4, harmonics=(4.0, 16.0))
        assert machine.tracker.known_s == machine.now_s
        assert machine.tracker.before_age_s == machine.now_s - 4.0 - 104.0
    machine.tracker.undo()
    assert (machine.zero_mv, machine.tracker.known_s) == (ZERO_MV, 104.0)


def refused(*levels_mv: float, harmonics: tuple[complex, ...]) -> tuple[float, float, float] | None:
    refusal = Machine().sees(*levels_mv, harmonics=harmonics).tracker.refusal
    return (refusal.waited_s, refusal.pulse_mv, refusal.level_range_mv) if refusal else None


@pytest.mark.parametrize(
    ("levels_mv", "harmonics", "expected"),
    [
        ((ZERO_MV, ZERO_MV + 4.0), (8.0,), None),
        ((ZERO_MV, ZERO_MV + 4.0 + BEYOND), (0.0,), (1.0, 0.0, 4.0 + BEYOND)),
        ((ZERO_MV, ZERO_MV), (8.0 + BEYOND,), (1.0, 8.0 + BEYOND, 0.0)),
        ((ZERO_MV, ZERO_MV), (6.0, 8.0), (1.0, 10.0, 0.0)),
        ((ZERO_MV, 150.0, 140.0, 120.0), (), (3.0, 0.0, 20.0)),
    ],
)
def test_why_there_is_no_first_zero(
    levels_mv: tuple[float, ...], harmonics: tuple[complex, ...], expected: tuple[float, float, float] | None
) -> None:
    """How long it has been waited, the pulses of all harmonics together, and the range of the last windows."""
    assert refused(*levels_mv, harmonics=harmonics) == expected


def test_no_first_zero_while_the_machine_may_hold_grain() -> None:
    machine = Machine().sees(*[ZERO_MV] * 4, empty=False)
    refusal = machine.tracker.refusal
    assert machine.zero_mv is None
    assert refusal is not None
    cutting = "the machine is cutting, by header and work state (check them if it is not)"
    assert (refusal.waited_s, refusal.obstacle) == (4.0, cutting)
    assert machine.sees(ZERO_MV).zero_mv == ZERO_MV


def vibration_learnt(harmonic: float, away_mv: float) -> tuple[float, ...]:
    machine = Machine().sees(ZERO_MV, ZERO_MV)
    machine.sees(ZERO_MV, ZERO_MV + away_mv, harmonics=(harmonic,))
    machine.tracker.interrupt()
    machine.sees(*[ZERO_MV + away_mv] * 4, harmonics=(harmonic,), pulse_mv=2.0)
    assert machine.tracker.state is not None
    return machine.tracker.state.vibration_mv


LIMITS: dict[str, tuple[Callable[[float], object], object, object]] = {
    # what happens at a limit and so much beyond it; the outcome at the limit; beyond it
    "vibration near the zero": (lambda e: vibration_learnt(8.0, 4.0 + e), (8.0,), ()),
    "vibration near the zero, below": (lambda e: vibration_learnt(8.0, -4.0 - e), (8.0,), ()),
    "vibration without pulses": (lambda e: vibration_learnt(8.0 + e, 0.0), (8.0,), ()),
    "loaded in a small harmonic": (
        lambda e: known().sees(*[ZERO_MV] * 4, harmonics=(5.0 + e, 16.0)).tracker.looks_loaded, False, True),
    "loaded in a large harmonic": (
        lambda e: known().sees(*[ZERO_MV] * 4, harmonics=(4.0, 20.0 + e)).tracker.looks_loaded, False, True),
    "empty in a small harmonic": (
        lambda e: known().sees(*[ZERO_MV] * 4, harmonics=(3.0 - e, 16.0)).tracker.looks_empty, True, False),
    "empty in a large harmonic": (
        lambda e: known().sees(*[ZERO_MV] * 4, harmonics=(4.0, 12.0 - e)).tracker.looks_empty, True, False),
    "less vibration is no load": (
        lambda e: known().sees(*[ZERO_MV] * 4, harmonics=(3.0 - e, 16.0)).tracker.looks_loaded, False, False),
    "vibration with the square of the speed": (
        lambda e: known().sees(*[ZERO_MV] * 4, harmonics=(16.0, 80.0 + e), speed=64.0).tracker.looks_loaded, False, True),
    "pulses of one window by factor": (
        lambda e: known(pulse_mv=8.0).tracker.pulses(Machine().window(ZERO_MV, (), 12.0 + e)), False, True),
    "pulses of one window by millivolts": (
        lambda e: known(pulse_mv=2.0).tracker.pulses(Machine().window(ZERO_MV, (), 4.0 + e)), False, True),
    "pulses of one window with the square of the speed": (
        lambda e: known(pulse_mv=2.0).tracker.pulses(Machine().window(ZERO_MV, (), 12.0 + e, 64.0)), False, True),
    "pulses before there is a zero": (
        lambda e: Machine().tracker.pulses(Machine().window(ZERO_MV, (), 8.0 + e)), False, True),
    "below empty": (lambda e: known().sees(*[ZERO_MV - 16.0 - e] * 4, empty=False).tracker.below_empty, False, True),
    "too far to follow": (
        lambda e: known().sees(*[ZERO_MV + 16.0 + e] * 4, harmonics=(4.0, 16.0), empty=False).tracker.drift != "", False, True),
}  # fmt: skip


@pytest.mark.parametrize("name", LIMITS)
def test_limit(name: str) -> None:
    happens, at, beyond = LIMITS[name]
    assert (happens(0.0), happens(BEYOND)) == (at, beyond)


@pytest.mark.parametrize(
    ("steps_mv", "moved_mv"),
    [
        ([2.0] * 4, 0.125),
        ([-2.0] * 4, -0.125),
        ([4.0] * 4, 0.25),
        ([8.0] * 4, 0.25),
        ([-8.0] * 4, -0.25),
        ([16.0] * 4, 0.25),
        ([16.5] * 4, None),
        ([15.0, 2.0, 2.0, 2.0], 0.125),
        ([2.0, 2.0, 2.0, 15.0], 0.125),
        ([2.0, 8.0, 8.0, 8.0], 0.125),
        ([8.0, 3.0, 1.0, 0.0], 0.0625),
    ],
    ids=[
        *["slowly", "slowly down", "at the fastest", "no faster", "no faster down", "as far as it follows", "too far"],
        *["the last grain after a stop", "grain in the last second", "a trickle begins", "grain dies away"],
    ],
)
def test_the_zero_follows_what_is_empty_of_the_last_windows(steps_mv: list[float], moved_mv: float | None) -> None:
    machine = known()
    machine.tracker.interrupt()
    machine.sees(*[ZERO_MV + step_mv for step_mv in steps_mv[:3]], harmonics=(4.0, 16.0))
    assert machine.zero_mv == ZERO_MV, "too few windows to say that it is empty"
    machine.sees(ZERO_MV + steps_mv[3], harmonics=(4.0, 16.0))
    assert machine.zero_mv == ZERO_MV + (moved_mv or 0.0)
    assert machine.tracker.known_s == (104.0 if moved_mv is None else 108.0)
    state = machine.tracker.state
    assert state is not None
    assert (state.first_zero_mv, state.speed_rad_s, state.window_pulse_mv, state.vibration_mv) == (
        ZERO_MV,
        SPEED,
        4.0,
        (4.0, 16.0),
    )


@pytest.mark.parametrize(("harmonics", "empty"), [((4.0, 21.0), True), ((4.0, 16.0), False)])
def test_the_zero_stands_still_under_grain_and_while_cutting(harmonics: tuple[complex, ...], empty: bool) -> None:
    assert known().sees(*[ZERO_MV + 2.0] * 8, harmonics=harmonics, empty=empty).zero_mv == ZERO_MV


def test_a_zero_that_follows_far_has_drifted() -> None:
    machine = known()
    while machine.zero_mv is not None and machine.zero_mv < ZERO_MV + 32.0:
        assert not machine.tracker.drift
        machine.sees(machine.zero_mv + 8.0, harmonics=(4.0, 16.0))
    assert machine.zero_mv == ZERO_MV + 32.0
    assert not machine.tracker.drift
    assert machine.tracker.drift == ""
    machine.sees(machine.zero_mv + 8.0, harmonics=(4.0, 16.0))
    assert machine.tracker.drift
    assert re.fullmatch(r"the zero is \+3\d mV from its first value", machine.tracker.drift)


def test_what_is_wrong_with_a_zero_is_said_by_its_cause() -> None:
    assert known().sees(*[ZERO_MV - 60.0] * 8).tracker.drift == "the plate reads 60 mV below empty"
    far = known().sees(*[ZERO_MV + 40.0] * 8, harmonics=(4.0, 16.0), empty=False).tracker.drift
    assert far == "the empty elevator reads +40 mV from the zero"
    machine = known()
    machine.tracker.calibrate(against_signs=True)
    machine.sees(*[ZERO_MV + 100.0] * 8)
    assert machine.tracker.drift == "the last zero was taken despite signs of grain"


def test_what_lies_before_an_interruption_or_a_window_without_a_mean_does_not_count() -> None:
    for gap in (lambda m: m.tracker.interrupt(), lambda m: m.sees(float("nan"))):
        machine = Machine().sees(ZERO_MV)
        gap(machine)
        assert machine.sees(ZERO_MV).zero_mv is None
        assert machine.sees(ZERO_MV).zero_mv == ZERO_MV
        loaded = known().sees(*[ZERO_MV] * 4, harmonics=(9.0, 16.0))
        assert loaded.tracker.looks_loaded
        gap(loaded)
        assert not loaded.tracker.looks_loaded
        assert not loaded.tracker.looks_empty


def test_nothing_is_reported_of_pulses_before_vibration_is_learnt() -> None:
    machine = Machine().sees(*[ZERO_MV] * 2).sees(*[ZERO_MV] * 2, harmonics=(90.0,), empty=False)
    assert (machine.tracker.looks_empty, machine.tracker.looks_loaded, machine.tracker.drift) == (False, False, "")
    assert (Machine().tracker.drift, Machine().tracker.below_empty, Machine().tracker.taken_from_s) == ("", False, inf)


@pytest.mark.parametrize(
    ("against", "despite", "signs", "waits", "suspect"),
    [
        (False, True, "force", False, True),
        (False, True, "", False, False),
        (False, False, "force", True, False),
        (False, False, "", False, False),
        (True, True, "", False, True),
        (True, False, "force", True, True),
        (True, False, "", False, True),
    ],
)
def test_a_calibration_against_signs_of_grain(against: bool, despite: bool, signs: str, waits: bool, suspect: bool) -> None:
    machine = known()
    assert machine.tracker.waits_for_grain_to_pass("force") is False, "none is under way"
    machine.tracker.calibrate(against_signs=against, despite_signs=despite)
    assert machine.tracker.waits_for_grain_to_pass(signs) is waits
    machine.sees(*[ZERO_MV + 5.0] * 4)
    assert machine.tracker.suspect is suspect


@pytest.mark.parametrize(("against", "despite"), [(True, True), (False, True), (False, False)])
def test_a_calibration_goes_on_in_another_tracker(against: bool, despite: bool) -> None:
    before, after = known(), known()
    after.tracker.go_on_with(before.tracker)
    assert not after.tracker.calibrating
    before.tracker.calibrate(against_signs=against, despite_signs=despite)
    after.tracker.go_on_with(before.tracker)
    assert after.tracker.calibrating
    assert after.tracker.waits_for_grain_to_pass("force") is not despite
    after.sees(*[ZERO_MV + 5.0] * 4)
    assert after.tracker.suspect is (against or despite)
