"""Places as receivers send them."""

from __future__ import annotations

from typing import Any

_ON_THE_POINT_DEG = 1e-6


def is_somewhere(latitude_deg: Any, longitude_deg: Any) -> Any:
    """Whether a place (floats or arrays) is other than latitude and longitude 0, which receivers without a fix send.

    >>> is_somewhere(0.0, 36.8), is_somewhere(0.0, 0.0)
    (True, False)
    """
    return (abs(latitude_deg) > _ON_THE_POINT_DEG) | (abs(longitude_deg) > _ON_THE_POINT_DEG)
