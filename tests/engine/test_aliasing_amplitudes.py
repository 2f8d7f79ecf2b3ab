"""What a slow sensor costs, against the pulses of the virtual combine, whose physics is a program of its own."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from yieldmon.engine.sampling.aliasing import aliasing_share
from yieldmon.engine.sources import SampleSource
from yieldmon.physics.machine import Machine
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine

MACHINE = Machine()
RPM = 400.0
PATTERN_HZ = RPM * 2.0 * pi / 60.0 * MACHINE.sprocket_pitch_radius_m / MACHINE.pattern_length_m
WARM_UP_S, LENGTH_S = 14, 20


@pytest.fixture(scope="module")
def amplitudes() -> list[float]:
    """Of eight harmonics of the pattern over the mean force, by Fourier's transform of 20 s at 12 kg/s."""
    pieces = [{"kind": "steady", "duration_s": 1e5, "flow_kg_s": 12.0}]
    chosen = scenario.from_mapping({"flow": {"pieces": pieces}, "duration_s": 40.0}, "aliasing")
    combine = VirtualCombine(chosen, MACHINE, 5)
    frames = [frame for frame in combine.frames_until(WARM_UP_S + LENGTH_S) if frame.message == "ImpactSensorSamples"]
    samples = np.array([[frame.signals[f"Sample{place}"] for place in range(4)] for frame in frames], dtype=float).ravel()
    force = samples[1000 * WARM_UP_S :] - float(np.mean(combine.truth.columns["zero_mv"]))
    window = np.hanning(force.size)
    power = np.abs(np.fft.rfft((force - force.mean()) * window)) ** 2
    hz = np.fft.rfftfreq(force.size, 1e-3)
    near = (np.abs(hz - order * PATTERN_HZ) < 0.3 * PATTERN_HZ for order in range(1, 9))
    return [float(sqrt(4.0 * power[band].sum() / (force.size * (window**2).sum())) / force.mean()) for band in near]


@pytest.mark.parametrize("order", range(1, 9))
@pytest.mark.parametrize("time_constant_s", [0.0, 0.004])
def test_a_harmonic_at_the_sampling_rate_is_seen_whole(amplitudes: list[float], order: int, time_constant_s: float) -> None:
    """Sampled at its own frequency it looks like a constant force; its multiples do too, and the others hardly get through."""
    source = SampleSource("Slow", ("Sample",), 1.0 / (order * PATTERN_HZ), time_constant_s=time_constant_s)
    share = aliasing_share(source, MACHINE, RPM * 2.0 * pi / 60.0)
    whole = 0.0
    for place, amplitude in enumerate(amplitudes, 1):
        lag = 2.0 * pi * place * PATTERN_HZ * time_constant_s
        if place % order == 0:
            whole += 0.5 * amplitude**2 / (1.0 + lag**2)
    assert share == pytest.approx(sqrt(whole), rel=0.08, abs=0.02)
