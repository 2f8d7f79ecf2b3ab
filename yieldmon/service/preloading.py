"""Modules that measuring calls for the first time long after the start, such as at the end of the first sweep."""

from __future__ import annotations

import importlib

_CALLED_LATER = ("scipy.special", "scipy.linalg")


def preload() -> None:
    """Import them: an import keeps the engine's thread for seconds where disk or processor is slow, and windows come late."""
    for name in _CALLED_LATER:
        importlib.import_module(name)
