"""Every number the engine uses, as frozen dataclasses with units in the names.

They are the sections of the configuration file: `service.config.engine_sections` makes its keys from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from yieldmon.engine.flow_filter import FlowFilterSettings
from yieldmon.engine.sources import THOUSAND_KERNELS_G
from yieldmon.estimation.waveform.arrival_law import ArrivalLaw
from yieldmon.physics.grain import FLOW_PER_MOISTURE_PCT
from yieldmon.setting_keys import by_name, choice, quantities, quantity
from yieldmon.units import S_PER_DAY

MARKET_MOISTURE_PCT = (0.0, 40.0)
"""Range of a crop's market moisture, wet basis."""


@dataclass(frozen=True, slots=True)
class ClockSettings:
    """Checks of the frames' time stamps."""

    max_gap_s: float = quantity(
        60.0, 2.0, 3600.0, "s", "a longer step forward between frames means that the clock was set forward"
    )
    backstep_tolerance_s: float = quantity(
        0.1, 0.0, 1.0, "s", "a longer step back means that the clock was set back, a shorter one frames out of order"
    )


@dataclass(frozen=True, slots=True)
class WindowSettings:
    """The one-second results."""

    grid_offset_s: float = quantity(
        0.1, 0.0, 0.9, "s", "windows end this long after each full second, for the delay of bus and sensor"
    )
    """In whole command intervals: half a paddle pattern and the sensor's delay at rated speed, so that a result belongs to the
    full second before it."""
    max_ramp_s: float = quantity(0.5, 0.1, 0.5, "s", "longest weighted edge of a window")
    """Below the speed at which one paddle pattern takes this long the edge is a ramp of this length."""
    min_coverage: float = quantity(0.2, 0.05, 1.0, "1", "a window with less sample coverage has no result")
    """What was measured still counts in the totals."""
    full_coverage: float = quantity(0.98, 0.5, 1.0, "1", "a window with less sample coverage is degraded")
    saturated_share: float = quantity(0.01, 0.0, 1.0, "1", "share of samples at the range limit from which a window is saturated")
    plausible_full_scales: float = quantity(4.0, 1.0, 100.0, "full scales", "samples beyond this are ignored as impossible")
    paddle_scatter: float = quantity(0.07, 0.0, 1.0, "1", "expected relative scatter of the paddles' momentum")
    scatter_prior_patterns: float = quantity(
        6.0, 0.0, 1000.0, "patterns", "weight of that expectation, in repeats of the paddle pattern"
    )
    scatter_memory_patterns: float = quantity(
        300.0, 50.0, 1e5, "patterns", "repeats of the pattern over which the scatter is estimated"
    )
    min_force_std_dev_n: float = quantity(0.05, 0.0, 10.0, "N", "minimum standard deviation of a window's mean force")
    """By electrical noise and zero."""
    window_s: float = 1.0
    """Fixed: MassFlow is a 1 Hz message."""


@dataclass(frozen=True, slots=True)
class InputSettings:
    """How long the last value of an input may be used.

    By default ten of its periods.
    """

    sensor_timeout_s: float = quantity(0.04, 0.01, 1.0, "s", "impact samples")
    speed_timeout_s: float = quantity(1.0, 0.1, 10.0, "s", "elevator speed")
    feedback_timeout_s: float = quantity(0.5, 0.1, 10.0, "s", "plate angle and actuator state")
    condition_timeout_s: float = quantity(10.0, 1.0, 600.0, "s", "moisture, temperature and test weight")
    scale_timeout_s: float = quantity(10.0, 1.0, 600.0, "s", "tank mass and its status")
    vehicle_timeout_s: float = quantity(2.0, 0.2, 600.0, "s", "position, course, speed, states of the machine")
    held_angle_std_dev_deg: float = quantity(
        1.0, 0.0, 30.0, "deg", "standard deviation of a resting plate's angle while its feedback is missing"
    )


