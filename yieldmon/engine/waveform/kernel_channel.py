"""The impulse of a kernel, from the noise of recent windows with grain and of the empty machine."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import isfinite

import numpy as np

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.windows import Trace
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.waveform.window_noise import SEGMENT, LoadedSamples, LoadedWindow, WindowNoise, noise_of
from yieldmon.estimation.waveform import noise_by_phase, pulse_times, spectral_density
from yieldmon.estimation.waveform.kernel_noise import CLEAR_OF_ALIASES, KernelImpulse, KernelNoiseSettings, kernel_impulse
from yieldmon.estimation.waveform.noise_gain import power_gain
from yieldmon.estimation.waveform.noise_scatter import excess_scatter
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.running_pulses import RunningPulses
from yieldmon.estimation.waveform.spectral_density import Density
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

_APART = 3
"""Windows between grain and a window that counts as the empty machine."""
_CHANCE_SDS = 4.0
"""Deviations of a mean by its samples' noise that an empty machine's may be off, in addition to 1 mV; the zero is as noisy."""
_CHANGING = 0.1
"""Relative change of the mean force between windows above which the pulses of a window are not of one load."""

_BY_PHASE_EVERY = 5
"""One window in so many is evaluated for noise between the pulses, which is accurate enough."""
_EVERY, _GROWN = 10, 0.25
"""The mean over the windows kept moves slowly: it is formed anew after so many, or while there are few when they have grown by so
much. Pulses are taken off so many windows together."""


class KernelChannel:
    """Collects the noise of windows with grain and of the empty machine, and evaluates it."""

    def __init__(self, settings: WaveformSettings, machine: Machine) -> None:
        self._settings = settings
        self._machine = machine
        self.noise = KernelNoiseSettings(
            low_hz=settings.kernel_low_hz,
            high_hz=settings.kernel_high_hz,
            quiet_error=settings.quiet_error,
            response_error=settings.response_error,
            bias=settings.kernel_bias,
            bias_sd=settings.kernel_bias_sd,
            averaged=settings.samples_averaged,
        )
        self._pulses = RunningPulses()
        self._loaded: deque[WindowNoise] = deque(maxlen=settings.kernel_windows)
        self._samples: list[LoadedSamples] = []
        """Of the windows after those, until their pulses are taken off."""
        self._estimator: FlowEstimator | None = None
        self._apparent: KernelImpulse | None = None
        self._since_mean = 0
        """Windows kept since `_apparent` was computed."""
        self._until_by_phase = 0
        self._force_before_n = 0.0
        self._quiet: deque[Density] = deque(maxlen=settings.kernel_windows)
        self._quiet_mean: Density | None = None
        self._waiting: deque[Density] = deque()

    def empty(self, force_n: Array, interval_s: float, mean_force_n: float) -> None:
        """Add a window of the empty machine; it counts unless grain came shortly before or comes shortly after it."""
        chance_n = _CHANCE_SDS * float(np.std(force_n)) / force_n.size**0.5
        if not abs(mean_force_n) < self._machine.sensor.gain_n_per_mv + chance_n:
            self._waiting.clear()
            return
        self._waiting.append(spectral_density.density(force_n, interval_s, segment=SEGMENT))
        if len(self._waiting) > 2 * _APART:
            self._quiet.append(self._waiting[_APART])
            self._quiet_mean = None
            self._waiting.popleft()

    def grain(self) -> None:
        """Grain has come: the last windows do not count as empty."""
        self._waiting.clear()

    @property
    def missing(self) -> str:
        """What is still to be measured, in words; "" where both empty machine and grain have been measured for long enough."""
        needed, empty, loaded = self._settings.quiet_windows, len(self._quiet), self._kept_windows
        if min(empty, loaded) >= needed:
            return ""
        return f"{empty} s of the empty machine and {loaded} s of steady grain measured, {needed} s of each needed"

    @property
    def _kept_windows(self) -> int:
        return min(len(self._loaded) + len(self._samples), self._settings.kernel_windows)

    def _changed(self, force_n: float) -> bool:
        before, self._force_before_n = self._force_before_n, force_n
        return not abs(force_n - before) < _CHANGING * force_n

    def loaded(
        self, force_n: Array, trace: Trace, wave: PatternWave, reading: Reading, flow_kg_s: float, estimator: FlowEstimator
    ) -> KernelImpulse | None:
        """The impulse of a kernel in a window with grain, and add the window's noise.

        A kernel's impulse varies with load, plate angle and speed as that of a kilogram does, so the mean force's model relates
        earlier windows to this one, and its scale cancels. Only windows with the plate at home count, because the kernels' own
        scatter over angles is unknown.

        Parameters
        ----------
        force_n : ndarray
            Of the samples, N, (n,).
        trace : Trace
        wave : PatternWave
            Phases of trace and wave are counted from the fitted pulses.
        reading : Reading
        flow_kg_s : float
            By the mean force.
        estimator : FlowEstimator

        Returns
        -------
        KernelImpulse or None
            None until enough windows with pulses like earlier ones, and enough of the empty machine, have been measured.
        """
        if estimator is not self._estimator:
            self._estimate_anew(estimator, trace.interval_s)
        if reading.at_home:
            self._keep_noise(force_n, trace, wave, reading, flow_kg_s)
        if len(self._samples) >= _EVERY:
            self._take_pulses_off(trace.interval_s)
        if min(len(self._quiet), self._kept_windows) < self._settings.quiet_windows:
            return None
        if self._apparent is None or self._since_mean >= min(_EVERY, _GROWN * (self._kept_windows - self._since_mean)):
            self._take_pulses_off(trace.interval_s)
            self._apparent, self._since_mean = self._apparent_mass(trace.interval_s), 0
        return replace(self._apparent, impulse_n_s=self._apparent.impulse_n_s * reading.force_n / flow_kg_s)

    def _apparent_mass(self, interval_s: float) -> KernelImpulse:
        """A kernel's impulse relative to that of a kilogram, over the windows kept."""
        densities = [noise.density for noise in self._loaded]
        weights = [shown.averages for shown in densities]
        sizes = [noise.window.force_n * noise.window.impulse_per_kg for noise in self._loaded]
        per_kg = sum(w * size for w, size in zip(weights, sizes, strict=True))
        low_hz, high_hz = self._band_hz(interval_s)
        return kernel_impulse(
            spectral_density.pooled(densities),
            self._empty_noise(),
            per_kg / sum(weights),
            cell_response_s=self._machine.sensor.response_s,
            sample_interval_s=interval_s,
            settings=self.noise,
            steady_share=self._steady_share(interval_s),
            scatter=excess_scatter(densities, self._empty_noise(), sizes, low_hz=low_hz, high_hz=high_hz),
            misplaced=self._misplaced(interval_s),
        )

    def _steady_share(self, interval_s: float) -> float:
        """Share of the windows' noise above that of the empty machine that is also present between the pulses."""
        low_hz, high_hz = self._band_hz(interval_s)
        shown = [(noise.by_phase, noise) for noise in self._loaded if noise.by_phase is not None]
        if not (high_hz > low_hz and shown):
            return 0.0
        empty = self._empty_noise()
        speeds = [noise.window.speed_rad_s for _, noise in shown]
        return noise_by_phase.steady_noise(
            [by_phase for by_phase, _ in shown],
            [noise.window.impulse_per_kg for _, noise in shown],
            quiet_n2=noise_by_phase.band_power(empty.frequency_hz, empty.density, low_hz, high_hz),
            pattern_s=self._machine.pattern_length_m / self._machine.paddle_speed_m_s(sum(speeds) / len(speeds)),
            interval_s=interval_s,
            low_hz=low_hz,
            high_hz=high_hz,
        ).share

    def _misplaced(self, interval_s: float) -> float:
        """Share of the windows' noise above that of the empty machine that comes from pulses at irregular times."""
        shown = [(noise.times, noise) for noise in self._loaded if noise.times is not None]
        if not shown:
            return 0.0
        empty, (low_hz, high_hz) = self._empty_noise(), self._band_hz(interval_s)
        band = (empty.frequency_hz >= low_hz) & (empty.frequency_hz <= high_hz)
        if not band.any():
            return 0.0
        # Both signs of the frequency.
        spacing_hz = 2.0 * float(empty.frequency_hz[1] - empty.frequency_hz[0])
        gain = power_gain(
            empty.frequency_hz[band], self._machine.sensor.response_s, interval_s, averaged=self._settings.samples_averaged
        )
        power = [spacing_hz * float((noise.density.density - empty.density)[band].sum()) for _, noise in shown]
        felt_n = spacing_hz * float(gain.sum()) * sum(noise.window.force_n for _, noise in shown)
        return pulse_times.misplaced_share([times for times, _ in shown], sum(power) / felt_n, power)

    def _band_hz(self, interval_s: float) -> tuple[float, float]:
        return self.noise.low_hz, min(self.noise.high_hz, CLEAR_OF_ALIASES / interval_s)

    def _keep_noise(self, force_n: Array, trace: Trace, wave: PatternWave, reading: Reading, flow_kg_s: float) -> None:
        """Keep the noise of a window, unless its flow is changing."""
        window, changed = reading.window, self._changed(reading.force_n)
        kind = {
            "mean_force_n": reading.force_n,
            "plate_angle_rad": window.plate_angle_rad,
            "elevator_speed_rad_s": window.speed_rad_s,
        }
        phase = trace.phase - self._pulses.late_turns(wave.amplitudes_n, **kind)
        like = self._pulses.take(force_n, phase, **kind)
        if like is None or changed:
            return
        mean, own_variance = like
        heard = LoadedWindow(
            reading.force_n, window.plate_angle_rad, window.speed_rad_s, reading.inputs.fresh["moisture"], flow_kg_s
        )
        by_phase = self._until_by_phase == 0
        self._until_by_phase = (self._until_by_phase - 1) % _BY_PHASE_EVERY
        self._samples.append(LoadedSamples(heard, force_n, phase, mean, own_variance, by_phase))
        self._since_mean += 1

    def _take_pulses_off(self, interval_s: float) -> None:
        """The noise of the windows whose samples wait."""
        self._loaded.extend(noise_of(self._samples, self._machine, interval_s, self._band_hz(interval_s)))
        self._samples.clear()

    def _estimate_anew(self, estimator: FlowEstimator, interval_s: float) -> None:
        """Compute the flows of the windows kept again, by another estimator."""
        self._take_pulses_off(interval_s)
        self._estimator, self._apparent = estimator, None
        if not self._loaded:
            return
        windows = [noise.window for noise in self._loaded]
        columns = np.array([(w.force_n, w.plate_angle_rad, w.speed_rad_s, 0.0, w.moisture_pct) for w in windows]).T
        flows = np.broadcast_to(estimator.estimate(*columns).mass_flow_kg_s, len(windows)).tolist()
        kept = [
            replace(noise, window=replace(noise.window, flow_kg_s=flow))
            for noise, flow in zip(self._loaded, flows, strict=True)
            if isfinite(flow) and flow > 0.0
        ]
        self._loaded.clear()
        self._loaded.extend(kept)

    def _empty_noise(self) -> Density:
        if self._quiet_mean is None:
            self._quiet_mean = spectral_density.pooled(list(self._quiet))
        return self._quiet_mean
