"""Whether flow and elevator speed at home are steady enough for a sweep to begin."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweeps.sweep_inputs import SweepWindow


class SteadyHome:
    """The newest successive windows at home.

    Parameters
    ----------
    settings : SweepSettings
        How many windows, and how steady they are to be.
    """

    def __init__(self, settings: SweepSettings) -> None:
        self._settings = settings
        self._flows_kg_s: deque[float] = deque(maxlen=settings.steady_windows)
        self._speeds_rad_s: deque[float] = deque(maxlen=settings.steady_windows)

    def add(self, window: SweepWindow) -> None:
        """A window at home with a flow."""
        self._flows_kg_s.append(window.flow_kg_s)
        self._speeds_rad_s.append(window.speed_rad_s)

    def clear(self) -> None:
        """Forget them: a window did not qualify."""
        self._flows_kg_s.clear()
        self._speeds_rad_s.clear()

    @property
    def steady(self) -> bool:
        """Whether there are enough of them, with enough flow and little scatter."""
        settings = self._settings
        return (
            len(self._flows_kg_s) == settings.steady_windows
            and _is_steady(self._flows_kg_s, settings.min_flow_kg_s, settings.steady_cv)
            and _is_steady(self._speeds_rad_s, 0.0, 0.5 * settings.speed_change)
        )

    @property
    def means(self) -> tuple[float, float]:
        """Mean flow, kg/s, and mean elevator speed, rad/s; of one window or more."""
        return sum(self._flows_kg_s) / len(self._flows_kg_s), sum(self._speeds_rad_s) / len(self._speeds_rad_s)


def _is_steady(values: Sequence[float], least: float, limit_cv: float) -> bool:
    """Whether the mean is at least `least` and above 0, and the standard deviation over it at most limit_cv."""
    mean = sum(values) / len(values)
    if not mean > 0.0 or mean < least:
        return False
    return spread(values) <= limit_cv * mean


def spread(values: Sequence[float]) -> float:
    """Standard deviation, 0 for fewer than two values."""
    if len(values) < 2:
        return 0.0
    mean = sum(values) / len(values)
    return float((sum((value - mean) ** 2 for value in values) / (len(values) - 1)) ** 0.5)
