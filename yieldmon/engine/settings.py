"""Every number the engine uses, as frozen dataclasses with units in the names.

The defaults are those of the shipped configuration; `service.config.configuration` builds these from YAML after it has checked
ranges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from yieldmon.engine.flow_filter import FlowFilterSettings
from yieldmon.physics.grain import FLOW_PER_MOISTURE_PCT
from yieldmon.units import S_PER_DAY

if TYPE_CHECKING:
    from yieldmon.estimation.waveform.arrival_law import ArrivalLaw


@dataclass(frozen=True, slots=True)
class ClockSettings:
    """Which time stamps of the bus are plausible."""

    max_gap_s: float = 60.0
    """A longer forward step between two frames is a clock jump (or a hole in a log), not a silent bus."""
    backstep_tolerance_s: float = 0.1
    """A smaller backward step is frames out of order; a larger one is a clock set back."""


@dataclass(frozen=True, slots=True)
class WindowSettings:
    """Forming of the one-second results."""

    window_s: float = 1.0
    """Fixed: MassFlow is a 1 Hz message."""
    grid_offset_s: float = 0.1
    """Windows end this long after each full second of bus time, in whole command intervals: half a paddle pattern and the
    sensor's own delay at rated speed, so that a result belongs to the full second before it."""
    max_ramp_s: float = 0.5
    """Longest window edge. Below the speed at which one paddle pattern takes this long the edge is a ramp of this length."""
    min_coverage: float = 0.2
    """Below this share of a window's weight its mean is not published; what was measured still counts in the totals."""
    full_coverage: float = 0.98
    """Below this share the result is marked as degraded."""
    saturated_share: float = 0.01
    """Share of a window's samples at the end of the sensor's range from which the window counts as saturated."""
    plausible_full_scales: float = 4.0
    """A sample beyond this many full scales is no voltage the sensor can give; it is not used."""
    paddle_scatter: float = 0.07
    """Prior for the standard deviation of one paddle's momentum, as a share of its mean."""
    scatter_prior_patterns: float = 6.0
    """Weight of that prior, in paddle patterns, against the scatter seen within the window."""
    scatter_memory_patterns: float = 300.0
    """Paddle patterns over which the scatter is learnt: the windows of about a minute."""
    min_force_std_dev_n: float = 0.05
    """Floor for the standard deviation of a window's mean force, N (electrical noise, zero)."""


@dataclass(frozen=True, slots=True)
class InputSettings:
    """How long an input's last value may be used: ten of its periods."""

    sensor_timeout_s: float = 0.04
    speed_timeout_s: float = 1.0
    feedback_timeout_s: float = 0.5
    condition_timeout_s: float = 10.0
    scale_timeout_s: float = 10.0
    vehicle_timeout_s: float = 2.0
    held_angle_std_dev_deg: float = 1.0
    """Uncertainty of the last known plate angle while the feedback is silent and the plate was at rest, deg."""


@dataclass(frozen=True, slots=True)
class ZeroSettings:
    """Zero-load voltage. The elevator is taken to run empty while the paddle-synchronous signal is no more than vibration."""

    first_zero_windows: int = 3
    """Windows averaged for the first zero."""
    first_pulse_limit_mv: float = 12.0
    """Largest paddle-synchronous amplitude taken for vibration before any has been learnt, mV."""
    level_range_mv: float = 3.0
    """Largest range of the windows' means in learning a zero, mV."""
    settle_windows: int = 10
    """Windows over which pulses are averaged coherently, and empty windows in a row before the zero follows."""
    pulse_margin_mv: float = 0.8
    """Departure of a pattern harmonic from the learnt vibration that speaks of grain, over settle_windows, mV."""
    pulse_margin: float = 0.12
    """The same as a share of the learnt vibration; the larger of the two margins holds."""
    window_pulse_margin_mv: float = 1.5
    """Excess of one window's pulses over the largest seen empty that speaks of grain, mV."""
    window_pulse_margin: float = 1.25
    """The same as a factor; the larger of the two holds."""
    follow_time_s: float = 20.0
    """Time constant of the following."""
    max_rate_mv_s: float = 0.2
    """Fastest change of the zero, mV/s."""
    max_step_mv: float = 20.0
    """An empty window further than this from the zero moves nothing: something other than drift has happened."""
    drift_limit_mv: float = 40.0
    """Distance from the first zero from which the fault ZeroDrifted is raised, mV."""


@dataclass(frozen=True, slots=True)
class GateSettings:
    """When flow is measured and when the machine is not harvesting."""

    grain_on_n: float = 1.0
    """Mean force from which, with paddle pulses, grain is present, N."""
    grain_off_n: float = 0.5
    """Mean force below which grain is gone, N."""
    certain_force_n: float = 10.0
    """Mean force that means grain even before pulses have been seen, N."""
    off_windows: int = 3
    """Windows without grain before the state changes to not harvesting."""
    emptying_s: float = 20.0
    """With the header up or the machine standing for this long, what is left of a signal is not harvest."""
    min_ground_speed_m_s: float = 0.3
    min_turning_rpm: float = 50.0
    """Below this the elevator stands."""


