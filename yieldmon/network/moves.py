"""NAMEs that move between addresses, as one node does when it loses its own, and those that two nodes claim in turn."""

from __future__ import annotations

from .name import Name
from .rates import Budget

_MEMORY_S = 5.0
_SHOWN_S = 3.0
_MOST = 254
_ASKS_PER_S, _ASKS_AT_ONCE = 1.0, 5.0


class Moves:
    """Whoever leaves an address is silent there: asked for its claim, only a node that has not moved answers from the old one."""

    def __init__(self) -> None:
        self._left: dict[int, tuple[int, float]] = {}
        self._asks = Budget(_ASKS_PER_S, _ASKS_AT_ONCE)
        self._twice: tuple[Name, float] | None = None

    def claimed(self, name: Name, before: int | None, address: int, now_s: float) -> bool:
        """A NAME that held the address `before` has claimed another one; whether the old one is to be asked for its claim."""
        if before is None or before == address:
            return False
        left, left_s = self._left.get(int(name), (None, float("-inf")))
        if left == address and now_s - left_s < _MEMORY_S:
            self._twice = name, now_s
        if len(self._left) >= _MOST:
            self._left.clear()
        self._left[int(name)] = before, now_s
        return self._asks.take(now_s)

    def claimed_twice(self, now_s: float) -> Name | None:
        """A NAME that two addresses have claimed of late."""
        return self._twice[0] if self._twice is not None and now_s - self._twice[1] < _SHOWN_S else None
