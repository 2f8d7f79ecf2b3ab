"""The flow filter against interacting multiple models as Blom and Bar-Shalom (1988) write them, in matrices."""

from __future__ import annotations

import numpy as np
import pytest

from yieldmon.engine.flow_filter import FlowFilter, FlowFilterSettings

STEADY_WALK, TREND_CHANGE, JUMP, STAY = 0.008, 0.002, 0.18, 0.95
CHANGES = np.array([[0.85, 0.03, 0.12], [0.1 * (1 - STAY), STAY, 0.9 * (1 - STAY)], [0.20, 0.01, 0.79]])
MOTIONS = (
    (np.diag((1.0, 0.5)), np.diag((STEADY_WALK**2, 0.02**2))),
    (np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag((STEADY_WALK**2, TREND_CHANGE**2))),
    (np.diag((1.0, 0.5)), np.diag((JUMP**2, JUMP**2 / 16))),
)


class ByMatrices:
    """Steady, trend, jump: mean and covariance of level and trend of ln(flow), and a probability each."""

    def __init__(self, flow: float, noise: float) -> None:
        self.means = [np.array([np.log(flow), 0.0])] * 3
        self.spreads = [np.diag([(noise / flow) ** 2, 0.15**2])] * 3
        self.weights = np.full(3, 1 / 3)

    def update(self, flow: float, noise: float, lead: float) -> tuple[float, float]:
        reached = self.weights @ CHANGES
        mixing = CHANGES * self.weights[:, None] / reached
        means, spreads, likelihoods = [], [], []
        for model, (motion, walk) in enumerate(MOTIONS):
            mean = sum(mixing[i, model] * self.means[i] for i in range(3))
            spread = sum(
                mixing[i, model] * (self.spreads[i] + np.outer(self.means[i] - mean, self.means[i] - mean)) for i in range(3)
            )
            mean, spread = motion @ mean, motion @ spread @ motion.T + walk
            variance = spread[0, 0] + (noise / flow) ** 2
            gain, innovation = spread[:, 0] / variance, np.log(flow) - mean[0]
            means.append(mean + gain * innovation)
            spreads.append(spread - np.outer(gain, spread[0]))
            likelihoods.append(np.exp(-0.5 * innovation**2 / variance) / np.sqrt(variance))
        weights = reached * likelihoods
        weights = np.maximum(weights / weights.max(), 1e-12)
        self.means, self.spreads, self.weights = means, spreads, weights / weights.sum()
        ahead = np.array([1.0, lead])
        levels = np.array([ahead @ mean for mean in means])
        level = self.weights @ levels
        variance = self.weights @ ([ahead @ spread @ ahead for spread in spreads] + (levels - level) ** 2)
        return float(np.exp(level)), float(np.exp(level) * np.sqrt(variance))


@pytest.mark.parametrize("lead", [0.0, -0.75, 1.5])
@pytest.mark.parametrize("seed", range(4))
def test_the_filter_is_three_models_weighed(seed: int, lead: float) -> None:
    """Steady flow, a rise, jumps up and down, and noise that changes."""
    draw = np.random.default_rng(seed)
    true = np.concatenate((np.full(30, 8.0), 8.0 * 1.04 ** np.arange(20), np.full(20, 5.0), np.full(10, 25.0), np.full(10, 0.4)))
    noises = true * draw.uniform(0.005, 0.08, true.size)
    flows = true + noises * draw.standard_normal(true.size)
    flow_filter, reference = FlowFilter(FlowFilterSettings()), ByMatrices(flows[0], noises[0])
    assert flow_filter.update(float(flows[0]), float(noises[0]), lead) == (flows[0], noises[0])
    for flow, noise in zip(flows[1:].tolist(), noises[1:].tolist(), strict=True):
        assert flow_filter.update(flow, noise, lead) == pytest.approx(reference.update(flow, noise, lead), rel=1e-9)


@pytest.mark.parametrize(
    ("flow", "noise", "usable"),
    [(0.3, 0.01, True), (0.2999, 0.01, False), (1e6, 1.0, True), (1.1e6, 1.0, False), (5.0, 0.0, False), (5.0, -1.0, False),
     (5.0, float("inf"), False), (5.0, float("nan"), False), (float("nan"), 1.0, False), (5.0, 1e-9, True)],
)  # fmt: skip
def test_what_is_not_usable_stands_for_itself_and_begins_anew(flow: float, noise: float, usable: bool) -> None:
    flow_filter = FlowFilter(FlowFilterSettings())
    flow_filter.update(10.0, 0.3)
    back = flow_filter.update(flow, noise)
    assert (repr(back) == repr((flow, noise))) is not usable
    assert (flow_filter.update(20.0, 0.3) == (20.0, 0.3)) is not usable