@dataclass(frozen=True, slots=True)
class ZeroSettings:
    """Zero-load voltage of the impact sensor.

    The elevator is taken to run empty while the paddle-synchronous signal is no more than vibration.
    """

    first_zero_windows: int = quantity(3, 1, 60, "s", "empty seconds averaged for the first zero and by `yieldmon zero`")
    first_pulse_limit_mv: float = quantity(12.0, 0.1, 1000.0, "mV", "largest pulses accepted as vibration before the first zero")
    level_range_mv: float = quantity(3.0, 0.0, 1000.0, "mV", "largest range of the seconds' means for a zero")
    settle_windows: int = quantity(
        10, 1, 600, "s", "empty seconds before the zero follows slow drift; also the averaging time of the pulses"
    )
    pulse_margin_mv: float = quantity(0.8, 0.0, 1000.0, "mV", "averaged pulses that differ more from the vibration mean grain")
    """Of each harmonic of the paddle pattern, averaged over settle_windows."""
    pulse_margin: float = quantity(0.12, 0.0, 100.0, "1", "the same relative to the vibration; the larger limit applies")
    window_pulse_margin_mv: float = quantity(
        1.5, 0.0, 1000.0, "mV", "one second's pulses that exceed the empty ones by more mean grain"
    )
    window_pulse_margin: float = quantity(1.25, 1.0, 100.0, "1", "the same as a factor; the larger limit applies")
    follow_time_s: float = quantity(20.0, 1.0, 3600.0, "s", "time constant of following")
    max_rate_mv_s: float = quantity(0.2, 0.0, 100.0, "mV/s", "fastest change of the zero")
    max_step_mv: float = quantity(20.0, 0.1, 4000.0, "mV", "empty seconds further off are ignored")
    """Something other than drift has happened."""
    drift_limit_mv: float = quantity(40.0, 0.1, 4000.0, "mV", "difference from the first zero that sets ZeroDrifted")

    @property
    def noted_mv(self) -> float:
        """Change of the zero during harvest from which ZeroDrifted is shown, mV: too much for drift, and enough to matter."""
        return 0.5 * self.max_step_mv


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Detection of grain and harvest."""

    grain_on_n: float = quantity(1.0, 0.01, 1000.0, "N", "mean force, with pulses, from which grain is present")
    grain_off_n: float = quantity(0.5, 0.0, 1000.0, "N", "mean force below which grain is absent")
    certain_force_n: float = quantity(10.0, 0.1, 1000.0, "N", "mean force that means grain even without pulses")
    off_windows: int = quantity(3, 1, 600, "s", "seconds without grain before the state is not harvesting")
    emptying_s: float = quantity(20.0, 0.0, 600.0, "s", "not harvesting after this long with header up or machine stopped")
    min_ground_speed_m_s: float = quantity(0.3, 0.0, 10.0, "m/s", "a slower machine is stopped")
    min_turning_rpm: float = quantity(50.0, 0.0, 250.0, "rpm", "a slower elevator is stopped")


@dataclass(frozen=True, slots=True)
class TotalsSettings:
    """Load and total mass."""

    moisture_reference_pct: float | None = quantity(
        None, *MARKET_MOISTURE_PCT, "%", "market moisture for dry mass, wet basis; null: the crop's (no crop: corn's)"
    )
    credit_below_reference: bool = choice(False, "drier grain counts as more than its wet mass; false: as its wet mass")
    new_load: Literal["switch", "tank_scale", "command"] = choice(
        "switch", "what else begins a load: input unloading (switch), tank mass stable at half (tank_scale), nothing (command)"
    )
    unloading_s: float = quantity(10.0, 1.0, 600.0, "s", "shorter unloading ends no load; shorter pauses do not end unloading")


@dataclass(frozen=True, slots=True)
class BudgetSettings:
    """Further errors in the standard deviations of flow and mass, besides noise and parameters."""

    zero_mv: float = quantity(0.2, 0.0, 100.0, "mV", "standard deviation of a new or followed zero")
    zero_drift_mv_per_root_h: float = quantity(
        1.0, 0.0, 100.0, "mV per root hour", "its growth until the elevator runs empty again"
    )
    moisture_per_pct: float = quantity(
        FLOW_PER_MOISTURE_PCT,
        0.0,
        0.2,
        "per percentage point",
        "relative error of flow from a moisture that the model does not include",
    )
    """Relative standard deviation of flow per percentage point of moisture that the calibration does not follow: published slopes
    of friction, density and restitution (config/crops.yaml) through the model at 10 kg/s give 1.6 (rice) to 3.0 (wheat), corn
    2.0 %."""
    unmeasured_moisture_pct: float = quantity(2.0, 0.0, 20.0, "percentage points", "standard deviation of an unmeasured moisture")


@dataclass(frozen=True, slots=True)
class PlateSettings:
    """Limits of plate commands, inside the range of the machine file."""

    fixed_angle_deg: float | None = quantity(
        None, 10.0, 170.0, "deg", "angle of a fixed plate: no feedback needed, no sweeps; null: the plate moves"
    )
    max_rate_deg_s: float = quantity(20.0, 0.5, 90.0, "deg/s", "fastest change of the target")
    command_interval_s: float = quantity(0.1, 0.02, 1.0, "s", "interval of commands while the plate moves")
    at_target_tolerance_deg: float = quantity(
        0.5, 0.05, 5.0, "deg", "largest difference from the target angle that counts as reached"
    )
    command_counter_modulus: int = 256

    @property
    def rest_tolerance_deg(self) -> float:
        """Largest difference from home, and largest movement in a window, of a plate that rests at home, deg."""
        return 2.0 * self.at_target_tolerance_deg


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Self-calibration sweeps of the plate."""

    enabled: bool = choice(True, "allow sweeps; false: the plate never moves")
    when: Literal["interval", "information"] = choice(
        "interval", "sweep after each interval, or only if it improves the flow more than harvesting on"
    )
    worth_ratio: float = quantity(
        1.05, 1.0, 10.0, "1", "information: least ratio of the flow's standard deviation without to that with a sweep"
    )
    interval_s: float = quantity(1800.0, 60.0, 1e6, "s", "interval of sweeps")
    first_after_s: float = quantity(600.0, 0.0, 1e6, "s", "harvesting time before the first sweep")
    angles_deg: tuple[float, ...] = quantities(
        (40.0, 40.0, 40.0, 40.0, 50.0, 60.0, 80.0, 90.0, 90.0, 90.0), 50, "deg", "angles to visit, in the machine's range"
    )
    """Most of the time at the ends, where the information is; the middle shows whether the model holds (studies/sweep_design)."""
    home_every: int = quantity(2, 1, 50, "angles", "the plate returns home after this many")
    """So that home windows bracket the flow."""
    windows_per_step: int = quantity(2, 1, 60, "s", "seconds measured at each angle")
    min_flow_kg_s: float = quantity(4.0, 0.1, 25.0, "kg/s", "minimum flow for a sweep")
    steady_windows: int = quantity(8, 2, 600, "s", "seconds of steady flow before a sweep")
    steady_cv: float = quantity(0.08, 0.001, 1.0, "1", "largest standard deviation over mean in these seconds")
    flow_change: float = quantity(0.25, 0.01, 1.0, "1", "change of flow at home that ends a sweep")
    flow_change_away: float = quantity(0.6, 0.01, 10.0, "1", "the same at other angles")
    """Larger because the estimate leans on the parameters under test."""
    speed_change: float = quantity(0.06, 0.001, 1.0, "1", "change of elevator speed that ends a sweep")
    move_margin_s: float = quantity(3.0, 0.1, 60.0, "s", "time beyond travel / rate that sets PlateNotFollowing")
    settle_s: float = quantity(0.5, 0.0, 60.0, "s", "time on target before measuring")
    settle_timeout_s: float = quantity(6.0, 0.5, 120.0, "s", "longest wait for the plate to settle")
    measure_timeout_s: float = quantity(12.0, 1.0, 600.0, "s", "longest time at one angle")
    signal_trend: float = quantity(
        5.0, 0.5, 100.0, "standard errors", "difference between a window's halves that means not settled"
    )
    return_timeout_s: float = quantity(10.0, 0.5, 120.0, "s", "longest time for the return home")
    home_rest_s: float = quantity(3.0, 0.0, 600.0, "s", "rest away from home before the plate is driven home")
    home_retry_s: float = quantity(20.0, 1.0, 1e5, "s", "wait before the plate is driven home again after a failure")
    backoff_s: float = quantity(60.0, 1.0, 1e5, "s", "wait after an aborted sweep; doubles up to the interval")
    feedback_plausibility_flow_spread: float = quantity(
        0.08, 0.0, 5.0, "1", "spread of ln(flow) over a sweep from which the angle feedback is checked"
    )
    feedback_plausibility_force_ratio: float = quantity(
        0.5, 0.0, 1.0, "1", "the plate did not move if the spread of force is below this share of it"
    )
    max_std_dev_factor: float = quantity(1.0, 1.0, 10.0, "1", "factor on the flow's standard deviation away from home")
    """Beside what the plate's motion adds."""


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """Limits of faults without a section of their own."""

    stuck_windows: int = quantity(5, 1, 600, "s", "seconds of equal samples that set SensorStuck")
    calibration_old_s: float = quantity(30.0 * S_PER_DAY, 3600.0, 1e9, "s", "age of the calibration that sets CalibrationOld")
    mass_near_end: float = quantity(0.95, 0.1, 1.0, "1", "share of a mass signal's range that sets MassNearEnd")
    clock_jump_hold_windows: int = quantity(10, 1, 3600, "s", "duration of ClockJumped")
    scale_disagrees_p: float = quantity(0.001, 1e-9, 0.05, "1", "p-value below which a weighed mass contradicts the calibration")
    scale_agrees_p: float = quantity(0.05, 1e-6, 0.5, "1", "p-value from which a weighed mass agrees with the calibration again")
    zero_missing_s: float = quantity(60.0, 5.0, 3600.0, "s", "running time without a zero that sets ZeroMissing")
    """With the plate at home."""


