"""Scatter of the momentum from paddle to paddle, estimated from the windows."""

from __future__ import annotations

from yieldmon.engine.settings import WindowSettings

_LARGEST_RATIO = 4.0
"""A window's squared scatter is limited to this ratio to the current estimate."""


class PaddleScatter:
    """Squared relative standard deviation of one paddle's momentum, estimated over the windows.

    It starts at the prior with the prior's weight; older windows count less, so that a change of crop or chain is followed.
    """

    def __init__(self, settings: WindowSettings) -> None:
        self._settings = settings
        self._sum = settings.scatter_prior_patterns * settings.paddle_scatter**2
        self.patterns = settings.scatter_prior_patterns
        """Weight of the estimate, in paddle patterns."""

    @property
    def square(self) -> float:
        """Current estimate."""
        return self._sum / self.patterns if self.patterns > 0.0 else self._settings.paddle_scatter**2

    def see(self, square: float, patterns: float) -> None:
        """Update with the squared scatter of a window, from so many paddle patterns."""
        # Limited, because a step of the flow inside the window is no scatter.
        taken = min(square, _LARGEST_RATIO * self.square)
        kept = 1.0 - patterns / self._settings.scatter_memory_patterns
        self._sum = kept * self._sum + patterns * taken
        self.patterns = kept * self.patterns + patterns
