"""The shape of the configuration file: sections and keys with type, range, unit and meaning.

Defaults of the engine's keys are the engine's own. A key's unit is in its name; `quantity` repeats it for messages and
for the comments of the shipped file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.settings import EngineSettings
from yieldmon.physics.grain import GRAIN

_ENGINE = EngineSettings()


def quantity(default: Any, low: float, high: float, unit: str, meaning: str) -> Any:
    """A number from `low` to `high`."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def text(default: str | None, meaning: str, max_length: int = 200) -> Any:
    """A word or path."""
    return Field(default, max_length=max_length, pattern=r"^[^\x00-\x1f]*$", description=meaning)


def choice(default: Any, meaning: str) -> Any:
    """True or false, or one of a few words."""
    return Field(default, description=meaning)


class Section(BaseModel):
    """Common rules: no unknown keys, no silent conversion, no infinities."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Bus(Section):
    """The CAN bus, through python-can."""

    interface: str = text("socketcan", "python-can interface: socketcan, udp_multicast, virtual, pcan, kvaser ...")
    channel: str = text("can0", "channel of that interface")
    bitrate_bit_s: int | None = quantity(
        None,
        10_000,
        1_000_000,
        "bit/s",
        "for interfaces that set it; null leaves it alone (SocketCAN: the system sets it)",
    )
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further options for that interface, as python-can names them"
    )
    receive_buffer_bytes: int = quantity(
        4 * 1024 * 1024, 65_536, 64 * 1024 * 1024, "bytes", "SocketCAN receive buffer to ask the kernel for"
    )
    receive_queue_frames: int = quantity(20_000, 1_000, 1_000_000, "frames", "frames that may wait for the engine")
    transmit_queue_frames: int = quantity(200, 20, 10_000, "frames", "frames that may wait for the bus; the oldest go first")
    transmit_max_age_s: float = quantity(
        0.5, 0.05, 60.0, "s", "older frames are not sent: a late command is worse than none, a late figure passes for fresh"
    )
    idle_after_s: float = quantity(5.0, 0.5, 600.0, "s", "no frame at all for this long means that the bus is idle")


class Outputs(Section):
    """What is sent beside DM1 and the network's own frames."""

    shipped: bool = choice(True, "send the messages of the shipped DBC")
    signals: dict[str, Any] = Field(
        default_factory=dict, description="published quantities in messages of any DBC, by quantity (docs/guide/wiring.md)"
    )


class Store(Section):
    """Records, totals and state on disk."""

    path: str = text("yieldmon.sqlite", "file; relative paths are under the service's state folder")
    record_hours: float = quantity(2000.0, 1.0, 1e5, "h", "hours of one-second records to keep")
    size_mb: float = quantity(512.0, 16.0, 1e5, "MB", "limit for the file; the oldest one-second records make room")
    event_rows: int = quantity(100_000, 100, 10_000_000, "rows", "sweeps, faults and tickets to keep, each")
    pending_seconds: int = quantity(
        3600, 10, 100_000, "s", "seconds to hold in memory while the disk fails; totals are kept for longer"
    )


class Status(Section):
    """Status of the daemon, for this machine."""

    socket: str = text("yieldmon.sock", "UNIX socket of `yieldmon status`; relative paths are under the runtime folder")
    group: str | None = text(None, "group that may use the socket (mode 0660); null: the daemon's user only (0600)")
    prometheus_file: str | None = text(None, "text file for Prometheus' node exporter, rewritten each interval; null: none")
    prometheus_interval_s: float = quantity(15.0, 1.0, 3600.0, "s", "interval of that file")


class Diagnostics(Section):
    """J1939 DM1, active trouble codes."""

    dm1_enabled: bool = choice(True, "send faults as DM1 beside YieldMonitorStatus")


