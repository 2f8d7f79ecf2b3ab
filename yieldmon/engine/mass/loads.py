"""Loads and totals: which mass belongs to which load, and whether every second of it was measured.

A window whose coverage is at least `WindowSettings.min_coverage` counts its whole duration at its mean flow; below that, only the
time that was measured counts. A window without flow (not harvesting, no zero yet, an input missing) adds nothing. The mass of a
window for which more than one node sent samples is contested: it is counted separately and in no total.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import replace
from math import inf, isfinite, nan

from yieldmon.engine.flow import Flow
from yieldmon.engine.mass.load_errors import Deviations, LoadErrors
from yieldmon.engine.mass.load_register import LoadRegister
from yieldmon.engine.mass.load_summary import LoadClosed, LoadEvents, LoadOpened, LoadSummary
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.shared_error import ClosedLoadState
from yieldmon.engine.mass.silences import Missing, Silences
from yieldmon.engine.mass.since_empty import LoadSinceEmpty, SinceEmpty
from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.mass.unseen import FlowAtStop, UnseenMass
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.frames import EstimateQuality
from yieldmon.physics.machine import RPM

_KEPT_CLOSED = 12
"""Newest loads whose budgets and shared errors are kept over a restart."""


class Loads:
    """The loads of one machine: counted second by second, restated as their shared errors become known, and corrected.

    Times are bus time, s; nan before the first frame.
    """

    def __init__(self, settings: EngineSettings) -> None:
        self._settings = settings
        self._register = LoadRegister(self._at_market(Totals()))
        self._errors = LoadErrors()
        self._silences = Silences()
        self._unseen = UnseenMass()
        self._since_empty = SinceEmpty()
        self._counted_until_s = nan
        self._stopped_at_s = nan

    @property
    def totals(self) -> Totals:
        """Masses of the load and in total."""
        return self._register.totals

    @totals.setter
    def totals(self, totals: Totals) -> None:
        self._register.totals = totals

    @property
    def open(self) -> LoadSummary | None:
        """The open load."""
        return self._register.open

    @property
    def all(self) -> tuple[LoadSummary, ...]:
        """Loads completed since the start, and the open one."""
        return self._register.all

    # Begin and end

    def begin(self, now_s: float) -> LoadEvents:
        """With the first frame: begin the load, unless it has a start."""
        if isfinite(self._register.start_s):
            return ()
        self._register.start_s = now_s
        self._unseen.resume(now_s - self._stopped_at_s)
        self._stopped_at_s = now_s
        fresh = self.totals.load_open and self.totals.load_kg == 0.0
        return (LoadOpened(self._register.summary()),) if fresh else ()

    def start(self, now_s: float) -> LoadEvents:
        """Begin a new load."""
        return (*self._close(now_s), *self._open(self.totals.start_load(), now_s))

    def reset(self, now_s: float) -> LoadEvents:
        """Set all masses to 0 and begin a load with the next number."""
        closed = self._close(now_s)
        self._unseen.total_kg = 0.0
        self._since_empty.totals_reset()
        return (*closed, *self._open(self.totals.start_totals(), now_s))

    def stop(self, now_s: float) -> LoadEvents:
        """The load is complete; mass measured from now on belongs to no load until the next one starts."""
        closed = self._close(now_s)
        self.totals = self.totals.stop_load()
        return closed

    def _open(self, totals: Totals, now_s: float) -> LoadEvents:
        self.totals, self._register.start_s = totals, now_s
        self._register.complete, self._silences = True, Silences()
        return (LoadOpened(self._register.summary()),)

    def _close(self, now_s: float) -> LoadEvents:
        self._miss(self._unseen.cut())
        unseen_kg, self._unseen.load_kg = self._unseen.load_kg, 0.0
        if not self.totals.load_open:
            return ()
        closed = self._register.close(now_s, unseen_kg)
        self._errors.keep(self._register.closed_numbers)
        return (LoadClosed(closed),)

    # What every second brings

    def count(
        self,
        window: Window,
        flow: Flow,
        moisture_pct: float,
        area_m2: float = nan,
        missing: Missing = Missing.SOME,
        *,
        silent: bool = False,
    ) -> float:
        """Add a window to the totals.

        Parameters
        ----------
        window : Window
        flow : Flow
            As it is counted.
        moisture_pct : float
            Wet basis, %; nan where it is not known.
        area_m2 : float
            Of the window's grain, m2; nan where it is not known.
        missing : Missing
            Which inputs are missing, where there is no flow.
        silent : bool
            Neither sensor nor elevator speed is reported any more.

        Returns
        -------
        float
            Mass added, kg.
        """
        lacking = None if flow.measured or flow.quality is not EstimateQuality.NOT_AVAILABLE else missing
        stands = window.speed_rad_s <= self._settings.gate.min_turning_rpm * RPM
        duration_s, self._counted_until_s = window.end_s - window.start_s, window.end_s
        whole = self._silences.lacks_nothing(duration_s, lacking, stands=stands)
        if not whole:
            self.doubt()
        if missing is Missing.HIDDEN:
            self.totals = self.totals.with_hidden(self._unseen.grain_kg_s * duration_s)
        else:
            rate_kg_s = flow.rate_kg_s if flow.measured else 0.0
            self._miss(self._unseen.second(duration_s, rate_kg_s, lacking, whole=whole, stands=stands, silent=silent))
        if not flow.measured:
            self.totals = self.totals.with_area(area_m2, 0.0)
            return 0.0
        enough = window.coverage >= self._settings.windows.min_coverage
        seconds = window.weight_s if enough else window.covered_s
        mass_kg = flow.rate_kg_s * seconds
        if not enough:
            self.doubt()
            self._miss(flow.rate_kg_s * max(duration_s - window.covered_s, 0.0))
        if window.contested:
            # Which node's samples are the plate's is not known.
            self.doubt()
            self.totals = self.totals.with_contested(mass_kg).with_area(area_m2, 0.0)
            return 0.0
        dry_kg = self.dry_kg(mass_kg, moisture_pct)
        self.totals = self.totals.with_mass(mass_kg, dry_kg, flow.budget, seconds, area_m2)
        self._since_empty.add(self.totals.load_number if self.totals.load_open else NO_LOAD, flow.budget, flow.force_n, seconds)
        return mass_kg

    def seen_empty(self, force_n: float) -> LoadEvents:
        """The plate is seen empty, force_n from the zero by which the mass since then was measured, 0 where drift explains it:
        its standard deviation is at least what that makes. Returns the closed loads that change."""
        lacking = self._since_empty.seen_empty(force_n)
        return tuple(event for number, kg in lacking.items() for event in self._register.widen_zero(number, kg))

    def doubt(self) -> None:
        """Mass counted last may be wrong: the load cannot be compared with a weight."""
        self._register.complete = False

    def _miss(self, unseen_kg: float) -> None:
        """Add to the budgets that unseen_kg may have come unmeasured."""
        if unseen_kg > 0.0:
            self.totals = self.totals.with_unseen(unseen_kg, before=self._unseen)
            self._unseen.load_kg += unseen_kg
            self._unseen.total_kg += unseen_kg

    # What becomes known of all mass measured with the same parameters or scale

    def share(self, mass_kg: float, flow: Flow, version: int, plate_angle_rad: float, error: AngleError = NO_ERROR) -> None:
        """After `count`: add the window's shared error to its load. version: of the parameters that measured it. error: of the
        model, at the window's angle and at those of the load before it."""
        totals = self.totals
        if totals.load_open and mass_kg > 0.0:
            self._restate(
                self._errors.measured(
                    totals.load_number,
                    mass_kg,
                    flow,
                    budget=totals.load_budget,
                    version=version,
                    plate_angle_rad=plate_angle_rad,
                    error=error,
                )
            )

    def restate(self, error: AngleError, version: int) -> LoadEvents:
        """Sweeps show another model error with these parameters: restate all loads measured with them. Returns the closed loads
        that change."""
        return self._restate(self._errors.by_model(error, version))

    def scale_is_off(self, relative: float, by_load: int = 0) -> LoadEvents:
        """A weighed mass shows the scale in use since `scale_is_set` to be off by `relative`: the least relative standard
        deviation of all mass measured with it. by_load: number of the weighed load. Returns the closed loads that change."""
        return self._restate(self._errors.scale_is_off(relative, by_load, self._register.budget))

    def scale_was_right(self, by_loads: Container[int], *, again: Container[int] = (), crop: str = "") -> LoadEvents:
        """Take back the tickets for these loads with their effect on other loads; the parameters are those from before them.
        again: loads whose tickets will update the parameters again. crop: of the parameters, where another crop is harvested
        now, else "". Returns the closed loads that change."""
        masses_kg = {load.number: load.measured_kg for load in self.all}
        return self._decrease(self._errors.scale_was_right(by_loads, masses_kg, again=again, crop=crop))

    def forget_weights(self, by_loads: Container[int]) -> LoadEvents:
        """Take back the tickets for these loads with their effect on other loads; the parameters in use do not rest on them."""
        return self._decrease(self._errors.forget_weights(by_loads))

    def scale_is_set(self, by_loads: Iterable[int] = ()) -> None:
        """The parameters have a new scale from now on, from the weights of these loads or from outside."""
        self._errors.scale_is_set(by_loads)

    def change_crop(self, before: str, now: str) -> None:
        """Another crop from now on, measured with the parameters it had when it was last harvested."""
        self._errors.change_crop(before, now)

    def widen(self, error_kg: float, by_load: int = 0) -> None:
        """The standard deviation of the open load by the parameters turns out to be at least error_kg. by_load: number of the
        load whose weight shows it."""
        totals = self.totals
        if not (totals.load_open and error_kg > 0.0):
            return
        load = totals.load_budget.with_common(error_kg)
        more_kg = load.parameters_kg - totals.load_budget.parameters_kg
        self._errors.widened(totals.load_number, by_load, more_kg)
        self.totals = totals.with_budgets(load=load, total=totals.total_budget.with_parameters(more_kg))

    def _restate(self, deviations: Deviations) -> LoadEvents:
        """Set the standard deviations of loads. Returns the closed loads that change."""
        return tuple(event for number, kg in deviations for event in self._register.restate(number, kg))

    def _decrease(self, deviations: Deviations) -> LoadEvents:
        """Decrease the standard deviations of loads by so much, kg. Returns the closed loads that change."""
        events: LoadEvents = ()
        for number, by_kg in deviations:
            known = self._register.budget(number)
            if known is not None:
                events += self._register.restate(number, max(known.parameters_kg - by_kg, 0.0))
        return events

    # Corrections

    def correct(self, missed: Mapping[int, MissedMass], since: UnseenMass | None = None) -> LoadEvents:
        """Add mass that was missed, by load number, to its loads, and to the totals where it came since their reset. Returns the
        closed loads that change. since: mass that may have come since the last measured second, where computed anew."""
        events: LoadEvents = ()
        for number, found in missed.items():
            self._errors.forget_parameters(number)
            self._since_empty.recomputed(number)
            events += self._register.correct(number, found, self._unseen)
        if since is not None:
            self._unseen.recomputed(since)
        return events

    # Moisture of dry masses

    def dry_kg(self, wet_kg: float, moisture_pct: float) -> float | None:
        """Mass at market moisture, kg; None where the moisture is not known."""
        return dry_mass(wet_kg, moisture_pct, self._settings.totals, self.totals.market_moisture_pct)

    def set_market_moisture(self, moisture_pct: float) -> None:
        """Set the moisture of the dry masses counted from now on, %; the settings take precedence."""
        self.totals = self._at_market(replace(self.totals, market_moisture_pct=moisture_pct))

    def _at_market(self, totals: Totals) -> Totals:
        given = self._settings.totals.moisture_reference_pct
        return totals if given is None else replace(totals, market_moisture_pct=given)

    # Over a restart

    @property
    def counted_until_s(self) -> float:
        """Engine time of the end of the last window; nan before one."""
        return self._counted_until_s

    def at_stop(self, counted_until_s: float) -> FlowAtStop | None:
        """For `restore`; None before the first frame. counted_until_s: bus time of the end of the last window, nan before one."""
        time_s = counted_until_s if isfinite(counted_until_s) else self._stopped_at_s
        return self._unseen.at_stop(time_s) if isfinite(time_s) else None

    @property
    def closed_states(self) -> tuple[ClosedLoadState, ...]:
        """States of the newest loads, the open one included."""
        numbers = self._register.closed_numbers | ({self.totals.load_number} if self.totals.load_open else set())
        budgets = ((number, self._register.budget(number)) for number in sorted(numbers))
        known = [(number, budget) for number, budget in budgets if budget is not None and 0.0 < budget.std_dev_kg < inf]
        return tuple(self._errors.state(number, budget) for number, budget in known[-_KEPT_CLOSED:])

    @property
    def since_empty_states(self) -> tuple[LoadSinceEmpty, ...]:
        """Mass since the plate was last seen empty, for `restore`."""
        known = {state.number for state in self.closed_states}
        return self._since_empty.states(known, self.totals.first_load)

    def as_stated(self, load: LoadSummary) -> LoadSummary:
        """A load of an earlier run with the budget that is kept of it, else as given."""
        return self._register.as_stated(load)

    def restore(self, totals: Totals, before_stop: FlowAtStop | None = None, since_empty: Iterable[LoadSinceEmpty] = ()) -> None:
        """Continue from stored totals; grain since then was not measured. before_stop, since_empty: what `at_stop` and
        `since_empty_states` returned then."""
        self._since_empty.resume(since_empty)
        self._errors.clear()
        self._register.restore(self._at_market(totals))
        stop = before_stop or FlowAtStop(nan, 0.0)
        self._silences, self._unseen, self._stopped_at_s = Silences(), UnseenMass.since(stop), stop.time_s

    def resume_closed(self, states: Iterable[ClosedLoadState], version: int) -> None:
        """After `restore`: continue with loads that an earlier run closed; version: of the parameters in use."""
        for state in states:
            self._errors.resume(state, version)
            self._register.resume(state.number, state.budget)

    def resume_share(self, error: AngleError, version: int, home_rad: float) -> None:
        """After `restore`: the open load was measured with the parameters of this version, which are in use, and its budget
        contains this model error. All of it is taken as measured at home_rad."""
        totals = self.totals
        if totals.load_open and totals.load_kg > 0.0:
            self._errors.resume_share(
                totals.load_number, totals.load_kg, totals.load_budget, error=error, version=version, home_rad=home_rad
            )
