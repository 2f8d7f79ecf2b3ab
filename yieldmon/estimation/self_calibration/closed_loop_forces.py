"""Forces of all windows, of sweeps and of weighed loads, as functions of the closed loop's unknown vector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from yieldmon.estimation.fitting.batch import MomentumBatch
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .closed_loop_inputs import Sweep, WeighedMass

_LEAST_WEIGHED_KG_S = 1e-3
_FOLLOWED = 1e-4
"""Relative size of a Newton step of the flows after which the remaining error is that of rounding."""
_NEWTON_STEPS = 4


@dataclass(frozen=True, slots=True)
class UnknownLayout:
    """Order of the unknown vector: parameters, ln flows, slopes of flows, model errors.

    Attributes
    ----------
    parameters, sweeps, slopes, errors : int
        Number of each; there is one flow for each sweep, and one slope for each or none.
    """

    parameters: int
    sweeps: int
    slopes: int
    errors: int

    @property
    def of_parameters(self) -> slice:
        """Place of the parameters."""
        return slice(0, self.parameters)

    @property
    def of_flows(self) -> slice:
        """Place of the logarithms of the flows."""
        return slice(self.parameters, self.parameters + self.sweeps)

    @property
    def of_slopes(self) -> slice:
        """Place of the flows' slopes."""
        return slice(self.of_flows.stop, self.of_flows.stop + self.slopes)

    @property
    def of_errors(self) -> slice:
        """Place of the model errors."""
        return slice(self.of_slopes.stop, self.of_slopes.stop + self.errors)

    def vector(self, parameters: Array, flows: Array | float, slopes: float, errors: float) -> Array:
        """An unknown vector (u,) from its parts."""
        rest = np.full(self.sweeps, flows), np.full(self.slopes, slopes), np.full(self.errors, errors)
        return np.concatenate((parameters, *rest))


@dataclass(frozen=True, slots=True)
class Forces:
    """Force of the windows (N,), its derivatives with respect to parameters (N, n) and flow (N,), and the flow (N,)."""

    force: Array
    by_theta: Array
    by_load: Array
    load: Array

    @property
    def elastic(self) -> Array:
        """d(force)/d(ln flow) (N,), N."""
        return self.by_load * self.load


@dataclass(frozen=True, slots=True)
class _WeighedFlows:
    """Flows that explain the forces of the weighed loads' windows (w,), their derivatives (w, n), and the parameters there
    (n,)."""

    flow: Array
    by_theta: Array
    theta: Array

    def at(self, theta: Array) -> Array:
        """Approximate flows with other parameters."""
        return np.clip(self.flow + self.by_theta @ (theta - self.theta), 0.5 * self.flow, 2.0 * self.flow)


