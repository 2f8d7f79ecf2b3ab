"""Evaluation of single samples: volume flow from the shape of the pulses, and the scale from the noise of kernels.

It is independent of the mean force's estimate and compares with it; its results correct the flows of later windows. Off by
default.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import exp, hypot, isfinite, log, sqrt
from statistics import median

from yieldmon.engine.fast_dataclasses import changer_of
from yieldmon.engine.flow import Flow
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.self_calibration.kernel_measurements import KernelMeasurements
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.waveform.channel_scales import ChannelScales, Scale, local_exponent
from yieldmon.engine.waveform.heap_slopes import HeapSlopes
from yieldmon.engine.waveform.kernel_channel import KernelChannel
from yieldmon.engine.waveform.pulse_fits import PulseFits
from yieldmon.engine.waveform.shape_difference import NO_FIT
from yieldmon.engine.waveform.waveform_reading import WaveformReading
from yieldmon.engine.waveform.window_noise import SEGMENT
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels
from yieldmon.estimation.waveform.channel_combination import combine, relative_covariance
from yieldmon.estimation.waveform.kernel_noise import KernelImpulse, KernelVerdict, kernel_flow
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_fit import PulseEstimate
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict
from yieldmon.physics.machine import Machine

_NAN = float("nan")
_WHOLE = 0.98
"""Coverage of a window above which a missing fit is not due to missing samples."""
_with = changer_of(WaveformReading)


def _without(verdict: ShapeVerdict, reason: str, kernels: KernelVerdict = KernelVerdict.NOT_LOOKED_AT) -> WaveformReading:
    return WaveformReading(shape=verdict, shape_reason=reason, kernels=kernels, kernels_reason=reason)


_NO_WINDOW = "no second has been measured yet"
_NO_TRACE = "samples are missing, or more than one sensor carries the plate"
_NO_ZERO = ShapeVerdict.NO_ZERO, "no zero-load voltage has been measured yet"
_OTHER_SPEED = ShapeVerdict.SPEED_OUT_OF_RANGE, "the elevator speed is outside the measuring range"
_NO_GRAIN = "no grain"
_NOT_STILL = "no flow from the mean force, or the plate moves"
_NO_PULSES = "no pulse of the model fits the samples"
_FEW_TURNS = "the window holds fewer than two turns of the paddle pattern"
_NO_WEIGHT = "no thousand-kernel weight is known"


class Waveform:
    """Evaluates one window after another."""

    def __init__(self, settings: WaveformSettings, machine: Machine) -> None:
        self.kernel_weight_g = settings.thousand_kernel_weight_g
        """Mass of a thousand kernels as last entered, g; 0: not known. A received value takes precedence."""
        self.last = _without(ShapeVerdict.NOT_LOOKED_AT, _NO_WINDOW, KernelVerdict.NOT_LOOKED_AT)
        self._settings = settings
        self._machine = machine
        self._kernel_channel = KernelChannel(settings, machine)
        self.kernel_measurements = KernelMeasurements(settings)
        self._fits = PulseFits(settings, machine)
        self._heaps = HeapSlopes(settings)
        self._scales = ChannelScales(settings)
        self._stretches: deque[float] = deque(maxlen=settings.contradiction_windows)
        self._biases: deque[float] = deque(maxlen=settings.kernel_windows)

    def go_on_with(self, before: Waveform) -> None:
        """Take over the noise measured by another one, on the same machine with the same settings."""
        if (self._settings, self._machine) == (before._settings, before._machine):
            self._kernel_channel, self.kernel_measurements = before._kernel_channel, before.kernel_measurements

    def prepare(self, readings: Sequence[Reading], rates_kg_s: Sequence[float], estimator: FlowEstimator) -> None:
        """Fit the pulses of these windows together, for the calls of `see`. rates_kg_s: by the mean force."""
        self._fits.prepare(readings, rates_kg_s, estimator)

    def see(self, reading: Reading, flow: Flow, estimator: FlowEstimator) -> WaveformReading:
        """Evaluate a window. flow: by the mean force."""
        self.last = self._seen(reading, flow, estimator)
        return self.last

    def _seen(self, reading: Reading, flow: Flow, estimator: FlowEstimator) -> WaveformReading:
        trace = reading.window.trace
        if trace is None:
            return _without(ShapeVerdict.NO_SAMPLES, _NO_TRACE)
        if trace.samples_mv.size < SEGMENT:
            few = f"{trace.samples_mv.size} samples a second, at least {SEGMENT} are needed"
            return _without(ShapeVerdict.NO_SAMPLES, few, KernelVerdict.NO_BAND)
        if reading.zero is None or not reading.in_range:
            return _without(*(_NO_ZERO if reading.zero is None else _OTHER_SPEED))
        force_n = (trace.samples_mv - reading.zero.zero_mv) * self._machine.sensor.gain_n_per_mv
        if not reading.harvesting:
            self._kernel_channel.empty(force_n, trace.interval_s, reading.force_n)
            return _without(ShapeVerdict.NO_GRAIN, _NO_GRAIN)
        self._kernel_channel.grain()
        if not (flow.rate_kg_s > 0.0 and reading.still):
            return self._counted(_without(ShapeVerdict.NOT_STILL, _NOT_STILL), reading, flow, estimator)
        fit = self._fits.of(reading, flow.rate_kg_s, estimator)
        kernels = None
        if fit is not None:
            aligned, wave = self._fits.aligned(trace, *fit, reading)
            kernels = self._kernel_channel.loaded(force_n, aligned, wave, reading, flow.rate_kg_s, estimator)
        return self._judged(reading, flow, estimator, fit, kernels)

    def _judged(
        self,
        reading: Reading,
        mean_flow: Flow,
        estimator: FlowEstimator,
        fit: tuple[PatternWave, PulseEstimate] | None,
        kernels: KernelImpulse | None,
    ) -> WaveformReading:
        rate, std_dev = mean_flow.rate_kg_s, mean_flow.std_dev_kg_s
        seen = WaveformReading(mean_kg_s=rate, mean_std_dev_kg_s=std_dev, kernel_weight_g=self._weight_g(reading) or _NAN)
        if fit is not None and isfinite(fit[1].volume_flow_m3_s):
            seen = self._with_shape(_with(seen, wave=fit[0]), fit, reading, mean_flow, estimator)
        elif reading.window.coverage < _WHOLE:
            seen = _with(seen, shape=ShapeVerdict.FEW_TURNS, shape_reason=_FEW_TURNS)
        elif of_mean := self._fits.outside(rate / estimator.parameters.values["density"], reading, estimator):
            seen = _with(seen, shape=ShapeVerdict.OUTSIDE_CALIBRATION, shape_reason=of_mean)
        else:
            no_fit = self._scales.difference.add(0.0, NO_FIT, reading.window.end_s, estimator)
            seen = _with(seen, shape=ShapeVerdict.NO_PULSES, shape_reason=_NO_PULSES, contradiction=no_fit)
        missing = seen.shape_reason if fit is None else ""
        seen = self._with_kernels(seen, reading, kernels, missing)
        if seen.kernels is KernelVerdict.USED:
            over, sd = seen.kernels_kg_s / rate, seen.kernels_std_dev_kg_s / seen.kernels_kg_s
            self._scales.by_kernels(Scale(log(over), sd, 0.0, estimator, reading.window.end_s))
            seen = _with(seen, bias=self._agreeing_bias(over))
            if reading.at_home and kernels is not None:
                self.kernel_measurements.add(seen.kernels_kg_s, sd, kernels.random_sd, reading)
        elif seen.kernels is not KernelVerdict.TOO_EARLY:
            self._scales.by_kernels(None)
        return self._counted(seen, reading, mean_flow, estimator)

    def _counted(self, seen: WaveformReading, reading: Reading, mean_flow: Flow, estimator: FlowEstimator) -> WaveformReading:
        """The reading with the combined flow, and with a contradiction between kernels and mean force."""
        now_s = reading.window.end_s
        if against := self._scales.kernels_contradict(mean_flow, now_s, estimator):
            seen = _with(seen, contradiction=seen.contradiction or against)
            if seen.kernels is KernelVerdict.USED:
                seen = _with(seen, kernels=KernelVerdict.CONTRADICTS, kernels_reason=against)
        found = self.corrected(mean_flow, now_s, estimator)
        if found is None:
            return seen
        return _with(seen, combined_kg_s=found[0], combined_std_dev_kg_s=found[1])

    def corrected(self, mean_flow: Flow, now_s: float, estimator: FlowEstimator) -> tuple[float, float] | None:
        """The mean force's flow corrected by the recent scales of shape and kernels; see `ChannelScales.corrected`."""
        return self._scales.corrected(mean_flow, now_s, estimator)

    def channels(self, now_s: float, estimator: FlowEstimator) -> OtherChannels:
        """The current accuracy of shape and kernels for the published flow; none while they contradict the mean force."""
        return OtherChannels() if self.last.contradiction else self._scales.channels(now_s, estimator)

    def _with_shape(
        self,
        seen: WaveformReading,
        fit: tuple[PatternWave, PulseEstimate],
        reading: Reading,
        mean_flow: Flow,
        estimator: FlowEstimator,
    ) -> WaveformReading:
        """The reading with a fit's flow, alone and combined; without where fit or mean force is outside the calibrated range."""
        wave, shape = fit
        parameters, pulses = estimator.parameters, self._fits.model(estimator)
        density, rate = parameters.values["density"], mean_flow.rate_kg_s
        relative_sd, flow = mean_flow.std_dev_kg_s / rate, shape.volume_flow_m3_s * density
        exponent = local_exponent(mean_flow)
        heap = self._heaps.moved_by(shape, reading, rate, estimator, pulses.model)
        together = combine(rate, relative_sd, flow, shape.relative_sd, exponent=exponent, parameters=parameters, heap=heap)
        of_mean = self._fits.outside(rate / density, reading, estimator)
        if not of_mean:
            # The law holds at the mean force's flow, so a shape whose flow is outside still contradicts the mean force.
            z = self._scales.difference.farther(together, pulses, wave, shape, rate / density)
            against = self._scales.difference.add(z, shape.misfit, reading.window.end_s, estimator)
            seen = _with(seen, contradiction=against, stretch=self._agreeing_stretch(shape, rate / density))
        if outside := of_mean or shape.outside:
            return _with(seen, shape=ShapeVerdict.OUTSIDE_CALIBRATION, shape_reason=outside)
        lasting_sd = sqrt(max(shape.relative_sd**2 - shape.random_sd**2, 0.0))
        self._scales.by_shape(Scale(log(flow / rate), lasting_sd, shape.random_sd, estimator, reading.window.end_s, heap))
        return _with(
            seen,
            shape=ShapeVerdict.USED,
            volume_m3_s=shape.volume_flow_m3_s,
            volume_std_dev_m3_s=shape.volume_flow_m3_s * shape.relative_sd,
            shape_kg_s=flow,
            shape_std_dev_kg_s=flow * hypot(shape.relative_sd, sqrt(relative_covariance(parameters)[0])),
        )

    def _weight_g(self, reading: Reading) -> float:
        """Mass of a thousand kernels, g: as recently received, else as last entered; 0: not known."""
        received_g = reading.inputs.fresh["thousand_kernel_weight"]
        return received_g if isfinite(received_g) else self.kernel_weight_g

    def _with_kernels(
        self, seen: WaveformReading, reading: Reading, kernels: KernelImpulse | None, missing: str
    ) -> WaveformReading:
        """The reading with the flow by kernel noise. missing: why there is no fit, without which pulses cannot be subtracted."""
        if kernels is None:
            early = missing or self._kernel_channel.missing
            return _with(seen, kernels=KernelVerdict.TOO_EARLY, kernels_reason=early)
        if not kernels.usable:
            return _with(seen, kernels=kernels.verdict, kernels_reason=kernels.reason)
        if not isfinite(seen.kernel_weight_g):
            return _with(seen, kernels=KernelVerdict.NO_KERNEL_WEIGHT, kernels_reason=_NO_WEIGHT)
        found = kernel_flow(
            kernels,
            reading.force_n,
            1e-6 * seen.kernel_weight_g,
            kernel_mass_sd=self._settings.kernel_mass_sd,
            settings=self._kernel_channel.noise,
        )
        return _with(
            seen,
            kernels_kg_s=found.mass_flow_kg_s,
            kernels_std_dev_kg_s=found.mass_flow_kg_s * found.relative_sd,
            kernels=KernelVerdict.USED,
        )

    def _agreeing_bias(self, over_mean_force: float) -> float:
        """The kernel bias that would give the mean force's flow, median over windows; the flow is proportional to its inverse."""
        self._biases.append(self._settings.kernel_bias / over_mean_force)
        return median(self._biases)

    def _agreeing_stretch(self, shape: PulseEstimate, volume_flow_m3_s: float) -> float:
        """The stretch that the fit would have at a given volume flow, by its covariance; median over windows."""
        flow, stretch = (shape.names.index(name) for name in ("log_volume_flow", "log_stretch"))
        slope = shape.covariance[flow, stretch] / shape.covariance[flow, flow]
        moved = shape.values["log_stretch"] + slope * log(volume_flow_m3_s / shape.volume_flow_m3_s)
        self._stretches.append(exp(moved) * (1.0 if self._settings.shape_terms else self._settings.stretch))
        return median(self._stretches)
