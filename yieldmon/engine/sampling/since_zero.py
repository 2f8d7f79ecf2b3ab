"""Seconds since the operator's last zero calibration, kept so that an undo can measure them again with the zero before it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan

import numpy as np

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.mass.budget import EMPTY, FlowBudget
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.mass.remeasured_unseen import RemeasuredSecond, remeasured_unseen
from yieldmon.engine.mass.unseen import UnseenChange, UnseenMass
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.numerics import Array

KEPT_S = 7200
"""Newest seconds that are kept."""


@dataclass(frozen=True, slots=True)
class KeptSecond:
    """What is needed of a second to measure it again; nan where not known. zero_mv: the zero it was measured with, which is that
    after the second before it. surplus_frames: above 0 the second is contested by more than one sender."""

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
"""Error budgets of seconds, from their forces, N, and flows by another zero."""


class SinceZero:
    """The seconds, and the mass of the tank scale that was counted in their place."""

    def __init__(self, settings: EngineSettings, machine: Machine) -> None:
        self._gain_n_per_mv = machine.sensor.gain_n_per_mv
        self._gate = settings.gate
        self._min_coverage = settings.windows.min_coverage
        self._seconds: deque[KeptSecond] = deque(maxlen=KEPT_S)
        self._by_scale: dict[int, float] = {}

    def clear(self) -> None:
        """Forget all: another zero is in use from now on."""
        self._seconds.clear()
        self._by_scale.clear()

    def add(self, seconds: Iterable[KeptSecond]) -> None:
        """Further seconds."""
        self._seconds.extend(seconds)

    def totals_reset(self) -> None:
        """The totals begin anew: seconds without an open load are in no mass that is still counted."""
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
        dry_kg: Callable[[float, float], float | None],
        budgets: Budgets | None = None,
    ) -> dict[int, MissedMass]:
        """Mass that was missed because another zero than this one was in use.

        Parameters
        ----------
        zero_mv : float
            The right zero, mV.
        estimator : FlowEstimator
            With the parameters in use.
        dry_kg : callable
            (wet mass, kg; moisture, %) -> dry mass, kg, None where it is not known.
        budgets : callable, optional
            Error budgets of the flows by this zero; None: not known.

        Returns
        -------
        dict of int to MissedMass
            By load number. Contested seconds are in no load; seconds without a flow by this zero stay as they were.
        """
        nothing = MissedMass(budget=EMPTY)
        missed = {n: nothing.plus(-kg, None, area_known=True, budget=EMPTY) for n, kg in self._by_scale.items()}
        again = self._again(zero_mv, estimator)
        if again is None:
            return missed
        rows = [self._seconds[place] for place in again.places]
        sure = [None] * len(rows) if budgets is None else budgets(rows, again.force_n, again.found)
        again_kg, lacking = dict[int, float](), set[int]()
        for second, rate, budget in zip(rows, again.flow_kg_s.tolist(), sure, strict=True):
            if not isfinite(rate):
                # For example above a full paddle: what was counted stays.
                lacking.add(second.load_number)
                continue
            seconds = _counted_s(second, self._min_coverage)
            kg = rate * seconds - second.mass_kg
            # Where the bus reports nothing of the header, a second without grain has no area.
            known, dry, with_area = missed.get(second.load_number, nothing), dry_kg(kg, second.moisture_pct), second.area_m2 > 0.0
            of_again = None if budget is None else EMPTY.plus(budget, seconds)
            missed[second.load_number] = known.plus(kg, dry, area_known=with_area, budget=of_again)
            again_kg[second.load_number] = again_kg.get(second.load_number, 0.0) + rate * seconds
        if len(self._seconds) == KEPT_S:
            return missed
        return {n: replace(found, again_kg=nan if n in lacking else again_kg.get(n, nan)) for n, found in missed.items()}

    def remeasured_unseen(
        self, zero_mv: float, estimator: FlowEstimator, open_load: int
    ) -> tuple[dict[int, UnseenChange], UnseenMass]:
        """Mass that may have come unmeasured, by the right zero; arguments as of `missed`, result as of `remeasured_unseen`.

        open_load: number of the load that is open now.
        """
        again = self._again(zero_mv, estimator)
        rates = {} if again is None else dict(zip(again.places, again.flow_kg_s.tolist(), strict=True))
        seconds = []
        for place, second in enumerate(self._seconds):
            if second.surplus_frames:
                continue
            counted_s, rate = _counted_s(second, self._min_coverage), rates.get(place, 0.0)
            before = second.mass_kg / counted_s if counted_s > 0.0 else 0.0
            seconds.append(
                RemeasuredSecond(
                    load_number=second.load_number,
                    duration_s=second.duration_s,
                    covered_s=second.duration_s * second.coverage if isfinite(second.force_n) else 0.0,
                    enough=second.coverage >= self._min_coverage,
                    elevator_speed_rad_s=second.elevator_speed_rad_s,
                    stands=second.elevator_speed_rad_s <= self._gate.min_turning_rpm * RPM,
                    before_kg_s=before,
                    after_kg_s=rate if isfinite(rate) else before,
                    hidden=second.mass_kg == 0.0 and rate > 0.0,
                )
            )
        return remeasured_unseen(seconds, open_load)

    def _again(self, zero_mv: float, estimator: FlowEstimator) -> _Again | None:
        """The seconds with grain, by this zero or as counted, measured again; None where there are none."""
        places, forces = [], []
        for place, second in enumerate(self._seconds):
            known = isfinite(second.zero_mv) and isfinite(second.force_n) and second.coverage > 0.0 and not second.surplus_frames
            force_n = second.force_n + (second.zero_mv - zero_mv) * self._gain_n_per_mv
            # A second that counted is measured again whatever its force: with a zero too low, an empty plate counted as grain.
            if known and (force_n > self._gate.grain_on_n or second.mass_kg > 0.0):
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