class ClosedLoopForces:
    """The windows of sweeps and, after them, of weighed loads.

    The flow of a sweep is in the unknown vector; that of a weighed load is whatever explains its forces.

    Attributes
    ----------
    measured : ndarray (N,)
        Forces, N.
    windows : int
        Windows of all sweeps.
    sweep_rows, weighed_rows : list of slice
        Rows of each sweep and of each weighed load.
    clocks : list of ndarray
        Time of each sweep's windows from their mean, s.
    """

    def __init__(
        self,
        model: ForwardModel,
        layout: UnknownLayout,
        names: Sequence[str],
        fixed: Mapping[str, float],
        sweeps: Sequence[Sweep],
        masses: Sequence[WeighedMass],
    ) -> None:
        self._model, self._layout, self._sweeps, self._masses = model, layout, sweeps, masses
        self._rows = MomentumBatch(model, self._conditions(), tuple(names), fixed)
        forces = [s.force_n for s in sweeps] + [a.force_n for a in masses]
        self.measured: Array = np.concatenate(forces) if forces else np.zeros(0)
        self.sweep_rows = _slices([s.force_n.size for s in sweeps])
        self.windows = sum(s.force_n.size for s in sweeps)
        self.weighed_rows = _slices([a.force_n.size for a in masses], self.windows)
        self.clocks = [s.time_s - s.time_s.mean() for s in sweeps]
        self._near = _WeighedFlows(np.zeros(0), np.zeros((0, len(names))), np.zeros(len(names)))
        """Flows of the weighed loads at the last evaluation."""
        self._last: tuple[bytes, Forces] | None = None

    def _conditions(self) -> Conditions:
        parts: tuple[Sweep | WeighedMass, ...] = (*self._sweeps, *self._masses)
        if not parts:
            home = self._model.machine
            return Conditions(home.home_plate_angle_rad, home.nominal_elevator_speed_rad_s, mass_flow_kg_s=np.ones(1))
        needs_moisture = any(p.moisture_pct is not None for p in parts)
        moisture = [np.full(p.force_n.size, np.nan) if p.moisture_pct is None else p.moisture_pct for p in parts]
        return Conditions(
            np.concatenate([p.plate_angle_rad for p in parts]),
            np.concatenate([p.elevator_speed_rad_s for p in parts]),
            mass_flow_kg_s=np.ones(sum(p.force_n.size for p in parts)),
            moisture_pct=np.concatenate(moisture) if needs_moisture else None,
        )

    def start(self, prior: ParameterSet, theta: Array) -> Array:
        """Begin at the prior's parameters, theta (n,): the flow of each sweep (S,) by them, kg/s.

        Raises ValueError if no flow can explain a sweep or a weighed load.
        """
        loop = OpenLoop(self._model, prior)
        flows = np.empty(len(self._sweeps))
        for i, sweep in enumerate(self._sweeps):
            # Large forces determine the flow best; the median over the larger half is robust against a bad window.
            order = np.argsort(sweep.force_n)[-max(1, sweep.force_n.size // 2) :]
            moisture = None if sweep.moisture_pct is None else sweep.moisture_pct[order]
            each = loop.invert(sweep.force_n[order], sweep.plate_angle_rad[order], sweep.elevator_speed_rad_s[order], moisture)
            each = each[np.isfinite(each) & (each > 0.0)]
            if not each.size:
                raise ValueError("no flow below a full paddle explains a sweep with the prior's parameters")
            flows[i] = np.median(each)
        of_masses = [loop.invert(a.force_n, a.plate_angle_rad, a.elevator_speed_rad_s, a.moisture_pct) for a in self._masses]
        weighed = np.concatenate(of_masses) if of_masses else np.zeros(0)
        if not np.all(np.isfinite(weighed)):
            raise ValueError("a weighed load holds more force than a full paddle gives with the prior's parameters")
        self._near = _WeighedFlows(np.maximum(weighed, _LEAST_WEIGHED_KG_S), np.zeros((weighed.size, theta.size)), theta)
        return flows

    def at(self, unknown: Array) -> Forces:
        """Forces with an unknown vector (u,). Flows of the weighed loads are updated so that they explain their forces."""
        place = unknown.tobytes()
        if self._last is not None and self._last[0] == place:
            return self._last[1]
        if not self._sweeps and not self._masses:
            return Forces(np.zeros(0), np.zeros((0, self._layout.parameters)), np.zeros(0), np.ones(1))
        theta, rows, passes = unknown[self._layout.of_parameters], slice(self.windows, None), self._rows.passes_per_s
        for _ in range(_NEWTON_STEPS):
            load = np.concatenate([*self._sweep_flows(unknown), self._near.at(theta)])
            value, jacobian, by_load = self._rows.at_load(theta, load)
            found = Forces(value * passes, jacobian * passes[:, None], by_load * passes, load)
            if not self._masses:
                break
            change = (self.measured[rows] - found.force[rows]) / found.by_load[rows]
            if not np.all(np.isfinite(change)):
                # More than a full paddle: the flows cannot be updated.
                return found
            flow = np.clip(load[rows] + change, 0.5 * load[rows], 2.0 * load[rows])
            self._near = _WeighedFlows(flow, -found.by_theta[rows] / found.by_load[rows, None], theta)
            if np.max(np.abs(change)) <= _FOLLOWED * np.mean(flow):
                break
        self._last = place, found
        return found

    def _sweep_flows(self, unknown: Array) -> list[Array]:
        level, slope = unknown[self._layout.of_flows], unknown[self._layout.of_slopes]
        return [
            np.exp(level[i] + (slope[i] * clock if slope.size else 0.0)) * np.ones(clock.size)
            for i, clock in enumerate(self.clocks)
        ]


def _slices(sizes: Sequence[int], first: int = 0) -> list[slice]:
    ends = first + np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]
