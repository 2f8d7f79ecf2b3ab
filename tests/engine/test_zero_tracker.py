"""Zero calibrations by the operator's word: which of them are suspect, and what an undo brings back."""

from __future__ import annotations

import pytest

from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.sampling.zero import ZeroTracker
from yieldmon.engine.settings import ZeroSettings

SETTINGS = ZeroSettings()
EMPTY_MV, GRAIN_MV = 150.0, 400.0


class Empty:
    """A tracker that knows the zero of an empty machine."""

    def __init__(self) -> None:
        self.tracker = ZeroTracker(SETTINGS)
        self.now_s = 0.0
        self.sees(EMPTY_MV)

    def sees(self, level_mv: float) -> None:
        for _ in range(SETTINGS.settle_windows):
            plain = dict.fromkeys(Window.__dataclass_fields__, 0.0)
            begun_s, self.now_s = self.now_s, self.now_s + 1.0
            given = {"start_s": begun_s, "end_s": self.now_s, "mean_mv": level_mv, "speed_rad_s": 42.0, "harmonics_mv": ()}
            self.tracker.see(Window(**plain | given), True)  # type: ignore[arg-type]

    @property
    def zero_mv(self) -> float | None:
        return None if self.tracker.state is None else self.tracker.state.zero_mv


@pytest.mark.parametrize(
    ("against_signs", "level_mv", "suspect"),
    [
        (True, GRAIN_MV, True),
        (True, EMPTY_MV + SETTINGS.level_range_mv, False),
        (True, EMPTY_MV + SETTINGS.level_range_mv + 0.5, True),
        (False, GRAIN_MV, False),
    ],
)
def test_a_zero_is_suspect_that_was_taken_against_the_signs_and_is_another(
    against_signs: bool, level_mv: float, suspect: bool
) -> None:
    machine = Empty()
    assert machine.tracker.calibrate(against_signs=against_signs) is False
    assert machine.tracker.calibrating
    machine.sees(level_mv)
    assert not machine.tracker.calibrating
    assert (machine.zero_mv, machine.tracker.suspect, bool(machine.tracker.drift)) == (level_mv, suspect, suspect)
    machine.tracker.undo()
    assert (machine.zero_mv, machine.tracker.suspect, machine.tracker.before) == (EMPTY_MV, False, None)


@pytest.mark.parametrize(("first_against_signs", "undone_mv"), [(True, EMPTY_MV), (False, GRAIN_MV)])
def test_a_zero_after_a_suspect_one_is_suspect_and_an_undo_takes_both_back(first_against_signs: bool, undone_mv: float) -> None:
    """What looks empty under a suspect zero need not be."""
    machine = Empty()
    machine.tracker.calibrate(against_signs=first_against_signs)
    machine.sees(GRAIN_MV)
    assert machine.tracker.calibrate(against_signs=False) is first_against_signs
    machine.sees(GRAIN_MV + 20.0)
    assert machine.tracker.suspect is first_against_signs
    machine.tracker.undo()
    assert machine.zero_mv == undone_mv