@dataclass(frozen=True, slots=True)
class TotalsSettings:
    """Load and total mass."""

    moisture_reference_pct: float | None = None
    """Market moisture for dry mass, % wet basis (corn)."""
    credit_below_reference: bool = False
    """True: grain drier than the reference counts as more than its wet mass; False: its dry mass is its wet mass."""
    new_load: str = "switch"
    """What ends a load and begins the next, beside the command: "switch", the input `unloading`; "tank_scale", a stable tank mass
    that has fallen to half or less; "command", nothing."""
    unloading_s: float = 10.0
    """Unloading shorter than this ends no load; it is over when it has not gone on for this long, s."""


@dataclass(frozen=True, slots=True)
class BudgetSettings:
    """What the standard deviations of flow and mass include beside the windows' noise and the parameters' covariance."""

    zero_mv: float = 0.2
    """Standard deviation of a zero when it is taken or followed, mV."""
    zero_drift_mv_per_root_h: float = 1.0
    """Its growth while the elevator never runs empty, mV per square root of an hour."""
    moisture_per_pct: float = FLOW_PER_MOISTURE_PCT
    """Relative standard deviation of flow per percentage point of moisture that the calibration does not follow: published slopes
    of friction, density and restitution (config/crops.yaml) through the model at 10 kg/s give 1.6 (rice) to 3.0 (wheat), corn
    2.0 %."""
    unmeasured_moisture_pct: float = 2.0
    """Standard deviation of a moisture that is not measured, percentage points."""


@dataclass(frozen=True, slots=True)
class PlateSettings:
    """Limits of plate commands. The range itself is the machine's."""

    fixed_angle_deg: float | None = None
    """Of a plate that is bolted on; None: the plate turns."""
    max_rate_deg_s: float = 20.0
    command_interval_s: float = 0.1
    at_target_tolerance_deg: float = 0.5
    command_counter_modulus: int = 256


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Self-calibration sweeps of the plate."""

    enabled: bool = True
    when: str = "interval"
    """`interval`: whenever that has passed; `information`: only where the flow is then better known than by harvesting on."""
    worth_ratio: float = 1.05
    """The flow's standard deviation after as long at home over that after the sweep, from which a sweep is worth making."""
    interval_s: float = 1800.0
    first_after_s: float = 600.0
    """Time from the start to the first sweep."""
    angles_deg: tuple[float, ...] = (40.0, 40.0, 40.0, 40.0, 50.0, 60.0, 80.0, 90.0, 90.0, 90.0)
    """Most of the time at the ends, where the information is; the middle shows whether the model holds (studies/sweep_design)."""
    home_every: int = 2
    """The plate returns home after this many angles, so that home windows bracket the flow."""
    windows_per_step: int = 2
    min_flow_kg_s: float = 4.0
    steady_windows: int = 8
    """Windows over which the flow must have been steady before a sweep starts."""
    steady_cv: float = 0.08
    """Largest standard deviation over mean of those windows."""
    flow_change: float = 0.25
    """Change of the home-angle flow against the start of the sweep that ends it."""
    flow_change_away: float = 0.6
    """The same at other angles, where the estimate leans on the parameters under test."""
    speed_change: float = 0.06
    move_margin_s: float = 3.0
    """Time beyond travel / rate after which the actuator is not following."""
    settle_s: float = 0.5
    """Time the feedback must stay on target."""
    settle_timeout_s: float = 6.0
    measure_timeout_s: float = 12.0
    signal_trend: float = 5.0
    """A window whose first and second half differ by more standard errors than this has not settled."""
    return_timeout_s: float = 10.0
    home_rest_s: float = 3.0
    """Time the plate may rest away from home undriven before it is taken home."""
    home_retry_s: float = 20.0
    """Wait before the plate is taken home again after it did not get there."""
    backoff_s: float = 60.0
    """Wait after an aborted sweep; doubles with each abort in a row, up to the interval."""
    feedback_plausibility_flow_spread: float = 0.08
    """Spread of ln(flow) over a whole sweep from which it is asked whether the plate moved at all."""
    feedback_plausibility_force_ratio: float = 0.5
    """The plate did not move if the force itself spreads less than this share of that."""
    max_std_dev_factor: float = 1.0
    """Widening of the standard deviation of flow measured away from home, beside what the plate's motion adds."""


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """Hysteresis that is more than a count of windows, and limits that belong to no other part."""

    stuck_windows: int = 5
    """Windows with every sample equal before the sensor counts as stuck."""
    calibration_old_s: float = 30.0 * S_PER_DAY
    zero_missing_s: float = 60.0
    """Time with the elevator running, the plate at home and no first zero after which that is a fault."""
    clock_jump_hold_windows: int = 10
    mass_near_end: float = 0.95
    """Share of the largest mass that a signal carries from which that is a fault."""
    scale_disagrees_p: float = 0.001
    """Probability of so large a difference by chance below which a weighed mass contradicts the calibration."""
    scale_agrees_p: float = 0.05
    """Probability from which a weighed mass agrees again."""


