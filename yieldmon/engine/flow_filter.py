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

from yieldmon.setting_keys import choice, quantity

# A jump is over within some seconds, and a steady flow is left more often than a trend, whose slope is worth keeping.
_STEADY = (0.85, 0.03, 0.12)
_JUMP = (0.20, 0.01, 0.79)
"""Probabilities of steady, trend and jump in the next window."""
_TREND_TO_JUMP = 0.9
"""Share of the trends that end in a jump."""
_LARGEST_FLOW_KG_S = 1e6
"""Beyond any machine; what is above is handed on as it came."""

_Vector = tuple[float, float]
_Matrix = tuple[float, float, float]
"""Symmetric 2 x 2: (level, level), (level, trend), (trend, trend)."""


@dataclass(frozen=True, slots=True)
class FlowFilterSettings:
    """Smoothing of the published flow; totals are not smoothed.

    Rates are shares of the flow per window.
    """

    enabled: bool = choice(True, "false: no smoothing")
    steady_walk: float = quantity(0.008, 1e-6, 1.0, "1/s", "relative change of a steady flow from second to second")
    trend_change: float = quantity(0.002, 1e-6, 1.0, "1/s", "the same for the trend of a rising or falling flow")
    jump: float = quantity(0.18, 1e-3, 10.0, "1", "relative standard deviation of a jump")
    stay: float = quantity(0.95, 0.34, 0.9999, "1", "probability that a flow keeps rising or falling")
    min_flow_kg_s: float = quantity(0.3, 0.01, 25.0, "kg/s", "no smoothing below this")


@dataclass(frozen=True, slots=True)
class _Model:
    keeps_trend: float
    level_noise: float
    trend_noise: float


_State = tuple[_Vector, _Matrix, float]
"""Mean and spread by one description, and its weight."""
_States = tuple[_State, _State, _State]


class FlowFilter:
    """Holds what is known of the flow after each window; `reset` forgets it."""

    def __init__(self, settings: FlowFilterSettings) -> None:
        self._settings = settings
        self._models = (
            _Model(0.5, settings.steady_walk**2, 0.02**2),
            _Model(1.0, settings.steady_walk**2, settings.trend_change**2),
            _Model(0.5, settings.jump**2, settings.jump**2 / 16.0),
        )
        self._states: _States | None = None

    def reset(self) -> None:
        """Begin anew with the next window."""
        self._states = None

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
        if self._states is None:
            first = (seen, 0.0), (noise, 0.0, 0.15**2), 1.0 / 3.0
            self._states = first, first, first
            return flow_kg_s, noise_std_dev_kg_s
        self._states = _step(self._states, self._models, self._settings.stay, seen, noise)
        level = variance = 0.0
        for (middle, trend), _, weight in self._states:
            level += weight * (middle + lead_windows * trend)
        for (middle, trend), (a, b, c), weight in self._states:
            away = middle + lead_windows * trend - level
            variance += weight * (a + lead_windows * (2.0 * b + lead_windows * c) + away**2)
        flow = exp(level)
        return flow, flow * sqrt(variance)


def _step(states: _States, models: tuple[_Model, _Model, _Model], stay: float, seen: float, noise: float) -> _States:
    to_jump = _TREND_TO_JUMP * (1.0 - stay)
    ((l0, t0), (a0, b0, c0), w0), ((l1, t1), (a1, b1, c1), w1), ((l2, t2), (a2, b2, c2), w2) = states
    reaches = (
        (_STEADY[0] * w0, (1.0 - stay - to_jump) * w1, _JUMP[0] * w2),
        (_STEADY[1] * w0, stay * w1, _JUMP[1] * w2),
        (_STEADY[2] * w0, to_jump * w1, _JUMP[2] * w2),
    )
    updated: list[tuple[_Vector, _Matrix]] = []
    weights: list[float] = []
    for model, (r0, r1, r2) in zip(models, reaches, strict=True):
        total = r0 + r1 + r2
        # What leads to this description, as one mean and spread. Written out: once a second, and calls take as long again.
        w0, w1, w2 = r0 / total, r1 / total, r2 / total
        level = w0 * l0 + w1 * l1 + w2 * l2
        trend = w0 * t0 + w1 * t1 + w2 * t2
        dl0, dl1, dl2 = l0 - level, l1 - level, l2 - level
        dt0, dt1, dt2 = t0 - trend, t1 - trend, t2 - trend
        a = w0 * (a0 + dl0 * dl0) + w1 * (a1 + dl1 * dl1) + w2 * (a2 + dl2 * dl2)
        b = w0 * (b0 + dl0 * dt0) + w1 * (b1 + dl1 * dt1) + w2 * (b2 + dl2 * dt2)
        c = w0 * (c0 + dt0 * dt0) + w1 * (c1 + dt1 * dt1) + w2 * (c2 + dt2 * dt2)
        # The prediction.
        f = model.keeps_trend
        if f < 1.0:
            b = f * b
        else:
            level, a, b = level + trend, a + 2.0 * b + c, b + c
        trend, a, c = f * trend, a + model.level_noise, f * f * c + model.trend_noise
        innovation, variance = seen - level, a + noise
        gain, trend_gain = a / variance, b / variance
        updated.append(
            ((level + gain * innovation, trend + trend_gain * innovation), (a - gain * a, b - gain * b, c - trend_gain * b))
        )
        weights.append(log(total) - 0.5 * innovation * innovation / variance - 0.5 * log(variance))
    top = max(weights)
    # Kept above zero so that a description that has long been wrong can come back.
    s0, s1, s2 = [max(exp(w - top), 1e-12) for w in weights]
    whole = s0 + s1 + s2
    first, second, third = updated
    return (*first, s0 / whole), (*second, s1 / whole), (*third, s2 / whole)
