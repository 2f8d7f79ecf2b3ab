"""Times of a log in another unit than seconds, by the sensor's rate."""

from __future__ import annotations

import pytest

from yieldmon.engine.sources import DEFAULT_SOURCES
from yieldmon.errors import InputError
from yieldmon.frames import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from yieldmon.service.logs.time_units import TimeUnitCheck, unit_slip

APART_S = SAMPLE_INTERVAL_S * SAMPLES_PER_FRAME


def times(count: int, factor: float) -> list[float]:
    return [number * APART_S * factor for number in range(count)]


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1e3, "1000 times too far apart, as of milliseconds"),
        (1e6, "1000000 times too far apart, as of microseconds"),
        (1e9, "1000000000 times too far apart, as of nanoseconds"),
        (1e-3, "1000 times too near each other"),
        (1.08e3, "1000 times too far apart"),
        (0.92e3, "1000 times too far apart"),
        (1.12e3, ""),
        (0.88e3, ""),
        (1.0, ""),
        (10.0, ""),
    ],
)
def test_a_unit_is_told_by_its_factor(factor: float, said: str) -> None:
    """A sensor's rate is within a tenth of the mapping's."""
    found = unit_slip(0.004 * factor, 0.004)
    assert (said in found) if said else found == ""


@pytest.mark.parametrize(("factor", "refused"), [(1e3, True), (1e6, True), (1.0, False), (1e-3, False), (50.0, False)])
def test_a_log_in_another_unit_is_refused_by_its_first_hundred_frames(factor: float, refused: bool) -> None:
    """Frames too near each other are no hour of harvest out of a second; they are other checks' business."""
    shown, check = times(100, factor), TimeUnitCheck(DEFAULT_SOURCES)
    check.take("a.log", shown[:60])
    check.take("a.log", shown[60:99])
    assert check.wants
    if refused:
        with pytest.raises(InputError, match=r"a\.log: .* times too far apart"):
            check.take("a.log", shown[99:])
    else:
        check.take("a.log", shown[99:])
        assert not check.wants
