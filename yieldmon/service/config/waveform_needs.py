"""What pulses' shape and kernel noise need of a sensor, held against a configuration before it runs."""

from __future__ import annotations

from yieldmon.engine.waveform.window_noise import SEGMENT
from yieldmon.estimation.waveform.kernel_noise import CLEAR_OF_ALIASES, KernelImpulse, KernelNoiseSettings, KernelVerdict
from yieldmon.estimation.waveform.kernel_reach import expected_impulse
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.config.configuration import Configuration

_FLOW_KG_S, _GRAIN_S = 8.0, 60.0
_NOISE_MV = 3.0
"""Standard deviation of an amplifier's samples."""
_CREST = 4.0
"""Mean square of paddles' pulses over the square of their mean."""
_USUAL_G = 350.0
"""Of a thousand kernels of maize, where none is configured."""
_SUITABLE = "a cell, or an accelerometer on the plate, that answers within 0.3 ms, sampled 1000 times a second or more"


def notes(configuration: Configuration) -> list[str]:
    """What the waveform will not give with this sensor, and what is not said that it needs.

    Parameters
    ----------
    configuration : Configuration

    Returns
    -------
    list of str
        A sentence each; none where the waveform is switched off.
    """
    settings, sensor = configuration.engine.waveform, configuration.machine.sensor
    sources = configuration.signals.sources.impact
    if not settings.enabled:
        return []
    if len(sources) != 1:
        return [f"waveform.enabled: {len(sources)} impact sensors carry the plate: neither shape nor kernel noise is evaluated"]
    found, rate_hz = [], sources[0].rate_hz
    if rate_hz < SEGMENT:
        return [
            f"waveform.enabled: {rate_hz:g} samples per second show neither the pulses' shape, which needs {SEGMENT}, nor kernel "
            f"noise, which needs {_SUITABLE}; the mean force alone will count"
        ]
    if not sensor.response_s > 0.0:
        found.append(
            "waveform.enabled: sensor.response_s of the machine file is 0, a cell without lag; a real lag is measured as extra "
            "grain (yieldmon calibrate --taps finds it)"
        )
    if sources[0].time_constant_s > 0.0:
        found.append(
            f"waveform.enabled: the sensor's filter of {1000.0 * sources[0].time_constant_s:g} ms counts as part of the cell: "
            "sensor.response_s of the machine file must hold both"
        )
    weights = [settings.thousand_kernel_weight_g, *settings.thousand_kernel_weights_g.values()]
    known_g = [weight for weight in weights if weight > 0.0]
    expected = _expected(configuration, 1.0 / rate_hz, max(known_g, default=_USUAL_G))
    if not expected.usable:
        found.append(
            f"waveform.enabled: kernel noise will give no flow: {_why(expected, configuration, rate_hz)}; it needs {_SUITABLE}"
        )
    elif not known_g and not any(source.quantity == "thousand_kernel_weight" for source in configuration.signals.sources.inputs):
        found.append(
            "waveform.enabled: kernel noise gives no flow without a thousand-kernel weight: waveform.thousand_kernel_weights_g, "
            "or yieldmon load start --thousand-kernel-weight with each load"
        )
    return found


def _expected(configuration: Configuration, interval_s: float, thousand_kernels_g: float) -> KernelImpulse:
    """Of a minute of a usual flow at home, with a quiet machine."""
    settings, machine, known = configuration.engine.waveform, configuration.machine, configuration.parameters
    at = Conditions(
        machine.home_plate_angle_rad, machine.nominal_elevator_speed_rad_s, mass_flow_kg_s=_FLOW_KG_S, moisture_pct=15.0
    )
    force_n = float(ForwardModel(machine, known.effects).force(at, known.values, overfull="nan").real)
    return expected_impulse(
        mean_force_n=force_n,
        impulse_n_s=1e-6 * thousand_kernels_g * force_n / _FLOW_KG_S,
        quiet_n2_hz=(_NOISE_MV * machine.sensor.gain_n_per_mv) ** 2 * interval_s,
        cell_response_s=machine.sensor.response_s,
        sample_interval_s=interval_s,
        duration_s=_GRAIN_S,
        settings=KernelNoiseSettings(
            low_hz=settings.kernel_low_hz,
            high_hz=settings.kernel_high_hz,
            quiet_error=settings.quiet_error,
            response_error=settings.response_error,
            averaged=settings.samples_averaged,
        ),
        segment=SEGMENT,
        crest=_CREST,
    )


def _why(expected: KernelImpulse, configuration: Configuration, rate_hz: float) -> str:
    low_hz = configuration.engine.waveform.kernel_low_hz
    if expected.verdict is KernelVerdict.NO_BAND and CLEAR_OF_ALIASES * rate_hz < low_hz:
        return f"{rate_hz:g} samples per second show nothing above {CLEAR_OF_ALIASES * rate_hz:g} Hz, it begins at {low_hz:g} Hz"
    cell_ms, known_pct = 1000.0 * configuration.machine.sensor.response_s, 100.0 * expected.relative_sd
    cell = f"behind a cell of {cell_ms:g} ms (sensor.response_s of the machine file)"
    if not known_pct < 100.0:
        return f"{cell} nothing is left of it"
    limit_pct = 100.0 * KernelNoiseSettings().largest_sd
    return f"{cell} {_FLOW_KG_S:g} kg/s for a minute would be known to {known_pct:.0f} %, and {limit_pct:.0f} % is the limit"