class Network(Section):
    """J1939 and ISO 11783: our NAME and address, and whom we answer."""

    enabled: bool = choice(True, "claim an address and answer requests; false: frames leave from the DBC's addresses")
    preferred_address: int = quantity(131, 0, 253, "1", "address to claim; another one is taken when it is lost")
    identity_number: int | None = quantity(
        None, 0, 2_097_151, "1", "of the NAME, unique among units of one maker; null: from this computer's machine id"
    )
    manufacturer_code: int = quantity(0, 0, 2047, "1", "of the NAME, as SAE assigns them")
    ecu_instance: int = quantity(0, 0, 7, "1", "of the NAME")
    function_instance: int = quantity(0, 0, 31, "1", "of the NAME; distinguishes several monitors on one machine")
    function: int = quantity(135, 0, 255, "1", "of the NAME; 135 with vehicle system 17: product mass")
    vehicle_system: int = quantity(17, 0, 127, "1", "of the NAME, ISO 11783's device class; 17: sensor systems")
    vehicle_system_instance: int = quantity(0, 0, 15, "1", "of the NAME")
    industry_group: int = quantity(2, 0, 7, "1", "of the NAME; 2: agriculture")
    arbitrary_address_capable: bool = choice(True, "take another address when the preferred one is lost; false: be silent then")
    obey_commanded_address: bool = choice(False, "let other nodes give us another address")
    task_controller: bool = choice(False, "connect to an ISO 11783-10 task controller, which then records our yield")


class Logging(Section):
    """What goes to standard error, which the service manager keeps."""

    level: Literal["debug", "info", "warning", "error"] = choice("info", "least severe message to show")


_C = _ENGINE.clock


class Clock(Section):
    """Trust in the bus's time stamps."""

    max_gap_s: float = quantity(_C.max_gap_s, 2.0, 3600.0, "s", "longer forward steps between frames are a clock set forward")
    backstep_tolerance_s: float = quantity(
        _C.backstep_tolerance_s,
        0.0,
        1.0,
        "s",
        "longer backward steps are a clock set back, shorter ones frames out of order",
    )


_W = _ENGINE.windows


class Windows(Section):
    """The one-second results."""

    grid_offset_s: float = quantity(
        _W.grid_offset_s, 0.0, 0.9, "s", "windows end this long after each full second: the delay of chain and sensor"
    )
    max_ramp_s: float = quantity(_W.max_ramp_s, 0.1, 0.5, "s", "longest edge of a window")
    min_coverage: float = quantity(_W.min_coverage, 0.05, 1.0, "1", "share of a window below which no mean is published")
    full_coverage: float = quantity(_W.full_coverage, 0.5, 1.0, "1", "share of a window below which the result is degraded")
    saturated_share: float = quantity(_W.saturated_share, 0.0, 1.0, "1", "share of samples at the range's end that is too many")
    plausible_full_scales: float = quantity(
        _W.plausible_full_scales, 1.0, 100.0, "full scales", "a sample beyond this is no voltage the sensor can give"
    )
    paddle_scatter: float = quantity(_W.paddle_scatter, 0.0, 1.0, "1", "expected scatter of one paddle's momentum over its mean")
    scatter_prior_patterns: float = quantity(
        _W.scatter_prior_patterns,
        0.0,
        1000.0,
        "patterns",
        "weight of that expectation, in repeats of the paddle pattern",
    )
    scatter_memory_patterns: float = quantity(
        _W.scatter_memory_patterns, 50.0, 1e5, "patterns", "repeats of the pattern over which the scatter is learnt"
    )
    min_force_std_dev_n: float = quantity(
        _W.min_force_std_dev_n, 0.0, 10.0, "N", "floor for the standard deviation of a window's mean force"
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
        "uncertainty of a resting plate's angle while its feedback is silent",
    )


_Z = _ENGINE.zero


