"""Seconds since the operator's last zero calibration, kept so that they can be measured again with the zero before it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan

import numpy as np

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.mass.budget import EMPTY, FlowBudget
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.unseen import UnseenChange, UnseenMass
from yieldmon.engine.mass.unseen_again import SecondAgain, unseen_again
from yieldmon.engine.records import WindowRecord
from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.physics.numerics import Array

KEPT_S = 7200
"""Newest seconds that are kept."""


@dataclass(frozen=True, slots=True)
class KeptSecond:
    """What of a second it takes to measure it again; nan where not known. zero_mv: with which it was measured, which is the zero
    after the second before it. surplus_frames: of more than one sender, the second is contested."""

    load_number: int
    duration_s: float
    mass_kg: float
    coverage: float
    zero_mv: float
    force_n: float
    force_std_dev_n: float
    plate_angle_rad: float
    elevator_speed_rad_s: float
    moisture_pct: float
    area_m2: float
    surplus_frames: int = 0

    @classmethod
    def of(cls, record: WindowRecord) -> KeptSecond:
        """Of a window's record."""
        return cls(*(getattr(record, name) for name in cls.__dataclass_fields__))


Budgets = Callable[[Sequence[KeptSecond], Array, FlowEstimate], Sequence[FlowBudget]]
"""Of seconds whose force, N, and flow are these by another zero."""


