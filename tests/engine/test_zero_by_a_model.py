"""The zero tracker against a list of the windows it was shown, for any order of windows, interruptions and operator's words."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isnan, nan

from hypothesis import given, settings
from hypothesis import strategies as st
from test_zero_limits import PLAIN, SETTINGS, ZERO_MV

from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.sampling.zero import ZeroTracker

FIRST, SETTLE = 2, 4


@dataclass(frozen=True)
class Shown:
    """A window of one second. beat_mv: of its one harmonic; pulse_mv: of the window alone."""

    level_mv: float
    beat_mv: float
    pulse_mv: float
    speed: float
    may_be_empty: bool
    end_s: float = 0.0


@dataclass(frozen=True)
class Zero:
    mv: float
    first_mv: float
    speed: float
    pulse_mv: float
    beat_mv: float | None = None


def mean(values: list[float]) -> float:
    return sum(values) / len(values)


def middle(rows: list[Shown]) -> float:
    levels = sorted(one.level_mv for one in rows)
    return (levels[(len(levels) - 1) // 2] + levels[len(levels) // 2]) / 2.0


@dataclass
class Model:
    """What the tracker ought to hold."""

    zero: Zero | None = None
    before: Zero | None = None
    row: list[Shown] = field(default_factory=list)
    """What was seen since the last interruption."""
    calibrating: bool = False
    against: bool = False
    despite: bool = False
    suspect: bool = False
    far_mv: float = 0.0
    """How far the empty elevator read from the zero when it was seen last, where that is too far to follow."""
    looked_empty: bool = False
    """As a calibration despite signs of grain began."""
    known_s: float | None = None
    before_known_s: float | None = None
    taken_from_s: float = inf
    refusal: tuple[float, tuple[float, float] | None] | None = None
    """Seconds waited; pulses and range of the last windows, None for one that could not be looked at."""

    @property
    def last(self) -> list[Shown]:
        return self.row[-SETTLE:]

    def calibrate(self, against: bool, despite: bool) -> bool:
        goes_on = self.suspect and self.before is not None
        if not goes_on:
            self.before, self.before_known_s = self.zero, self.known_s
        self.looked_empty = despite and self.looks_empty
        self.calibrating, self.despite, self.against, self.row = True, despite, against or goes_on, []
        return goes_on

    def undo(self) -> None:
        self.zero, self.before, self.calibrating, self.suspect, self.row = self.before, None, False, False, []
        self.far_mv, self.known_s, self.before_known_s = 0.0, self.before_known_s, None

    def signs(self, text: str) -> bool:
        if not self.calibrating or not text:
            return False
        if self.despite:
            self.against = True
        return not self.despite

    def see(self, shown: Shown) -> None:
        if isnan(shown.level_mv):
            self.row = []
            return
        self.row.append(shown)
        if self.calibrating:
            self.calibration()
        elif shown.may_be_empty and self.zero is None:
            self.first()
        elif shown.may_be_empty and self.zero is not None:
            if self.zero.beat_mv is None:
                self.vibration(self.zero)
            else:
                self.follow(self.zero, shown)
        elif self.zero is None:
            self.refusal = self.waited_s + 1.0, None

    @property
    def usual_mv(self) -> float:
        """Half of the last windows read no more, half no less."""
        return middle(self.last)

    @property
    def waited_s(self) -> float:
        return 0.0 if self.refusal is None else self.refusal[0]

    def learnt(self, rows: list[Shown]) -> Zero:
        level = mean([one.level_mv for one in rows])
        speed, pulse = mean([one.speed for one in rows]), max(one.pulse_mv for one in rows)
        return Zero(level, level, speed, pulse, mean([one.beat_mv for one in rows]))

    def calibration(self) -> None:
        if len(self.row) < SETTLE:
            return
        self.zero, self.calibrating, self.far_mv = self.learnt(self.last), False, 0.0
        changed = 0.0 if self.before is None else abs(self.zero.mv - self.before.mv)
        self.suspect = self.against and changed > 4.0
        self.known_s, self.taken_from_s = self.row[-1].end_s, self.last[0].end_s - 1.0

    @staticmethod
    def quiet(rows: list[Shown]) -> bool:
        levels = [one.level_mv for one in rows]
        return mean([one.beat_mv for one in rows]) <= 8.0 and max(levels) - min(levels) <= 4.0

    def first(self) -> None:
        rows = self.row[-FIRST:]
        if len(rows) < FIRST:
            return
        found = self.learnt(rows)
        if self.quiet(rows):
            self.zero = Zero(found.mv, found.mv, found.speed, found.pulse_mv)
            self.known_s, self.taken_from_s = rows[-1].end_s, rows[0].end_s - 1.0
            return
        levels = [one.level_mv for one in rows]
        self.refusal = self.waited_s + 1.0, (found.beat_mv or 0.0, max(levels) - min(levels))

    def vibration(self, zero: Zero) -> None:
        rows = self.last
        if len(rows) == SETTLE and self.quiet(rows) and all(abs(one.level_mv - zero.mv) <= 4.0 for one in rows):
            found = self.learnt(rows)
            self.zero = Zero(self.usual_mv, zero.first_mv, found.speed, found.pulse_mv, found.beat_mv)
            self.known_s = rows[-1].end_s

    def follow(self, zero: Zero, shown: Shown) -> None:
        away, newest = min(self.last[0].level_mv, self.usual_mv) - zero.mv, middle(self.last[-3:]) - zero.mv
        if self.looks_empty and abs(away) <= 16.0:
            self.known_s, self.far_mv = shown.end_s, 0.0
            step = max(-0.25, min(0.25, min(away, newest if newest >= -16.0 else away) / 16.0))
            self.zero = Zero(zero.mv + step, zero.first_mv, zero.speed, zero.pulse_mv, zero.beat_mv)
        elif self.looks_empty:
            self.far_mv = self.away_mv(zero)

    def away_mv(self, zero: Zero) -> float:
        """Of the newest window, where that is too far to follow."""
        away = self.row[-1].level_mv - zero.mv
        return away if abs(away) > 16.0 else 0.0

    def departure(self) -> tuple[float, float] | None:
        """By how much the beat is off what vibration makes, and its margin; None where that cannot be said."""
        if self.zero is None or self.zero.beat_mv is None or len(self.row) < SETTLE:
            return None
        usual = self.zero.beat_mv * (mean([one.speed for one in self.last]) / self.zero.speed) ** 2
        return mean([one.beat_mv for one in self.last]) - usual, max(1.0, 0.25 * usual)

    @property
    def looks_empty(self) -> bool:
        found = self.departure()
        return found is not None and abs(found[0]) <= found[1]

    @property
    def looks_loaded(self) -> bool:
        found = self.departure()
        return found is not None and found[0] > found[1]

    @property
    def below_empty(self) -> bool:
        zero = self.zero
        return zero is not None and len(self.row) >= SETTLE and max(one.level_mv for one in self.last) < zero.mv - 16.0

    @property
    def drifted(self) -> bool:
        if self.zero is None:
            return False
        far_mv = self.away_mv(self.zero) if self.looks_empty else self.far_mv
        return self.suspect or abs(self.zero.mv - self.zero.first_mv) > 32.0 or self.below_empty or far_mv != 0.0

    @property
    def progress(self) -> tuple[int, int]:
        if self.calibrating:
            return min(len(self.row), SETTLE), SETTLE
        return (0, 0) if self.zero is not None else (min(len(self.row), FIRST), FIRST)


LEVELS = st.sampled_from([ZERO_MV] * 4 + [ZERO_MV + away for away in (2.0, 4.0, -4.0, 5.0, -16.0, -18.0, 17.0, 40.0)] + [nan])
WINDOWS = st.builds(
    Shown,
    LEVELS,
    st.sampled_from([4.0, 4.0, 4.0, 5.0, 8.0, 2.0, 24.0]),
    st.sampled_from([2.0, 3.0, 9.0]),
    st.sampled_from([32.0, 32.0, 32.0, 64.0]),
    st.sampled_from([True, True, True, False]),
)
#: Several of one kind in a row, as a machine makes them.
STRETCHES = st.lists(st.tuples(WINDOWS, st.integers(1, 6)).map(lambda one: [one[0]] * one[1]), min_size=1, max_size=3)
WORDS = st.one_of(
    st.tuples(st.just("calibrate"), st.booleans(), st.booleans()),
    st.tuples(st.just("signs"), st.sampled_from(["", "the plate feels 9 N"])),
    st.just(("undo",)),
    st.just(("interrupt",)),
)


@settings(max_examples=200)
@given(st.lists(st.tuples(st.none() | WORDS, STRETCHES), min_size=1, max_size=8))
def test_any_order_of_windows_and_words(steps: list[tuple[tuple[object, ...] | None, list[list[Shown]]]]) -> None:
    tracker, model, now_s = ZeroTracker(SETTINGS), Model(), 100.0
    for word, stretches in steps:
        if word is not None:
            told(tracker, model, *word)
            compare(tracker, model)
        for shown in (one for stretch in stretches for one in stretch):
            now_s += 1.0
            given = {"start_s": now_s - 1.0, "end_s": now_s, "mean_mv": shown.level_mv, "harmonics_mv": (shown.beat_mv,)}
            given |= {"pulse_mv": shown.pulse_mv, "speed_rad_s": shown.speed}
            tracker.see(Window(**PLAIN | given), shown.may_be_empty)  # type: ignore[arg-type]
            model.see(Shown(shown.level_mv, shown.beat_mv, shown.pulse_mv, shown.speed, shown.may_be_empty, now_s))
            compare(tracker, model)


def told(tracker: ZeroTracker, model: Model, what: object, *how: object) -> None:
    if what == "calibrate":
        against, despite = bool(how[0]), bool(how[1])
        assert tracker.calibrate(against_signs=against, despite_signs=despite) is model.calibrate(against, despite)
    elif what == "signs":
        assert tracker.waits_for_grain_to_pass(str(how[0])) is model.signs(str(how[0]))
    elif what == "undo":
        tracker.undo()
        model.undo()
    else:
        tracker.interrupt()
        model.row = []


def compare(tracker: ZeroTracker, model: Model) -> None:
    state, refusal = tracker.state, tracker.refusal
    held = None if state is None else (*(state.vibration_mv or (None,)), state.zero_mv, state.first_zero_mv, state.speed_rad_s)
    zero = model.zero
    assert held == (None if zero is None else (zero.beat_mv, zero.mv, zero.first_mv, zero.speed))
    assert (None if state is None else state.window_pulse_mv) == (None if zero is None else zero.pulse_mv)
    assert (None if tracker.before is None else tracker.before.zero_mv) == (None if model.before is None else model.before.mv)
    found = None
    if refusal is not None:
        found = refusal.waited_s, None if refusal.obstacle else (refusal.pulse_mv, refusal.level_range_mv)
    assert found == (model.refusal if zero is None else None)
    assert (tracker.calibrating, tracker.suspect) == (model.calibrating, model.suspect)
    assert (tracker.known_s, tracker.taken_from_s, tracker.progress) == (model.known_s, model.taken_from_s, model.progress)
    assert (tracker.looks_empty, tracker.looks_loaded) == (model.looks_empty, model.looks_loaded)
    assert (tracker.below_empty, bool(tracker.drift)) == (model.below_empty, model.drifted)
    assert (tracker.far_mv if zero is not None else 0.0) == (model.far_mv if zero is not None else 0.0)
    assert tracker.level_says_nothing == (model.looked_empty if model.calibrating else model.looks_empty)
