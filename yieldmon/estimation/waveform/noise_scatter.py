"""Scatter of the noise between windows beyond chance.

Kernels cause the same noise in each second with the same force. A paddle that is bent, late or missing passes every few seconds,
and the residual of its pulse is in some windows only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .spectral_density import Density

_LEAST_WINDOWS = 10
_BEYOND = 2.0
"""Excess of a variance, in its standard deviations, that is attributed to chance."""


def excess_scatter(windows: Sequence[Density], quiet: Density, sizes: Sequence[float], *, low_hz: float, high_hz: float) -> float:
    """Relative standard deviation of windows' noise beyond chance.

    It is an upper limit of the error that a disturbance in less than half of the windows causes in their mean: if a share p of
    the windows has h more noise, the mean increases by p h, and the standard deviation is h sqrt(p (1 - p)).

    Parameters
    ----------
    windows : sequence of Density (w,)
        Densities of single windows with grain, on the same frequencies.
    quiet : Density
        Density of the empty machine.
    sizes : sequence of float (w,)
        Expected relative size of each window's kernel noise: force times impulse per kilogram.
    low_hz, high_hz : float
        Ends of the band, Hz.

    Returns
    -------
    float
        0 if chance explains the scatter, for fewer than ten windows, or without noise above the empty machine's.
    """
    band = (quiet.frequency_hz >= low_hz) & (quiet.frequency_hz <= high_hz)
    if len(windows) < _LEAST_WINDOWS or not band.any():
        return 0.0
    shown, ground = np.array([window.density for window in windows])[:, band], quiet.density[band]
    size, averages = np.asarray(sizes, dtype=float), np.array([window.averages for window in windows])
    typical = np.mean(shown, axis=0)
    weight = np.maximum(typical - ground, 0.0) / typical**2
    found = (shown - ground) @ weight / size
    mean = float(found.mean())
    if not mean > 0.0:
        return 0.0
    # Each frequency's density scatters independently, with a relative standard deviation of 1 / sqrt(averages).
    expected = ground + np.outer(size, (typical - ground) / size.mean())
    chance = float(np.mean(expected**2 @ weight**2 / averages / size**2))
    beyond = float(found.var(ddof=1)) - chance * (1.0 + _BEYOND * float(np.sqrt(2.0 / len(windows))))
    return float(np.sqrt(max(beyond, 0.0))) / mean
