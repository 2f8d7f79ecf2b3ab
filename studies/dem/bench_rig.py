"""The bench rig: one paddle in a closed housing, thrown once, its response summed.

Source: "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), section 10.3, appendices S, T. The paddle turns with its
load in the closed housing; an optical pulse counts revolutions; after 40 of them a solenoid, held for 1 s, lets the whole
housing go; the sensor is sampled fast; its no-load mean is taken off and what is left is summed over the throw.

`BenchRig` is the sequence alone: events in with their time, states out. It knows no clock, pin or grain.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BenchSettings:
    """The published sequence. Times in s.

    no_load_s: record before the release that gives the zero. recording_s: how long after the release the throw may last.
    pulse_timeout_s: longest time between revolutions before the rig gives up.
    """

    release_after_revolutions: int = 40
    debounce_s: float = 0.010
    solenoid_on_s: float = 1.0
    sampling_hz: float = 1.0e5
    no_load_s: float = 0.5
    recording_s: float = 1.0
    pulse_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        if self.release_after_revolutions < 1:
            raise ValueError(f"release_after_revolutions is {self.release_after_revolutions}, expected at least 1")
        for key in ("solenoid_on_s", "sampling_hz", "no_load_s", "recording_s", "pulse_timeout_s"):
            if not getattr(self, key) > 0.0:
                raise ValueError(f"{key} is {getattr(self, key)}, expected a value above 0")
        if not 0.0 <= self.debounce_s < self.pulse_timeout_s:
            raise ValueError(f"debounce_s is {self.debounce_s}, expected 0 to below {self.pulse_timeout_s} s")


class BenchState(StrEnum):
    """Where the sequence is."""

    IDLE = "idle"
    COUNTING = "counting"
    RELEASING = "releasing"
    """The solenoid is held."""
    RECORDING = "recording"
    """The solenoid is off again; the throw may still be going on."""
    DONE = "done"
    FAULT = "fault"


class BenchRig:
    """The rig's sequence: start, count, release, record.

    Give it every edge of the optical sensor and call `tick` now and then; times in s, never going back.
    """

    def __init__(self, settings: BenchSettings) -> None:
        self._settings = settings
        self._state = BenchState.IDLE
        self._revolutions = 0
        self._last_pulse_s: float | None = None
        self._pulse_times_s: list[float] = []
        self._started_s = 0.0
        self._release_s: float | None = None
        self._now_s = float("-inf")
        self._fault = ""

    @property
    def state(self) -> BenchState:
        return self._state

    @property
    def revolutions(self) -> int:
        """Pulses counted since the start."""
        return self._revolutions

    @property
    def solenoid_on(self) -> bool:
        return self._state is BenchState.RELEASING

    @property
    def release_s(self) -> float | None:
        """When the solenoid was switched on, or None."""
        return self._release_s

    @property
    def fault(self) -> str:
        """Why the rig gave up; empty when it has not."""
        return self._fault

    @property
    def elevator_speed_rad_s(self) -> float | None:
        """Mean speed over the revolutions counted before the release, or None before the second pulse."""
        if len(self._pulse_times_s) < 2:
            return None
        turns = len(self._pulse_times_s) - 1
        return 2.0 * np.pi * turns / (self._pulse_times_s[-1] - self._pulse_times_s[0])

    def start(self, time_s: float) -> None:
        """Begins to count. Raises RuntimeError when a throw is under way."""
        if self._state in (BenchState.COUNTING, BenchState.RELEASING, BenchState.RECORDING):
            raise RuntimeError(f"bench rig is {self._state}, expected idle, done or fault before a start")
        self._advance(time_s)
        self._state = BenchState.COUNTING
        self._revolutions = 0
        self._last_pulse_s = None
        self._pulse_times_s = []
        self._started_s = time_s
        self._release_s = None
        self._fault = ""

    def optical_edge(self, time_s: float) -> bool:
        """A rising edge of the optical sensor; whether it counted as a revolution.

        An edge within debounce_s of the last counted one is contact bounce.
        """
        self.tick(time_s)
        if self._state is not BenchState.COUNTING:
            return False
        if self._last_pulse_s is not None and time_s - self._last_pulse_s < self._settings.debounce_s:
            return False
        self._last_pulse_s = time_s
        self._pulse_times_s.append(time_s)
        self._revolutions += 1
        if self._revolutions == self._settings.release_after_revolutions:
            self._state = BenchState.RELEASING
            self._release_s = time_s
        return True

    def tick(self, time_s: float) -> BenchState:
        """Lets time pass; the state then."""
        self._advance(time_s)
        s = self._settings
        if self._state is BenchState.COUNTING:
            since = self._started_s if self._last_pulse_s is None else self._last_pulse_s
            if time_s - since > s.pulse_timeout_s:
                self._state = BenchState.FAULT
                counted = f"{self._revolutions} of {s.release_after_revolutions}"
                self._fault = f"no revolution for {s.pulse_timeout_s:g} s after {counted}"
        if self._release_s is not None:
            passed = time_s - self._release_s
            if self._state is BenchState.RELEASING and passed >= s.solenoid_on_s:
                self._state = BenchState.RECORDING
            if self._state is BenchState.RECORDING and passed >= s.recording_s:
                self._state = BenchState.DONE
        return self._state

    def _advance(self, time_s: float) -> None:
        if time_s < self._now_s:
            raise ValueError(f"time went back from {self._now_s} to {time_s} s")
        self._now_s = time_s


@dataclass(frozen=True, slots=True)
class Response:
    """What the rig reports of a throw. sum: in the samples' unit; zero, noise_sd: of the no-load samples; saturated: samples at
    full scale."""

    sum: float
    impulse: float
    zero: float
    noise_sd: float
    saturated: int


def response(samples: Array, first_s: float, release_s: float, settings: BenchSettings, full_scale: float = np.inf) -> Response:
    """Sums the sensor's samples over the throw, less their no-load mean.

    samples: (n,) at settings.sampling_hz, the first at first_s. `sum` is in sample units, as published; `impulse` is that sum
    times the sampling interval, which does not depend on the rate. Raises ValueError when the record lacks the no-load time
    before the release or the throw after it.
    """
    interval = 1.0 / settings.sampling_hz
    at_release = round((release_s - first_s) / interval)
    no_load = round(settings.no_load_s / interval)
    recording = round(settings.recording_s / interval)
    if at_release - no_load < 0 or at_release + recording > len(samples):
        raise ValueError(
            f"record of {len(samples)} samples with the release at sample {at_release}, expected {no_load} before it and "
            f"{recording} after it"
        )
    before = samples[at_release - no_load : at_release]
    throw = samples[at_release : at_release + recording]
    zero = float(before.mean())
    total = float((throw - zero).sum())
    return Response(total, total * interval, zero, float(before.std(ddof=1)), int((throw >= full_scale).sum()))


@dataclass(frozen=True, slots=True)
class BenchSensor:
    """Force cell and amplifier of the rig: V per N, offset, white noise per sample, full scale."""

    volt_per_n: float = 0.01
    zero_v: float = 0.5
    noise_v: float = 0.02
    full_scale_v: float = 10.0


@dataclass(frozen=True, slots=True)
class BenchOptics:
    """The revolution pulse: extra edges that follow each true one within bounce_s, and the solenoid's delay."""

    bounces: int = 2
    bounce_s: float = 0.004
    solenoid_delay_s: float = 0.015


