"""The loads of one machine by number, whose masses and error budgets may change after they were counted."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from math import isfinite, nan

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_summary import LoadClosed, LoadEvents, LoadRestated, LoadSummary
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.mass.unseen import UnseenMass

_KEPT_LOADS = 256
"""Closed loads kept."""
_RESTATED = 0.01
"""Least relative change of a closed load's standard deviation for which it is reported again."""


class LoadRegister:
    """The open load with the totals, the loads closed in this run, and the budgets of loads closed before it.

    Attributes
    ----------
    totals : Totals
    start_s : float
        Begin of the open load, bus time, s; nan before the first frame.
    complete : bool
        Whether every second of the open load was measured.
    """

    def __init__(self, totals: Totals) -> None:
        self.totals = totals
        self.start_s = nan
        self.complete = True
        self._closed: dict[int, LoadSummary] = {}
        self._unseen_kg: dict[int, float] = {}
        """Standard deviation by unmeasured mass of the loads closed in this run."""
        self._earlier: dict[int, MassBudget] = {}

    @property
    def open(self) -> LoadSummary | None:
        """The open load."""
        return self.summary() if self.totals.load_open else None

    @property
    def all(self) -> tuple[LoadSummary, ...]:
        """The loads closed in this run, and the open one."""
        return (*self._closed.values(), *((self.summary(),) if self.totals.load_open else ()))

    @property
    def closed_numbers(self) -> Set[int]:
        """Numbers of the closed loads that are known."""
        return self._closed.keys() | self._earlier.keys()

    def budget(self, number: int) -> MassBudget | None:
        """Of a load; None where it is not known."""
        if self._is_open(number):
            return self.totals.load_budget
        return self._closed[number].budget if number in self._closed else self._earlier.get(number)

    def summary(self, end_s: float = nan) -> LoadSummary:
        """The load that the totals show."""
        totals = self.totals
        return LoadSummary(
            number=totals.load_number,
            start_s=self.start_s,
            end_s=end_s,
            measured_kg=totals.load_kg,
            dry_kg=totals.load_dry_kg,
            unknown_moisture_kg=totals.load_unknown_moisture_kg,
            complete=self.complete,
            std_dev_kg=totals.load_budget.std_dev_kg,
            budget=totals.load_budget,
            area_m2=totals.load_area_m2,
            unknown_area_kg=totals.load_unknown_area_kg,
        )

    def close(self, end_s: float, unseen_kg: float) -> LoadSummary:
        """Keep the open load as closed. unseen_kg: standard deviation of its mass by unmeasured mass."""
        load = self.summary(end_s)
        self._closed[load.number], self._unseen_kg[load.number] = load, unseen_kg
        if len(self._closed) > _KEPT_LOADS:
            oldest = next(iter(self._closed))
            del self._closed[oldest], self._unseen_kg[oldest]
        return load

    def restore(self, totals: Totals) -> None:
        """Continue from stored totals."""
        self.totals = totals
        self.complete = not (totals.load_open and totals.load_kg > 0.0)
        self._earlier = {}

    def resume(self, number: int, budget: MassBudget) -> None:
        """After `restore`: a load of an earlier run; the totals contain the open one's budget."""
        if not self._is_open(number):
            self._earlier[number] = budget

    def as_stated(self, load: LoadSummary) -> LoadSummary:
        """A load of an earlier run with the budget that is kept of it, else as given."""
        budget = self._earlier.get(load.number, load.budget)
        return replace(load, std_dev_kg=budget.std_dev_kg, budget=budget)

    def restate(self, number: int, parameters_kg: float) -> LoadEvents:
        """Set the standard deviation of a load's mass by the parameters; changes nothing where the load is not known."""
        before = self.budget(number)
        if before is None:
            return ()
        more_kg = parameters_kg - before.parameters_kg
        budget = before.with_parameters(more_kg) if self._is_open(number) else replace(before, parameters_kg=parameters_kg)
        return self._state(number, before, budget, self.totals.total_budget.with_parameters(more_kg))

    def widen_zero(self, number: int, more_kg: float) -> LoadEvents:
        """Increase the standard deviation of a load's mass by the zero; of `NO_LOAD`, or a load that is not known, that of the
        totals alone."""
        total, before = self.totals.total_budget.with_zero(more_kg), self.budget(number)
        if before is not None:
            return self._state(number, before, before.with_zero(more_kg), total)
        if number == NO_LOAD or number >= self.totals.first_load:
            self.totals = self.totals.with_budgets(load=self.totals.load_budget, total=total)
        return ()

    def _state(self, number: int, before: MassBudget, budget: MassBudget, total: MassBudget) -> LoadEvents:
        """Set the budget of a known load. total: of the totals, where the load is in them."""
        totals = self.totals
        if not (number >= totals.first_load or self._is_open(number)):
            total = totals.total_budget
        if self._is_open(number):
            self.totals = totals.with_budgets(load=budget, total=total)
            return ()
        # The totals show the last load until the next one begins.
        self.totals = totals.with_budgets(load=budget if number == totals.load_number else totals.load_budget, total=total)
        changed = abs(budget.std_dev_kg - before.std_dev_kg) > _RESTATED * before.std_dev_kg
        if number not in self._closed:
            self._earlier[number] = budget
            return (LoadRestated(number, budget),) if changed else ()
        load = self._closed[number] = replace(self._closed[number], budget=budget, std_dev_kg=budget.std_dev_kg)
        return (LoadClosed(load),) if changed else ()

    def correct(self, number: int, missed: MissedMass, unseen: UnseenMass) -> LoadEvents:
        """Add mass that was missed to its load, and to the totals where it came since their reset. unseen: of the open load and
        the totals, changed with them."""
        totals, known = self.totals, self.budget(number)
        here, is_open = number == totals.load_number, self._is_open(number)
        taken = max(missed.kg, -totals.load_kg) if here else missed.kg
        before = unseen if is_open else replace(unseen, load_kg=self._unseen_kg.get(number, missed.unseen.before_kg))
        of_load, _ = before.changed_by(missed.unseen)
        if number == NO_LOAD or number >= totals.first_load:
            self.totals = totals.with_missed(replace(missed, kg=taken), in_load=here, before=before)
            unseen.change(missed.unseen, in_load=is_open)
        if self._earlier.pop(number, None) is not None and here:
            # The masses of earlier loads are not known here; whoever stores them corrects them.
            self._earlier[number] = self.totals.load_budget
        events: LoadEvents = ()
        if number in self._closed:
            self._closed[number] = self._closed[number].with_missed(replace(missed, unseen=of_load))
            self._unseen_kg[number] = of_load.after_kg
            events = (LoadClosed(self._closed[number]),)
        stated = self.budget(number)
        if number >= totals.first_load and isfinite(missed.again_kg) and known is not None and stated is not None:
            # The load's zero is known anew as a whole, and the total's is that of all of its loads.
            zero_kg = max(totals.total_budget.zero_kg - known.zero_kg, 0.0) + stated.zero_kg
            self.totals = replace(self.totals, total_budget=replace(self.totals.total_budget, zero_kg=zero_kg))
        return events

    def _is_open(self, number: int) -> bool:
        return self.totals.load_open and number == self.totals.load_number
