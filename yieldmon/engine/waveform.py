"""What the samples of a window hold beside their mean: volume flow from the pulses' shape, and scale from the noise of kernels.

Runs beside the mean force's estimate and knows it only to compare. Off unless the settings say otherwise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.measurement import Reading
from yieldmon.engine.records import FlowEstimator
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.windows import Trace
from yieldmon.estimation import kernel_noise
from yieldmon.estimation.channel_combination import combine, relative_covariance
from yieldmon.estimation.kernel_noise import Density, KernelImpulse, KernelNoiseSettings
from yieldmon.estimation.pattern_fold import FoldedPattern, fold, harmonics_of, residual
from yieldmon.estimation.pulse_shape import PulseEstimate, PulseModel, PulseSettings, estimate
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

Array = NDArray[np.float64]
_NAN = float("nan")
_SEGMENT = 256
_BINS = 64
_FINE_BINS = 512
_KEEP = 0.95
"""What of the running mean pulse, which is taken off before the noise is looked at, a window leaves."""
_NO_FIT = 1000.0
"""Misfit that stands for pulses to which no fit settles."""
_WHOLE = 0.98
_APART = 3
"""Windows between grain and a window of the empty machine."""
_LEAST_SAMPLES = 4.0


@dataclass(frozen=True, slots=True)
class WaveformReading:
    """What a window's samples say; nan where they say nothing.

    shape_kg_s, shape_std_dev_kg_s: volume flow times density, the density's standard deviation in it. kernels_kg_s,
    kernels_std_dev_kg_s: from kernel noise. kernels_reason: why it says nothing. combined_kg_s, combined_std_dev_kg_s: mean force
    and shape together. contradiction: of shape and mean force, over the last windows; empty where they agree.
    """

    shape_kg_s: float = _NAN
    shape_std_dev_kg_s: float = _NAN
    kernels_kg_s: float = _NAN
    kernels_std_dev_kg_s: float = _NAN
    kernels_reason: str = ""
    combined_kg_s: float = _NAN
    combined_std_dev_kg_s: float = _NAN
    contradiction: str = ""


NOTHING = WaveformReading()


class Waveform:
    """Looks at one window after another."""

    def __init__(self, settings: WaveformSettings, machine: Machine) -> None:
        self.kernel_mass_kg = 1e-6 * settings.thousand_kernel_weight_g
        self._settings = settings
        self._machine = machine
        self._noise = KernelNoiseSettings(
            low_hz=settings.kernel_low_hz,
            high_hz=settings.kernel_high_hz,
            quiet_error=settings.quiet_error,
            response_error=settings.response_error,
            bias=settings.kernel_bias,
            bias_sd=settings.kernel_bias_sd,
        )
        self._pulses: PulseModel | None = None
        self._estimator: FlowEstimator | None = None
        self._last: PulseEstimate | None = None
        self._sums, self._counts = np.zeros(_FINE_BINS), np.zeros(_FINE_BINS)
        self._loaded: deque[tuple[Density, float]] = deque(maxlen=settings.kernel_windows)
        self._quiet: deque[Density] = deque(maxlen=settings.kernel_windows)
        self._waiting: deque[Density] = deque()
        self._differences: deque[tuple[float, float]] = deque(maxlen=settings.contradiction_windows)

    def see(self, reading: Reading, rate_kg_s: float, std_dev_kg_s: float, estimator: FlowEstimator) -> WaveformReading:
        """The window's own word beside that of the mean force (nan: none)."""
        trace = reading.window.trace
        if trace is None or reading.zero is None or not reading.in_range or trace.samples_mv.size < _SEGMENT:
            return NOTHING
        force_n = (trace.samples_mv - reading.zero.zero_mv) * self._machine.sensor.gain_n_per_mv
        if not reading.harvesting:
            self._last = None
            self._sums[:], self._counts[:] = 0.0, 0.0
            self._see_empty(kernel_noise.density(force_n, trace.interval_s, segment=_SEGMENT), reading)
            return NOTHING
        self._waiting.clear()
        if not (isfinite(rate_kg_s) and rate_kg_s > 0.0 and reading.still):
            self._last = None
            return NOTHING
        folded = fold(force_n, trace.phase, bins=_BINS)
        shape = self._shape(folded, reading, estimator)
        kernels = None if shape is None else self._kernels(force_n, self._aligned(trace, shape, reading), reading.force_n)
        return self._judged(reading, rate_kg_s, std_dev_kg_s, estimator, shape, kernels)

    def _see_empty(self, shown: Density, reading: Reading) -> None:
        """A window of the empty machine counts once grain has neither just gone nor comes with the next windows."""
        if not abs(reading.force_n) < self._machine.sensor.gain_n_per_mv:
            self._waiting.clear()
            return
        self._waiting.append(shown)
        if len(self._waiting) > 2 * _APART:
            self._quiet.append(self._waiting[_APART])
            self._waiting.popleft()

    def _shape(self, folded: FoldedPattern, reading: Reading, estimator: FlowEstimator) -> PulseEstimate | None:
        """The fit to the window's pulses, begun where the last one ended."""
        if not folded.complete:
            return None
        pulses = self._model(estimator)
        wave = harmonics_of(
            folded,
            self._settings.harmonics,
            elevator_speed_rad_s=reading.window.speed_rad_s,
            plate_angle_rad=reading.window.plate_angle_rad,
        )
        last = self._last
        if last is not None:
            # The phase goes on along the chain, so that only a change of speed moves the shift.
            start = np.array([last.values[name] for name in pulses.names])
            centre = pulses.start(last.volume_flow_m3_s, shift_s=last.values["shift_s"], log_gain=last.values["log_gain"])
            found = estimate(pulses, wave, start=start, centre=centre, iterations=6)
            if found.converged and found.misfit < self._settings.largest_misfit:
                self._last = found
                return found
        found = estimate(pulses, wave)
        self._last = found if found.converged else None
        return self._last

    def _model(self, estimator: FlowEstimator) -> PulseModel:
        if self._pulses is None or estimator is not self._estimator:
            settings, sensor = self._settings, self._machine.sensor
            values = dict(estimator.parameters.values)
            values["friction"] = max(values["friction"], 0.02)
            sd = dict(PulseSettings().sd)
            sd |= {"log_friction": settings.friction_sd, "log_shape_ratio": settings.shape_ratio_sd}
            sd |= {"log_cell": settings.response_error}
            self._pulses = PulseModel(
                ForwardModel(self._machine, estimator.parameters.effects),
                values,
                PulseSettings(
                    harmonics=settings.harmonics, model_error=settings.model_error, cell_response_s=sensor.response_s, sd=sd
                ),
            )
            self._estimator, self._last = estimator, None
        return self._pulses

    def _aligned(self, trace: Trace, shape: PulseEstimate, reading: Reading) -> Trace:
        """The samples with their phase counted from the pulses themselves: the phase from ten speeds a second creeps."""
        turns_per_s = self._machine.paddle_speed_m_s(reading.window.speed_rad_s) / self._machine.pattern_length_m
        return replace(trace, phase=trace.phase - shape.values["shift_s"] * turns_per_s)

    def _kernels(self, force_n: Array, trace: Trace, mean_force_n: float) -> KernelImpulse | None:
        """The impulse of a kernel from the last windows; None until a mean pulse and the empty machine's noise are known."""
        sums, counts = self._sums.copy(), self._counts.copy()
        place = np.floor((trace.phase % 1.0) * _FINE_BINS).astype(np.intp) % _FINE_BINS
        self._sums = _KEEP * self._sums + np.bincount(place, weights=force_n, minlength=_FINE_BINS)
        self._counts = _KEEP * self._counts + np.bincount(place, minlength=_FINE_BINS)
        if counts.min() < _LEAST_SAMPLES:
            return None
        before = FoldedPattern(sums / counts, np.zeros(_FINE_BINS), counts, float("inf"))
        shown = kernel_noise.density(residual(force_n, trace.phase, before), trace.interval_s, segment=_SEGMENT)
        # The running mean holds noise of its own.
        shown = replace(shown, density=shown.density / (1.0 + float(np.mean(1.0 / counts))))
        self._loaded.append((shown, mean_force_n))
        if len(self._quiet) < self._settings.quiet_windows or len(self._loaded) < self._settings.quiet_windows:
            return None
        force = float(np.mean([f for _, f in self._loaded]))
        return kernel_noise.kernel_impulse(
            kernel_noise.pooled([d for d, _ in self._loaded]),
            kernel_noise.pooled(list(self._quiet)),
            force,
            cell_response_s=self._machine.sensor.response_s,
            sample_interval_s=trace.interval_s,
            settings=self._noise,
        )

    def _judged(
        self,
        reading: Reading,
        rate: float,
        std_dev: float,
        estimator: FlowEstimator,
        shape: PulseEstimate | None,
        kernels: KernelImpulse | None,
    ) -> WaveformReading:
        flow, flow_sd = _NAN, _NAN
        both, both_sd, contradiction = _NAN, _NAN, ""
        if shape is not None and isfinite(shape.volume_flow_m3_s):
            parameters = estimator.parameters
            flow = shape.volume_flow_m3_s * parameters.values["density"]
            flow_sd = flow * hypot(shape.relative_sd, sqrt(relative_covariance(parameters)[0]))
            exponent = _exponent(reading, rate, estimator)
            together = combine(rate, std_dev / rate, flow, shape.relative_sd, exponent=exponent, parameters=parameters)
            both, both_sd = together.mass_flow_kg_s, together.mass_flow_kg_s * together.relative_sd
            contradiction = self._contradiction(together.z, shape.misfit)
        elif reading.window.coverage >= _WHOLE:
            contradiction = self._contradiction(0.0, _NO_FIT)
        grain, grain_sd, reason = _NAN, _NAN, ""
        if kernels is not None and self.kernel_mass_kg > 0.0:
            reason = kernels.reason
            if kernels.usable:
                found = kernel_noise.kernel_flow(
                    kernels,
                    reading.force_n,
                    self.kernel_mass_kg,
                    kernel_mass_sd=self._settings.kernel_mass_sd,
                    settings=self._noise,
                )
                grain, grain_sd = found.mass_flow_kg_s, found.mass_flow_kg_s * found.relative_sd
        return WaveformReading(flow, flow_sd, grain, grain_sd, reason, both, both_sd, contradiction)

    def _contradiction(self, z: float, misfit: float) -> str:
        if isfinite(z):
            self._differences.append((z, min(misfit, _NO_FIT)))
        if len(self._differences) < self._settings.contradiction_windows:
            return ""
        seen, off = (float(np.median(column)) for column in zip(*self._differences, strict=True))
        if abs(seen) > self._settings.contradiction_z:
            return f"pulse shape and mean force differ by {abs(seen):.1f} standard deviations"
        if off > self._settings.largest_misfit:
            return f"pulses are not of the model's shape: misfit {off:.0f}"
        return ""


def _exponent(reading: Reading, rate: float, estimator: FlowEstimator) -> float:
    """d ln(force) / d ln(flow) from the estimator's own answer to a little more force."""
    more = 1.02
    window = reading.window
    found = estimator.estimate(
        np.array([reading.force_n * more]),
        np.array([window.plate_angle_rad]),
        np.array([window.speed_rad_s]),
        np.array([reading.force_std_dev_n]),
        np.array([reading.inputs.fresh["moisture"]]),
    )
    other = float(np.ravel(found.mass_flow_kg_s)[0])
    if not (isfinite(other) and other > rate > 0.0):
        return 0.7
    return float(np.clip(np.log(more) / np.log(other / rate), 0.2, 1.5))
