"""pyarrow without pandas: it imports that, where it is installed, with the first list that it is given."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import ModuleType

_PANDAS = "pandas"


class _Hidden(MetaPathFinder):
    """Finds no pandas."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /) -> None:
        if fullname == _PANDAS:
            raise ModuleNotFoundError(f"No module named {_PANDAS!r}", name=_PANDAS)


def without_pandas() -> None:
    """Let pyarrow find no pandas in this process, which saves its import; nothing where pandas has been imported already."""
    import pyarrow

    if _PANDAS in sys.modules:
        return
    hidden = _Hidden()
    sys.meta_path.insert(0, hidden)
    try:
        # It looks once, and remembers.
        pyarrow.array([0])
    finally:
        sys.meta_path.remove(hidden)
