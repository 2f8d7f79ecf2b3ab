"""The force of a second in which the flow begins, ends or jumps.

Force grows less than in proportion to flow, so that the mean force of a second in which grain came for half of the time is not
that of half the flow. Its flow is the mean of those that its paddle patterns have, each by its own mean force; it counts with
the force that a steady flow of this size has. What that is depends on how force bends over flow, not on its scale, and hardly on
the crop; it is taken from one set of parameters for a whole run, so that what comes of a load does not depend on those in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.aliasing import ALIAS_FREE_HZ
from yieldmon.engine.settings import EngineSettings
from yieldmon.physics.numerics import Array

_UNEVEN = 0.6
"""Range of the patterns' forces over their mean; paddles that scatter by 16 % reach 0.3."""
_LEAST_PATTERNS = 3
_STEPS = 33
"""Of each of the two searches for the steady force: within a thousandth of the range each."""


def evened(
    readings: Sequence[Reading], estimator: FlowEstimator, settings: EngineSettings, gain_n_per_mv: float
) -> list[Reading]:
    """The readings, those of uneven seconds with the force of a steady flow of the same size.

    Parameters
    ----------
    readings : sequence of Reading
    estimator : FlowEstimator
        Its curve of force over flow is used; its scale hardly matters.
    settings : EngineSettings
    gain_n_per_mv : float
        Of the impact sensor.
    """
    return [
        replace(reading, force_n=_steady_force_n(reading, forces_n, estimator))
        if (forces_n := _uneven_n(reading, settings, gain_n_per_mv)) is not None
        else reading
        for reading in readings
    ]


def _uneven_n(reading: Reading, settings: EngineSettings, gain_n_per_mv: float) -> Array | None:
    """Mean forces of the patterns (n,), not below 0, where they differ so much that it matters."""
    window, zero = reading.window, reading.zero
    if reading.quality is not None or zero is None or len(window.pattern_means_mv) < _LEAST_PATTERNS:
        return None
    mean_n = (sum(window.pattern_means_mv) / len(window.pattern_means_mv) - zero.zero_mv) * gain_n_per_mv
    range_n = (max(window.pattern_means_mv) - min(window.pattern_means_mv)) * gain_n_per_mv
    if not range_n > max(_UNEVEN * mean_n, settings.gate.certain_force_n):
        return None
    whole = window.coverage >= settings.windows.full_coverage and not window.contested
    if window.samples < ALIAS_FREE_HZ * (window.end_s - window.start_s):
        # Single samples of paddle pulses differ in any flow.
        return None
    if not whole or window.saturated_share >= settings.windows.saturated_share:
        return None
    return np.maximum((np.array(window.pattern_means_mv) - zero.zero_mv) * gain_n_per_mv, 0.0)


def _steady_force_n(reading: Reading, forces_n: Array, estimator: FlowEstimator) -> float:
    """forces_n: of the patterns (n,). The reading's own force where one of them has no flow."""

    def flows_kg_s(force_n: Array) -> Array:
        window, like = reading.window, np.ones(force_n.size)
        found = estimator.estimate(
            force_n,
            window.plate_angle_rad * like,
            window.speed_rad_s * like,
            reading.force_std_dev_n * like,
            reading.inputs.fresh["moisture"] * like,
        )
        return np.where(force_n > 0.0, found.mass_flow_kg_s, 0.0)

    of_pattern = flows_kg_s(np.append(forces_n, (forces_n.mean(), reading.force_n)))
    # The window's mean is weighted over its edges: its flow changes by as much as that of the patterns' plain mean does.
    wanted_kg_s = of_pattern[-1] * of_pattern[:-2].mean() / of_pattern[-2] if of_pattern[-2] > 0.0 else np.nan
    low_n, high_n = 0.5 * reading.force_n, max(float(forces_n.max()), reading.force_n)
    for _ in range(2):
        grid_n = np.linspace(low_n, high_n, _STEPS)
        grid_kg_s = flows_kg_s(grid_n)
        if not (np.isfinite(grid_kg_s).all() and grid_kg_s[0] <= wanted_kg_s <= grid_kg_s[-1]):
            return reading.force_n
        above = min(max(int(np.searchsorted(grid_kg_s, wanted_kg_s)), 1), _STEPS - 1)
        low_n, high_n = float(grid_n[above - 1]), float(grid_n[above])
    return 0.5 * (low_n + high_n)
