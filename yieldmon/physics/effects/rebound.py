"""The part of the impact's gain that rebound makes, for effects that act on rebound alone."""

from __future__ import annotations

from yieldmon.physics.numerics import AnyArray
from yieldmon.physics.stages import Impulse, Setting

NOMINAL_RESTITUTION = 0.6
"""Typical restitution of grain on steel, where exchange coefficients hide how much of the gain is rebound."""


def scale_restitution(impulse: Impulse, factor: AnyArray, setting: Setting) -> AnyArray:
    """Normal gain after restitution is multiplied by `factor`.

    1 + e f in the restitution form; with exchange coefficients g the same proportion of a nominal 1 + e: g (1 + e f) / (1 + e).
    """
    gain = impulse.normal_gain
    if setting.restitution is not None:
        return gain + (gain - 1.0) * (factor - 1.0)
    return gain * (1.0 + NOMINAL_RESTITUTION / (1.0 + NOMINAL_RESTITUTION) * (factor - 1.0))


def restitution(impulse: Impulse, setting: Setting) -> AnyArray:
    """Restitution in effect: the gain less 1, or the nominal one where exchange coefficients hide it."""
    if setting.restitution is not None:
        return impulse.normal_gain - 1.0
    return 0.0 * impulse.normal_gain + NOMINAL_RESTITUTION
