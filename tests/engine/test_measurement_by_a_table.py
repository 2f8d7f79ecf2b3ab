"""What one window's reading says, for each thing that can be wrong with a window or an input, at its limit and beyond."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isnan, nan, nextafter, pi

import pytest
from engine_bench import MACHINE, ZERO_MV

from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.measurement import Measurement, Reading
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, QUANTITIES
from yieldmon.frames import EstimateQuality, HeaderDown, WorkState
from yieldmon.physics.machine import RPM

SETTINGS = EngineSettings()
GAIN_N_PER_MV = MACHINE.sensor.gain_n_per_mv
HOME_RAD, RATED = MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s
REST_RAD = 2.0 * SETTINGS.plate.at_target_tolerance_deg * pi / 180.0
NOT_AVAILABLE, NOT_HARVESTING = EstimateQuality.NOT_AVAILABLE, EstimateQuality.NOT_HARVESTING
DOWN, UP = float(HeaderDown.DOWN), float(HeaderDown.UP)
WORKING, IDLE = float(WorkState.WORKING), float(WorkState.NOT_WORKING)


class Seconds:
    """A measurement that is shown one window of a second after another, in engine time from 0."""

    def __init__(self, *, zero: bool = True) -> None:
        self.measurement = Measurement(SETTINGS, MACHINE, DEFAULT_SOURCES)
        self.now_s = 0.0
        if zero:
            for _ in range(SETTINGS.zero.first_zero_windows):
                self.second(0.0)
            assert self.measurement.zero.state is not None

    def second(self, force_n: float, fresh: Mapping[str, float] | None = None, **of: float) -> Reading:
        """The reading of the next window. of: fields of the window, or of the inputs where their names begin with "in_"."""
        begun_s, self.now_s = self.now_s, self.now_s + 1.0
        plain: dict[str, object] = dict.fromkeys(Window.__dataclass_fields__, 0.0)
        plain |= dict.fromkeys(("patterns", "sensor_fault_frames", "lost_frames", "surplus_frames", "repeated_frames"), 0)
        plain |= {
            "start_s": begun_s, "end_s": self.now_s, "mean_mv": ZERO_MV + force_n / GAIN_N_PER_MV, "std_dev_mv": nan,
            "harmonics_mv": (0.0, 0.0, 0.0, 0.0), "weight_s": 1.0, "covered_s": 1.0, "speed_rad_s": RATED,
            "plate_angle_rad": HOME_RAD, "plate_min_rad": HOME_RAD, "plate_max_rad": HOME_RAD, "frames": 250, "samples": 1000,
            "last_frame_s": self.now_s, "span_mv": 5.0, "disputed": "", "trace": None,
        }  # fmt: skip
        held = InputSnapshot(
            self.now_s, True, self.now_s, 70.0, 0, nan, -inf, nan, dict.fromkeys(QUANTITIES, nan) | dict(fresh or {})
        )
        window = {name: value for name, value in of.items() if not name.startswith("in_")}
        inputs = held._replace(**{name.removeprefix("in_"): value for name, value in of.items() if name.startswith("in_")})
        return self.measurement.read(Window(**plain | window), inputs, 0)  # type: ignore[arg-type]

    def harvest(self, seconds: int = 1, **of: float) -> Reading:
        return [self.second(60.0, pulse_mv=90.0, **of) for _ in range(seconds)][-1]


QUALITY: dict[str, tuple[float, dict[str, float], EstimateQuality | None]] = {
    # mean force N, what else the window has, why there is no flow
    "grain": (60.0, {}, None),
    "no sample": (60.0, {"covered_s": 0.0}, NOT_AVAILABLE),
    "a sample held for half of it": (60.0, {"held_s": 0.5}, None),
    "for longer": (60.0, {"held_s": nextafter(0.5, 1.0)}, NOT_AVAILABLE),
    "for longer, below empty": (-60.0, {"held_s": nextafter(0.5, 1.0)}, NOT_AVAILABLE),
    "for longer, without force": (0.75, {"held_s": 1.0}, None),
    "for longer, with hardly any": (0.99 * SETTINGS.gate.grain_on_n, {"held_s": 1.0}, None),
    "without grain, while the state holds": (0.9 * SETTINGS.gate.grain_off_n, {}, NOT_HARVESTING),
    "below empty, while the state holds": (-0.2, {}, NOT_HARVESTING),
    "slowest": (60.0, {"speed_rad_s": MACHINE.min_elevator_speed_rad_s}, None),
    "too slow": (60.0, {"speed_rad_s": nextafter(MACHINE.min_elevator_speed_rad_s, 0.0)}, NOT_AVAILABLE),
    "fastest": (60.0, {"speed_rad_s": MACHINE.max_elevator_speed_rad_s}, None),
    "too fast": (60.0, {"speed_rad_s": nextafter(MACHINE.max_elevator_speed_rad_s, inf)}, NOT_AVAILABLE),
    "too fast and empty": (0.0, {"speed_rad_s": nextafter(MACHINE.max_elevator_speed_rad_s, inf)}, NOT_HARVESTING),
    "speed of before": (60.0, {"in_speed_known": False, "in_speed_time_s": 3.0, "last_frame_s": 4.0}, None),
    "speed too old": (60.0, {"in_speed_known": False, "in_speed_time_s": 3.0, "last_frame_s": 4.5}, NOT_AVAILABLE),
}


@pytest.mark.parametrize("case", QUALITY)
def test_why_a_window_has_no_flow(case: str) -> None:
    force_n, of, expected = QUALITY[case]
    machine = Seconds()
    if force_n not in {0.0, 60.0}:
        machine.harvest()
    reading = machine.second(force_n, pulse_mv=90.0 if force_n == 60.0 else 0.0, **of)
    assert reading.quality is expected
    unknown = "covered_s" in of or of.get("last_frame_s") == 4.5
    assert isnan(reading.force_n) is unknown
    assert unknown or reading.force_n == pytest.approx(force_n)


def test_no_flow_without_a_zero() -> None:
    assert Seconds(zero=False).second(60.0, pulse_mv=90.0).quality is NOT_AVAILABLE


@pytest.mark.parametrize(("turns", "moves", "known"), [(True, False, True), (True, True, False), (False, False, False)])
def test_a_sensor_is_stuck_that_stays_the_same_while_the_elevator_turns(turns: bool, moves: bool, known: bool) -> None:
    machine = Seconds()
    machine.harvest()
    of = {"span_mv": 5.0 if moves else 0.0, "speed_rad_s": RATED if turns else 0.0}
    counts = [machine.harvest(**of).stuck_s for _ in range(6)]
    assert counts == ([1, 2, 3, 4, 5, 6] if known else [0] * 6)
    assert machine.second(60.0, pulse_mv=90.0, **of).quality is (None if moves else NOT_AVAILABLE)
    assert machine.harvest().stuck_s == 0


STRUCK: dict[str, tuple[float, dict[str, float], bool]] = {
    # mean force N, what else the window has, whether grain strikes the plate of an elevator that is reported to stand
    "pulses": (60.0, {"speed_rad_s": 0.0, "span_mv": 140.0}, True),
    "slower than one that turns": (60.0, {"speed_rad_s": 49.0 * RPM, "span_mv": 140.0}, True),
    "turning, too slow": (60.0, {"speed_rad_s": 51.0 * RPM, "span_mv": 140.0}, False),
    "grain that lies on the plate": (60.0, {"speed_rad_s": 0.0, "span_mv": 10.0}, False),
    "taps on an empty plate": (0.9 * SETTINGS.gate.certain_force_n, {"speed_rad_s": 0.0, "span_mv": 2000.0}, False),
    "no sample": (nan, {"speed_rad_s": 0.0, "span_mv": 0.0, "covered_s": 0.0}, False),
}


@pytest.mark.parametrize("case", STRUCK)
def test_grain_strikes_the_plate_of_an_elevator_that_is_reported_to_stand(case: str) -> None:
    force_n, of, known = STRUCK[case]
    machine = Seconds()
    machine.harvest()
    assert [machine.second(force_n, **of).struck_s for _ in range(3)] == ([1, 2, 3] if known else [0, 0, 0])
    assert machine.harvest().struck_s == 0


def test_a_stuck_sensor_gives_a_flow_until_it_counts_as_stuck() -> None:
    machine = Seconds()
    machine.harvest()
    found = [machine.harvest(span_mv=0.0).quality for _ in range(SETTINGS.faults.stuck_windows)]
    assert found == [None] * (SETTINGS.faults.stuck_windows - 1) + [NOT_AVAILABLE]


@pytest.mark.parametrize(
    "idle",
    [{"header_down": UP}, {"work_state": IDLE}, {"ground_speed": nextafter(SETTINGS.gate.min_ground_speed_m_s, 0.0)}],
    ids=["header up", "drives off", "standing"],
)
@pytest.mark.parametrize("force_n", [8.0, 60.0])
def test_after_a_while_idle_a_small_force_is_no_harvest(idle: dict[str, float], force_n: float) -> None:
    machine, emptying_s = Seconds(), int(SETTINGS.gate.emptying_s)
    cutting = {"header_down": DOWN, "work_state": WORKING, "ground_speed": SETTINGS.gate.min_ground_speed_m_s}
    for _ in range(emptying_s + 5):
        assert machine.second(force_n, cutting, pulse_mv=90.0).quality is None
    found = [machine.second(force_n, cutting | idle, pulse_mv=90.0).quality for _ in range(emptying_s + 3)]
    assert found == [None] * emptying_s + [NOT_HARVESTING if force_n < SETTINGS.gate.certain_force_n else None] * 3
    assert machine.second(force_n, cutting, pulse_mv=90.0).quality is None
    assert machine.second(force_n, cutting | idle, pulse_mv=90.0).quality is None, "counted anew"


TAKEN: dict[str, tuple[dict[str, float], dict[str, float], bool]] = {
    # what bus and window have while the elevator runs empty; whether a zero is taken
    "as it should be": ({}, {}, True),
    "nearly whole": ({}, {"covered_s": SETTINGS.windows.full_coverage}, True),
    "not whole": ({}, {"covered_s": nextafter(SETTINGS.windows.full_coverage, 0.0)}, False),
    "of two senders": ({}, {"surplus_frames": 1}, False),
    "speed not known": ({}, {"in_speed_known": False}, False),
    "too slow": ({}, {"speed_rad_s": nextafter(MACHINE.min_elevator_speed_rad_s, 0.0)}, False),
    "plate rests": ({}, {"plate_max_rad": HOME_RAD + 0.99 * REST_RAD}, True),
    "plate moves": ({}, {"plate_max_rad": HOME_RAD + 1.01 * REST_RAD}, False),
    "plate near home": ({}, {"plate_angle_rad": HOME_RAD - 0.99 * REST_RAD}, True),
    "plate away": ({}, {"plate_angle_rad": HOME_RAD - 1.01 * REST_RAD}, False),
    "cutting": ({"header_down": DOWN, "work_state": WORKING}, {}, False),
    "header down": ({"header_down": DOWN}, {}, False),
    "header down, drives off": ({"header_down": DOWN, "work_state": IDLE}, {}, True),
    "header up": ({"header_down": UP, "work_state": WORKING}, {}, True),
    "drives on": ({"work_state": WORKING}, {}, True),
    "sensor that moves": ({}, {"span_mv": 0.1}, True),
}  # fmt: skip


@pytest.mark.parametrize("case", TAKEN)
def test_when_a_first_zero_is_taken(case: str) -> None:
    fresh, of, taken = TAKEN[case]
    machine = Seconds(zero=False)
    found = [machine.second(0.0, fresh, **of).zero_taken for _ in range(SETTINGS.zero.first_zero_windows)]
    assert found == [False] * (SETTINGS.zero.first_zero_windows - 1) + [taken]
    assert (machine.measurement.zero.state is not None) is taken


def test_a_stuck_sensor_gives_no_zero() -> None:
    machine = Seconds(zero=False)
    for _ in range(SETTINGS.faults.stuck_windows):
        machine.second(0.0, span_mv=0.0, covered_s=0.5)
    assert not any(machine.second(0.0, span_mv=0.0).zero_taken for _ in range(6))


def test_after_cutting_the_elevator_is_given_time_to_run_empty() -> None:
    machine, emptying_s = Seconds(zero=False), int(SETTINGS.gate.emptying_s)
    machine.second(0.0, {"header_down": DOWN, "work_state": WORKING})
    found = [machine.second(0.0, {"header_down": UP}).zero_taken for _ in range(emptying_s + 1)]
    assert found.index(True) == emptying_s - 1


@pytest.mark.parametrize(("contested", "learns"), [(0, True), (1, False)])
def test_the_paddles_scatter_is_learnt_from_seconds_of_one_sender(contested: int, learns: bool) -> None:
    stated = []
    for scattered_mv in (1.0, 60.0):
        machine = Seconds()
        for _ in range(20):
            machine.harvest(std_dev_mv=scattered_mv, patterns=7, surplus_frames=contested)
        stated.append(machine.harvest().force_std_dev_n)
    assert (stated[1] > 1.5 * stated[0]) is learns
    assert learns or stated[1] == stated[0]


@pytest.mark.parametrize(("force_n", "learns"), [(10.0, False), (10.01, True)])
def test_nor_from_forces_that_are_not_certainly_grain(force_n: float, learns: bool) -> None:
    stated = []
    for scattered_mv in (1.0, 60.0):
        machine = Seconds()
        for _ in range(20):
            machine.second(force_n, pulse_mv=90.0, std_dev_mv=scattered_mv, patterns=7)
        stated.append(machine.harvest().force_std_dev_n)
    assert (stated[1] != stated[0]) is learns


def tank(*readings: tuple[float, float], until_s: float, disputed_s: float = -1.0) -> str:
    """The signs of grain after readings (time s, kg) of the tank's scale."""
    machine = Seconds()
    held = (-inf, nan)
    while machine.now_s < until_s:
        held = next((one for one in reversed(readings) if one[0] <= machine.now_s + 1.0), held)
        of = {"in_tank_time_s": held[0], "in_tank_kg": held[1]}
        machine.second(0.0, **of, in_tank_disputed=machine.now_s + 1.0 == disputed_s)
    return machine.measurement.signs_of_grain


