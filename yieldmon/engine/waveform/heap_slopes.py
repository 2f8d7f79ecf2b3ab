"""Effect of the uncertain heap shape on the flow by the mean force and on that by the pulses."""

from __future__ import annotations

from math import exp, isfinite, log

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.settings import WaveformSettings
from yieldmon.estimation.waveform.channel_combination import heap_slope
from yieldmon.estimation.waveform.pulse_fit import PulseEstimate
from yieldmon.physics.model import ForwardModel

_NAN = float("nan")
_MOST = 500
"""Most slopes kept."""


class HeapSlopes:
    """Slopes of the mean force's flow over the heap's shape ratio, by the state of the machine."""

    def __init__(self, settings: WaveformSettings) -> None:
        self._sd = settings.shape_ratio_sd
        self._estimator: FlowEstimator | None = None
        self._slopes: dict[tuple[float, ...], float] = {}

    def moved_by(
        self, shape: PulseEstimate, reading: Reading, rate_kg_s: float, estimator: FlowEstimator, model: ForwardModel
    ) -> tuple[float, float]:
        """Relative change of the mean force's flow and of the shape's by one standard deviation of the heap's shape ratio.

        rate_kg_s: by the mean force.
        """
        if not self._sd > 0.0:
            return 0.0, 0.0
        if estimator is not self._estimator:
            self._estimator, self._slopes = estimator, {}
        window, moisture = reading.window, reading.inputs.fresh["moisture"]
        # The slope changes slowly: one value per 10 % of flow, 0.01 rad of plate angle and 2 rad/s of elevator speed.
        here = (
            round(log(rate_kg_s), 1),
            round(window.plate_angle_rad, 2),
            2 * round(0.5 * window.speed_rad_s),
            _per_cent(moisture),
        )
        if len(self._slopes) > _MOST:
            self._slopes.clear()
        if here not in self._slopes:
            self._slopes[here] = heap_slope(
                model,
                estimator.parameters,
                mass_flow_kg_s=exp(here[0]),
                plate_angle_rad=here[1],
                elevator_speed_rad_s=here[2],
                moisture_pct=here[3],
            )
        flow, ratio = (shape.names.index(name) for name in ("log_volume_flow", "log_shape_ratio"))
        return self._slopes[here] * self._sd, float(shape.covariance[flow, ratio]) / self._sd


def _per_cent(moisture_pct: float) -> float:
    """Rounded; always the same nan object where not known, so that it matches as a dictionary key."""
    return round(moisture_pct) if isfinite(moisture_pct) else _NAN