@dataclass(frozen=True, slots=True)
class DisagreementSettings:
    """When the residual pattern that sweeps share is the model's."""

    keep_sweeps: int = 16
    """Newest sweeps that are looked at together."""
    least_sweeps: int = 4
    tolerance: float = 0.005
    """Tolerated relative error of the model at one plate angle (standard deviation)."""
    begin_p: float = 0.001
    """Probability of so strong a pattern by chance below which the model is said to disagree."""
    end_p: float = 0.05
    """Probability above which it no longer is."""


@dataclass(frozen=True, slots=True)
class ReferenceMassSettings:
    """Reference masses from a tank scale."""

    min_increment_kg: float = 1000.0
    scale_std_dev_kg: float = 20.0
    unloading_kg: float = 50.0
    """A fall of the tank mass by this much is unloading."""
    keep: int = 64


@dataclass(frozen=True, slots=True)
class WaveformSettings:
    """Flow from the pulses' shape and from kernel noise, beside the mean force (docs/internals/waveform.md)."""

    enabled: bool = False
    combine: bool = False
    """Publish and count mean force, shape and kernel noise together, by their covariance."""
    update_parameters: bool = False
    """Let kernel noise update the parameters, with one bias common to all its updates; then it corrects nothing published."""
    update_windows: int = 1800
    """Seconds of grain with a flow by kernel noise from one update to the next."""
    harmonics: int = 20
    """Harmonics of the paddle pattern that are fitted."""
    model_error: float = 0.1
    """The pulse model's own error, relative, standard deviation."""
    friction_sd: float = 0.3
    """Relative standard deviation of friction beside the shape."""
    shape_ratio_sd: float = 0.1
    """Relative standard deviation of the heap's shape ratio."""
    stretch: float = 1.0
    """Time over which a load arrives, over that of straight paths; 1.2 to 1.5 in discrete elements. From weighed loads."""
    stretch_sd: float = 0.2
    """Its relative standard deviation; 0.03 once it has been calibrated on the machine."""
    tail_s: float = 0.002
    """Mean time for which grain goes on pushing once it has struck; 3 to 8 ms in discrete elements."""
    tail_sd: float = 1.0
    """Standard deviation of its logarithm."""
    shape_terms: bool = False
    """Stretch and tail by the terms of `shape`, with its covariance, in place of the four above."""
    shape: ArrivalLaw | None = None
    """Law and range of the pulse-shape file; outside the range, or without one, the shape gives no flow."""
    response_error: float = 0.05
    """Relative standard deviation of the cell's time constant, which the machine file states."""
    largest_misfit: float = 4.0
    """Mean square of the fit's residuals, in their own standard deviations, above which the pulses are not the model's."""
    contradiction_windows: int = 30
    contradiction_z: float = 3.0
    """Standard deviations between shape and mean force over those windows from which they contradict."""
    hit_sd: float = 0.05
    """Relative standard deviation of what mean force and kernel noise lose or gain alike: grain that misses the plate, or strikes
    it again."""
    thousand_kernel_weight_g: float = 0.0
    """Mass of a thousand kernels; 0: not known, and kernel noise gives no flow."""
    thousand_kernel_weights_g: Mapping[str, float] = field(default_factory=dict)
    """The same by crop; goes before it."""
    kernel_mass_sd: float = 0.03
    kernel_low_hz: float = 200.0
    kernel_high_hz: float = 800.0
    kernel_bias: float = 1.2
    """Impulse of a kernel over its mass times the impulse per kilogram (studies/waveform)."""
    kernel_bias_sd: float = 0.15
    quiet_error: float = 0.1
    """Relative standard deviation of the background's noise between empty and harvesting."""
    samples_averaged: bool = True
    """Whether each sample is the mean of the force over its interval, as kernel noise takes it; else its value at one instant."""
    quiet_windows: int = 5
    """Windows of the empty machine, and of harvest, before kernel noise says anything."""
    kernel_windows: int = 60


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """All of the above."""

    clock: ClockSettings = field(default_factory=ClockSettings)
    windows: WindowSettings = field(default_factory=WindowSettings)
    inputs: InputSettings = field(default_factory=InputSettings)
    zero: ZeroSettings = field(default_factory=ZeroSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    flow_filter: FlowFilterSettings = field(default_factory=FlowFilterSettings)
    totals: TotalsSettings = field(default_factory=TotalsSettings)
    budget: BudgetSettings = field(default_factory=BudgetSettings)
    plate: PlateSettings = field(default_factory=PlateSettings)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    faults: FaultSettings = field(default_factory=FaultSettings)
    disagreement: DisagreementSettings = field(default_factory=DisagreementSettings)
    reference_masses: ReferenceMassSettings = field(default_factory=ReferenceMassSettings)
    waveform: WaveformSettings = field(default_factory=WaveformSettings)