class Zero(Section):
    """Zero-load voltage of the impact sensor."""

    first_zero_windows: int = quantity(
        _Z.first_zero_windows, 1, 60, "s", "empty seconds averaged for the first zero and by `yieldmon zero`"
    )
    first_pulse_limit_mv: float = quantity(
        _Z.first_pulse_limit_mv, 0.1, 1000.0, "mV", "largest amplitude taken for vibration before any was learnt"
    )
    level_range_mv: float = quantity(
        _Z.level_range_mv, 0.0, 1000.0, "mV", "largest range of the seconds' means in learning a zero"
    )
    settle_windows: int = quantity(
        _Z.settle_windows, 1, 600, "s", "empty seconds before the zero follows; pulses are averaged over as many"
    )
    pulse_margin_mv: float = quantity(
        _Z.pulse_margin_mv, 0.0, 1000.0, "mV", "departure of averaged pulses from the vibration that means grain"
    )
    pulse_margin: float = quantity(
        _Z.pulse_margin, 0.0, 100.0, "1", "the same as a share of the vibration; the larger of the two holds"
    )
    window_pulse_margin_mv: float = quantity(
        _Z.window_pulse_margin_mv, 0.0, 1000.0, "mV", "excess of one second's pulses over those seen empty"
    )
    window_pulse_margin: float = quantity(
        _Z.window_pulse_margin, 1.0, 100.0, "1", "the same as a factor; the larger of the two holds"
    )
    follow_time_s: float = quantity(_Z.follow_time_s, 1.0, 3600.0, "s", "time constant of the following")
    max_rate_mv_s: float = quantity(_Z.max_rate_mv_s, 0.0, 100.0, "mV/s", "fastest change of the zero")
    max_step_mv: float = quantity(_Z.max_step_mv, 0.1, 4000.0, "mV", "an empty second further off moves nothing")
    drift_limit_mv: float = quantity(_Z.drift_limit_mv, 0.1, 4000.0, "mV", "distance from the first zero that is a fault")


_G = _ENGINE.gate


class Gate(Section):
    """When flow is measured and when the machine is not harvesting."""

    grain_on_n: float = quantity(_G.grain_on_n, 0.01, 1000.0, "N", "mean force from which, with pulses, grain is present")
    grain_off_n: float = quantity(_G.grain_off_n, 0.0, 1000.0, "N", "mean force below which grain is gone")
    certain_force_n: float = quantity(_G.certain_force_n, 0.1, 1000.0, "N", "mean force that means grain even without pulses")
    off_windows: int = quantity(_G.off_windows, 1, 600, "s", "seconds without grain before the state is not harvesting")
    emptying_s: float = quantity(_G.emptying_s, 0.0, 600.0, "s", "header up or standing for this long is not harvest")
    min_ground_speed_m_s: float = quantity(_G.min_ground_speed_m_s, 0.0, 10.0, "m/s", "slower than this is standing")
    min_turning_rpm: float = quantity(_G.min_turning_rpm, 0.0, 250.0, "rpm", "slower than this the elevator stands")


_T = _ENGINE.totals


class Totals(Section):
    """Load and total mass."""

    moisture_reference_pct: float | None = quantity(
        _T.moisture_reference_pct,
        0.0,
        40.0,
        "%",
        "market moisture for dry mass, wet basis; null: the crop's, corn's where none is named",
    )
    credit_below_reference: bool = choice(
        _T.credit_below_reference,
        "true: grain drier than that counts as more than its wet mass; false: as its wet mass",
    )
    new_load: Literal["switch", "tank_scale", "command"] = choice(
        _T.new_load, "what begins a load, beside the command: input unloading, tank mass fallen to half, nothing"
    )
    unloading_s: float = quantity(
        _T.unloading_s, 1.0, 600.0, "s", "shorter unloading ends no load; without any for this long it is over"
    )


_U = _ENGINE.budget


class Budget(Section):
    """What the standard deviations of flow and mass include beside noise and the parameters' covariance."""

    zero_mv: float = quantity(_U.zero_mv, 0.0, 100.0, "mV", "standard deviation of a zero when it is taken or followed")
    zero_drift_mv_per_root_h: float = quantity(
        _U.zero_drift_mv_per_root_h, 0.0, 100.0, "mV per root hour", "its growth while the elevator never runs empty"
    )
    moisture_per_pct: float = quantity(
        _U.moisture_per_pct, 0.0, 0.2, "per percentage point", "relative error of flow with a moisture that is not followed"
    )
    unmeasured_moisture_pct: float = quantity(
        _U.unmeasured_moisture_pct, 0.0, 20.0, "percentage points", "standard deviation of a moisture that is not measured"
    )


_Q = _ENGINE.flow_filter


