"""The weighed mass of a ticket's loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

from yieldmon.engine.self_calibration.reference_mass import Weighing
from yieldmon.service.storage.batch import Load


@dataclass(frozen=True, slots=True)
class TicketMass:
    """What was weighed of all loads of a ticket, kg. common_kg: the part of std_dev_kg by another combine's monitor, the same
    error in all tickets that have one."""

    mass_kg: float
    std_dev_kg: float
    common_kg: float = 0.0

    def shared_out(self, loads: Sequence[Load], measured_kg: float) -> list[Weighing]:
        """For each load with a mass its part. measured_kg: of all loads of the ticket."""
        found = []
        for load in loads:
            share = load.mass_kg / measured_kg
            if share > 0.0:
                found.append(Weighing(load.number, share * self.mass_kg, sqrt(share) * self.std_dev_kg, share * self.common_kg))
        return found