class SinceZero:
    """The seconds, and the mass that the tank scale put in their place."""

    def __init__(self) -> None:
        self._seconds: deque[KeptSecond] = deque(maxlen=KEPT_S)
        self._by_scale: dict[int, float] = {}

    def clear(self) -> None:
        """Another zero from now on."""
        self._seconds.clear()
        self._by_scale.clear()

    def add(self, seconds: Iterable[KeptSecond]) -> None:
        """Further seconds."""
        self._seconds.extend(seconds)

    def totals_reset(self) -> None:
        """The totals begin anew: what no load was open for is in none of those that are still counted."""
        self._seconds = deque((s for s in self._seconds if s.load_number != NO_LOAD), maxlen=KEPT_S)
        self._by_scale.pop(NO_LOAD, None)

    def add_scale(self, load_number: int, mass_kg: float) -> None:
        """Mass that joined a load because the tank scale showed it."""
        self._by_scale[load_number] = self._by_scale.get(load_number, 0.0) + mass_kg

    @property
    def seconds(self) -> tuple[KeptSecond, ...]:
        """The newest of them, in order."""
        return tuple(self._seconds)

    @property
    def by_scale(self) -> dict[int, float]:
        """Load number -> kg, for a restart."""
        return dict(self._by_scale)

    def missed(
        self,
        zero_mv: float,
        estimator: FlowEstimator,
        gain_n_per_mv: float,
        grain_on_n: float,
        min_coverage: float,
        dry_kg: Callable[[float, float], float | None],
        budgets: Budgets | None = None,
    ) -> dict[int, MissedMass]:
        """Load number -> what its seconds miss where zero_mv is the zero; up to grain_on_n there is no grain where none counted.

        min_coverage: of a second that counts whole. dry_kg: of a wet mass, kg, at a moisture, %. budgets: how sure the flows by
        this zero are; None: not known. Contested seconds stay in no total; those without a flow by this zero stay as they were.
        """
        nothing = MissedMass(budget=EMPTY)
        missed = {n: nothing.plus(-kg, None, area_known=True, budget=EMPTY) for n, kg in self._by_scale.items()}
        again = self._again(zero_mv, estimator, gain_n_per_mv, grain_on_n)
        if again is None:
            return missed
        rows = [self._seconds[place] for place in again.places]
        sure = [None] * len(rows) if budgets is None else budgets(rows, again.force_n, again.found)
        again_kg, lacking = dict[int, float](), set[int]()
        for second, rate, budget in zip(rows, again.flow_kg_s.tolist(), sure, strict=True):
            if not isfinite(rate):
                # Above a full paddle, say: what was counted stays.
                lacking.add(second.load_number)
                continue
            seconds = _counted_s(second, min_coverage)
            kg = rate * seconds - second.mass_kg
            # Where the bus reports nothing of the header, a second without grain has no area.
            known, dry, with_area = missed.get(second.load_number, nothing), dry_kg(kg, second.moisture_pct), second.area_m2 > 0.0
            of_again = None if budget is None else EMPTY.plus(budget, seconds)
            missed[second.load_number] = known.plus(kg, dry, area_known=with_area, budget=of_again)
            again_kg[second.load_number] = again_kg.get(second.load_number, 0.0) + rate * seconds
        if len(self._seconds) == KEPT_S:
            return missed
        return {n: replace(found, again_kg=nan if n in lacking else again_kg.get(n, nan)) for n, found in missed.items()}

    def unseen_again(
        self,
        zero_mv: float,
        estimator: FlowEstimator,
        gain_n_per_mv: float,
        grain_on_n: float,
        min_coverage: float,
        min_turning_rad_s: float,
        open_load: int,
    ) -> tuple[dict[int, UnseenChange], UnseenMass]:
        """What may have come unseen where zero_mv is the zero; arguments as of `missed`, result as of `unseen_again`.

        min_turning_rad_s: up to this speed the elevator stands. open_load: number of the load that is open now.
        """
        again = self._again(zero_mv, estimator, gain_n_per_mv, grain_on_n)
        rates = {} if again is None else dict(zip(again.places, again.flow_kg_s.tolist(), strict=True))
        seconds = []
        for place, second in enumerate(self._seconds):
            if second.surplus_frames:
                continue
            counted_s, rate = _counted_s(second, min_coverage), rates.get(place, 0.0)
            before = second.mass_kg / counted_s if counted_s > 0.0 else 0.0
            seconds.append(
                SecondAgain(
                    load_number=second.load_number,
                    duration_s=second.duration_s,
                    covered_s=second.duration_s * second.coverage if isfinite(second.force_n) else 0.0,
                    enough=second.coverage >= min_coverage,
                    elevator_speed_rad_s=second.elevator_speed_rad_s,
                    stands=second.elevator_speed_rad_s <= min_turning_rad_s,
                    before_kg_s=before,
                    after_kg_s=rate if isfinite(rate) else before,
                    hidden=second.mass_kg == 0.0 and rate > 0.0,
                )
            )
        return unseen_again(seconds, open_load)

    def _again(self, zero_mv: float, estimator: FlowEstimator, gain_n_per_mv: float, grain_on_n: float) -> _Again | None:
        """Those seconds that have grain by this zero, or had some; None where there are none."""
        places, forces = [], []
        for place, second in enumerate(self._seconds):
            known = isfinite(second.zero_mv) and isfinite(second.force_n) and second.coverage > 0.0 and not second.surplus_frames
            force_n = second.force_n + (second.zero_mv - zero_mv) * gain_n_per_mv
            # What counted is measured again whatever is left of its force: a zero that was too low made grain of nothing.
            if known and (force_n > grain_on_n or second.mass_kg > 0.0):
                places.append(place)
                forces.append(force_n)
        if not places:
            return None
        force, rows = np.array(forces), [self._seconds[place] for place in places]
        columns = np.array([(s.plate_angle_rad, s.elevator_speed_rad_s, s.force_std_dev_n, s.moisture_pct) for s in rows]).T
        found = estimator.estimate(force, *columns)
        return _Again(places, force, found, np.where(force > 0.0, found.mass_flow_kg_s, 0.0))


@dataclass(frozen=True, slots=True)
class _Again:
    """Seconds by another zero: their places among those kept, force, and flow, nan where there is none."""

    places: list[int]
    force_n: Array
    found: FlowEstimate
    flow_kg_s: Array


def _counted_s(second: KeptSecond, min_coverage: float) -> float:
    """The time that the second's flow stands for."""
    return second.duration_s if second.coverage >= min_coverage else second.duration_s * second.coverage
