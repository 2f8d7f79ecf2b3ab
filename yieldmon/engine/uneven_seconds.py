"""The force of a second in which the flow begins, ends or jumps.

Force grows less than proportionally with flow, so the mean force of a second in which grain came for half of the time is not the
force of half the flow. The flow of such a second is the mean of the flows of its paddle patterns, each by its own mean force; the
second counts with the force that a steady flow of that size has. That force depends on the curvature of force over flow, not on
its scale, and hardly on the crop. The curve is taken from one set of parameters for a whole run, so that the mass of a load does
not depend on the parameters in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import exp, log

import numpy as np

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.aliasing import ALIAS_FREE_HZ
from yieldmon.engine.settings import EngineSettings
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

_UNEVEN = 0.6
"""Least range of the patterns' forces, relative to their mean; paddles that scatter by 16 % reach 0.3."""
_LEAST_PATTERNS = 3
_SPEED_STEP = 0.05
"""Step of ln(speed) between two curves."""


class UnevenSeconds:
    """Finds uneven seconds, and replaces their force by that of a steady flow of the same size.

    Parameters
    ----------
    settings : EngineSettings
    machine : Machine
    estimator : FlowEstimator
        Its curve of force over flow is used, at the plate's home angle; its scale hardly matters.
    """

    def __init__(self, settings: EngineSettings, machine: Machine, estimator: FlowEstimator) -> None:
        self._settings = settings
        self._machine = machine
        self._estimator = estimator
        self._curves: dict[int, tuple[Array, Array]] = {}
        """Force, N, and flow, kg/s, both rising from 0, by the number of speed steps from the nominal speed; each computed when
        first needed, at the moisture measured then."""

    def evened(self, readings: Sequence[Reading]) -> list[Reading]:
        """The readings, those of uneven seconds with the force of a steady flow of the same size."""
        return [
            reading
            if (forces_n := self._uneven_n(reading)) is None
            else replace(reading, force_n=self._steady_force_n(reading, forces_n))
            for reading in readings
        ]

    def _uneven_n(self, reading: Reading) -> Array | None:
        """Mean forces of the patterns (n,), N, not below 0; None where the second is not uneven."""
        window, zero, settings = reading.window, reading.zero, self._settings
        if reading.quality is not None or zero is None or len(window.pattern_means_mv) < _LEAST_PATTERNS:
            return None
        gain_n_per_mv = self._machine.sensor.gain_n_per_mv
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

    def _steady_force_n(self, reading: Reading, forces_n: Array) -> float:
        """Force of a steady flow of the second's size, N; the reading's own force where a pattern has no flow. forces_n: mean
        forces of the patterns (n,)."""
        step = round(log(reading.window.speed_rad_s / self._machine.nominal_elevator_speed_rad_s) / _SPEED_STEP)
        speed_rad_s = self._machine.nominal_elevator_speed_rad_s * exp(_SPEED_STEP * step)
        if step not in self._curves:
            found = self._curve(speed_rad_s, reading.inputs.fresh["moisture"])
            if found[0].size == 1:
                # Not kept: with a known moisture there may be a curve later.
                return reading.force_n
            self._curves[step] = found
        curve_n, curve_kg_s = self._curves[step]
        # Over so small a change of speed, force at a given paddle load grows with the square of speed.
        to_step = (speed_rad_s / reading.window.speed_rad_s) ** 2
        mean_n = forces_n.mean()
        if not (max(forces_n.max(), reading.force_n) * to_step < curve_n[-1] and mean_n > 0.0 and reading.force_n > 0.0):
            return reading.force_n
        of_pattern = np.interp(np.append(forces_n, (mean_n, reading.force_n)) * to_step, curve_n, curve_kg_s)
        # The window's mean is weighted at its edges: its flow is changed by the same factor as that of the patterns' plain mean.
        wanted_kg_s = of_pattern[-1] * of_pattern[:-2].mean() / of_pattern[-2]
        return float(np.interp(wanted_kg_s, curve_kg_s, curve_n)) / to_step

    def _curve(self, speed_rad_s: float, moisture_pct: float) -> tuple[Array, Array]:
        """Force, N, and flow, kg/s, from 0 up to a full paddle; 0 alone where flow does not rise with force."""
        force_n, flow_kg_s = self._estimator.force_curve(self._machine.home_plate_angle_rad, speed_rad_s, moisture_pct)
        rises = (np.diff(force_n, prepend=0.0) > 0.0) & (np.diff(flow_kg_s, prepend=0.0) > 0.0)
        rises = np.append(rises, False)
        # Some curves give no flow below a force.
        first = int(np.argmax(rises))
        last = first + int(np.argmin(rises[first:]))
        return np.append(0.0, force_n[first:last]), np.append(0.0, flow_kg_s[first:last])
