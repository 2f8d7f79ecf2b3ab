"""The errors that all of a load's mass shares: of the parameters that measured it, of the model, and of the scale.

Loads are identified by number; `Loads` applies the standard deviations that are returned.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, replace

from yieldmon.engine.flow import Flow
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.shared_error import ClosedLoadState, SharedError
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError

Deviations = tuple[tuple[int, float], ...]
"""Load number, and the new standard deviation of its mass by the parameters, kg."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """Effect of one load's weight on another load, kg. more_kg: increase of its standard deviation, because the weight showed the
    scale to be off. of_scale_kg: its mass that was measured with that scale."""

    more_kg: float
    of_scale_kg: float


class LoadErrors:
    """The shared errors of one machine's loads, by load number."""

    def __init__(self) -> None:
        self._shared: dict[int, SharedError] = {}
        """Of loads measured with the parameters in use."""
        self._of_scale: dict[int, float] = {}
        """Mass of each load measured since the parameters' scale was last set, kg."""
        self._of_crop: dict[str, dict[int, float]] = {}
        """The same for crops harvested before, which have their own parameters."""
        self._shown: dict[tuple[int, int], _Shown] = {}
        """By number of the load and number of the weighed load."""

    def clear(self) -> None:
        """Forget all loads."""
        self._shared, self._of_scale, self._of_crop, self._shown = {}, {}, {}, {}

    def keep(self, numbers: Container[int]) -> None:
        """Forget all other loads."""
        self._shared = {number: shared for number, shared in self._shared.items() if number in numbers}
        for masses_kg in (self._of_scale, *self._of_crop.values()):
            for number in [number for number in masses_kg if number not in numbers]:
                del masses_kg[number]
        self._shown = {key: shown for key, shown in self._shown.items() if key[0] in numbers}

    def forget_parameters(self, number: int) -> None:
        """The load keeps its standard deviation: which parameters measured it is no longer known."""
        self._shared.pop(number, None)

    def widened(self, number: int, by_load: int, more_kg: float) -> None:
        """The weight of load by_load increased this load's standard deviation by more_kg; its parameters are no longer known."""
        self.forget_parameters(number)
        self._show(number, by_load, more_kg, self._of_scale.get(number, 0.0))

    def _show(self, number: int, by_load: int, more_kg: float, of_scale_kg: float) -> None:
        before = self._shown.get((number, by_load))
        self._shown[number, by_load] = _Shown(more_kg + (before.more_kg if before is not None else 0.0), of_scale_kg)

    def scale_is_set(self, by_loads: Iterable[int] = ()) -> None:
        """The parameters have a new scale from now on, from the weights of these loads or from outside."""
        for by_load in by_loads:
            for number, mass_kg in self._of_scale.items():
                self._shown.setdefault((number, by_load), _Shown(0.0, mass_kg))
        self._of_scale = {}

    def change_crop(self, before: str, now: str) -> None:
        """Another crop from now on, measured with the parameters it had when it was last harvested."""
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
        """Add mass to a load.

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
            Of the model, at this angle and at those of the load before; `NO_ERROR`: the budget contains it.

        Returns
        -------
        Deviations
            Of the load; empty for `NO_ERROR`.
        """
        self._of_scale[number] = self._of_scale.get(number, 0.0) + mass_kg
        seconds, known = mass_kg / flow.rate_kg_s, self._shared.get(number)
        if known is None or known.version != version:
            # The part measured with other parameters keeps its standard deviation.
            self._shared = {n: shared for n, shared in self._shared.items() if shared.version == version}
            known = SharedError(version, budget.parameters_kg - flow.budget.parameters_kg_s * seconds)
        self._shared[number] = known = known.plus(flow.budget, seconds, plate_angle_rad)
        return () if error is NO_ERROR else ((number, known.parameters_kg(error)),)

    def resume_share(
        self, number: int, mass_kg: float, budget: MassBudget, *, error: AngleError, version: int, home_rad: float
    ) -> None:
        """Continue with a load measured at home_rad with the parameters of this version; its budget contains the model error."""
        if number not in self._shared:
            own_kg = max(budget.parameters_kg**2 - (error.home * mass_kg) ** 2, 0.0) ** 0.5
            self._shared[number] = SharedError.at(version, own_kg, mass_kg, home_rad)

    def by_model(self, error: AngleError, version: int) -> Deviations:
        """The standard deviations of all loads that these parameters measured, with this model error."""
        return tuple((n, shared.parameters_kg(error)) for n, shared in self._shared.items() if shared.version == version)

    def scale_is_off(self, relative: float, by_load: int, budget_of: Callable[[int], MassBudget | None]) -> Deviations:
        """The weight of load by_load shows the scale in use since `scale_is_set` to be off by `relative`, which is then the least
        relative standard deviation of all mass measured with it. budget_of: by load number, None where it is not known."""
        found: list[tuple[int, float]] = []
        for number, mass_kg in self._of_scale.items():
            self._shared.pop(number, None)
            known = budget_of(number)
            if known is not None and relative * mass_kg > known.parameters_kg:
                self._show(number, by_load, relative * mass_kg - known.parameters_kg, mass_kg)
                found.append((number, relative * mass_kg))
        return tuple(found)

    def scale_was_right(
        self, by_loads: Container[int], masses_kg: Mapping[int, float], *, again: Container[int] = (), crop: str = ""
    ) -> Deviations:
        """Tickets for by_loads are taken back, and the parameters are those from before them and before the tickets for `again`,
        which will update them again.

        masses_kg: of the loads of this run, by number. crop: of the parameters, where another crop is harvested now, else "".
        Returns as `forget_weights`.
        """
        of_scale = self._of_crop.setdefault(crop, {}) if crop else self._of_scale
        for (number, by_load), shown in self._shown.items():
            if by_load in by_loads or by_load in again:
                of_scale[number] = masses_kg.get(number, max(shown.of_scale_kg, of_scale.get(number, 0.0)))
        return self.forget_weights(by_loads)

    def forget_weights(self, by_loads: Container[int]) -> Deviations:
        """Take back the effect of the weights of these loads. Returns (load number, decrease of its standard deviation in kg), a
        pair for each weight."""
        found: list[tuple[int, float]] = []
        for number, by_load in [key for key in self._shown if key[1] in by_loads]:
            more_kg, shared = self._shown.pop((number, by_load)).more_kg, self._shared.get(number)
            if more_kg > 0.0:
                found.append((number, more_kg))
                if shared is not None:
                    self._shared[number] = replace(shared, before_kg=max(shared.before_kg - more_kg, 0.0))
        return tuple(found)

    def state(self, number: int, budget: MassBudget) -> ClosedLoadState:
        """The state of a load to keep for a restart."""
        shown = tuple((by, one.more_kg, one.of_scale_kg) for (load, by), one in self._shown.items() if load == number)
        of_crop = next(((crop, masses_kg[number]) for crop, masses_kg in self._of_crop.items() if number in masses_kg), ("", 0.0))
        crop, of_scale_kg = ("", self._of_scale[number]) if number in self._of_scale else of_crop
        return ClosedLoadState(number, budget, self._shared.get(number), of_scale_kg, crop, shown)

    def resume(self, state: ClosedLoadState, version: int) -> None:
        """Continue with a load of an earlier run. version: of the parameters in use."""
        if state.shared is not None and state.shared.version == version:
            self._shared[state.number] = state.shared
        if state.of_scale_kg > 0.0:
            of_scale = self._of_crop.setdefault(state.crop, {}) if state.crop else self._of_scale
            of_scale[state.number] = state.of_scale_kg
        self._shown |= {(state.number, by): _Shown(more_kg, mass_kg) for by, more_kg, mass_kg in state.shown}
