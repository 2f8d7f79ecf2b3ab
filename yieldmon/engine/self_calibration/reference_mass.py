"""Reference masses: a weighed mass and the mass measured of the same grain."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from yieldmon.engine.mass.budget import EMPTY, MassBudget
from yieldmon.engine.self_calibration.load_forces import LoadForces


class Weighing(NamedTuple):
    """The weighing of a load: mass and standard deviation, kg; common_kg: the part of the latter by another combine's monitor."""

    load_number: int
    mass_kg: float
    std_dev_kg: float
    common_kg: float = 0.0


class ReferenceSource(StrEnum):
    """Where a reference mass came from."""

    TANK_SCALE = "tank scale"
    TICKET = "ticket"


@dataclass(frozen=True, slots=True)
class ReferenceMass:
    """A weighed mass and the mass measured over the same time, kg; times are bus time, s.

    complete: every second in between was measured. load_number is 0 where the weighing belongs to no load. budget: standard
    deviations of measured_kg. forces: measured over the load, None where they were not kept. common_kg: the part of std_dev_kg by
    another combine's monitor, the same error in all masses that have one.
    """

    source: ReferenceSource
    start_s: float
    end_s: float
    reference_kg: float
    std_dev_kg: float
    measured_kg: float
    complete: bool
    load_number: int = 0
    budget: MassBudget = EMPTY
    zero_doubted: bool = False
    """Whether part of measured_kg was measured with a suspect zero."""
    forces: LoadForces | None = field(default=None, compare=False, repr=False)
    common_kg: float = 0.0

    @property
    def comparable(self) -> bool:
        """Whether it can be compared with the model: by its forces, else by its duration, which is unknown if the clock was set
        back."""
        return self.complete and self.measured_kg > 0.0 and (self.forces is not None or self.end_s > self.start_s)
