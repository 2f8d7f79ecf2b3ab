"""Names that come more than once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable


def repeated(names: Iterable[str]) -> list[str]:
    """Those that come more than once, each once, in the order in which they first come."""
    return [name for name, count in Counter(names).items() if count > 1]