class FlowFilter(Section):
    """Smoothing of the published flow; totals do not pass through it."""

    enabled: bool = choice(_Q.enabled, "false: no smoothing")
    steady_walk: float = quantity(_Q.steady_walk, 1e-6, 1.0, "1/s", "relative change from second to second of a steady flow")
    trend_change: float = quantity(_Q.trend_change, 1e-6, 1.0, "1/s", "the same of the trend of a rising or falling flow")
    jump: float = quantity(_Q.jump, 1e-3, 10.0, "1", "relative standard deviation of a jump")
    stay: float = quantity(_Q.stay, 0.34, 0.9999, "1", "probability that the flow goes on as it was")
    min_flow_kg_s: float = quantity(_Q.min_flow_kg_s, 0.01, 25.0, "kg/s", "no smoothing below this")


_P = _ENGINE.plate


class Plate(Section):
    """Limits of plate commands, inside the range of the machine file."""

    fixed_angle_deg: float | None = quantity(
        _P.fixed_angle_deg, 10.0, 170.0, "deg", "angle of a plate that is bolted on: no feedback needed, no sweep; null: it turns"
    )
    max_rate_deg_s: float = quantity(_P.max_rate_deg_s, 0.5, 90.0, "deg/s", "fastest change of the target")
    command_interval_s: float = quantity(_P.command_interval_s, 0.02, 1.0, "s", "between commands while driving")
    at_target_tolerance_deg: float = quantity(_P.at_target_tolerance_deg, 0.05, 5.0, "deg", "feedback this near is on target")


_S = _ENGINE.sweep


class Sweep(Section):
    """Self-calibration sweeps of the plate."""

    enabled: bool = choice(_S.enabled, "drive the plate at all")
    interval_s: float = quantity(_S.interval_s, 60.0, 1e6, "s", "between sweeps")
    first_after_s: float = quantity(_S.first_after_s, 0.0, 1e6, "s", "harvesting time before the first sweep")
    angles_deg: list[float] = Field(
        default=list(_S.angles_deg), min_length=1, max_length=50, description="angles to visit, in the machine's range",
        json_schema_extra={"unit": "deg"},
    )  # fmt: skip
    home_every: int = quantity(_S.home_every, 1, 50, "angles", "the plate returns home after this many")
    windows_per_step: int = quantity(_S.windows_per_step, 1, 60, "s", "seconds measured at each angle")
    min_flow_kg_s: float = quantity(_S.min_flow_kg_s, 0.1, 25.0, "kg/s", "least flow for a sweep")
    steady_windows: int = quantity(_S.steady_windows, 2, 600, "s", "seconds of steady flow before a sweep")
    steady_cv: float = quantity(_S.steady_cv, 0.001, 1.0, "1", "largest standard deviation over mean in them")
    flow_change: float = quantity(_S.flow_change, 0.01, 1.0, "1", "change of flow at home that ends a sweep")
    flow_change_away: float = quantity(_S.flow_change_away, 0.01, 10.0, "1", "the same at other angles")
    speed_change: float = quantity(_S.speed_change, 0.001, 1.0, "1", "change of elevator speed that ends a sweep")
    move_margin_s: float = quantity(_S.move_margin_s, 0.1, 60.0, "s", "beyond travel / rate the plate is not following")
    settle_s: float = quantity(_S.settle_s, 0.0, 60.0, "s", "time on target before measuring")
    settle_timeout_s: float = quantity(_S.settle_timeout_s, 0.5, 120.0, "s", "longest wait for it")
    measure_timeout_s: float = quantity(_S.measure_timeout_s, 1.0, 600.0, "s", "longest time at one angle")
    signal_trend: float = quantity(
        _S.signal_trend, 0.5, 100.0, "standard errors", "difference of a window's halves that is not yet settled"
    )
    return_timeout_s: float = quantity(_S.return_timeout_s, 0.5, 120.0, "s", "longest way home")
    home_rest_s: float = quantity(_S.home_rest_s, 0.0, 600.0, "s", "rest away from home before the plate is taken home")
    home_retry_s: float = quantity(
        _S.home_retry_s, 1.0, 1e5, "s", "wait before the plate is taken home again after it did not get there"
    )
    backoff_s: float = quantity(_S.backoff_s, 1.0, 1e5, "s", "wait after an aborted sweep; doubles up to the interval")
    feedback_plausibility_flow_spread: float = quantity(
        _S.feedback_plausibility_flow_spread, 0.0, 5.0, "1", "spread of ln(flow) over a sweep from which the feedback is doubted"
    )
    feedback_plausibility_force_ratio: float = quantity(
        _S.feedback_plausibility_force_ratio,
        0.0,
        1.0,
        "1",
        "the plate did not move if the force spreads less than this share of that",
    )
    max_std_dev_factor: float = quantity(
        _S.max_std_dev_factor, 1.0, 10.0, "1", "widening of the standard deviation of flow away from home"
    )


