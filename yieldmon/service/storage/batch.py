"""What the store holds, row by row, and the batch that one second brings of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.service.storage.rows import SecondRow


@dataclass(frozen=True)
class Load:
    """A load: from one emptying of the tank, or one `load start`, to the next. `ended_s` is None while it is open, `area_m2`
    where the area of its grain is not known. `std_dev_kg`: of mass_kg, None where it is not known; sweeps may change it later.
    `budget`: the same by cause."""

    number: int
    field: str
    crop: str
    started_s: float | None
    ended_s: float | None
    mass_kg: float
    dry_mass_kg: float | None
    area_m2: float | None = None
    std_dev_kg: float | None = None
    budget: MassBudget | None = None


@dataclass(frozen=True)
class SweepRecord:
    """How a self-calibration sweep ended."""

    time_s: float
    outcome: str
    reason: str
    document: Mapping[str, Any]


@dataclass(frozen=True)
class ParameterVersion:
    """A parameter set that came into use; `document` has values, covariance and provenance."""

    version: int
    time_s: float
    origin: str
    document: Mapping[str, Any]


@dataclass(frozen=True)
class FaultEvent:
    """A fault that came (`active`) or went."""

    time_s: float
    code: str
    active: bool
    detail: str = ""


@dataclass(frozen=True)
class Ticket:
    """A weighed mass, kg, for the loads `first_load`..`last_load`, beside what was measured for them, kg."""

    time_s: float
    first_load: int
    last_load: int
    weighed_mass_kg: float
    measured_mass_kg: float
    note: str = ""

    @property
    def loads(self) -> range:
        """Their numbers."""
        return range(self.first_load, self.last_load + 1)

    @property
    def factor(self) -> float:
        """Weighed over measured."""
        return self.weighed_mass_kg / self.measured_mass_kg


@dataclass(frozen=True)
class Action:
    """What an operator entered, an update of the parameters, or what took either back. who: a user of this computer, "" for the
    monitor itself."""

    number: int
    time_s: float
    kind: str
    who: str
    document: Mapping[str, Any]


@dataclass(frozen=True)
class Step:
    """How the parameters of a version came of those before them, for a smoother."""

    version: int
    time_s: float
    document: Mapping[str, Any]


@dataclass(frozen=True)
class Batch:
    """All that one second brought. `number` rises by one from batch to batch over the store's life."""

    number: int
    time_s: float
    state: Mapping[str, Any]
    seconds: tuple[SecondRow, ...] = ()
    loads: tuple[Load, ...] = ()
    sweeps: tuple[SweepRecord, ...] = ()
    parameter_versions: tuple[ParameterVersion, ...] = ()
    faults: tuple[FaultEvent, ...] = ()
    tickets: tuple[Ticket, ...] = ()
    actions: tuple[Action, ...] = ()
    steps: tuple[Step, ...] = ()
    counters: Mapping[str, int] = field(default_factory=dict)
