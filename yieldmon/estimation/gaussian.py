"""Figures of the normal distribution."""

from __future__ import annotations

REACH_95 = 1.96
"""Half of a 95 % interval, in standard deviations."""
SD_PER_MAD = 1.4826
"""Standard deviation over the median of absolute deviations."""
