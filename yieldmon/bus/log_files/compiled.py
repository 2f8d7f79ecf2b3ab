"""numba's compiler (the fast extra) as the modules named compiled_* use it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """njit that keeps its code on disk where there is a place for it."""
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba's word for "no folder to keep it in"
        return njit(nogil=True)(function)