_F = _ENGINE.faults


class Faults(Section):
    """Limits that belong to no other section."""

    stuck_windows: int = quantity(_F.stuck_windows, 1, 600, "s", "seconds of equal samples before the sensor counts as stuck")
    calibration_old_s: float = quantity(_F.calibration_old_s, 3600.0, 1e9, "s", "age from which the calibration is old")
    mass_near_end: float = quantity(
        _F.mass_near_end, 0.1, 1.0, "1", "share of the largest mass that a signal carries from which that is a fault"
    )
    clock_jump_hold_windows: int = quantity(_F.clock_jump_hold_windows, 1, 3600, "s", "how long ClockJumped is shown")
    scale_disagrees_p: float = quantity(
        _F.scale_disagrees_p, 1e-9, 0.05, "1", "probability below which a weighed mass contradicts the calibration"
    )
    scale_agrees_p: float = quantity(
        _F.scale_agrees_p, 1e-6, 0.5, "1", "probability from which a weighed mass agrees with the calibration again"
    )
    zero_missing_s: float = quantity(
        _F.zero_missing_s, 5.0, 3600.0, "s", "time with the elevator running and no zero after which that is a fault"
    )


_A = _ENGINE.anchors


class Anchors(Section):
    """Reference masses from a tank scale."""

    min_increment_kg: float = quantity(_A.min_increment_kg, 10.0, 1e5, "kg", "least gain of the tank that is a reference")
    scale_std_dev_kg: float = quantity(_A.scale_std_dev_kg, 0.1, 1e4, "kg", "standard deviation of the scale")
    unloading_kg: float = quantity(_A.unloading_kg, 1.0, 1e4, "kg", "fall of the tank mass that is unloading")
    keep: int = quantity(_A.keep, 1, 10_000, "references", "newest references to keep")


_D = _ENGINE.disagreement


class Disagreement(Section):
    """When the residuals of several sweeps show that the model lacks an effect: the fault ModelDisagrees."""

    keep_sweeps: int = quantity(_D.keep_sweeps, 2, 200, "sweeps", "newest sweeps that are looked at together")
    least_sweeps: int = quantity(_D.least_sweeps, 2, 200, "sweeps", "fewer give no verdict")
    tolerance: float = quantity(_D.tolerance, 0.0, 0.5, "1", "tolerated relative model error at a plate angle")
    begin_p: float = quantity(_D.begin_p, 0.0, 0.5, "1", "probability of such a pattern by chance below which the fault is shown")
    end_p: float = quantity(_D.end_p, 0.0, 1.0, "1", "probability above which it is withdrawn")


_V = _ENGINE.waveform


