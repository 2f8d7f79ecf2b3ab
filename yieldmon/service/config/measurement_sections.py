"""Sections of the configuration file about how a second is measured and counted; the defaults are the engine's own."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import THOUSAND_KERNELS_G
from yieldmon.service.config.section import Section, choice, quantity

_ENGINE = EngineSettings()
_C = _ENGINE.clock


class Clock(Section):
    """Checks of the frames' time stamps."""

    max_gap_s: float = quantity(
        _C.max_gap_s, 2.0, 3600.0, "s", "a longer step forward between frames means that the clock was set forward"
    )
    backstep_tolerance_s: float = quantity(
        _C.backstep_tolerance_s,
        0.0,
        1.0,
        "s",
        "a longer step back means that the clock was set back, a shorter one frames out of order",
    )


_W = _ENGINE.windows


class Windows(Section):
    """The one-second results."""

    grid_offset_s: float = quantity(
        _W.grid_offset_s, 0.0, 0.9, "s", "windows end this long after each full second, for the delay of bus and sensor"
    )
    max_ramp_s: float = quantity(_W.max_ramp_s, 0.1, 0.5, "s", "longest weighted edge of a window")
    min_coverage: float = quantity(_W.min_coverage, 0.05, 1.0, "1", "a window with less sample coverage has no result")
    full_coverage: float = quantity(_W.full_coverage, 0.5, 1.0, "1", "a window with less sample coverage is degraded")
    saturated_share: float = quantity(
        _W.saturated_share, 0.0, 1.0, "1", "share of samples at the range limit from which a window is saturated"
    )
    plausible_full_scales: float = quantity(
        _W.plausible_full_scales, 1.0, 100.0, "full scales", "samples beyond this are ignored as impossible"
    )
    paddle_scatter: float = quantity(_W.paddle_scatter, 0.0, 1.0, "1", "expected relative scatter of the paddles' momentum")
    scatter_prior_patterns: float = quantity(
        _W.scatter_prior_patterns,
        0.0,
        1000.0,
        "patterns",
        "weight of that expectation, in repeats of the paddle pattern",
    )
    scatter_memory_patterns: float = quantity(
        _W.scatter_memory_patterns, 50.0, 1e5, "patterns", "repeats of the pattern over which the scatter is estimated"
    )
    min_force_std_dev_n: float = quantity(
        _W.min_force_std_dev_n, 0.0, 10.0, "N", "minimum standard deviation of a window's mean force"
    )


_I = _ENGINE.inputs


class Inputs(Section):
    """How long the last value of an input may be used."""

    sensor_timeout_s: float = quantity(_I.sensor_timeout_s, 0.01, 1.0, "s", "impact samples")
    speed_timeout_s: float = quantity(_I.speed_timeout_s, 0.1, 10.0, "s", "elevator speed")
    feedback_timeout_s: float = quantity(_I.feedback_timeout_s, 0.1, 10.0, "s", "plate angle and actuator state")
    condition_timeout_s: float = quantity(_I.condition_timeout_s, 1.0, 600.0, "s", "moisture, temperature and test weight")
    scale_timeout_s: float = quantity(_I.scale_timeout_s, 1.0, 600.0, "s", "tank mass and its status")
    vehicle_timeout_s: float = quantity(_I.vehicle_timeout_s, 0.2, 600.0, "s", "position, course, speed, states of the machine")
    held_angle_std_dev_deg: float = quantity(
        _I.held_angle_std_dev_deg,
        0.0,
        30.0,
        "deg",
        "standard deviation of a resting plate's angle while its feedback is missing",
    )


_Z = _ENGINE.zero


class Zero(Section):
    """Zero-load voltage of the impact sensor."""

    first_zero_windows: int = quantity(
        _Z.first_zero_windows, 1, 60, "s", "empty seconds averaged for the first zero and by `yieldmon zero`"
    )
    first_pulse_limit_mv: float = quantity(
        _Z.first_pulse_limit_mv, 0.1, 1000.0, "mV", "largest pulses accepted as vibration before the first zero"
    )
    level_range_mv: float = quantity(_Z.level_range_mv, 0.0, 1000.0, "mV", "largest range of the seconds' means for a zero")
    settle_windows: int = quantity(
        _Z.settle_windows, 1, 600, "s", "empty seconds before the zero follows slow drift; also the averaging time of the pulses"
    )
    pulse_margin_mv: float = quantity(
        _Z.pulse_margin_mv, 0.0, 1000.0, "mV", "averaged pulses that differ more from the vibration mean grain"
    )
    pulse_margin: float = quantity(
        _Z.pulse_margin, 0.0, 100.0, "1", "the same relative to the vibration; the larger limit applies"
    )
    window_pulse_margin_mv: float = quantity(
        _Z.window_pulse_margin_mv, 0.0, 1000.0, "mV", "one second's pulses that exceed the empty ones by more mean grain"
    )
    window_pulse_margin: float = quantity(
        _Z.window_pulse_margin, 1.0, 100.0, "1", "the same as a factor; the larger limit applies"
    )
    follow_time_s: float = quantity(_Z.follow_time_s, 1.0, 3600.0, "s", "time constant of following")
    max_rate_mv_s: float = quantity(_Z.max_rate_mv_s, 0.0, 100.0, "mV/s", "fastest change of the zero")
    max_step_mv: float = quantity(_Z.max_step_mv, 0.1, 4000.0, "mV", "empty seconds further off are ignored")
    drift_limit_mv: float = quantity(_Z.drift_limit_mv, 0.1, 4000.0, "mV", "difference from the first zero that sets ZeroDrifted")


