"""How far the momentum of one paddle's grain differs from that of the next, estimated from the windows."""

from __future__ import annotations

from yieldmon.engine.settings import WindowSettings

_LARGEST_RATIO = 4.0
"""A window's squared scatter counts for no more than this times what is known."""


class PaddleScatter:
    """Squared relative standard deviation of one paddle's momentum, estimated over the windows.

    It begins at the prior with the prior's weight; older windows count less, so that another crop or chain is followed.
    """

    def __init__(self, settings: WindowSettings) -> None:
        self._settings = settings
        self._sum = settings.scatter_prior_patterns * settings.paddle_scatter**2
        self.patterns = settings.scatter_prior_patterns
        """Weight of what is known, in paddle patterns."""

    @property
    def square(self) -> float:
        """As known now."""
        return self._sum / self.patterns if self.patterns > 0.0 else self._settings.paddle_scatter**2

    def see(self, square: float, patterns: float) -> None:
        """A window's own, from so many paddle patterns."""
        # A step of the flow inside the window is no scatter.
        taken = min(square, _LARGEST_RATIO * self.square)
        kept = 1.0 - patterns / self._settings.scatter_memory_patterns
        self._sum = kept * self._sum + patterns * taken
        self.patterns = kept * self.patterns + patterns