RISE_KG = 3.0 * SETTINGS.reference_masses.scale_std_dev_kg


@pytest.mark.parametrize(
    ("signs", "expected"),
    [
        (tank((5.0, 800.0), (15.0, 800.0 + RISE_KG), until_s=20.0), ""),
        (tank((5.0, 800.0), (15.0, 801.0 + RISE_KG), until_s=20.0), f"the tank has gained {RISE_KG + 1.0:.0f} kg in 10 s"),
        (tank((5.0, 800.0), (15.0, 400.0), until_s=20.0), ""),
        (tank((5.0, 800.0), (15.0, 900.0), until_s=65.0), "the tank has gained 100 kg in 10 s"),
        (tank((5.0, 800.0), (15.0, 900.0), until_s=66.0), ""),
        (tank((5.0, 800.0), (15.0, 900.0), until_s=20.0, disputed_s=12.0), "the tank has gained 100 kg in 10 s"),
        (tank((5.0, 800.0), (15.0, 900.0), until_s=20.0, disputed_s=15.0), ""),
        (tank((5.0, 800.0), (15.0, 900.0), until_s=20.0, disputed_s=20.0), ""),
    ],
    ids=[
        "scatter of the scale",
        "grain",
        "emptied",
        "a minute ago",
        "longer ago",
        "disputed before",
        "disputed with it",
        "disputed since",
    ],
)
def test_a_tank_that_gains_speaks_of_grain(signs: str, expected: str) -> None:
    assert signs == expected