_G = _ENGINE.gate


class Gate(Section):
    """Detection of grain and harvest."""

    grain_on_n: float = quantity(_G.grain_on_n, 0.01, 1000.0, "N", "mean force, with pulses, from which grain is present")
    grain_off_n: float = quantity(_G.grain_off_n, 0.0, 1000.0, "N", "mean force below which grain is absent")
    certain_force_n: float = quantity(_G.certain_force_n, 0.1, 1000.0, "N", "mean force that means grain even without pulses")
    off_windows: int = quantity(_G.off_windows, 1, 600, "s", "seconds without grain before the state is not harvesting")
    emptying_s: float = quantity(
        _G.emptying_s, 0.0, 600.0, "s", "not harvesting after this long with header up or machine stopped"
    )
    min_ground_speed_m_s: float = quantity(_G.min_ground_speed_m_s, 0.0, 10.0, "m/s", "a slower machine is stopped")
    min_turning_rpm: float = quantity(_G.min_turning_rpm, 0.0, 250.0, "rpm", "a slower elevator is stopped")


_T = _ENGINE.totals


class Totals(Section):
    """Load and total mass."""

    moisture_reference_pct: float | None = quantity(
        _T.moisture_reference_pct,
        0.0,
        40.0,
        "%",
        "market moisture for dry mass, wet basis; null: the crop's (no crop: corn's)",
    )
    credit_below_reference: bool = choice(
        _T.credit_below_reference,
        "drier grain counts as more than its wet mass; false: as its wet mass",
    )
    new_load: Literal["switch", "tank_scale", "command"] = choice(
        _T.new_load, "what else begins a load: input unloading (switch), tank mass stable at half (tank_scale), nothing (command)"
    )
    unloading_s: float = quantity(
        _T.unloading_s, 1.0, 600.0, "s", "shorter unloading ends no load; shorter pauses do not end unloading"
    )


_U = _ENGINE.budget


class Budget(Section):
    """Further errors in the standard deviations of flow and mass, besides noise and parameters."""

    zero_mv: float = quantity(_U.zero_mv, 0.0, 100.0, "mV", "standard deviation of a new or followed zero")
    zero_drift_mv_per_root_h: float = quantity(
        _U.zero_drift_mv_per_root_h, 0.0, 100.0, "mV per root hour", "its growth until the elevator runs empty again"
    )
    moisture_per_pct: float = quantity(
        _U.moisture_per_pct,
        0.0,
        0.2,
        "per percentage point",
        "relative error of flow from a moisture that the model does not include",
    )
    unmeasured_moisture_pct: float = quantity(
        _U.unmeasured_moisture_pct, 0.0, 20.0, "percentage points", "standard deviation of an unmeasured moisture"
    )


_Q = _ENGINE.flow_filter


class FlowFilter(Section):
    """Smoothing of the published flow; totals are not smoothed."""

    enabled: bool = choice(_Q.enabled, "false: no smoothing")
    steady_walk: float = quantity(_Q.steady_walk, 1e-6, 1.0, "1/s", "relative change of a steady flow from second to second")
    trend_change: float = quantity(_Q.trend_change, 1e-6, 1.0, "1/s", "the same for the trend of a rising or falling flow")
    jump: float = quantity(_Q.jump, 1e-3, 10.0, "1", "relative standard deviation of a jump")
    stay: float = quantity(_Q.stay, 0.34, 0.9999, "1", "probability that a flow keeps rising or falling")
    min_flow_kg_s: float = quantity(_Q.min_flow_kg_s, 0.01, 25.0, "kg/s", "no smoothing below this")


_F = _ENGINE.faults