@dataclass(frozen=True, slots=True)
class ReferenceMassSettings:
    """Reference masses from a tank scale."""

    min_increment_kg: float = quantity(1000.0, 10.0, 1e5, "kg", "smallest gain of tank mass that is a reference")
    scale_std_dev_kg: float = quantity(20.0, 0.1, 1e4, "kg", "standard deviation of the scale")
    unloading_kg: float = quantity(50.0, 1.0, 1e4, "kg", "fall of the tank mass that means unloading")
    keep: int = quantity(64, 1, 10_000, "references", "number of newest references to keep")


@dataclass(frozen=True, slots=True)
class DisagreementSettings:
    """The fault ModelDisagrees: residuals of several sweeps show that the model lacks an effect."""

    keep_sweeps: int = quantity(16, 2, 200, "sweeps", "number of newest sweeps to test together")
    least_sweeps: int = quantity(4, 2, 200, "sweeps", "minimum number of sweeps for a verdict")
    tolerance: float = quantity(0.005, 0.0, 0.5, "1", "tolerated relative model error at a plate angle")
    begin_p: float = quantity(0.001, 0.0, 0.5, "1", "p-value below which the fault begins")
    """The probability of so strong a pattern by chance."""
    end_p: float = quantity(0.05, 0.0, 1.0, "1", "p-value above which the fault ends")