def test_readings_are_as_windows_say() -> None:
    machine = Seconds()
    assert not machine.second(0.0, covered_s=0.0).zero_taken
    reading = machine.harvest()
    assert (reading.sampled_before, reading.silent_before) == (False, True)
    reading = machine.harvest()
    assert (reading.still, reading.at_home, reading.harvesting, reading.in_range, reading.speed_known) == (True,) * 5
    assert (reading.sampled_before, reading.zero_age_s, reading.calibrating_zero) == (True, 3.0, False)
    assert not reading.silent_before


UNSEEN_MV = SETTINGS.zero.window_pulse_margin_mv
CERTAIN_MV = SETTINGS.gate.certain_force_n / GAIN_N_PER_MV
EMPTY_SPELLS: dict[str, tuple[list[tuple[float, float]], float]] = {
    # levels above the zero and pulses of the seconds after some of grain, mV; how far the empty plate was seen from the zero
    "a turn at the headland": ([(14.0, 0.0)] * 3, 14.0),
    "below empty": ([(-14.0, 0.0)] * 3, 14.0),
    "too short": ([(14.0, 0.0)] * 2, 0.0),
    "interrupted by pulses": ([(14.0, 0.0), (14.0, 0.0), (14.0, 90.0), (14.0, 0.0), (14.0, 0.0)], 0.0),
    "the last grain trickles": ([(60.0, 0.0), (19.0, 0.0), (17.0, 0.0), (14.0, 0.0)], 14.0),
    "grain comes again": ([(14.0, 0.0)] * 3 + [(40.0, 0.0), (600.0, 90.0)], 14.0),
    "a later spell": ([(14.0, 0.0)] * 3 + [(600.0, 90.0)] + [(9.0, 0.0)] * 3, 9.0),
    "what a trickle may do": ([(0.99 * UNSEEN_MV, 0.0)] * 3, 0.0),
    "more than a trickle": ([(1.01 * UNSEEN_MV, 0.0)] * 3, 1.01 * UNSEEN_MV),
    "as much as grain may have without pulses": ([(0.99 * CERTAIN_MV, 0.0)] * 3, 0.99 * CERTAIN_MV),
    "grain to a sensor too slow for pulses": ([(1.01 * CERTAIN_MV, 0.0)] * 3, 0.0),
}