@dataclass(frozen=True, slots=True)
class BenchThrow:
    """One simulated throw as the rig saw it, and the truth beside it."""

    response: Response
    revolutions: int
    elevator_speed_rad_s: float
    true_impulse_n_s: float


def simulate(
    force_n: Array,
    elevator_speed_rad_s: float,
    rng: np.random.Generator,
    settings: BenchSettings | None = None,
    sensor: BenchSensor | None = None,
    optics: BenchOptics | None = None,
) -> BenchThrow:
    """Runs the whole sequence around a throw whose force on the plate is known.

    force_n: (n,) horizontal force at settings.sampling_hz, from the moment the housing opens. Raises ValueError when the throw is
    longer than the recording, RuntimeError when the rig ends in a fault.
    """
    settings, sensor, optics = settings or BenchSettings(), sensor or BenchSensor(), optics or BenchOptics()
    interval = 1.0 / settings.sampling_hz
    period = 2.0 * np.pi / elevator_speed_rad_s
    rig = BenchRig(settings)
    rig.start(0.0)
    for turn in range(settings.release_after_revolutions):
        pulse = (turn + 1) * period
        for edge in [pulse, *np.sort(pulse + rng.uniform(0.0, optics.bounce_s, optics.bounces))]:
            rig.optical_edge(float(edge))
    if rig.release_s is None or rig.elevator_speed_rad_s is None:
        raise RuntimeError(f"bench rig {rig.state}: {rig.fault or 'no release'}")
    opening = optics.solenoid_delay_s
    first = rig.release_s - settings.no_load_s
    count = round((settings.no_load_s + settings.recording_s) / interval)
    force = np.zeros(count)
    at = round((settings.no_load_s + opening) / interval)
    if at + len(force_n) > count:
        raise ValueError(f"throw of {len(force_n) * interval:g} s, expected at most {settings.recording_s - opening:g} s")
    force[at : at + len(force_n)] = force_n
    volts = sensor.zero_v + sensor.volt_per_n * force + rng.normal(0.0, sensor.noise_v, count)
    volts = np.clip(volts, 0.0, sensor.full_scale_v)
    rig.tick(rig.release_s + max(settings.recording_s, settings.solenoid_on_s))
    if rig.state is not BenchState.DONE:
        raise RuntimeError(f"bench rig {rig.state}: {rig.fault}")
    result = response(volts, first, rig.release_s, settings, sensor.full_scale_v)
    return BenchThrow(result, rig.revolutions, rig.elevator_speed_rad_s, float(force_n.sum() * interval))
