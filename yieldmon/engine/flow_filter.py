"""Mass flow from one window to the next: steady, changing steadily, or jumping.

One window holds a dozen paddles, and each paddle's pulse scatters by several per cent, so that a window alone is good to 3 % at
best. Grain flow itself mostly changes slowly. The filter weighs three descriptions of it against each other, window by window, by
how well each foresaw the measurement (interacting multiple models: Blom and Bar-Shalom, IEEE Trans. Autom. Control 33 (1988)
780), and so averages over several seconds while the flow is steady and follows at once when it is not. It works in the logarithm
of the flow, in which scatter and changes are shares. Totals do not pass through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, log, sqrt
from typing import NamedTuple

_LARGEST_FLOW_KG_S = 1e6
"""Beyond any machine; what is above is handed on as it came."""

_Vector = tuple[float, float]
_Matrix = tuple[float, float, float]
"""Symmetric 2 x 2: (level, level), (level, trend), (trend, trend)."""


@dataclass(frozen=True, slots=True)
class FlowFilterSettings:
    """Rates are shares of the flow per window."""

    enabled: bool = True
    steady_walk: float = 0.008
    """Standard deviation of the change from window to window while the flow is steady."""
    trend_change: float = 0.006
    """The same of the change of the trend while the flow rises or falls steadily."""
    jump: float = 0.25
    """Standard deviation of a jump."""
    stay: float = 0.95
    """Probability that the flow goes on as it was from one window to the next."""
    min_flow_kg_s: float = 0.3
    """Below this a window stands for itself."""


@dataclass(frozen=True, slots=True)
class _Model:
    keeps_trend: float
    level_noise: float
    trend_noise: float


class _State(NamedTuple):
    mean: _Vector
    spread: _Matrix
    weight: float


class FlowFilter:
    """Holds what is known of the flow after each window; `reset` forgets it."""

    def __init__(self, settings: FlowFilterSettings) -> None:
        self._settings = settings
        self._models = (
            _Model(0.5, settings.steady_walk**2, 0.02**2),
            _Model(1.0, settings.steady_walk**2, settings.trend_change**2),
            _Model(0.5, settings.jump**2, settings.jump**2 / 4.0),
        )
        self._states: tuple[_State, ...] = ()

    def reset(self) -> None:
        """Begin anew with the next window."""
        self._states = ()

    def update(self, flow_kg_s: float, noise_std_dev_kg_s: float, lead_windows: float = 0.0) -> tuple[float, float]:
        """Take a window's flow and the standard deviation of its noise, kg/s; returns both as the filter sees them.

        lead_windows: how far the middle of the measurement lies before the middle of the second that it is published for, in
        windows; the trend carries the flow over it. A flow that is unknown, below the filter's range or without a usable
        standard deviation comes back as it is and resets the filter.
        """
        usable = flow_kg_s <= _LARGEST_FLOW_KG_S and isfinite(noise_std_dev_kg_s) and noise_std_dev_kg_s > 0.0
        if not usable or not self._settings.enabled or flow_kg_s < self._settings.min_flow_kg_s:
            self.reset()
            return flow_kg_s, noise_std_dev_kg_s
        seen = log(flow_kg_s)
        noise = (noise_std_dev_kg_s / flow_kg_s) ** 2
        if not self._states:
            share = 1.0 / len(self._models)
            self._states = tuple(_State((seen, 0.0), (noise, 0.0, 0.15**2), share) for _ in self._models)
            return flow_kg_s, noise_std_dev_kg_s
        self._states = _step(self._states, self._models, self._settings.stay, seen, noise)
        levels = [s.mean[0] + lead_windows * s.mean[1] for s in self._states]
        level = _sum([s.weight * each for s, each in zip(self._states, levels, strict=True)])
        variance = _sum(
            [
                s.weight * (s.spread[0] + lead_windows * (2.0 * s.spread[1] + lead_windows * s.spread[2]) + (each - level) ** 2)
                for s, each in zip(self._states, levels, strict=True)
            ]
        )
        flow = exp(level)
        return flow, flow * sqrt(variance)


def _step(states: tuple[_State, ...], models: tuple[_Model, ...], stay: float, seen: float, noise: float) -> tuple[_State, ...]:
    count = len(states)
    move = (1.0 - stay) / (count - 1)
    updated, weights = [], []
    for j, model in enumerate(models):
        reach = [(stay if i == j else move) * state.weight for i, state in enumerate(states)]
        total = _sum(reach)
        mean, spread = _mixture(states, [r / total for r in reach])
        (level, trend), (a, b, c) = _predict(mean, spread, model)
        innovation, variance = seen - level, a + noise
        gain, trend_gain = a / variance, b / variance
        updated.append(
            ((level + gain * innovation, trend + trend_gain * innovation), (a - gain * a, b - gain * b, c - trend_gain * b))
        )
        weights.append(log(total) - 0.5 * innovation * innovation / variance - 0.5 * log(variance))
    top = max(weights)
    # Kept above zero so that a description that has long been wrong can come back.
    shares = [max(exp(w - top), 1e-12) for w in weights]
    whole = _sum(shares)
    return tuple([_State(mean, spread, share / whole) for (mean, spread), share in zip(updated, shares, strict=True)])


def _mixture(states: tuple[_State, ...], shares: list[float]) -> tuple[_Vector, _Matrix]:
    level = trend = a = b = c = 0.0
    for w, (mean, _, _) in zip(shares, states, strict=True):
        level += w * mean[0]
        trend += w * mean[1]
    for w, (mean, spread, _) in zip(shares, states, strict=True):
        dl, dt = mean[0] - level, mean[1] - trend
        a += w * (spread[0] + dl * dl)
        b += w * (spread[1] + dl * dt)
        c += w * (spread[2] + dt * dt)
    return (level, trend), (a, b, c)


def _predict(mean: _Vector, spread: _Matrix, model: _Model) -> tuple[_Vector, _Matrix]:
    f = model.keeps_trend
    if f < 1.0:
        level, a, b = mean[0], spread[0], f * spread[1]
    else:
        level = mean[0] + mean[1]
        a = spread[0] + 2.0 * spread[1] + spread[2]
        b = spread[1] + spread[2]
    return (level, f * mean[1]), (a + model.level_noise, b, f * f * spread[2] + model.trend_noise)


def _sum(values: list[float]) -> float:
    """From left to right: the built-in one rounds otherwise from Python 3.12 on."""
    total = 0.0
    for value in values:
        total += value
    return total
