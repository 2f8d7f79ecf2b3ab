"""Whether a signal, as it is mapped, can give any value that is of use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.databases import SignalBits
from yieldmon.physics.numerics import Array
from yieldmon.signals.extraction import Extraction

_EVERY = 1 << 16
"""Raw values that are looked at one by one."""
_LOOKS = 4096
_POWERS = [1 << power for power in range(63)]


def values_in_reach(extraction: Extraction) -> Array:
    """Values that a signal can give.

    Parameters
    ----------
    extraction : Extraction

    Returns
    -------
    ndarray
        (n,), all of them for a signal of up to 16 bits. Of a wider one those spread over its range, and near its ends and its 0;
        of a floating-point number those spread over the mapping's range. Values that are none are left out.
    """
    if extraction.bits.kind == "float":
        return _of_float(extraction)
    found = extraction.of_raws(_raws(extraction.bits, extraction))
    kept: Array = found[np.isfinite(found)]
    return kept


def reaches(extraction: Extraction, usable: Callable[[Any], Any]) -> bool:
    """Whether a signal can give a value that is usable.

    Parameters
    ----------
    extraction : Extraction
    usable : callable
        From values (n,) to whether each is.

    Returns
    -------
    bool
    """
    return bool(np.any(usable(values_in_reach(extraction))))


def without_range(extraction: Extraction) -> Extraction:
    """The signal as if the mapping gave no range."""
    return replace(extraction, low=-inf, high=inf)


def _of_float(extraction: Extraction) -> Array:
    low, high = (end if isfinite(end) else side for end, side in ((extraction.low, -1e9), (extraction.high, 1e9)))
    powers = np.geomspace(1e-6, 1e9, _LOOKS)
    spread = np.concatenate([np.linspace(low, high, _LOOKS), -powers, [0.0], powers])
    found: Array = spread[(spread >= low) & (spread <= high)]
    return found


def _raws(bits: SignalBits, extraction: Extraction) -> NDArray[np.int64]:
    first, last = (-(1 << bits.bits - 1), (1 << bits.bits - 1) - 1) if bits.kind == "int" else (0, (1 << bits.bits) - 1)
    last = min(last, (1 << 63) - 1)
    if last - first < _EVERY:
        return np.arange(first, last + 1)
    zero_at = -extraction.offset / extraction.scale if extraction.scale else inf
    zero = round(zero_at) if isfinite(zero_at) else first
    step = (last - first) // _LOOKS
    near = [place + sign * power for place in (first, zero, last) for power in (0, *_POWERS) for sign in (1, -1)]
    return np.array(sorted({raw for raw in (*near, *range(first, last + 1, step)) if first <= raw <= last}), np.int64)
