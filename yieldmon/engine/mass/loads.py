"""Loads and totals: which mass belongs to which load, and whether every second of it was measured.

A window whose coverage is at least `WindowSettings.min_coverage` counts its whole duration at its mean flow; below that, only the
time that was measured counts. A window without flow (not harvesting, no zero yet, an input missing) adds nothing. The mass of a
window for which more than one node sent samples is contested: it is counted separately and in no total.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Container, Iterable, Mapping
from dataclasses import replace
from math import inf, isfinite

from yieldmon.engine.flow import Flow
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_errors import Deviations, LoadErrors
from yieldmon.engine.mass.load_summary import LoadClosed, LoadEvents, LoadOpened, LoadRestated, LoadSummary
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.shared_error import ClosedLoadState
from yieldmon.engine.mass.silences import Missing, Silences
from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.mass.unseen import FlowAtStop, UnseenMass
from yieldmon.engine.sampling.windows import Window
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.frames import EstimateQuality
from yieldmon.physics.machine import RPM

_NAN = float("nan")
_KEPT_LOADS = 256
"""Closed loads kept."""
_KEPT_CLOSED = 12
"""Newest loads whose budgets and shared errors are kept over a restart."""
_RESTATED = 0.01
"""Least relative change of a closed load's standard deviation for which it is reported again."""


