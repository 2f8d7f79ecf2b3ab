"""The scales of shape and kernels relative to the mean force, as recently measured, and the flow corrected by them."""

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
"""How long a scale of shape or kernels is used after its last measurement, as during a sweep."""


@dataclass(frozen=True, slots=True)
class Scale:
    """A channel's flow relative to that by the mean force of one estimator, at a time; it changes slowly.

    log_over_mean_force: logarithm of the ratio. lasting_sd, random_sd: relative standard deviations of the channel's flow;
    random_sd: of the part that averages out. heap: relative change of the mean force's flow and of this one by one standard
    deviation of the heap's shape.
    """

    log_over_mean_force: float
    lasting_sd: float
    random_sd: float
    estimator: FlowEstimator
    time_s: float
    heap: tuple[float, float] = (0.0, 0.0)


class ChannelScales:
    """Keeps the recent scales of each channel.

    difference: between shape and mean force, window by window.
    """

    def __init__(self, settings: WaveformSettings) -> None:
        self._settings = settings
        self.difference = ShapeDifference(settings)
        self._shapes: deque[Scale] = deque(maxlen=settings.contradiction_windows)
        self._by_kernels: Scale | None = None

    def by_shape(self, found: Scale) -> None:
        """Add the scale of a window by its pulses' shape."""
        self._shapes.append(found)

    def by_kernels(self, found: Scale | None) -> None:
        """Set the scale by kernels over the last windows; None where there is none."""
        self._by_kernels = found

    def corrected(self, mean_flow: Flow, now_s: float, estimator: FlowEstimator) -> tuple[float, float] | None:
        """The mean force's flow corrected by the recent scales of shape and kernels, and its standard deviation, kg/s.

        None where there is no scale. A channel that contradicts the mean force corrects nothing: the mean of two incompatible
        flows would be published with too small a standard deviation.
        """
        rate = mean_flow.rate_kg_s
        if not rate > 0.0:
            return None
        lasting = _lasting(mean_flow)
        flow, sd = rate, lasting
        # A shape outside its calibration corrects nothing, but its difference still counts.
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
        # Where kernels update the parameters, the mean force's flow contains them already.
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
        """The current accuracy of shape and kernels, as far as they enter the published flow."""
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
        """The scale by kernels, None where it is too old or of another estimator."""
        found = self._by_kernels
        return found if found is not None and self._holds(found, now_s, estimator) else None

    def _kernels_contradict(self, found: Scale, mean_flow: Flow) -> str:
        # Kernel noise is averaged over many windows, so no median over windows is needed.
        z = found.log_over_mean_force / hypot(_lasting(mean_flow), found.lasting_sd)
        if not abs(z) > self._settings.contradiction_z:
            return ""
        ask = "is sensor.response_s, the kernels' weight or the calibration wrong?"
        return f"kernel noise and mean force differ by {abs(z):.1f} standard deviations; {ask}"

    @staticmethod
    def _holds(scale: Scale, now_s: float, estimator: FlowEstimator) -> bool:
        return scale.estimator is estimator and now_s - scale.time_s <= _HOLDS_S


def _noise(mean_flow: Flow) -> float:
    """Relative noise of the flow by a window's mean force."""
    noise = mean_flow.budget.noise_kg_s / mean_flow.rate_kg_s
    return noise if isfinite(noise) else 0.0


def _lasting(mean_flow: Flow) -> float:
    """Relative standard deviation of a flow without that noise."""
    return sqrt(max((mean_flow.std_dev_kg_s / mean_flow.rate_kg_s) ** 2 - _noise(mean_flow) ** 2, 0.0))


def local_exponent(flow: Flow) -> float:
    """d ln(force) / d ln(flow), from the ratio of the noise of force and flow."""
    noise_kg_s, noise_n = flow.budget.noise_kg_s, flow.force_std_dev_n
    if not (noise_kg_s > 0.0 and noise_n > 0.0 and flow.force_n > 0.0) or flow.saturated:
        return 0.7
    return min(max(noise_n / noise_kg_s * flow.rate_kg_s / flow.force_n, 0.2), 1.5)
