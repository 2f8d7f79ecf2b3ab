"""Smallest size of an effect that a design can detect."""

from __future__ import annotations

import numpy as np

from .candidates import Signature

POWER_80 = 0.84
"""Distance from a limit, in standard deviations, at which 80 % exceed it."""
_LIMIT_SDS = 3.2
"""Two-sided 0.15 %, about 2 % over the library."""


def minimum_detectable(signatures: list[Signature]) -> dict[str, float]:
    """Size of each effect's leading parameter that this design detects with 80 % power at its global level.

    It is extrapolated linearly from each point of the signature, and the result nearest to the typical size is used. Effects
    whose size would be outside the parameter's bounds are omitted.
    """
    sizes = {s.effect: size_seen(s, 0) for s in signatures}
    return {effect: size for effect, size in sizes.items() if np.isfinite(size)}


def size_seen(drawn: Signature, number: int) -> float:
    """Smallest detectable distance of an effect's parameter from its null value; inf if outside its bounds."""
    needed = _LIMIT_SDS + POWER_80
    p = drawn.parameters[number]
    step = np.abs(drawn.points[:, number] - p.start)
    norm = np.linalg.norm(drawn.change, axis=1)
    seen = (step > 0.0) & (norm > 1e-6)
    if not np.any(seen):
        return float("inf")
    sizes = step[seen] * needed / norm[seen]
    typical = max(abs(p.typical - p.start), 1e-300)
    size = float(sizes[np.argmin(np.abs(np.log(sizes / typical)))])
    return size if size <= max(abs(p.upper - p.start), abs(p.lower - p.start)) else float("inf")
