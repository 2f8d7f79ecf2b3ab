"""A pulse as the sum of its kernels' impacts."""

from __future__ import annotations

import numpy as np

from yieldmon.physics.numerics import Array
from yieldmon.plant.pulse_table import QUANTILES
from yieldmon.plant.scenario import Kernels

_USUAL_LOAD_KG = 0.5


def strike(
    settings: Kernels, mass_kg: float, impulse_n_s: float, arrivals_s: Array, step_s: float, steps: int, rng: np.random.Generator
) -> Array:
    """Impulse in each step of time, N s (steps,), of kernels that strike independently at times drawn from the pulse's shape.

    Parameters
    ----------
    settings : Kernels
    mass_kg, impulse_n_s : float
        Of the load; the impulse is what all its kernels give in the mean.
    arrivals_s : ndarray
        Times, from the first step's start, at which the shares QUANTILES of the impulse have arrived.
    step_s : float
    steps : int
    rng : numpy.random.Generator

    Returns
    -------
    ndarray
        Kernels that strike before the first or after the last step are counted in that step.
    """
    if not impulse_n_s > 0.0:
        return np.zeros(steps)
    spread = settings.mass_spread_pct / 100.0
    # Packets of kernels, or parts of one, give the variance that is asked for.
    ratio = settings.noise_ratio * (mass_kg / _USUAL_LOAD_KG) ** settings.noise_load_exponent
    packet_kg = 1e-6 * settings.thousand_kernel_weight_g * ratio
    count = rng.poisson(mass_kg / packet_kg)
    time_s = np.interp(rng.random(count), QUANTILES, arrivals_s)
    size = impulse_n_s * packet_kg / mass_kg * np.maximum(1.0 + spread * rng.standard_normal(count), 0.0)
    place = np.clip(np.floor(time_s / step_s).astype(np.intp), 0, steps - 1)
    struck = np.asarray(np.bincount(place, weights=size, minlength=steps), dtype=np.float64)
    contact = round(1e-3 * settings.contact_ms / step_s)
    return _pushing(struck, contact) if contact > 1 else struck


def _pushing(struck: Array, contact: int) -> Array:
    """Impulses spread over the steps of a contact, from the step in which they begin."""
    shape = np.sin(np.pi * (np.arange(contact) + 0.5) / contact)
    spread = np.convolve(struck, shape / shape.sum())
    spread[struck.size - 1] += spread[struck.size :].sum()
    return np.asarray(spread[: struck.size])
