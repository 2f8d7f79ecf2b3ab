"""Figures of the normal distribution."""

from __future__ import annotations

REACH_90 = 1.645
"""Half of a 90 % interval, in standard deviations; 5 % lie beyond it on one side."""
REACH_95 = 1.96
"""Half of a 95 % interval, in standard deviations."""
SD_PER_MAD = 1.4826
"""Standard deviation over the median of absolute deviations."""
