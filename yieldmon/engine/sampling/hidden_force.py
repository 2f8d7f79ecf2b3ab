"""The part of the mean force that is lost in samples at the end of the sensor's range."""

from __future__ import annotations

_MOST = 1.0
"""Largest result: little is known of pulses that are clipped for more than half of their duration."""


def hidden_share(mean_mv: float, limit_mv: float, share: float) -> float:
    """Force beyond the end of the range, over the measured one, by pulses that rise and fall in straight lines.

    Parameters
    ----------
    mean_mv, limit_mv : float
        Mean of the samples and end of the range, above the zero-load voltage.
    share : float
        Of the samples at the end of the range.

    Returns
    -------
    float
        0 where no sample is there.
    """
    if not (share > 0.0 and mean_mv > 0.0 and limit_mv > 0.0):
        return 0.0
    # A trapezium's mean is limit (duty + share) / 2; the triangle above it is (share / duty)^2 of the whole one.
    duty = 2.0 * mean_mv / limit_mv - share
    if duty <= share:
        return _MOST
    lost = (share / duty) ** 2
    return min(lost / (1.0 - lost), _MOST)
