"""By how much the noise of windows differs beyond chance.

Kernels make the same noise in each second of the same force. A paddle of the chain that is bent, late or missing passes every few
seconds, and what it leaves of the pulses is in some windows only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .spectral_density import Density

_LEAST_WINDOWS = 10
_BEYOND = 2.0
"""Standard deviations of a variance that chance alone may add to it."""


def excess_scatter(windows: Sequence[Density], quiet: Density, sizes: Sequence[float], *, low_hz: float, high_hz: float) -> float:
    """Relative standard deviation of windows' noise beyond chance.

    What is in less than half of the windows raises their mean by at most this: a share p of windows with h more has a mean of p h
    more, and a standard deviation of h sqrt(p (1 - p)).

    Parameters
    ----------
    windows : sequence of Density (w,)
        Of single windows with grain, on the same frequencies.
    quiet : Density
        Of the empty machine.
    sizes : sequence of float (w,)
        What kernels' noise is in proportion to, in each: force times impulse per kilogram.
    low_hz, high_hz : float
        Ends of the band, Hz.

    Returns
    -------
    float
        0 where chance explains the scatter, for fewer than ten windows, and without noise above the empty machine's.
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
    # Of the windows' own: each frequency's density scatters by itself over the root of the averages.
    expected = ground + np.outer(size, (typical - ground) / size.mean())
    chance = float(np.mean(expected**2 @ weight**2 / averages / size**2))
    beyond = float(found.var(ddof=1)) - chance * (1.0 + _BEYOND * float(np.sqrt(2.0 / len(windows))))
    return float(np.sqrt(max(beyond, 0.0))) / mean
