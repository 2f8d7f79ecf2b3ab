"""Results that may be asked for again."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """The results last made, by what they depend on.

    Parameters
    ----------
    most : int
        So many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._found: dict[Hashable, T] = {}

    def of(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result that belongs to a key; made where it is not at hand.

        Parameters
        ----------
        key : hashable
        make : callable

        Returns
        -------
        The result, which whoever asks must not change.
        """
        try:
            # Again the last one.
            found = self._found.pop(key)
        except KeyError:
            found = make()
        self._found[key] = found
        if len(self._found) > self._most:
            # Another thread may have been first.
            self._found.pop(next(iter(self._found)), None)
        return found
