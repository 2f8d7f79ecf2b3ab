"""From a window to the force in it: zero, harvest gate, and standard deviation of the force. Independent of the estimator."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, hypot, isfinite, radians, sqrt

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.mass.budget import contradicts_drift
from yieldmon.engine.mass.gates import GateInputs, HarvestGate
from yieldmon.engine.mass.tank_rise import TankRise
from yieldmon.engine.sampling.aliasing import ALIAS_FREE_HZ, aliasing_share
from yieldmon.engine.sampling.empty_spells import EmptySpells
from yieldmon.engine.sampling.paddle_scatter import PaddleScatter
from yieldmon.engine.sampling.speed_agreement import SpeedAgreement
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.sampling.zero import ZeroRefusal, ZeroState, ZeroTracker
from yieldmon.engine.sampling.zero_step import ZeroStep
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import Sources
from yieldmon.frames import EstimateQuality, HeaderDown, WorkState
from yieldmon.physics.machine import RPM, Machine

_NAN = float("nan")
_NEVER = 1 << 62
_OTHER_SPEEDS = (("rad/s", 1.0 / RPM), ("turns a second", 60.0))
"""Units that a speed taken for rpm may really be in, and rpm in one of each."""
_ENOUGH = 0.8
"""Least coverage of a window that gives the level of an empty elevator, where the sensor loses samples all the time."""
_PULSED = 0.5
"""Least range of a window's samples over their mean that means paddle strikes; grain lying on the plate hardly varies."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A window before its flow is estimated.

    Attributes
    ----------
    window : Window
    inputs : InputSnapshot
    quality : EstimateQuality or None
        Why there is no flow; None where an estimate decides.
    force_n, force_std_dev_n : float
        N; nan where not known.
    speed_rad_s : float
        Of the window; nan where no frame reported it.
    speed_known : bool
        Whether it is at the window's end.
    speed_contradicted : bool
        Whether the pulses on the plate come at another rate, so that it counts as not known.
    speed_doubt : str
        How the pulses came at another rate when grain was last seen, by a wrong scale of the speed or a chain that slips; ""
        where they did not. The speed counts as known.
    speed_change : float
        Relative change of the speed's error since grain was first seen, by the pulses; 0 for none.
    in_range : bool
        Whether grain is measured at this speed.
    stuck_s : int
        How long no sample has changed, s.
    struck_s : int
        How long grain has struck the plate although the elevator is reported to stand, s.
    still, at_home : bool
        Whether the plate rested, and whether at the home angle.
    harvesting : bool
    zero : ZeroState or None
    zero_drift : str
        What is wrong with it; "" for nothing.
    calibrating_zero : bool
    sampled_before, silent_before : bool
        Whether the window before had samples; whether it had none although an earlier one had.
    windows_since_jump : int
        Closed since the bus's clock jumped.
    zero_taken : bool
        Whether a zero was taken with this window.
    zero_age_s : float
        Since the zero was last taken or followed, or since the start, s.
    zero_away_mv : float
        How far the empty plate was seen from the zero since, mV, in spells too short to take another, how far a zero taken
        despite signs of grain is from the one before it, or how far the zero has stepped by the pulses of the grain.
    zero_far_mv : float
        How far from the zero the plate looked empty for long, where that is too far to follow, mV.
    zero_moved_mv : float
        How far the empty plate is from the zero of the seconds before, mV, where it has just been seen empty again: 0 where drift
        explains it; nan where it was not seen.
    zero_refusal : ZeroRefusal or None
        Why there is no first zero.
    """

    window: Window
    inputs: InputSnapshot
    quality: EstimateQuality | None
    force_n: float
    force_std_dev_n: float
    speed_rad_s: float
    speed_known: bool
    speed_contradicted: bool
    speed_doubt: str
    speed_change: float
    in_range: bool
    stuck_s: int
    struck_s: int
    still: bool
    at_home: bool
    harvesting: bool
    zero: ZeroState | None
    zero_drift: str
    calibrating_zero: bool
    sampled_before: bool
    silent_before: bool
    windows_since_jump: int
    zero_taken: bool
    zero_age_s: float
    zero_away_mv: float
    zero_far_mv: float
    zero_moved_mv: float
    zero_refusal: ZeroRefusal | None


_reading, _gate_inputs = maker_of(Reading), maker_of(GateInputs)


class Measurement:
    """Reads windows in order; keeps the state that the next one needs: zero, gate and counts."""

    def __init__(self, settings: EngineSettings, machine: Machine, sources: Sources) -> None:
        slow = any(source.rate_hz < ALIAS_FREE_HZ for source in sources.impact)
        self.zero = ZeroTracker(settings.zero, sees_pulses=not slow)
        self._settings = settings
        self._machine = machine
        self._aliasing = sources.impact if slow else ()
        """Sensors too slow to sample the pulses without aliasing."""
        self._empty_spells = EmptySpells()
        self._step = None if slow else ZeroStep(len(machine.paddle_spacings_m), settings.zero.noted_mv)
        self._step_from: ZeroState | None = None
        """Zero from which a step is looked for."""
        self._was_far = False
        self._moved = ""
        """How far the zero moved until the plate was seen empty, for the operator; "" with grain and where drift explains it."""
        self._gate = HarvestGate(settings.gate)
        self._rest_rad = radians(settings.plate.rest_tolerance_deg)
        self._idle_since_s: float | None = None
        self._cutting_s = float("-inf")
        self._obstacle = ""
        """Why the last window could not be shown to the zero."""
        self._stuck_s = 0
        self._struck_s = 0
        self._was_hung = False
        """Whether the sensor hung in the last window."""
        self._scatter = PaddleScatter(settings.windows)
        self._agreement = None if slow else SpeedAgreement(machine)
        self._sampled = self._ever_sampled = False
        self._jumps = 0
        self._paused = 0.0, 0.0
        """When the recording last went on after a pause, and how long it had paused since the zero was known, s."""
        self._since_jump = _NEVER
        self._started_s: float = _NAN
        self._tank = TankRise(settings.reference_masses.scale_std_dev_kg)
        self._last: tuple[Window, float] | None = None

    def go_on_with(self, before: Measurement) -> None:
        """Take over from another one: its last window until the first of this one, and its zero calibration under way."""
        self.zero.go_on_with(before.zero)
        self._last = before._last

    @property
    def zero_waits_for(self) -> str:
        """What the requested or first zero waits for, "" where none is awaited."""
        seen, wanted = self.zero.progress
        if not wanted:
            return ""
        if self._obstacle:
            return self._obstacle
        refusal = self.zero.refusal
        if refusal is not None and not refusal.obstacle and seen == wanted:
            limits = self._settings.zero
            return (
                f"an elevator that runs empty: in the last {wanted} s the paddle pulses had an amplitude of "
                f"{refusal.pulse_mv:.1f} mV (at most {limits.first_pulse_limit_mv:g}) and the mean voltage varied by "
                f"{refusal.level_range_mv:.1f} mV (at most {limits.level_range_mv:g}); stop taking in crop"
            )
        return f"the elevator running empty: {seen} of {wanted} s"

    @property
    def signs_of_grain(self) -> str:
        """Signs of grain in the elevator, "" where there are none."""
        return self._signs(by_level=True)

    @property
    def signs_against_zero(self) -> str:
        """Signs of grain that make an operator's zero suspect: `signs_of_grain`, without the level where the pulses look empty.
        A new sensor, or something wedged behind the plate, shifts the level alone."""
        return self._signs(by_level=not self.zero.level_says_nothing)

    def _signs(self, *, by_level: bool) -> str:
        signs = []
        if self._last is not None:
            window, force_n = self._last
            if self.zero.pulses(window):
                signs.append(f"the paddle pulses have an amplitude of {window.pulse_mv:.0f} mV")
            elif self._gate.harvesting or self.zero.looks_loaded:
                signs.append("grain was measured in the last seconds")
            if by_level and isfinite(force_n) and force_n > self._settings.gate.grain_on_n:
                signs.append(f"the force on the plate is {force_n:.1f} N")
        if rise := self._tank.sign_of_grain:
            signs.append(rise)
        return " and ".join(signs)

    def undo_zero(self) -> None:
        """Restore the zero before the operator's last calibration, and forget the empty spells: they were judged by the vibration
        measured with the zero that is undone."""
        self.zero.undo()
        self._empty_spells = EmptySpells()
        self._moved = ""

    def resume(self, now_s: float, paused_s: float) -> None:
        """The recording continues after a pause of paused_s, during which the zero aged but engine time stood."""
        self._paused = now_s, self._paused_since_zero_s + paused_s

    @property
    def _zero_known_s(self) -> float:
        return self.zero.known_s if self.zero.known_s is not None else self._started_s

    @property
    def _paused_since_zero_s(self) -> float:
        at_s, paused_s = self._paused
        return 0.0 if at_s < self._zero_known_s else paused_s

    def read(self, window: Window, inputs: InputSnapshot, clock_jumps: int) -> Reading:
        """The reading of the next window. inputs: held at its end. clock_jumps: jumps of the bus's clock so far."""
        settings, machine = self._settings, self._machine
        if not isfinite(self._started_s):
            self._started_s = window.start_s
        # Samples left over from the last window were taken at a known speed, even if all inputs are silent by now.
        at_samples = window.covered_s > 0.0 and window.last_frame_s - inputs.speed_time_s <= settings.inputs.speed_timeout_s
        in_range = machine.min_elevator_speed_rad_s <= window.speed_rad_s <= machine.max_elevator_speed_rad_s
        contradicted = in_range and self._contradicts_speed(window)
        speed_was_known = (inputs.speed_known or at_samples) and not contradicted
        still = window.plate_max_rad - window.plate_min_rad <= self._rest_rad
        at_home = self.at_home(window.plate_angle_rad)
        self._stuck_s = self._stuck_s + 1 if window.samples and window.span_mv == 0.0 and in_range else 0
        stuck = self._stuck_s >= settings.faults.stuck_windows
        idle_s = self._idle_s(inputs)
        quality, force, noise = self._gated(window, speed_was_known and not stuck, in_range, idle_s)
        self._struck_s = self._struck_s + 1 if self._struck_at_rest(window, force) else 0
        self._last = (window, force) if window.samples else None
        self._tank.see(inputs)
        # Of the zero that the window is measured with: a new one may be taken at its end.
        doubted_mv, zero_before, age_before_s = self.zero.doubted_mv, self.zero.state, self._zero_age_s(window)
        taken = self._follow_zero(window, inputs, inputs.speed_known and in_range and not stuck, still and at_home)
        sampled_before, self._sampled = self._sampled, window.coverage > 0.0
        silent_before = self._ever_sampled and not sampled_before
        self._ever_sampled |= self._sampled
        self._since_jump = 0 if clock_jumps != self._jumps else self._since_jump + 1
        self._jumps = clock_jumps
        speed = window.speed_rad_s if speed_was_known else _NAN
        zero, agreement = self.zero, self._agreement
        moved_mv = self._moved_mv(window, zero_before, age_before_s, taken=taken)
        self._follow_step(window, force, usable=quality is None and still and at_home, seen=isfinite(moved_mv))
        return _reading(
            window, inputs, quality, force, noise, speed, inputs.speed_known, contradicted,
            "" if agreement is None else agreement.doubt, 0.0 if agreement is None else agreement.change, in_range, self._stuck_s,
            self._struck_s, still, at_home, self._gate.harvesting, zero.state, self._zero_drift, zero.calibrating, sampled_before,
            silent_before, self._since_jump, taken, self._zero_age_s(window), self._zero_away_mv(window, doubted_mv), zero.far_mv,
            moved_mv, zero.refusal,
        )  # fmt: skip

    def _gated(self, window: Window, usable: bool, in_range: bool, idle_s: float) -> tuple[EstimateQuality | None, float, float]:
        """Why the window has no flow (None: an estimate decides), its force and the force's standard deviation, N."""
        quality = EstimateQuality
        zero = self.zero.state
        if zero is None or not window.covered_s > 0.0 or not usable:
            return quality.NOT_AVAILABLE, _NAN, _NAN
        force = (window.mean_mv - zero.zero_mv) * self._machine.sensor.gain_n_per_mv
        noise = self._force_std_dev(window, force)
        empty = self.zero.looks_empty or self.zero.level_says_nothing
        gate = _gate_inputs(force, self.zero.pulses(window), empty, self.zero.looks_loaded, in_range, idle_s)
        grain = self._gate.grain(gate)
        if not self._gate.see(gate):
            # Pulses on a plate that reads far below empty: the zero is wrong.
            hidden = self.hides_grain(force) or (gate.pulses and force < -self._settings.gate.certain_force_n)
            return quality.NOT_AVAILABLE if hidden or (grain and not in_range) else quality.NOT_HARVESTING, force, noise
        # A sensor that is filtered until no pulses are left may stay at one of its steps.
        pulsed = window.span_mv > _PULSED * abs(window.mean_mv - zero.zero_mv)
        hung = abs(force) > self._settings.gate.grain_on_n and self._hung(window, zero.zero_mv, pulsed=pulsed)
        # The ramp of a window reaches into the one before.
        reaches, self._was_hung = self._was_hung, hung
        if hung or (reaches and grain and pulsed):
            return quality.NOT_AVAILABLE, force, noise
        # The state lasts some seconds beyond the grain; a second without grain is not a flow of 0.
        nothing = quality.NOT_AVAILABLE if self.hides_grain(force) else quality.NOT_HARVESTING
        return None if grain else nothing, force, noise

    def _hung(self, window: Window, zero_mv: float, *, pulsed: bool) -> bool:
        """Whether the samples of a window with a force stayed at one value for too long, other than that of the empty plate."""
        if window.held_s > 0.5 * self._settings.windows.window_s:
            return True
        # Of several sensors the level at which one hung is not known.
        empty_n = abs(window.frozen_mv - zero_mv) * self._machine.sensor.gain_n_per_mv
        at_empty = empty_n <= self._settings.gate.grain_on_n
        return window.frozen_s > 0.0 and pulsed and not at_empty and not window.saturated_share > 0.0

    def hides_grain(self, force_n: float) -> bool:
        """Whether the force means grain by the zero before, although the suspect zero in use shows an empty plate."""
        doubted_n = self.zero.doubted_mv * self._machine.sensor.gain_n_per_mv
        return doubted_n > 0.0 and force_n + doubted_n > self._settings.gate.grain_on_n

    def _force_std_dev(self, window: Window, force_n: float) -> float:
        """Standard deviation of the mean force, N: the scatter within the window, shrunk towards that of the windows before."""
        settings, machine = self._settings.windows, self._machine
        gain = machine.sensor.gain_n_per_mv
        per_scatter = (force_n / self._paddles(window.speed_rad_s, window.covered_s) ** 0.5) ** 2
        variance = self._scatter.square * per_scatter
        if isfinite(window.std_dev_mv):
            seen, own = (window.std_dev_mv * gain) ** 2, float(window.patterns - 1)
            prior = self._scatter.patterns
            if abs(force_n) > self._settings.gate.certain_force_n and not window.contested:
                self._scatter.see(seen / per_scatter, own)
            variance = (own * seen + prior * variance) / (own + prior)
        variance /= max(window.coverage, 1e-3)
        noise = hypot(variance**0.5, settings.min_force_std_dev_n)
        if not self._aliasing:
            return noise
        share = max(aliasing_share(source, machine, window.speed_rad_s) for source in self._aliasing)
        return hypot(noise, share * force_n) if share > 0.0 else noise

    def at_home(self, plate_angle_rad: float) -> bool:
        """Whether the plate is at home, within the tolerance of rest."""
        return abs(plate_angle_rad - self._machine.home_plate_angle_rad) <= self._rest_rad

    def scatter_n(self, force_n: float, speed_rad_s: float, seconds: float) -> float:
        """Standard deviation of a mean force by the scatter of its paddles, as estimated so far, N."""
        return abs(force_n) * sqrt(self._scatter.square / self._paddles(speed_rad_s, seconds))

    def _paddles(self, speed_rad_s: float, seconds: float) -> float:
        """Paddles that pass in a time, at least one."""
        return max(1.0, float(self._machine.passes_per_s(speed_rad_s)) * seconds)

    def _contradicts_speed(self, window: Window) -> bool:
        """Whether the pulses of a window with grain come at another rate than that of the reported speed."""
        zero, settings = self.zero.state, self._settings
        # Of pulses that are cut off neither range nor mean is known.
        if self._agreement is None or zero is None or not self._is_clean(window):
            return False
        grain_mv = window.mean_mv - zero.zero_mv
        if not grain_mv * self._machine.sensor.gain_n_per_mv > settings.gate.certain_force_n:
            return False
        return self._agreement.contradicted(window, grain_mv, pulses=self.zero.pulses(window))

    def _struck_at_rest(self, window: Window, force_n: float) -> bool:
        """Whether grain strikes the plate although the elevator is reported to stand."""
        gate = self._settings.gate
        if window.speed_rad_s > gate.min_turning_rpm * RPM or not force_n > gate.certain_force_n:
            return False
        return window.span_mv * self._machine.sensor.gain_n_per_mv > _PULSED * force_n

    def _idle_s(self, inputs: InputSnapshot) -> float:
        """How long header, work state or ground speed have indicated that no crop is taken in, s."""
        fresh = inputs.fresh
        idle = (
            fresh["header_down"] == HeaderDown.UP
            or fresh["work_state"] == WorkState.NOT_WORKING
            or fresh["ground_speed"] < self._settings.gate.min_ground_speed_m_s
        )
        if not idle:
            self._idle_since_s = None
            return 0.0
        if self._idle_since_s is None:
            self._idle_since_s = inputs.time_s
        return inputs.time_s - self._idle_since_s

    def _follow_zero(self, window: Window, inputs: InputSnapshot, elevator_runs: bool, plate_rests_at_home: bool) -> bool:
        """Update the zero with the window; returns whether a zero was taken from it."""
        if inputs.fresh["header_down"] == HeaderDown.DOWN and inputs.fresh["work_state"] != WorkState.NOT_WORKING:
            self._cutting_s = window.end_s
        self._obstacle = self._zero_obstacle(window, inputs, elevator_runs, plate_rests_at_home)
        if not self._obstacle and self.zero.calibrating and self.zero.waits_for_grain_to_pass(signs := self.signs_against_zero):
            self._obstacle = f"an elevator that runs empty: {signs}; stop taking in crop"
        self._follow_empty_spells(window, usable=not self._obstacle)
        if self._obstacle:
            self.zero.interrupt()
            if elevator_runs and window.samples:
                self.zero.lack(window, f"it takes {self._obstacle}")
            return False
        emptied = window.end_s - self._cutting_s >= self._settings.gate.emptying_s
        wanted = self.zero.calibrating or self.zero.state is None
        self.zero.see(window, may_be_empty=not self._gate.harvesting and emptied)
        return wanted and self.zero.state is not None and not self.zero.calibrating

    def _follow_empty_spells(self, window: Window, usable: bool) -> None:
        """Update the spells of an empty elevator with the window. usable: nothing hinders a zero.

        A sensor too slow for the paddles shows no pulses in grain either: a force that means grain without pulses is not empty.
        """
        zero = self.zero.state
        if zero is None or not usable or self.zero.pulses(window):
            self._empty_spells.interrupt()
            return
        force_n = (window.mean_mv - zero.zero_mv) * self._machine.sensor.gain_n_per_mv
        if abs(force_n) > self._settings.gate.certain_force_n:
            self._empty_spells.interrupt()
        else:
            self._empty_spells.see(window.mean_mv, zero.zero_mv, window.end_s)

    def _zero_age_s(self, window: Window) -> float:
        return window.end_s - self._zero_known_s + self._paused_since_zero_s

    def _moved_mv(self, window: Window, before: ZeroState | None, age_s: float, *, taken: bool) -> float:
        """As `Reading.zero_moved_mv`. before: the zero that the window was measured with; age_s: its age. taken: whether another
        was taken with it."""
        was_far, self._was_far = self._was_far, self.zero.far_mv != 0.0
        if taken or self.zero.pulses(window):
            self._moved = ""
        if before is None or taken:
            return _NAN
        if self._was_far and not was_far:
            moved_mv = self.zero.far_mv
        elif self._empty_spells.settled:
            moved_mv = self._empty_spells.level_mv - before.zero_mv
            moved_mv = moved_mv if abs(moved_mv) > self.zero.unseen_pulse_mv(window) else 0.0
        else:
            return _NAN
        if not contradicts_drift(self._settings.budget, age_s, abs(moved_mv)):
            return 0.0
        if abs(moved_mv) > self._settings.zero.noted_mv:
            self._moved = (
                f"the empty elevator reads {moved_mv:+.0f} mV from the zero with which the flow of the last {age_s:.0f} s was "
                "measured"
            )
        return moved_mv

    def _follow_step(self, window: Window, force_n: float, *, usable: bool, seen: bool) -> None:
        """Look for a step of the zero that the grain's pulses do not share. seen: the plate was seen empty."""
        if self._step is None:
            return
        if seen or self._step_from is not self.zero.state:
            self._step_from = self.zero.state
            self._step.forget()
            return
        gain = self._machine.sensor.gain_n_per_mv
        if usable and force_n > 0.0 and window.pulse_mv * gain > self._settings.gate.certain_force_n and self._is_clean(window):
            self._step.see(window, force_n / gain)

    def _is_clean(self, window: Window) -> bool:
        """Whether a window has all samples of one sensor, and none is cut off."""
        whole = window.coverage >= self._settings.windows.full_coverage and not (window.lost_frames or window.contested)
        return whole and not window.saturated_share > 0.0

    @property
    def _zero_drift(self) -> str:
        """What is wrong with the zero, for the operator; "" where nothing is."""
        if self._moved and not self.zero.suspect:
            return self._moved
        drift, step_mv = self.zero.drift, 0.0 if self._step is None else self._step.step_mv
        if drift or step_mv == 0.0:
            return drift
        return f"the signal has stepped by {step_mv:+.0f} mV, but the pulses of the grain have not changed"

    def _zero_away_mv(self, window: Window, doubted_mv: float) -> float:
        zero = self.zero.state
        if zero is None:
            return 0.0
        seen_mv = self._empty_spells.departure_mv(zero.zero_mv, self.zero.known_s, self.zero.unseen_pulse_mv(window))
        step_mv = 0.0 if self._step is None else self._step.step_mv
        return max(seen_mv, abs(self.zero.far_mv), abs(doubted_mv), abs(step_mv))

    def _is_level(self, window: Window) -> bool:
        """Whether a window's samples determine its level: full coverage, or most of it from a sensor that loses samples all the
        time. A sensor that starts or stops within the window may not have settled."""
        ended = window.end_s - window.last_frame_s > self._settings.inputs.sensor_timeout_s
        least = _ENOUGH if self._sampled and not ended else 1.0
        return window.coverage >= min(self._settings.windows.full_coverage, least)

    def _zero_obstacle(self, window: Window, inputs: InputSnapshot, elevator_runs: bool, plate_rests_at_home: bool) -> str:
        """What a window lacks for taking a zero, "" for nothing."""
        machine = self._machine
        if not inputs.speed_known:
            return "the elevator's speed, which no frame reports"
        if not elevator_runs:
            low, high = (speed / RPM for speed in (machine.min_elevator_speed_rad_s, machine.max_elevator_speed_rad_s))
            found = window.speed_rad_s / RPM
            return f"the elevator to run at {low:.0f} to {high:.0f} rpm: it turns at {found:.0f} rpm{_meant(found, low, high)}"
        if window.contested:
            return "samples of one impact sensor: more came than one sends"
        if not self._is_level(window):
            return f"whole seconds of samples from the impact sensor: the last has {100.0 * window.coverage:.0f} %"
        if not plate_rests_at_home:
            home = degrees(machine.home_plate_angle_rad)
            angle = degrees(window.plate_angle_rad)
            where = f"it is at {angle:.1f} deg" if isfinite(angle) else "no frame reports its angle"
            return f"the plate to rest at home, {home:.0f} deg: {where}"
        return ""


def _meant(found_rpm: float, low_rpm: float, high_rpm: float) -> str:
    """A hint where the speed, read in another unit, would be that of a working elevator; else ""."""
    for unit, factor in _OTHER_SPEEDS:
        if found_rpm < low_rpm <= found_rpm * factor <= high_rpm:
            return f"; if {found_rpm:.3g} is in {unit}, that is {found_rpm * factor:.0f} rpm: mapping `unit`"
    return ""