@pytest.mark.parametrize("case", EMPTY_SPELLS)
def test_short_spells_without_grain_show_how_far_the_zero_is_off(case: str) -> None:
    seconds, expected_mv = EMPTY_SPELLS[case]
    machine = Seconds()
    machine.harvest(20)
    zero = machine.measurement.zero.state
    for away_mv, pulse_mv in seconds:
        reading = machine.second(away_mv * GAIN_N_PER_MV, pulse_mv=pulse_mv)
    assert reading.zero_away_mv == pytest.approx(expected_mv)
    assert machine.measurement.zero.state == zero, "it moves no zero"


def test_a_zero_that_is_taken_anew_is_away_from_nothing() -> None:
    machine = Seconds()
    machine.harvest(20)
    # Less force than of grain, so that the zero is not suspect.
    force_n = 1.01 * UNSEEN_MV * GAIN_N_PER_MV
    assert force_n < SETTINGS.gate.grain_on_n
    readings = [machine.second(force_n) for _ in range(12)]
    assert readings[-1].zero_away_mv > 0.0
    machine.measurement.zero.calibrate()
    for _ in range(SETTINGS.zero.settle_windows):
        reading = machine.second(force_n)
    assert reading.zero_taken
    assert (reading.zero_away_mv, machine.harvest().zero_away_mv) == (0.0, 0.0)
