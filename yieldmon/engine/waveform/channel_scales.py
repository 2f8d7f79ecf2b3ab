"""The scale that shape and kernels have found against the mean force of late, and the flow that it corrects."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp, hypot, inf, isfinite, log, sqrt

from yieldmon.engine.flow import Flow
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.waveform.shape_difference import ShapeDifference
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels
from yieldmon.estimation.waveform.channel_combination import combine, together_sd

_HOLDS_S = 600.0
"""How long the scale that shape or kernels have found counts where they determine nothing, as in a sweep."""


@dataclass(frozen=True, slots=True)
class Scale:
    """A channel's flow over that by the mean force of one estimator, as it was at a time: it changes slowly.

    lasting_sd, random_sd: relative standard deviations of that flow, but for the noise of the mean force; random_sd: of what
    averages out. heap: what one standard deviation of the heap's shape moves the mean force's flow and this one by.
    """

    log_over_mean_force: float
    lasting_sd: float
    random_sd: float
    estimator: FlowEstimator
    time_s: float
    heap: tuple[float, float] = (0.0, 0.0)


class ChannelScales:
    """Holds what each channel has found, for as long as it counts.

    difference: between shape and mean force, window by window.
    """

    def __init__(self, settings: WaveformSettings) -> None:
        self._settings = settings
        self.difference = ShapeDifference(settings)
        self._shapes: deque[Scale] = deque(maxlen=settings.contradiction_windows)
        self._by_kernels: Scale | None = None

    def by_shape(self, found: Scale) -> None:
        """Another window's."""
        self._shapes.append(found)

    def by_kernels(self, found: Scale | None) -> None:
        """The last windows'; None where they have shown that there is none."""
        self._by_kernels = found

    def corrected(self, mean_flow: Flow, now_s: float, estimator: FlowEstimator) -> tuple[float, float] | None:
        """The mean force's flow, whose scale shape and kernels correct as they have found it of late, and its standard deviation.

        kg/s; None where neither has found one. One that contradicts the mean force corrects nothing: no mean of two flows that
        exclude each other has the deviation that it would be published with.
        """
        rate = mean_flow.rate_kg_s
        if not rate > 0.0:
            return None
        lasting = _lasting(mean_flow)
        flow, sd = rate, lasting
        # What lies outside its calibration corrects nothing, but is no less apart.
        contradicts, hit = self.difference.contradicts, 1.0
        apart = 0.0 if contradicts else self.difference.deviations(now_s, estimator, _HOLDS_S)
        corrected = apart > 1.0
        shapes = [scale for scale in self._shapes if self._holds(scale, now_s, estimator)]
        if shapes and not contradicts:
            mean = sum(scale.log_over_mean_force for scale in shapes) / len(shapes)
            shape_sd = hypot(shapes[-1].lasting_sd, sqrt(sum(scale.random_sd**2 for scale in shapes)) / len(shapes))
            exponent, parameters = local_exponent(mean_flow), estimator.parameters
            heap = shapes[-1].heap
            both = combine(rate, lasting, rate * exp(mean), shape_sd, exponent=exponent, parameters=parameters, heap=heap)
            flow, sd, corrected = both.mass_flow_kg_s, both.relative_sd, True
            apart, hit = max(apart, abs(both.z)), 1.0 - both.weight
        kernels = self._kernels(now_s, estimator)
        # What updates the parameters is in the mean force's flow already.
        if kernels is not None and not self._settings.update_parameters and not self._kernels_contradict(kernels, mean_flow):
            over, over_sd = kernels.log_over_mean_force, kernels.lasting_sd
            weight = sd**2 / (sd**2 + over_sd**2)
            further = over - log(flow / rate)
            flow *= exp(weight * further)
            apart, hit = max(apart, abs(further) / hypot(sd, over_sd)), weight + (1.0 - weight) * hit
            sd, corrected = sd * over_sd / hypot(sd, over_sd), True
        if not corrected:
            return None
        return flow, flow * hypot(together_sd(sd, z=apart, hit=hit, hit_sd=self._settings.hit_sd), _noise(mean_flow))

    def channels(self, now_s: float, estimator: FlowEstimator) -> OtherChannels:
        """What shape and kernels are worth to the published flow now."""
        shapes = [scale for scale in self._shapes if self._holds(scale, now_s, estimator)]
        kernels = self._kernels(now_s, estimator)
        by_shape, by_kernels = self._settings.combine and shapes, self._settings.combine or self._settings.update_parameters
        return OtherChannels(
            shape_sd=shapes[-1].lasting_sd if by_shape else inf,
            kernels_sd=kernels.lasting_sd if kernels is not None and by_kernels else inf,
        )

    def kernels_contradict(self, mean_flow: Flow, now_s: float, estimator: FlowEstimator) -> str:
        """How kernels and mean force contradict each other; empty where they do not."""
        kernels = self._kernels(now_s, estimator)
        return self._kernels_contradict(kernels, mean_flow) if kernels is not None and mean_flow.rate_kg_s > 0.0 else ""

    def _kernels(self, now_s: float, estimator: FlowEstimator) -> Scale | None:
        """The scale by kernels, where it still holds."""
        found = self._by_kernels
        return found if found is not None and self._holds(found, now_s, estimator) else None

    def _kernels_contradict(self, found: Scale, mean_flow: Flow) -> str:
        # The noise of many windows is in each: no median of windows is needed.
        z = found.log_over_mean_force / hypot(_lasting(mean_flow), found.lasting_sd)
        if not abs(z) > self._settings.contradiction_z:
            return ""
        ask = "is sensor.response_s, the kernels' weight or the calibration wrong?"
        return f"kernel noise and mean force differ by {abs(z):.1f} standard deviations; {ask}"

    @staticmethod
    def _holds(scale: Scale, now_s: float, estimator: FlowEstimator) -> bool:
        return scale.estimator is estimator and now_s - scale.time_s <= _HOLDS_S


def _noise(mean_flow: Flow) -> float:
    """Of a window's mean force, relative to its flow."""
    noise = mean_flow.budget.noise_kg_s / mean_flow.rate_kg_s
    return noise if isfinite(noise) else 0.0


def _lasting(mean_flow: Flow) -> float:
    """Relative standard deviation of a flow but for that noise."""
    return sqrt(max((mean_flow.std_dev_kg_s / mean_flow.rate_kg_s) ** 2 - _noise(mean_flow) ** 2, 0.0))


def local_exponent(flow: Flow) -> float:
    """d ln(force) / d ln(flow), from what the force's noise is worth in flow."""
    noise_kg_s, noise_n = flow.budget.noise_kg_s, flow.force_std_dev_n
    if not (noise_kg_s > 0.0 and noise_n > 0.0 and flow.force_n > 0.0) or flow.saturated:
        return 0.7
    return min(max(noise_n / noise_kg_s * flow.rate_kg_s / flow.force_n, 0.2), 1.5)