class Waveform(Section):
    """Flow from the pulses' shape and from kernel noise, beside the mean force; off until proven on the machine."""

    enabled: bool = choice(_V.enabled, "evaluate the samples themselves")
    combine: bool = choice(_V.combine, "publish and count mean force and shape together")
    harmonics: int = quantity(_V.harmonics, 4, 21, "harmonics", "of the paddle pattern that are fitted")
    model_error: float = quantity(_V.model_error, 0.001, 0.5, "1", "the pulse model's own error, relative")
    friction_sd: float = quantity(_V.friction_sd, 0.001, 1.0, "1", "relative deviation of friction")
    shape_ratio_sd: float = quantity(_V.shape_ratio_sd, 0.001, 1.0, "1", "relative deviation of the heap's shape ratio")
    stretch: float = quantity(_V.stretch, 0.5, 3.0, "1", "arrival's time over that of straight paths")
    stretch_sd: float = quantity(_V.stretch_sd, 0.0, 1.0, "1", "relative deviation; 0.03 once calibrated")
    tail_s: float = quantity(_V.tail_s, 1e-4, 0.1, "s", "mean time for which grain pushes after striking")
    tail_sd: float = quantity(_V.tail_sd, 0.0, 3.0, "1", "deviation of its logarithm")
    shape_terms: bool = choice(_V.shape_terms, "stretch and tail by pulse_shape_file instead")
    response_error: float = quantity(_V.response_error, 0.001, 1.0, "1", "relative deviation of the cell's response_s")
    largest_misfit: float = quantity(_V.largest_misfit, 1.0, 1000.0, "1", "misfit above which pulses contradict")
    contradiction_windows: int = quantity(_V.contradiction_windows, 5, 3600, "s", "windows compared")
    contradiction_z: float = quantity(_V.contradiction_z, 1.0, 20.0, "1", "standard deviations that contradict")
    thousand_kernel_weight_g: float = quantity(
        _V.thousand_kernel_weight_g, 0.0, 2000.0, "g", "mass of a thousand kernels; 0: not known"
    )
    thousand_kernel_weights_g: dict[str, Annotated[float, Field(ge=1.0, le=2000.0)]] = Field(
        default_factory=dict, description="the same by crop", json_schema_extra={"unit": "g"}
    )
    kernel_mass_sd: float = quantity(_V.kernel_mass_sd, 0.0, 1.0, "1", "relative deviation of that weight")
    kernel_low_hz: float = quantity(_V.kernel_low_hz, 20.0, 5000.0, "Hz", "lowest frequency, above the pulses")
    kernel_high_hz: float = quantity(_V.kernel_high_hz, 20.0, 5000.0, "Hz", "highest, below the inverse of a contact")
    kernel_bias: float = quantity(_V.kernel_bias, 0.2, 3.0, "1", "impulse of a kernel over mass times impulse per kilogram")
    kernel_bias_sd: float = quantity(_V.kernel_bias_sd, 0.0, 1.0, "1", "its deviation between crops and loads")
    quiet_error: float = quantity(_V.quiet_error, 0.0, 1.0, "1", "relative deviation of background noise")
    quiet_windows: int = quantity(_V.quiet_windows, 1, 3600, "s", "windows of each kind before a flow")
    kernel_windows: int = quantity(_V.kernel_windows, 5, 3600, "s", "windows that are averaged")


_L = CalibratorSettings()
_K = _L.closed_loop


class Learning(Section):
    """How sweeps and weighed loads update the parameters."""

    enabled: bool = choice(True, "let sweeps and weighed loads move the parameters")
    flow_model: Literal["constant", "linear", "process"] = choice(_K.flow, "how the flow may change during a sweep")
    flow_slope_sd_per_s: float = quantity(_K.flow_slope_sd_per_s, 0.0, 1.0, "1/s", "linear: relative deviation of the slope")
    flow_process_sd: float = quantity(_K.flow_process_sd, 0.0, 1.0, "1", "process: relative standard deviation of the flow")
    flow_process_time_s: float = quantity(_K.flow_process_time_s, 1.0, 3600.0, "s", "process: correlation time of the flow")
    model_error: float = quantity(_K.model_error, 0.0, 0.5, "1", "relative error of the model at an angle of a sweep")
    learned_information: float = quantity(
        _K.learned_information, 0.0, 100.0, "1", "a sweep's over prior information below which nothing is taken from it"
    )
    kept_ratio: float = quantity(_K.kept_ratio, 0.5, 1.0, "1", "a parameter that keeps more than this share of deviation stays")
    consistent_p: float = quantity(_K.consistent_p, 0.0, 0.5, "1", "probability of a misfit below which a sweep changes nothing")
    pattern_sd: float = quantity(
        _L.pattern_sd, 0.0, 0.2, "1", "relative error of the model away from home that sweeps separate from the grain; 0: none"
    )
    anchor_error: float = quantity(_L.anchor_error, 0.0, 0.5, "1", "relative error of a weighed load beside the scale's own")
    density_ratio: float | None = quantity(
        _L.density_ratio, 0.1, 10.0, "1", "density in the paddles over test weight, where known; null: test weight is not used"
    )
    density_ratio_std_dev: float = quantity(_L.density_ratio_std_dev, 0.0, 10.0, "1", "standard deviation of that ratio")
    test_weight_std_dev_kg_m3: float = quantity(
        _L.test_weight_std_dev_kg_m3, 0.1, 500.0, "kg/m3", "standard deviation of the test weight"
    )


_R = _L.drift