class Loads:
    """The loads of one machine. Times are bus time, s; nan before the first frame."""

    def __init__(self, settings: EngineSettings) -> None:
        self._settings = settings
        self.totals = self._at_market(Totals())
        self._closed: deque[LoadSummary] = deque(maxlen=_KEPT_LOADS)
        self._start_s = _NAN
        self._complete = True
        self._silences = Silences()
        self._unseen = UnseenMass()
        self._last_kg_s = 0.0
        self._counted_until_s = _NAN
        self._stopped_at_s = _NAN
        self._errors = LoadErrors()
        self._before: dict[int, MassBudget] = {}
        """Budgets of loads that closed in an earlier run, by number."""
        self._closed_unseen_kg: dict[int, float] = {}
        """Standard deviation by unmeasured mass of loads that closed in this run, by number."""

    @property
    def open(self) -> LoadSummary | None:
        """The open load."""
        return self._summary(_NAN) if self.totals.load_open else None

    @property
    def all(self) -> tuple[LoadSummary, ...]:
        """Loads completed since the start, and the open one."""
        return (*self._closed, self._summary(_NAN)) if self.totals.load_open else tuple(self._closed)

    def begin(self, now_s: float) -> LoadEvents:
        """With the first frame: begin the load, unless it has a start."""
        if isfinite(self._start_s):
            return ()
        self._start_s = now_s
        self._unseen.resume(now_s - self._stopped_at_s)
        self._stopped_at_s = now_s
        fresh = self.totals.load_open and self.totals.load_kg == 0.0
        return (LoadOpened(self._summary(_NAN)),) if fresh else ()

    def start(self, now_s: float) -> LoadEvents:
        """Begin a new load."""
        closed = self._close(now_s)
        self.totals = self.totals.start_load()
        self._start_s = now_s
        self._complete, self._silences = True, Silences()
        return (*closed, LoadOpened(self._summary(_NAN)))

    def reset(self, now_s: float) -> LoadEvents:
        """Set all masses to 0 and begin a load with the next number."""
        closed = self._close(now_s)
        number = self.totals.load_number + 1
        self._unseen.total_kg = 0.0
        self.totals = Totals(load_number=number, first_load=number, market_moisture_pct=self.totals.market_moisture_pct)
        self._start_s = now_s
        self._complete, self._silences = True, Silences()
        return (*closed, LoadOpened(self._summary(_NAN)))

    def stop(self, now_s: float) -> LoadEvents:
        """The load is complete; mass measured from now on belongs to no load until the next one starts."""
        closed = self._close(now_s)
        self.totals = self.totals.stop_load()
        return closed

    def count(
        self,
        window: Window,
        flow: Flow,
        moisture_pct: float,
        area_m2: float = _NAN,
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
        available = flow.measured or flow.quality is not EstimateQuality.NOT_AVAILABLE
        stands = window.speed_rad_s <= self._settings.gate.min_turning_rpm * RPM
        duration_s, self._counted_until_s = window.end_s - window.start_s, window.end_s
        whole = self._silences.lacks_nothing(duration_s, None if available else missing, stands=stands)
        if not whole:
            self._complete = False
        if flow.rate_kg_s > 0.0:
            self._last_kg_s = flow.rate_kg_s
        if missing is Missing.HIDDEN:
            self.totals = self.totals.with_hidden(self._last_kg_s * duration_s)
        elif available:
            self._miss(self._unseen.measured(flow.rate_kg_s if flow.measured else 0.0, whole=whole))
        elif not (stands and missing in (Missing.ALL, Missing.ZERO_STANDING)):
            self._unseen.missing(duration_s, whole=whole, silent=silent)
        if not flow.measured:
            self.totals = self.totals.with_area(area_m2, 0.0)
            return 0.0
        enough = window.coverage >= self._settings.windows.min_coverage
        seconds = window.weight_s if enough else window.covered_s
        mass_kg = flow.rate_kg_s * seconds
        if not enough:
            self._complete = False
            self._miss(flow.rate_kg_s * max(duration_s - window.covered_s, 0.0))
        if window.contested:
            # Which node's samples are the plate's is not known.
            self._complete = False
            self.totals = self.totals.with_contested(mass_kg).with_area(area_m2, 0.0)
            return 0.0
        dry_kg = self.dry_kg(mass_kg, moisture_pct)
        self.totals = self.totals.with_mass(mass_kg, dry_kg, flow.budget, seconds, area_m2)
        return mass_kg

    def _miss(self, unseen_kg: float) -> None:
        """Add to the budgets that unseen_kg may have come unmeasured."""
        if unseen_kg > 0.0:
            self.totals = self.totals.with_unseen(unseen_kg, before=self._unseen)
            self._unseen.load_kg += unseen_kg
            self._unseen.total_kg += unseen_kg

    def resume_share(self, error: AngleError, version: int, home_rad: float) -> None:
        """After `restore`: the open load was measured with the parameters of this version, which are in use, and its budget
        contains this model error. All of it is taken as measured at home_rad."""
        totals = self.totals
        if totals.load_open and totals.load_kg > 0.0:
            self._errors.resume_share(
                totals.load_number, totals.load_kg, totals.load_budget, error=error, version=version, home_rad=home_rad
            )

    def share(self, mass_kg: float, flow: Flow, version: int, plate_angle_rad: float, error: AngleError = NO_ERROR) -> None:
        """After `count`: add the window's shared error to its load. version: of the parameters that measured it. error: of the
        model, at the window's angle and at those of the load before it."""
        totals = self.totals
        if totals.load_open and mass_kg > 0.0:
            self._restated_all(
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
        return self._restated_all(self._errors.by_model(error, version))

    def scale_is_off(self, relative: float, by_load: int = 0) -> LoadEvents:
        """A weighed mass shows the scale in use since `scale_is_set` to be off by `relative`: the least relative standard
        deviation of all mass measured with it. by_load: number of the weighed load. Returns the closed loads that change."""
        return self._restated_all(self._errors.scale_is_off(relative, by_load, self._budget_of))

    def scale_was_right(self, by_loads: Container[int], *, again: Container[int] = (), crop: str = "") -> LoadEvents:
        """Take back the tickets for these loads with their effect on other loads; the parameters are those from before them.
        again: loads whose tickets will update the parameters again. crop: of the parameters, where another crop is harvested
        now, else "". Returns the closed loads that change."""
        masses_kg = {load.number: load.measured_kg for load in self.all}
        return self._decreased(self._errors.scale_was_right(by_loads, masses_kg, again=again, crop=crop))

    def forget_weights(self, by_loads: Container[int]) -> LoadEvents:
        """Take back the tickets for these loads with their effect on other loads; the parameters in use do not rest on them."""
        return self._decreased(self._errors.forget_weights(by_loads))

    def _decreased(self, deviations: Deviations) -> LoadEvents:
        """Decrease the standard deviations of loads by so much, kg. Returns the closed loads that change."""
        events: list[LoadClosed | LoadOpened | LoadRestated] = []
        for number, by_kg in deviations:
            known = self._budget_of(number)
            if known is not None:
                events += self._restated(number, max(known.parameters_kg - by_kg, 0.0))
        return tuple(events)

    def scale_is_set(self, by_loads: Iterable[int] = ()) -> None:
        """The parameters have a new scale from now on, from the weights of these loads or from outside."""
        self._errors.scale_is_set(by_loads)

    def change_crop(self, before: str, now: str) -> None:
        """Another crop from now on, measured with the parameters it had when it was last harvested."""
        self._errors.change_crop(before, now)

    def _budget_of(self, number: int) -> MassBudget | None:
        if self.totals.load_open and number == self.totals.load_number:
            return self.totals.load_budget
        closed = next((load.budget for load in self._closed if load.number == number), None)
        return self._before.get(number) if closed is None else closed

    def _restated_all(self, deviations: Deviations) -> LoadEvents:
        """Set the standard deviations of loads. Returns the closed loads that change."""
        events: list[LoadClosed | LoadOpened | LoadRestated] = []
        for number, parameters_kg in deviations:
            events += self._restated(number, parameters_kg)
        return tuple(events)

    def _restated(self, number: int, parameters_kg: float) -> LoadEvents:
        totals = self.totals
        if totals.load_open and number == totals.load_number:
            more_kg = parameters_kg - totals.load_budget.parameters_kg
            load, total = totals.load_budget.with_parameters(more_kg), totals.total_budget.with_parameters(more_kg)
            self.totals = totals.with_budgets(load=load, total=total)
            return ()
        place = next((place for place, load in enumerate(self._closed) if load.number == number), None)
        before = self._before.get(number) if place is None else self._closed[place].budget
        if before is None:
            return ()
        budget = replace(before, parameters_kg=parameters_kg)
        if number >= totals.first_load:
            more_kg = parameters_kg - before.parameters_kg
            self.totals = replace(totals, total_budget=totals.total_budget.with_parameters(more_kg))
        if number == totals.load_number:
            # The totals show the last load until the next one begins.
            self.totals = replace(self.totals, load_budget=budget)
        changed = abs(budget.std_dev_kg - before.std_dev_kg) > _RESTATED * before.std_dev_kg
        if place is None:
            self._before[number] = budget
            return (LoadRestated(number, budget),) if changed else ()
        self._closed[place] = replace(self._closed[place], budget=budget, std_dev_kg=budget.std_dev_kg)
        return (LoadClosed(self._closed[place]),) if changed else ()

    @property
    def closed_states(self) -> tuple[ClosedLoadState, ...]:
        """States of the newest loads, the open one included."""
        budgets = {**self._before, **{load.number: load.budget for load in self._closed}}
        if self.totals.load_open:
            budgets[self.totals.load_number] = self.totals.load_budget
        known = [number for number in sorted(budgets) if 0.0 < budgets[number].std_dev_kg < inf]
        return tuple(self._errors.state(number, budgets[number]) for number in known[-_KEPT_CLOSED:])

    def resume_closed(self, states: Iterable[ClosedLoadState], version: int) -> None:
        """After `restore`: continue with loads that an earlier run closed; version: of the parameters in use."""
        for state in states:
            self._errors.resume(state, version)
            if not (self.totals.load_open and state.number == self.totals.load_number):
                self._before[state.number] = state.budget

    def as_stated(self, load: LoadSummary) -> LoadSummary:
        """A load of an earlier run with the budget that is kept of it, else as given."""
        budget = self._before.get(load.number, load.budget)
        return replace(load, std_dev_kg=budget.std_dev_kg, budget=budget)

    def widen(self, error_kg: float, by_load: int = 0) -> None:
        """The standard deviation of the open load by the parameters turns out to be at least error_kg. by_load: number of the
        load whose weight shows it."""
        totals = self.totals
        if not (totals.load_open and error_kg > 0.0):
            return
        load = totals.load_budget.with_common(error_kg)
        more_kg = load.parameters_kg - totals.load_budget.parameters_kg
        self._errors.widened(totals.load_number, by_load, more_kg)
        total = totals.total_budget.with_common(totals.total_budget.parameters_kg + more_kg)
        self.totals = totals.with_budgets(load=load, total=total)

    def doubt(self) -> None:
        """Mass counted last may be wrong: the load cannot be compared with a weight."""
        self._complete = False

    @property
    def counted_until_s(self) -> float:
        """Engine time of the end of the last window; nan before one."""
        return self._counted_until_s

    def at_stop(self, counted_until_s: float) -> FlowAtStop | None:
        """For `restore`; None before the first frame. counted_until_s: bus time of the end of the last window, nan before one."""
        time_s = counted_until_s if isfinite(counted_until_s) else self._stopped_at_s
        return self._unseen.at_stop(time_s, self._last_kg_s) if isfinite(time_s) else None

    def restore(self, totals: Totals, before_stop: FlowAtStop | None = None) -> None:
        """Continue from stored totals; grain since then was not measured. before_stop: what `at_stop` returned then."""
        self._errors.clear()
        self._before = {}
        self.totals = self._at_market(totals)
        self._complete, self._silences = not (totals.load_open and totals.load_kg > 0.0), Silences()
        stop = before_stop or FlowAtStop(_NAN, 0.0)
        self._unseen, self._last_kg_s, self._stopped_at_s = UnseenMass.since(stop), stop.grain_kg_s, stop.time_s

    def correct(self, missed: Mapping[int, MissedMass], since: UnseenMass | None = None) -> LoadEvents:
        """Add mass that was missed, by load number, to its loads, and to the totals where it came since their reset. Returns the
        closed loads that change. since: mass that may have come since the last measured second, where computed anew."""
        events: list[LoadClosed | LoadOpened | LoadRestated] = []
        for number, found in missed.items():
            self._errors.forget_parameters(number)
            totals, known = self.totals, self._budget_of(number)
            here = number == totals.load_number
            taken, is_open = max(found.kg, -totals.load_kg) if here else found.kg, here and totals.load_open
            of_closed_kg = self._closed_unseen_kg.get(number, found.unseen.before_kg)
            before = self._unseen if is_open else replace(self._unseen, load_kg=of_closed_kg)
            of_load, _ = before.changed_by(found.unseen)
            if number == NO_LOAD or number >= totals.first_load:
                self.totals = totals.with_missed(replace(found, kg=taken), in_load=here, before=before)
                self._unseen.change(found.unseen, in_load=is_open)
            if self._before.pop(number, None) is not None and here:
                # The masses of earlier loads are not known here; whoever stores them corrects them.
                self._before[number] = self.totals.load_budget
            for place, load in enumerate(self._closed):
                if load.number == number:
                    self._closed[place] = load.with_missed(replace(found, unseen=of_load))
                    self._closed_unseen_kg[number] = of_load.after_kg
                    events.append(LoadClosed(self._closed[place]))
            stated = self._budget_of(number)
            if number >= totals.first_load and isfinite(found.again_kg) and known is not None and stated is not None:
                # The load's zero is known anew as a whole, and the total's is that of all of its loads.
                zero_kg = max(totals.total_budget.zero_kg - known.zero_kg, 0.0) + stated.zero_kg
                self.totals = replace(self.totals, total_budget=replace(self.totals.total_budget, zero_kg=zero_kg))
        if since is not None:
            self._unseen.measured_again(since)
        return tuple(events)

    def dry_kg(self, wet_kg: float, moisture_pct: float) -> float | None:
        """Mass at market moisture, kg; None where the moisture is not known."""
        return dry_mass(wet_kg, moisture_pct, self._settings.totals, self.totals.market_moisture_pct)

    def set_market_moisture(self, moisture_pct: float) -> None:
        """Set the moisture of the dry masses counted from now on, %; the settings take precedence."""
        self.totals = self._at_market(replace(self.totals, market_moisture_pct=moisture_pct))

    def _at_market(self, totals: Totals) -> Totals:
        given = self._settings.totals.moisture_reference_pct
        return totals if given is None else replace(totals, market_moisture_pct=given)

    def _summary(self, end_s: float) -> LoadSummary:
        totals = self.totals
        return LoadSummary(
            number=totals.load_number,
            start_s=self._start_s,
            end_s=end_s,
            measured_kg=totals.load_kg,
            dry_kg=totals.load_dry_kg,
            unknown_moisture_kg=totals.load_unknown_moisture_kg,
            complete=self._complete,
            std_dev_kg=totals.load_budget.std_dev_kg,
            budget=totals.load_budget,
            area_m2=totals.load_area_m2,
            unknown_area_kg=totals.load_unknown_area_kg,
        )

    def _close(self, now_s: float) -> LoadEvents:
        self._miss(self._unseen.cut())
        unseen_kg, self._unseen.load_kg = self._unseen.load_kg, 0.0
        if not self.totals.load_open:
            return ()
        self._closed.append(self._summary(now_s))
        kept = {load.number for load in self._closed}
        self._errors.keep(kept | set(self._before))
        self._closed_unseen_kg[self.totals.load_number] = unseen_kg
        self._closed_unseen_kg = {number: kg for number, kg in self._closed_unseen_kg.items() if number in kept}
        return (LoadClosed(self._closed[-1]),)
