"""What the samples of a window hold beside their mean: volume flow from the pulses' shape, and scale from the noise of kernels.

Runs beside the mean force's estimate and knows it only to compare; what it finds in a window corrects the flows of the windows
after it. Off unless the settings say otherwise.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, inf, isfinite, log, sqrt
from statistics import median

from yieldmon.engine.flow import Flow
from yieldmon.engine.kernel_channel import SEGMENT, KernelChannel
from yieldmon.engine.kernel_lessons import KernelLessons
from yieldmon.engine.measurement import Reading
from yieldmon.engine.quick import changer_of
from yieldmon.engine.records import FlowEstimator
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.shape_difference import NO_FIT, ShapeDifference
from yieldmon.engine.windows import Trace
from yieldmon.estimation import kernel_noise
from yieldmon.estimation.arrival_law import ArrivalLaw
from yieldmon.estimation.channel_combination import combine, heap_slope, relative_covariance, together_sd
from yieldmon.estimation.kernel_noise import KernelImpulse, KernelVerdict
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.pattern_fold import PatternWave, fold_all, harmonics_of_all
from yieldmon.estimation.pulse_fit import PulseEstimate
from yieldmon.estimation.pulse_model import PulseModel, PulseSettings
from yieldmon.estimation.pulse_shape import estimate, estimate_near
from yieldmon.estimation.shape_verdict import ShapeVerdict
from yieldmon.estimation.sweep_worth import OtherChannels
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

_NAN = float("nan")
_BINS = 64
_FITS = 1.0
"""Misfit below which a fit counts whose steps have not settled: within the model's own error."""
_WHOLE = 0.98
_FLOW_SD = 10.0
_ITERATIONS = 10
_SCALE_HOLDS_S = 600.0
"""How long the scale that shape or kernels have found counts where they determine nothing, as in a sweep."""
_MOST_SLOPES = 500
"""Kept at a time, of the mean force over the shape of heaps."""
_SEARCH_EVERY = 10
"""Windows from one search for pulses that fit nowhere to the next."""


@dataclass(frozen=True, slots=True)
class WaveformReading:
    """What a window's samples say; nan where they say nothing.

    volume_m3_s, volume_std_dev_m3_s: volume flow on the paddles. shape_kg_s, shape_std_dev_kg_s: the same times density, the
    density's standard deviation in it. shape, shape_reason: whether there is one, and why not. kernels_kg_s,
    kernels_std_dev_kg_s: from kernel noise. kernels, kernels_reason: whether it gives a flow, and why not. kernel_weight_g:
    of a thousand kernels, as used. mean_kg_s, mean_std_dev_kg_s: by the mean force alone. combined_kg_s,
    combined_std_dev_kg_s: all of them together. contradiction: of shape or kernel noise with the mean force, over the last
    windows; empty where they agree. stretch: the one with which the shape's flow would be that of the mean force, median over
    the same windows. bias: the same of kernel noise. wave: harmonics of the paddle pattern, None where there is no fit.
    """

    volume_m3_s: float = _NAN
    volume_std_dev_m3_s: float = _NAN
    shape: ShapeVerdict = ShapeVerdict.NOT_LOOKED_AT
    shape_reason: str = ""
    shape_kg_s: float = _NAN
    shape_std_dev_kg_s: float = _NAN
    kernels_kg_s: float = _NAN
    kernels_std_dev_kg_s: float = _NAN
    kernels: KernelVerdict = KernelVerdict.NOT_LOOKED_AT
    kernels_reason: str = ""
    kernel_weight_g: float = _NAN
    mean_kg_s: float = _NAN
    mean_std_dev_kg_s: float = _NAN
    combined_kg_s: float = _NAN
    combined_std_dev_kg_s: float = _NAN
    contradiction: str = ""
    stretch: float = _NAN
    bias: float = _NAN
    wave: PatternWave | None = None


NOTHING = WaveformReading()
_with = changer_of(WaveformReading)


@dataclass(frozen=True, slots=True)
class _Scale:
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


def _without(verdict: ShapeVerdict, reason: str, kernels: KernelVerdict = KernelVerdict.NOT_LOOKED_AT) -> WaveformReading:
    return WaveformReading(shape=verdict, shape_reason=reason, kernels=kernels, kernels_reason=reason)