def _by_parameter(name: str, meaning: str, defaults: Mapping[str, float], most: float) -> type[Section]:
    """A section with one key for each grain parameter that drifts."""
    shown = {"restitution": "impact gain (1 + restitution, k1, k2)"}
    keys: dict[str, Any] = {
        key: (float, quantity(value, 0.0, most, "1", shown.get(key, GRAIN[key].label))) for key, value in defaults.items()
    }
    return create_model(name, __base__=Section, __doc__=meaning, **keys)


if TYPE_CHECKING:

    class DriftPerRootHour(Section): ...

    class DriftPerRootKilotonne(Section): ...

    class SteadyDriftPerKilotonne(Section): ...

    class DriftLimit(Section): ...

else:
    DriftPerRootHour = _by_parameter(
        "DriftPerRootHour",
        "Growth of what is not known: relative standard deviation after one hour without an update.",
        _R.per_root_hour, 1.0,
    )  # fmt: skip
    DriftPerRootKilotonne = _by_parameter(
        "DriftPerRootKilotonne",
        "The same by wear: relative standard deviation after 1000 t of grain.",
        _R.per_root_kilotonne, 1.0,
    )  # fmt: skip
    SteadyDriftPerKilotonne = _by_parameter(
        "SteadyDriftPerKilotonne",
        "Steady drift, whose rate is learnt: its likely size before that, relative, per 1000 t of grain; 0: not looked for.",
        _L.steady_per_kilotonne, 2.0,
    )  # fmt: skip
    DriftLimit = _by_parameter(
        "DriftLimit",
        "Relative standard deviation beyond which nothing grows: what is known without any calibration.",
        _R.limit, 2.0,
    )  # fmt: skip


class Document(Section):
    """The whole file. Every key may be left out; its default is shown here."""

    machine_file: str | None = text(None, "machine geometry; null: the shipped 8-tooth sprocket")
    parameter_file: str | None = text(None, "grain parameters; null: the shipped corn")
    estimator_file: str | None = text(
        None,
        "curve that gives the flow (`calibrate --estimator`); null: the model",
    )
    moisture_map_file: str | None = text(
        None, "how parameters change with moisture (`calibrate --by-moisture`); null: they do not"
    )
    pulse_shape_file: str | None = text(None, "pulses' shape and its calibrated range; null: the shipped one")
    units: Literal["metric", "us"] = choice("metric", "shown to people; documents (JSON), tables and frames stay in SI")
    bus: Bus = Bus()
    signals: dict[str, Any] = Field(
        default_factory=dict,
        description="where quantities come from, by quantity (docs/guide/wiring.md); left out: the messages of the shipped DBC",
    )
    outputs: Outputs = Outputs()
    store: Store = Store()
    status: Status = Status()
    diagnostics: Diagnostics = Diagnostics()
    network: Network = Network()
    logging: Logging = Logging()
    clock: Clock = Clock()
    windows: Windows = Windows()
    inputs: Inputs = Inputs()
    zero: Zero = Zero()
    gate: Gate = Gate()
    totals: Totals = Totals()
    budget: Budget = Budget()
    flow_filter: FlowFilter = FlowFilter()
    plate: Plate = Plate()
    sweep: Sweep = Sweep()
    faults: Faults = Faults()
    anchors: Anchors = Anchors()
    disagreement: Disagreement = Disagreement()
    waveform: Waveform = Waveform()
    learning: Learning = Learning()
    drift_per_root_hour: DriftPerRootHour = DriftPerRootHour()
    drift_per_root_kilotonne: DriftPerRootKilotonne = DriftPerRootKilotonne()
    steady_drift_per_kilotonne: SteadyDriftPerKilotonne = SteadyDriftPerKilotonne()
    drift_limit: DriftLimit = DriftLimit()


#: Sections that hand their keys to the engine's settings of the same name.
ENGINE_SECTIONS = (
    "clock", "windows", "inputs", "zero", "gate", "totals", "budget", "flow_filter", "plate", "sweep", "faults", "anchors",
    "disagreement", "waveform",
)  # fmt: skip

#: Settings of the engine that the protocol fixes, or that come from a file of their own; their section has no key for them.
FIXED_BY_THE_FRAMES = frozenset({"windows.window_s", "plate.command_counter_modulus", "waveform.shape"})
