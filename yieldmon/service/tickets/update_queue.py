"""Tickets that are to update the parameters: those of the present crop, and those that wait for the return of another one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from math import isclose

from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.service.tickets.ticket_history import TicketHistory


class UpdateQueue:
    """Numbers of the tickets that have not updated the parameters yet."""

    def __init__(self, waiting: Sequence[int], of_crop: Mapping[str, Sequence[int]]) -> None:
        """waiting: of the present crop. of_crop: of the others, by name."""
        self._waiting = list(waiting)
        self._of_crop = {crop: list(numbers) for crop, numbers in of_crop.items()}

    @property
    def waiting(self) -> tuple[int, ...]:
        """Those that are to update the parameters in use, one with each second."""
        return tuple(self._waiting)

    @property
    def of_crop(self) -> Mapping[str, Sequence[int]]:
        """Those that wait for the return of another crop, by its name."""
        return {crop: tuple(numbers) for crop, numbers in self._of_crop.items() if numbers}

    def add(self, numbers: Sequence[int], crop: str) -> None:
        """crop: for whose return they wait, where another one is harvested now, else ""."""
        (self._of_crop.setdefault(crop, []) if crop else self._waiting).extend(numbers)

    def remove(self, numbers: Collection[int]) -> None:
        """They are not to update the parameters."""
        for kept in (self._waiting, *self._of_crop.values()):
            kept[:] = [number for number in kept if number not in numbers]

    def change_crop(self, before: str, now: str) -> None:
        """Those of the crop before wait for its return."""
        self._of_crop[before], self._waiting = self._waiting, self._of_crop.pop(now, [])

    def handed_over(self) -> None:
        """No ticket waits in the monitor any more: those that have not updated the parameters were refused."""
        self._waiting = []

    def take_behind(self, change: ParametersChanged, history: TicketHistory) -> list[int]:
        """Numbers of the tickets that were handed over for a change of the parameters; they wait no more."""
        behind, ticketed = list[int](), set[tuple[int, int]]()
        for number in self._waiting:
            ticket = history.entered(number)
            loads = ticket.first_load, ticket.last_load
            # Of two for the same loads one is handed over at a time.
            if loads not in ticketed and _is_of(number, change.references, history):
                behind.append(number)
                ticketed.add(loads)
        self.remove(behind)
        return behind


def _is_of(number: int, references: Sequence[tuple[int, float]], history: TicketHistory) -> bool:
    ticket, mass_kg = history.entered(number), history.reference_mass(number).mass_kg
    return isclose(sum(kg for load, kg in references if load in ticket.loads), mass_kg, rel_tol=1e-6)