class Faults(Section):
    """Limits of faults without a section of their own."""

    stuck_windows: int = quantity(_F.stuck_windows, 1, 600, "s", "seconds of equal samples that set SensorStuck")
    calibration_old_s: float = quantity(_F.calibration_old_s, 3600.0, 1e9, "s", "age of the calibration that sets CalibrationOld")
    mass_near_end: float = quantity(_F.mass_near_end, 0.1, 1.0, "1", "share of a mass signal's range that sets MassNearEnd")
    clock_jump_hold_windows: int = quantity(_F.clock_jump_hold_windows, 1, 3600, "s", "duration of ClockJumped")
    scale_disagrees_p: float = quantity(
        _F.scale_disagrees_p, 1e-9, 0.05, "1", "p-value below which a weighed mass contradicts the calibration"
    )
    scale_agrees_p: float = quantity(
        _F.scale_agrees_p, 1e-6, 0.5, "1", "p-value from which a weighed mass agrees with the calibration again"
    )
    zero_missing_s: float = quantity(_F.zero_missing_s, 5.0, 3600.0, "s", "running time without a zero that sets ZeroMissing")


_V = _ENGINE.waveform


class Waveform(Section):
    """Flow from pulse shape and kernel noise, in addition to the mean force."""

    enabled: bool = choice(_V.enabled, "evaluate single samples")
    combine: bool = choice(_V.combine, "publish the flow of mean force, shape and kernels combined")
    update_parameters: bool = choice(_V.update_parameters, "let kernel noise update the parameters")
    update_windows: int = quantity(_V.update_windows, 60, 100_000, "s", "time with grain between updates")
    harmonics: int = quantity(_V.harmonics, 4, 21, "harmonics", "harmonics of the paddle pattern")
    model_error: float = quantity(_V.model_error, 0.001, 0.5, "1", "relative error of the pulse model")
    friction_sd: float = quantity(_V.friction_sd, 0.001, 1.0, "1", "relative standard deviation of friction")
    shape_ratio_sd: float = quantity(_V.shape_ratio_sd, 0.001, 1.0, "1", "the same of the shape ratio")
    stretch: float = quantity(_V.stretch, 0.5, 3.0, "1", "duration of arrival relative to straight paths")
    stretch_sd: float = quantity(_V.stretch_sd, 0.0, 1.0, "1", "its relative standard deviation; 0.03 once calibrated")
    tail_s: float = quantity(_V.tail_s, 1e-4, 0.1, "s", "mean time that grain pushes after impact")
    tail_sd: float = quantity(_V.tail_sd, 0.0, 3.0, "1", "standard deviation of its logarithm")
    shape_terms: bool = choice(_V.shape_terms, "take stretch and tail from pulse_shape_file")
    response_error: float = quantity(_V.response_error, 0.001, 1.0, "1", "relative standard deviation of sensor.response_s")
    largest_misfit: float = quantity(_V.largest_misfit, 1.0, 1000.0, "1", "misfit above which pulses contradict")
    contradiction_windows: int = quantity(_V.contradiction_windows, 5, 3600, "s", "windows to compare")
    contradiction_z: float = quantity(_V.contradiction_z, 1.0, 20.0, "1", "difference, in standard deviations, that contradicts")
    hit_sd: float = quantity(_V.hit_sd, 0.0, 1.0, "1", "relative error that force and kernels share")
    thousand_kernel_weight_g: float = quantity(
        _V.thousand_kernel_weight_g, 0.0, THOUSAND_KERNELS_G[1], "g", "mass of a thousand kernels; 0: not known"
    )
    thousand_kernel_weights_g: dict[str, Annotated[float, Field(ge=THOUSAND_KERNELS_G[0], le=THOUSAND_KERNELS_G[1])]] = Field(
        default_factory=dict, description="the same by crop", json_schema_extra={"unit": "g"}
    )
    kernel_mass_sd: float = quantity(_V.kernel_mass_sd, 0.0, 1.0, "1", "its relative standard deviation")
    kernel_low_hz: float = quantity(_V.kernel_low_hz, 20.0, 5000.0, "Hz", "lowest frequency of kernel noise, above the pulses")
    kernel_high_hz: float = quantity(_V.kernel_high_hz, 20.0, 5000.0, "Hz", "highest frequency, below 1/contact time")
    kernel_bias: float = quantity(
        _V.kernel_bias, 0.2, 3.0, "1", "impulse of a kernel, relative to its mass times impulse per kilogram"
    )
    kernel_bias_sd: float = quantity(_V.kernel_bias_sd, 0.0, 1.0, "1", "its standard deviation")
    quiet_error: float = quantity(_V.quiet_error, 0.0, 1.0, "1", "relative standard deviation of background noise")
    samples_averaged: bool = choice(_V.samples_averaged, "samples are averages; false: instantaneous")
    quiet_windows: int = quantity(
        _V.quiet_windows, 1, 3600, "s", "windows of the empty machine, and of grain, before a first flow"
    )
    kernel_windows: int = quantity(_V.kernel_windows, 5, 3600, "s", "windows to average")