_NO_TRACE = "samples are missing, or more than one sensor carries the plate"
_NO_ZERO = "no zero-load voltage, or the sensor is out of range"
_NO_GRAIN = "no grain"
_NOT_STILL = "no flow from the mean force, or the plate moves"
_NO_PULSES = "no pulse of the model fits the samples"
_FEW_TURNS = "the window holds fewer than two turns of the paddle pattern"
_NO_RANGE = "no pulse-shape file says for which loads and plate angles the shape is calibrated"
_NO_WEIGHT = "no thousand-kernel weight is known"


class Waveform:
    """Looks at one window after another."""

    def __init__(self, settings: WaveformSettings, machine: Machine) -> None:
        self.kernel_weight_g = settings.thousand_kernel_weight_g
        """Of a thousand kernels, as last entered; 0: not known. What a frame says goes before it."""
        self.last = NOTHING
        self._settings = settings
        self._machine = machine
        self._kernel_channel = KernelChannel(settings, machine)
        self.lessons = KernelLessons(settings)
        self._law = law_of(settings)
        self._pulses: PulseModel | None = None
        self._estimator: FlowEstimator | None = None
        self._prepared: dict[float, tuple[PatternWave, PulseEstimate]] = {}
        """Waves and fits by their windows' ends, and the estimator that they are of."""
        self._fitted_with: FlowEstimator | None = None
        self._searchable_in = 0
        self._difference = ShapeDifference(settings)
        self._stretches: deque[float] = deque(maxlen=settings.contradiction_windows)
        self._biases: deque[float] = deque(maxlen=settings.kernel_windows)
        self._of_shapes: deque[_Scale] = deque(maxlen=settings.contradiction_windows)
        self._of_kernels: _Scale | None = None
        self._heap_slopes: tuple[FlowEstimator, dict[tuple[float, ...], float]] | None = None

    def go_on_with(self, before: Waveform) -> None:
        """Noise that was heard on the same machine by the same settings is heard no second time."""
        if (self._settings, self._machine) == (before._settings, before._machine):
            self._kernel_channel, self.lessons = before._kernel_channel, before.lessons

    def prepare(self, readings: Sequence[Reading], rates_kg_s: Sequence[float], estimator: FlowEstimator) -> None:
        """Fit the pulses of these windows side by side, begun at the mean force's flow; `see` then takes them up one by one."""
        self._prepared.clear()
        near = [
            (reading, trace, zero, rate)
            for reading, rate in zip(readings, rates_kg_s, strict=True)
            if rate > 0.0 and _shows_pulses(reading)
            if (trace := reading.window.trace) is not None and (zero := reading.zero) is not None
        ]
        if not near:
            return
        pulses, gain = self._model(estimator), self._machine.sensor.gain_n_per_mv
        forces = [(trace.samples_mv - zero.zero_mv) * gain for _, trace, zero, _ in near]
        folded = fold_all(forces, [trace.phase for _, trace, *_ in near], bins=_BINS)
        whole = [place for place, pattern in enumerate(folded) if pattern.complete]
        windows = [near[place][0].window for place in whole]
        waves = harmonics_of_all(
            [folded[place] for place in whole],
            self._settings.harmonics,
            elevator_speeds_rad_s=[window.speed_rad_s for window in windows],
            plate_angles_rad=[window.plate_angle_rad for window in windows],
        )
        flows = [near[place][3] / estimator.parameters.values["density"] for place in whole]
        self._fitted_with = estimator
        for window, wave, found in zip(windows, waves, estimate_near(pulses, waves, flows, iterations=_ITERATIONS), strict=True):
            self._prepared[window.end_s] = wave, found

    def see(self, reading: Reading, flow: Flow, estimator: FlowEstimator) -> WaveformReading:
        """The window's own word beside flow, that of the mean force."""
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
            return _without(ShapeVerdict.NO_SAMPLES, _NO_ZERO)
        force_n = (trace.samples_mv - reading.zero.zero_mv) * self._machine.sensor.gain_n_per_mv
        if not reading.harvesting:
            self._kernel_channel.empty(force_n, trace.interval_s, reading.force_n)
            return _without(ShapeVerdict.NO_GRAIN, _NO_GRAIN)
        self._kernel_channel.grain()
        if not (flow.rate_kg_s > 0.0 and reading.still):
            return self._counted(_without(ShapeVerdict.NOT_STILL, _NOT_STILL), reading, flow, estimator)
        if reading.window.end_s not in self._prepared or estimator is not self._fitted_with:
            self.prepare((reading,), (flow.rate_kg_s,), estimator)
        shape = self._shape(reading, estimator)
        kernels = None
        if shape is not None:
            aligned = self._aligned(trace, shape, reading)
            kernels = self._kernel_channel.loaded(force_n, aligned, reading, flow.rate_kg_s, estimator)
        return self._judged(reading, flow, estimator, shape, kernels)

    def _shape(self, reading: Reading, estimator: FlowEstimator) -> PulseEstimate | None:
        """The fit to the window's pulses; where none was found near the mean force's flow, over all fills and shifts."""
        prepared = self._prepared.get(reading.window.end_s)
        if prepared is None:
            return None
        wave, found = prepared
        if _usable(found) and (found.misfit < self._settings.largest_misfit or self._searchable_in > 0):
            self._searchable_in = max(0, self._searchable_in - 1)
            return found
        if self._searchable_in > 0:
            self._searchable_in -= 1
            return None
        found = estimate(self._model(estimator), wave)
        fits = _usable(found) and found.misfit < self._settings.largest_misfit
        # A search over all fills and shifts costs as much as twenty fits; pulses that fit nowhere are not searched each second.
        self._searchable_in = 0 if fits else _SEARCH_EVERY - 1
        return found if _usable(found) else None

    def _model(self, estimator: FlowEstimator) -> PulseModel:
        if self._pulses is None or estimator is not self._estimator:
            self._pulses = pulse_model(self._settings, self._machine, estimator.parameters, self._law)
            self._estimator = estimator
        return self._pulses

    def _aligned(self, trace: Trace, shape: PulseEstimate, reading: Reading) -> Trace:
        """The samples with their phase counted from the pulses themselves: the phase from ten speeds a second creeps."""
        turns_per_s = self._machine.paddle_speed_m_s(reading.window.speed_rad_s) / self._machine.pattern_length_m
        return replace(trace, phase=trace.phase - shape.values["shift_s"] * turns_per_s)

    def _judged(
        self,
        reading: Reading,
        mean_flow: Flow,
        estimator: FlowEstimator,
        shape: PulseEstimate | None,
        kernels: KernelImpulse | None,
    ) -> WaveformReading:
        rate, std_dev = mean_flow.rate_kg_s, mean_flow.std_dev_kg_s
        seen = WaveformReading(mean_kg_s=rate, mean_std_dev_kg_s=std_dev, kernel_weight_g=self._weight_g(reading) or _NAN)
        if shape is not None and isfinite(shape.volume_flow_m3_s):
            seen = _with(seen, wave=self._prepared[reading.window.end_s][0])
            seen = self._with_shape(seen, shape, reading, mean_flow, estimator)
        elif reading.window.coverage < _WHOLE:
            seen = _with(seen, shape=ShapeVerdict.FEW_TURNS, shape_reason=_FEW_TURNS)
        elif of_mean := self._outside(rate / estimator.parameters.values["density"], reading, estimator):
            seen = _with(seen, shape=ShapeVerdict.OUTSIDE_CALIBRATION, shape_reason=of_mean)
        else:
            no_fit = self._difference.add(0.0, NO_FIT, reading.window.end_s, estimator)
            seen = _with(seen, shape=ShapeVerdict.NO_PULSES, shape_reason=_NO_PULSES, contradiction=no_fit)
        missing = seen.shape_reason if shape is None else ""
        seen = self._with_kernels(seen, reading, kernels, missing)
        if seen.kernels is KernelVerdict.USED:
            over, sd = seen.kernels_kg_s / rate, seen.kernels_std_dev_kg_s / seen.kernels_kg_s
            self._of_kernels = _Scale(log(over), sd, 0.0, estimator, reading.window.end_s)
            seen = _with(seen, bias=self._agreeing_bias(over))
            if reading.at_home and kernels is not None:
                self.lessons.add(seen.kernels_kg_s, sd, kernels.random_sd, reading)
        elif seen.kernels is not KernelVerdict.TOO_EARLY:
            self._of_kernels = None
        return self._counted(seen, reading, mean_flow, estimator)

    def _counted(self, seen: WaveformReading, reading: Reading, mean_flow: Flow, estimator: FlowEstimator) -> WaveformReading:
        """The reading with all channels together, and with what the kernels' scale says against the mean force's."""
        now_s = reading.window.end_s
        kernels = self._held_kernels(now_s, estimator)
        if kernels is not None and mean_flow.rate_kg_s > 0.0 and (against := self._kernels_contradict(kernels, mean_flow)):
            seen = _with(seen, contradiction=seen.contradiction or against)
        found = self.corrected(mean_flow, now_s, estimator)
        if found is None:
            return seen
        return _with(seen, combined_kg_s=found[0], combined_std_dev_kg_s=found[1])

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
        contradicts, hit = self._difference.contradicts, 1.0
        apart = 0.0 if contradicts else self._difference.deviations(now_s, estimator, _SCALE_HOLDS_S)
        corrected = apart > 1.0
        shapes = [scale for scale in self._of_shapes if self._holds(scale, now_s, estimator)]
        if shapes and not contradicts:
            mean = sum(scale.log_over_mean_force for scale in shapes) / len(shapes)
            shape_sd = hypot(shapes[-1].lasting_sd, sqrt(sum(scale.random_sd**2 for scale in shapes)) / len(shapes))
            exponent, parameters = _exponent(mean_flow), estimator.parameters
            heap = shapes[-1].heap
            both = combine(rate, lasting, rate * exp(mean), shape_sd, exponent=exponent, parameters=parameters, heap=heap)
            flow, sd, corrected = both.mass_flow_kg_s, both.relative_sd, True
            apart, hit = max(apart, abs(both.z)), 1.0 - both.weight
        kernels = self._held_kernels(now_s, estimator)
        # What teaches the parameters is in the mean force's flow already.
        if kernels is not None and not self._settings.teach and not self._kernels_contradict(kernels, mean_flow):
            over, over_sd = kernels.log_over_mean_force, kernels.lasting_sd
            weight = sd**2 / (sd**2 + over_sd**2)
            further = over - log(flow / rate)
            flow *= exp(weight * further)
            apart, hit = max(apart, abs(further) / hypot(sd, over_sd)), weight + (1.0 - weight) * hit
            sd, corrected = sd * over_sd / hypot(sd, over_sd), True
        if not corrected:
            return None
        return flow, flow * hypot(together_sd(sd, z=apart, hit=hit), _noise(mean_flow))

    def channels(self, now_s: float, estimator: FlowEstimator) -> OtherChannels:
        """What shape and kernels are worth to the published flow now; nothing of what contradicts the mean force."""
        if self.last.contradiction:
            return OtherChannels()
        shapes = [scale for scale in self._of_shapes if self._holds(scale, now_s, estimator)]
        kernels = self._held_kernels(now_s, estimator)
        by_shape, by_kernels = self._settings.combine and shapes, self._settings.combine or self._settings.teach
        return OtherChannels(
            shape_sd=shapes[-1].lasting_sd if by_shape else inf,
            kernels_sd=kernels.lasting_sd if kernels is not None and by_kernels else inf,
        )

    @staticmethod
    def _holds(scale: _Scale, now_s: float, estimator: FlowEstimator) -> bool:
        return scale.estimator is estimator and now_s - scale.time_s <= _SCALE_HOLDS_S

    def _with_shape(
        self, seen: WaveformReading, shape: PulseEstimate, reading: Reading, mean_flow: Flow, estimator: FlowEstimator
    ) -> WaveformReading:
        """A fit's flow, alone and with the mean force; none where either of them lies outside the calibrated range."""
        parameters = estimator.parameters
        density = parameters.values["density"]
        rate, relative_sd, flow = (
            mean_flow.rate_kg_s,
            mean_flow.std_dev_kg_s / mean_flow.rate_kg_s,
            shape.volume_flow_m3_s * density,
        )
        exponent = _exponent(mean_flow)
        heap = self._heap(shape, reading, rate, estimator)
        together = combine(rate, relative_sd, flow, shape.relative_sd, exponent=exponent, parameters=parameters, heap=heap)
        of_mean = self._outside(rate / density, reading, estimator)
        if not of_mean:
            # There the law holds, and a shape that finds itself outside speaks against the mean force all the same.
            wave = self._prepared[reading.window.end_s][0]
            z = self._difference.farther(together, self._model(estimator), wave, shape, rate / density)
            against = self._difference.add(z, shape.misfit, reading.window.end_s, estimator)
            seen = _with(seen, contradiction=against, stretch=self._agreeing_stretch(shape, rate / density))
        if outside := of_mean or shape.outside:
            return _with(seen, shape=ShapeVerdict.OUTSIDE_CALIBRATION, shape_reason=outside)
        lasting_sd = sqrt(max(shape.relative_sd**2 - shape.random_sd**2, 0.0))
        self._of_shapes.append(_Scale(log(flow / rate), lasting_sd, shape.random_sd, estimator, reading.window.end_s, heap))
        return _with(
            seen,
            shape=ShapeVerdict.USED,
            volume_m3_s=shape.volume_flow_m3_s,
            volume_std_dev_m3_s=shape.volume_flow_m3_s * shape.relative_sd,
            shape_kg_s=flow,
            shape_std_dev_kg_s=flow * hypot(shape.relative_sd, sqrt(relative_covariance(parameters)[0])),
        )

    def _heap(self, shape: PulseEstimate, reading: Reading, rate_kg_s: float, estimator: FlowEstimator) -> tuple[float, float]:
        """What one standard deviation of the heap's shape moves the mean force's flow and the shape's by, relative."""
        sd, window = self._settings.shape_ratio_sd, reading.window
        if not sd > 0.0:
            return 0.0, 0.0
        moisture = reading.inputs.fresh["moisture"]
        if self._heap_slopes is None or self._heap_slopes[0] is not estimator:
            self._heap_slopes = estimator, {}
        # It changes slowly: once for each tenth of flow, degree or so of the plate and 2 rad/s of the elevator.
        here = (
            round(log(rate_kg_s), 1),
            round(window.plate_angle_rad, 2),
            2 * round(0.5 * window.speed_rad_s),
            _per_cent(moisture),
        )
        slopes = self._heap_slopes[1]
        if len(slopes) > _MOST_SLOPES:
            slopes.clear()
        if here not in slopes:
            slopes[here] = heap_slope(
                self._model(estimator).model,
                estimator.parameters,
                mass_flow_kg_s=exp(here[0]),
                plate_angle_rad=here[1],
                elevator_speed_rad_s=here[2],
                moisture_pct=here[3],
            )
        flow, ratio = (shape.names.index(name) for name in ("log_volume_flow", "log_shape_ratio"))
        return slopes[here] * sd, float(shape.covariance[flow, ratio]) / sd

    def _outside(self, volume_flow_m3_s: float, reading: Reading, estimator: FlowEstimator) -> str:
        """Why the shape says nothing at a volume flow; empty where it does."""
        if self._settings.shape is None:
            return _NO_RANGE
        speed = reading.window.speed_rad_s
        fill = self._model(estimator).mean_fill(volume_flow_m3_s, speed)
        return self._law.outside(fill, reading.window.plate_angle_rad, speed)

    def _weight_g(self, reading: Reading) -> float:
        """Of a thousand kernels: as a frame says of late, else as last entered; 0: not known."""
        heard = reading.inputs.fresh["thousand_kernel_weight"]
        return heard if isfinite(heard) else self.kernel_weight_g

    def _with_kernels(
        self, seen: WaveformReading, reading: Reading, kernels: KernelImpulse | None, missing: str
    ) -> WaveformReading:
        """missing: why there is no fit, without which the pulses cannot be taken off."""
        if kernels is None:
            early = missing or self._kernel_channel.missing
            return _with(seen, kernels=KernelVerdict.TOO_EARLY, kernels_reason=early)
        if not kernels.usable:
            return _with(seen, kernels=kernels.verdict, kernels_reason=kernels.reason)
        if not isfinite(seen.kernel_weight_g):
            return _with(seen, kernels=KernelVerdict.NO_KERNEL_WEIGHT, kernels_reason=_NO_WEIGHT)
        found = kernel_noise.kernel_flow(
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
        """The bias with which kernel noise would give the mean force's flow; kernel noise is in proportion to it."""
        self._biases.append(self._settings.kernel_bias / over_mean_force)
        return median(self._biases)

    def _held_kernels(self, now_s: float, estimator: FlowEstimator) -> _Scale | None:
        """The scale by kernels, where it still holds."""
        found = self._of_kernels
        return found if found is not None and self._holds(found, now_s, estimator) else None

    def _kernels_contradict(self, found: _Scale, mean_flow: Flow) -> str:
        # The noise of many windows is in each: no median of windows is needed.
        z = found.log_over_mean_force / hypot(_lasting(mean_flow), found.lasting_sd)
        if not abs(z) > self._settings.contradiction_z:
            return ""
        return f"kernel noise and mean force differ by {abs(z):.1f} standard deviations"

    def _agreeing_stretch(self, shape: PulseEstimate, volume_flow_m3_s: float) -> float:
        """The stretch to which the window's posterior moves when the volume flow is given."""
        flow, stretch = (shape.names.index(name) for name in ("log_volume_flow", "log_stretch"))
        slope = shape.covariance[flow, stretch] / shape.covariance[flow, flow]
        moved = shape.values["log_stretch"] + slope * log(volume_flow_m3_s / shape.volume_flow_m3_s)
        self._stretches.append(exp(moved) * (1.0 if self._settings.shape_terms else self._settings.stretch))
        return median(self._stretches)


def _per_cent(moisture_pct: float) -> float:
    """Whole; one and the same nan where it is not known, so that it finds itself again."""
    return round(moisture_pct) if isfinite(moisture_pct) else _NAN


def _noise(mean_flow: Flow) -> float:
    """Of a window's mean force, relative to its flow."""
    noise = mean_flow.budget.noise_kg_s / mean_flow.rate_kg_s
    return noise if isfinite(noise) else 0.0


def _lasting(mean_flow: Flow) -> float:
    """Relative standard deviation of a flow but for that noise."""
    return sqrt(max((mean_flow.std_dev_kg_s / mean_flow.rate_kg_s) ** 2 - _noise(mean_flow) ** 2, 0.0))


def _shows_pulses(reading: Reading) -> bool:
    trace = reading.window.trace
    return trace is not None and trace.samples_mv.size >= SEGMENT and reading.in_range and reading.harvesting and reading.still


def pulse_model(settings: WaveformSettings, machine: Machine, parameters: ParameterSet, law: ArrivalLaw) -> PulseModel:
    """Pulses of a machine with these parameters' grain, which arrives by a law."""
    values = dict(parameters.values)
    values["friction"] = max(values["friction"], 0.02)
    sd = dict(PulseSettings().sd)
    sd |= {"log_friction": settings.friction_sd, "log_shape_ratio": settings.shape_ratio_sd}
    # The mean force only says where to begin: a prior that is felt would make the two channels one.
    sd |= {"log_cell": settings.response_error, "log_volume_flow": _FLOW_SD}
    return PulseModel(
        ForwardModel(machine, parameters.effects),
        values,
        PulseSettings(
            harmonics=settings.harmonics,
            model_error=settings.model_error,
            cell_response_s=machine.sensor.response_s,
            sd=sd,
            arrival=law,
        ),
    )


def law_of(settings: WaveformSettings) -> ArrivalLaw:
    """How grain arrives by the settings: by the terms of the pulse-shape file, or one stretch and tail over the file's range."""
    known = settings.shape or ArrivalLaw()
    if settings.shape_terms and settings.shape is not None:
        return known
    return replace(
        known,
        stretch=(log(settings.stretch),),
        tail=(log(settings.tail_s),),
        covariance=(settings.stretch_sd**2, settings.tail_sd**2, 0.0),
    )


def _usable(found: PulseEstimate) -> bool:
    """Steps that have not settled among nearly collinear parameters do not reject a fit; its residual does."""
    return found.converged or (isfinite(found.misfit) and found.misfit < _FITS)


def _exponent(flow: Flow) -> float:
    """d ln(force) / d ln(flow), from what the force's noise is worth in flow."""
    noise_kg_s, noise_n = flow.budget.noise_kg_s, flow.force_std_dev_n
    if not (noise_kg_s > 0.0 and noise_n > 0.0 and flow.force_n > 0.0) or flow.saturated:
        return 0.7
    return min(max(noise_n / noise_kg_s * flow.rate_kg_s / flow.force_n, 0.2), 1.5)
