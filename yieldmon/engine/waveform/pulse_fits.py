"""Fits of the paddles' pulses to the windows' samples, started at the mean force's flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite, log

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.windows import Trace
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.waveform.window_noise import SEGMENT
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.waveform.arrival_law import ArrivalLaw
from yieldmon.estimation.waveform.pattern_fold import PatternWave, fold_all, harmonics_of_all, later
from yieldmon.estimation.waveform.pulse_fit import PulseEstimate
from yieldmon.estimation.waveform.pulse_model import PulseModel, PulseSettings
from yieldmon.estimation.waveform.pulse_shape import estimate, estimate_near
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

_BINS = 64
_FITS = 1.0
"""Misfit below which a fit counts even if its steps have not converged: it is within the model's own error."""
_FLOW_SD = 10.0
_ITERATIONS = 10
_SEARCH_EVERY = 10
"""Windows between two full searches, while no pulses fit."""
_NO_RANGE = "no pulse-shape file says for which loads and plate angles the shape is calibrated"


class PulseFits:
    """Fits several windows together, and returns each window's fit on request."""

    def __init__(self, settings: WaveformSettings, machine: Machine) -> None:
        self._settings = settings
        self._machine = machine
        self._law = law_of(settings)
        self._model: PulseModel | None = None
        self._model_of: FlowEstimator | None = None
        self._prepared: dict[float, tuple[PatternWave, PulseEstimate]] = {}
        """Waves and fits by end of window, made with `_fitted_with`."""
        self._fitted_with: FlowEstimator | None = None
        self._searchable_in = 0

    def prepare(self, readings: Sequence[Reading], rates_kg_s: Sequence[float], estimator: FlowEstimator) -> None:
        """Fit the pulses of these windows together; `of` returns them one by one. rates_kg_s: by the mean force."""
        self._prepared.clear()
        near = [
            (reading, trace, zero, rate)
            for reading, rate in zip(readings, rates_kg_s, strict=True)
            if rate > 0.0 and _shows_pulses(reading)
            if (trace := reading.window.trace) is not None and (zero := reading.zero) is not None
        ]
        if not near:
            return
        pulses, gain = self.model(estimator), self._machine.sensor.gain_n_per_mv
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

    def of(self, reading: Reading, rate_kg_s: float, estimator: FlowEstimator) -> tuple[PatternWave, PulseEstimate] | None:
        """A window's wave and the fit to it; if none is found near the mean force's flow, by a search over all fills and shifts.

        rate_kg_s: by the mean force. None without a complete pattern, and where nothing fits.
        """
        if reading.window.end_s not in self._prepared or estimator is not self._fitted_with:
            self.prepare((reading,), (rate_kg_s,), estimator)
        prepared = self._prepared.get(reading.window.end_s)
        if prepared is None:
            return None
        wave, found = prepared
        if _usable(found) and (found.misfit < self._settings.largest_misfit or self._searchable_in > 0):
            self._searchable_in = max(0, self._searchable_in - 1)
            return prepared
        if self._searchable_in > 0:
            self._searchable_in -= 1
            return None
        found = estimate(self.model(estimator), wave)
        fits = _usable(found) and found.misfit < self._settings.largest_misfit
        # A full search costs as much as twenty fits, so it is not repeated every second while nothing fits.
        self._searchable_in = 0 if fits else _SEARCH_EVERY - 1
        return (wave, found) if _usable(found) else None

    def model(self, estimator: FlowEstimator) -> PulseModel:
        """The pulse model with an estimator's parameters."""
        if self._model is None or estimator is not self._model_of:
            self._model = pulse_model(self._settings, self._machine, estimator.parameters, self._law)
            self._model_of = estimator
        return self._model

    def aligned(self, trace: Trace, wave: PatternWave, shape: PulseEstimate, reading: Reading) -> tuple[Trace, PatternWave]:
        """Samples and wave with their phase counted from the fitted pulses, because the phase integrated from the speed
        drifts."""
        turns_per_s = self._machine.paddle_speed_m_s(reading.window.speed_rad_s) / self._machine.pattern_length_m
        late = shape.values["shift_s"] * turns_per_s
        return Trace(trace.samples_mv, trace.phase - late, trace.interval_s), later(wave, -late)

    def outside(self, volume_flow_m3_s: float, reading: Reading, estimator: FlowEstimator) -> str:
        """Why the shape gives no flow at a volume flow; "" where it does."""
        if self._settings.shape is None:
            return _NO_RANGE
        speed = reading.window.speed_rad_s
        fill = self.model(estimator).mean_fill(volume_flow_m3_s, speed)
        return self._law.outside(fill, reading.window.plate_angle_rad, speed)


def _shows_pulses(reading: Reading) -> bool:
    trace = reading.window.trace
    return trace is not None and trace.samples_mv.size >= SEGMENT and reading.in_range and reading.harvesting and reading.still


def pulse_model(settings: WaveformSettings, machine: Machine, parameters: ParameterSet, law: ArrivalLaw) -> PulseModel:
    """The pulse model of a machine with these parameters' grain and an arrival law."""
    values = dict(parameters.values)
    values["friction"] = max(values["friction"], 0.02)
    sd = dict(PulseSettings().sd)
    sd |= {"log_friction": settings.friction_sd, "log_shape_ratio": settings.shape_ratio_sd}
    # The mean force only gives the start: an informative prior would make the two channels dependent.
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
    """The arrival law by the settings: with the terms of the pulse-shape file, or with one stretch and tail over the file's
    range."""
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
    """Whether a fit can be used. Steps that have not converged among nearly collinear parameters do not exclude it; its misfit
    does."""
    return found.converged or (isfinite(found.misfit) and found.misfit < _FITS)