@dataclass(frozen=True, slots=True)
class WaveformSettings:
    """Flow from pulse shape and kernel noise, in addition to the mean force.

    See docs/internals/waveform.md.
    """

    enabled: bool = choice(False, "evaluate single samples")
    combine: bool = choice(False, "publish the flow of mean force, shape and kernels combined")
    """By their covariance; then mass is counted from it as well."""
    update_parameters: bool = choice(False, "let kernel noise update the parameters")
    """With one bias common to all its updates; then it corrects nothing published."""
    update_windows: int = quantity(1800, 60, 100_000, "s", "time with grain between updates")
    harmonics: int = quantity(20, 4, 21, "harmonics", "harmonics of the paddle pattern")
    model_error: float = quantity(0.1, 0.001, 0.5, "1", "relative error of the pulse model")
    friction_sd: float = quantity(0.3, 0.001, 1.0, "1", "relative standard deviation of friction")
    shape_ratio_sd: float = quantity(0.1, 0.001, 1.0, "1", "the same of the shape ratio")
    stretch: float = quantity(1.0, 0.5, 3.0, "1", "duration of arrival relative to straight paths")
    """1.2 to 1.5 in discrete elements. From weighed loads."""
    stretch_sd: float = quantity(0.2, 0.0, 1.0, "1", "its relative standard deviation; 0.03 once calibrated")
    tail_s: float = quantity(0.002, 1e-4, 0.1, "s", "mean time that grain pushes after impact")
    """3 to 8 ms in discrete elements."""
    tail_sd: float = quantity(1.0, 0.0, 3.0, "1", "standard deviation of its logarithm")
    shape_terms: bool = choice(False, "take stretch and tail from pulse_shape_file")
    """By the terms of `shape`, with its covariance."""
    response_error: float = quantity(0.05, 0.001, 1.0, "1", "relative standard deviation of sensor.response_s")
    largest_misfit: float = quantity(4.0, 1.0, 1000.0, "1", "misfit above which pulses contradict")
    """Mean square of the fit's residuals, in their own standard deviations."""
    contradiction_windows: int = quantity(30, 5, 3600, "s", "windows to compare")
    contradiction_z: float = quantity(3.0, 1.0, 20.0, "1", "difference, in standard deviations, that contradicts")
    """Between shape and mean force over `contradiction_windows`."""
    hit_sd: float = quantity(0.05, 0.0, 1.0, "1", "relative error that force and kernels share")
    """Grain that misses the plate, or strikes it again."""
    thousand_kernel_weight_g: float = quantity(0.0, 0.0, THOUSAND_KERNELS_G[1], "g", "mass of a thousand kernels; 0: not known")
    """Without it kernel noise gives no flow."""
    thousand_kernel_weights_g: Mapping[str, float] = by_name(*THOUSAND_KERNELS_G, "g", "the same by crop")
    """Takes precedence."""
    kernel_mass_sd: float = quantity(0.03, 0.0, 1.0, "1", "its relative standard deviation")
    kernel_low_hz: float = quantity(200.0, 20.0, 5000.0, "Hz", "lowest frequency of kernel noise, above the pulses")
    kernel_high_hz: float = quantity(800.0, 20.0, 5000.0, "Hz", "highest frequency, below 1/contact time")
    kernel_bias: float = quantity(1.2, 0.2, 3.0, "1", "impulse of a kernel, relative to its mass times impulse per kilogram")
    """From studies/waveform."""
    kernel_bias_sd: float = quantity(0.15, 0.0, 1.0, "1", "its standard deviation")
    quiet_error: float = quantity(0.1, 0.0, 1.0, "1", "relative standard deviation of background noise")
    samples_averaged: bool = choice(True, "samples are averages; false: instantaneous")
    quiet_windows: int = quantity(5, 1, 3600, "s", "windows of the empty machine, and of grain, before a first flow")
    kernel_windows: int = quantity(60, 5, 3600, "s", "windows to average")
    shape: ArrivalLaw | None = None
    """Law and range of the pulse-shape file; outside the range, or without one, the shape gives no flow."""


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """All of the above, in the order of the configuration file."""

    clock: ClockSettings = field(default_factory=ClockSettings)
    windows: WindowSettings = field(default_factory=WindowSettings)
    inputs: InputSettings = field(default_factory=InputSettings)
    zero: ZeroSettings = field(default_factory=ZeroSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    totals: TotalsSettings = field(default_factory=TotalsSettings)
    budget: BudgetSettings = field(default_factory=BudgetSettings)
    flow_filter: FlowFilterSettings = field(default_factory=FlowFilterSettings)
    plate: PlateSettings = field(default_factory=PlateSettings)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    faults: FaultSettings = field(default_factory=FaultSettings)
    reference_masses: ReferenceMassSettings = field(default_factory=ReferenceMassSettings)
    disagreement: DisagreementSettings = field(default_factory=DisagreementSettings)
    waveform: WaveformSettings = field(default_factory=WaveformSettings)
