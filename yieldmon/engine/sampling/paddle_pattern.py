"""The last windows with the plate at home, and what keeps step with the paddles in them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from yieldmon.engine.sampling.windows import Window, coherent_amplitudes
from yieldmon.engine.settings import ZeroSettings


@dataclass(frozen=True, slots=True)
class Departure:
    """Whether any harmonic of the pattern is above vibration, and whether any is above or below it."""

    above: bool
    either: bool


class RecentWindows:
    """The newest successive windows, as many as `ZeroSettings.settle_windows`."""

    def __init__(self, settings: ZeroSettings) -> None:
        self._settings = settings
        self._windows: deque[Window] = deque(maxlen=settings.settle_windows)
        self._pattern: tuple[tuple[float, ...], float] | None = None
        """Amplitudes of the windows' harmonics, mV, and their speed, rad/s."""
        self._compared: tuple[tuple[float, ...], float, Departure] | None = None
        """Vibration and speed that the pattern was last compared with, and the result."""

    def __len__(self) -> int:
        return len(self._windows)

    @property
    def all(self) -> list[Window]:
        """From the oldest to the newest."""
        return list(self._windows)

    @property
    def newest(self) -> Window:
        """The newest; there is one."""
        return self._windows[-1]

    @property
    def full(self) -> bool:
        """Whether there are as many as are kept."""
        return len(self._windows) == self._settings.settle_windows

    def add(self, window: Window) -> None:
        """A further window."""
        self._windows.append(window)
        self._pattern = self._compared = None

    def clear(self) -> None:
        """Discard them."""
        self._windows.clear()
        self._pattern = self._compared = None

    def departure(self, vibration_mv: tuple[float, ...], speed_rad_s: float) -> Departure:
        """How the harmonics of the windows together, one or more, depart from those of vibration at a speed."""
        compared = self._compared
        if compared is None or compared[0] is not vibration_mv or compared[1] != speed_rad_s:
            compared = self._compared = (vibration_mv, speed_rad_s, self._departure(vibration_mv, speed_rad_s))
        return compared[2]

    def _departure(self, vibration_mv: tuple[float, ...], speed_rad_s: float) -> Departure:
        if self._pattern is None:
            self._pattern = coherent_amplitudes(self._windows), mean_speed(self._windows)
        amplitudes, speed = self._pattern
        factor = speed_factor(speed, speed_rad_s)
        lower = False
        for amplitude, known in zip(amplitudes, vibration_mv, strict=False):
            usual = known * factor
            margin = max(self._settings.pulse_margin_mv, self._settings.pulse_margin * usual)
            if amplitude - usual > margin:
                return Departure(above=True, either=True)
            lower = lower or usual - amplitude > margin
        return Departure(above=False, either=lower)


def pulse_mv(windows: Sequence[Window]) -> float:
    """Amplitude of what keeps step with the paddles, over all harmonics of the pattern."""
    power = sum(amplitude**2 for amplitude in coherent_amplitudes(windows))
    return float(power**0.5)


def mean_level(windows: Sequence[Window]) -> float:
    """Mean of the levels, mV."""
    return sum(window.mean_mv for window in windows) / len(windows)


def middle_level(windows: Sequence[Window]) -> float:
    """Median of the levels, mV: the last grain after a stop, and a trickle that has just begun, do not raise it."""
    return median([window.mean_mv for window in windows])


def mean_speed(windows: Sequence[Window] | deque[Window]) -> float:
    """Mean elevator speed, rad/s."""
    return sum([window.speed_rad_s for window in windows]) / len(windows)


def speed_factor(speed_rad_s: float, measured_at_rad_s: float) -> float:
    """Growth of vibration from one speed to another: unbalance grows with the square of the speed."""
    return (speed_rad_s / measured_at_rad_s) ** 2 if measured_at_rad_s > 0.0 else 1.0
