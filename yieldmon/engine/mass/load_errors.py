"""What all of a load's mass may be off by together: the parameters that measured it, the model's error, the scale.

Numbers in, numbers out: a load is known by its number, and `Loads` states the standard deviations that come back.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import replace

from yieldmon.engine.flow import Flow
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.shared_error import ClosedLoadState, SharedError
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError

Deviations = tuple[tuple[int, float], ...]
"""Number of a load, and the standard deviation of its mass by its parameters, kg, from now on."""


class LoadErrors:
    """Of the loads of one machine."""

    def __init__(self) -> None:
        self._shared: dict[int, SharedError] = {}
        """Of loads that the parameters in use have measured, by number."""
        self._of_scale: dict[int, float] = {}
        """Mass, kg, measured since the parameters' scale was set last, by load."""
        self._of_crop: dict[str, dict[int, float]] = {}
        """The same of crops harvested before, with their own parameters."""
        self._off: dict[tuple[int, int], float] = {}
        """What of a load's deviation, kg, is there because the scale was found to be off, by load and by the load weighed."""

    def clear(self) -> None:
        """Nothing is known of any load."""
        self._shared, self._of_scale, self._of_crop, self._off = {}, {}, {}, {}

    def keep(self, numbers: Container[int]) -> None:
        """Only these loads can be stated anew."""
        self._shared = {number: shared for number, shared in self._shared.items() if number in numbers}
        self._of_scale = {number: mass_kg for number, mass_kg in self._of_scale.items() if number in numbers}
        self._off = {key: more_kg for key, more_kg in self._off.items() if key[0] in numbers}

    def forget_parameters(self, number: int) -> None:
        """By which parameters the load was measured is not known any more."""
        self._shared.pop(number, None)

    def scale_is_set(self) -> None:
        """From now on the parameters have another scale: by a weighed mass, or from outside."""
        self._of_scale = {}

    def change_crop(self, before: str, now: str) -> None:
        """From now on another crop is measured with the parameters that it had when it was harvested last."""
        self._of_crop[before] = self._of_scale
        self._of_scale = self._of_crop.pop(now, {})

    def measured(
        self,
        number: int,
        mass_kg: float,
        flow: Flow,
        *,
        budget: MassBudget,
        version: int,
        plate_angle_rad: float,
        error: AngleError,
    ) -> Deviations:
        """More of a load was measured.

        Parameters
        ----------
        number : int
        mass_kg : float
        flow : Flow
            Of that mass.
        budget : MassBudget
            Of the load with it.
        version : int
            Of the parameters that measured it.
        plate_angle_rad : float
        error : AngleError
            Of the model, at this angle and at those of the load before it; `NO_ERROR`: the budget holds it.
        """
        self._of_scale[number] = self._of_scale.get(number, 0.0) + mass_kg
        seconds, known = mass_kg / flow.rate_kg_s, self._shared.get(number)
        if known is None or known.version != version:
            # What other parameters measured stays as stated.
            self._shared = {n: shared for n, shared in self._shared.items() if shared.version == version}
            known = SharedError(version, budget.parameters_kg - flow.budget.parameters_kg_s * seconds)
        self._shared[number] = known = known.plus(flow.budget, seconds, plate_angle_rad)
        return () if error is NO_ERROR else ((number, known.parameters_kg(error)),)

    def resume_share(
        self, number: int, mass_kg: float, budget: MassBudget, *, error: AngleError, version: int, home_rad: float
    ) -> None:
        """A load was measured at home, rad, with the parameters of this version; its budget holds this error of the model."""
        if number not in self._shared:
            own_kg = max(budget.parameters_kg**2 - (error.home * mass_kg) ** 2, 0.0) ** 0.5
            self._shared[number] = SharedError.at(version, own_kg, mass_kg, home_rad)

    def by_model(self, error: AngleError, version: int) -> Deviations:
        """Of all loads that these parameters have measured, with this error of the model."""
        return tuple((n, shared.parameters_kg(error)) for n, shared in self._shared.items() if shared.version == version)

    def scale_is_off(self, relative: float, by_load: int, budget_of: Callable[[int], MassBudget | None]) -> Deviations:
        """The scale that the parameters have had since `scale_is_set` is off by so much, by the weight of a load: that is the
        least deviation of all that was measured with it. budget_of: a load's, None where it is not known."""
        found: list[tuple[int, float]] = []
        for number, mass_kg in self._of_scale.items():
            self._shared.pop(number, None)
            known = budget_of(number)
            if known is not None and relative * mass_kg > known.parameters_kg:
                more_kg = relative * mass_kg - known.parameters_kg
                self._off[number, by_load] = self._off.get((number, by_load), 0.0) + more_kg
                found.append((number, known.parameters_kg + more_kg))
        return tuple(found)

    def scale_was_right(self, by_loads: Container[int], masses_kg: Mapping[int, float]) -> Deviations:
        """What the tickets for these loads have shown of the scale is taken back, with the parameters that they led to.

        masses_kg: of the loads of this run, by number. Returns by how much, kg, the deviations of loads are less, a pair for each
        ticket.
        """
        found: list[tuple[int, float]] = []
        for number, by_load in [key for key in self._off if key[1] in by_loads]:
            more_kg, shared = self._off.pop((number, by_load)), self._shared.get(number)
            if number in masses_kg:
                self._of_scale[number] = masses_kg[number]
            if shared is not None:
                self._shared[number] = replace(shared, before_kg=max(shared.before_kg - more_kg, 0.0))
            found.append((number, more_kg))
        return tuple(found)

    def state(self, number: int, budget: MassBudget) -> ClosedLoadState:
        """What of a load is to outlive a restart."""
        off = tuple((by_load, more_kg) for (load, by_load), more_kg in self._off.items() if load == number)
        return ClosedLoadState(number, budget, self._shared.get(number), self._of_scale.get(number, 0.0), off)

    def resume(self, state: ClosedLoadState, version: int) -> None:
        """A load of a run before. version: of the parameters in use."""
        if state.shared is not None and state.shared.version == version:
            self._shared[state.number] = state.shared
        if state.of_scale_kg > 0.0:
            self._of_scale[state.number] = state.of_scale_kg
        self._off |= {(state.number, by_load): more_kg for by_load, more_kg in state.off_kg}
