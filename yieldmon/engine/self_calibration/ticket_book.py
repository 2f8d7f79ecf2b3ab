"""Scale tickets by crop: all that are kept, and those that wait to update the parameters."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from math import isclose, isfinite, nan

from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.engine.self_calibration.load_forces import LoadForces, LoadForceSums, WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource, Weighing
from yieldmon.engine.state import TicketState

_KEPT_TICKETS = 12
"""Newest tickets of a crop that are kept over a restart."""


class TicketBook:
    """Tickets of the crop harvested now, and of earlier crops, kept for their return.

    Parameters
    ----------
    keep : int
        Tickets of one crop that are kept.

    Attributes
    ----------
    forces : LoadForceSums
        Over each load of this run.
    """

    def __init__(self, keep: int) -> None:
        self.forces = LoadForceSums()
        self._tickets: deque[ReferenceMass] = deque(maxlen=keep)
        self._waiting: list[ReferenceMass] = []
        self._of_crop: dict[str, tuple[list[ReferenceMass], list[ReferenceMass]]] = {}
        """By name of an earlier crop: all tickets kept, and those that wait for its return."""
        self._earlier: dict[int, tuple[LoadSummary, LoadForces | None]] = {}
        """Loads of an earlier run, by number."""

    @property
    def kept(self) -> tuple[ReferenceMass, ...]:
        """Of the crop that is harvested now, in the order they were entered."""
        return tuple(self._tickets)

    @property
    def of_any_crop(self) -> tuple[ReferenceMass, ...]:
        """Those kept of every crop."""
        return (*self._tickets, *(reference for kept, _ in self._of_crop.values() for reference in kept))

    @property
    def waiting(self) -> tuple[ReferenceMass, ...]:
        """Those that were not handed to the calibrator yet."""
        return tuple(self._waiting)

    @property
    def earlier_loads(self) -> tuple[LoadSummary, ...]:
        """Loads of an earlier run that are known."""
        return tuple(load for load, _ in self._earlier.values())

    @property
    def states(self) -> tuple[TicketState, ...]:
        """States of the tickets, to keep for a restart."""
        in_use: tuple[None, list[ReferenceMass], list[ReferenceMass]] = None, list(self._tickets), self._waiting
        return tuple(
            TicketState(a.load_number, a.reference_kg, a.std_dev_kg, a in waiting, crop, a.common_kg)
            for crop, tickets, waiting in (*((name, *of_one) for name, of_one in self._of_crop.items()), in_use)
            for place, a in enumerate(tickets)
            if place >= len(tickets) - _KEPT_TICKETS or a in waiting
        )

    def measured(self, load_number: int, mass_kg: float, window: WindowForces) -> None:
        """A window that added mass to a load."""
        self.forces.add(load_number, mass_kg, window)

    def ticket(self, weighing: Weighing, *, loads: Sequence[LoadSummary], now_s: float) -> ReferenceMass:
        """The reference mass of a ticket, which is not entered yet.

        Parameters
        ----------
        weighing : Weighing
            What the ticket says.
        loads : sequence of LoadSummary
            Of this run.
        now_s : float
            Bus time, s, at which an open load ends for the ticket.

        Returns
        -------
        ReferenceMass

        Raises
        ------
        ValueError
            When the load is not known or a number makes no sense.
        """
        load_number, mass_kg, std_dev_kg, _ = weighing
        if not (isfinite(mass_kg) and mass_kg > 0.0):
            raise ValueError(f"ticket for load {load_number}: mass {mass_kg} kg; expected a mass above 0 kg")
        if not (isfinite(std_dev_kg) and std_dev_kg > 0.0):
            raise ValueError(f"ticket for load {load_number}: standard deviation {std_dev_kg} kg; expected above 0 kg")
        load = next((load for load in reversed(loads) if load.number == load_number), None)
        forces = self.forces.of(load_number)
        if (load is None or not load.complete) and load_number in self._earlier:
            load, forces = self._earlier[load_number]
        if load is None:
            known = sorted(load.number for load in loads)
            raise ValueError(f"ticket for load {load_number}: no such load; expected one of {known}")
        return _ticket(load, forces, weighing, now_s)

    def enter(self, ticket: ReferenceMass, crop: str = "") -> None:
        """Enter a ticket that is to update the parameters. crop: on whose return; "": the crop harvested now."""
        if not crop:
            self._tickets.append(ticket)
            self._waiting.append(ticket)
            return
        tickets, waiting = self._of_crop.get(crop, ([], []))
        self._of_crop[crop] = [*tickets, ticket], [*waiting, ticket]

    def hand_over(self) -> tuple[ReferenceMass, ...]:
        """Hand the first waiting ticket to the calibrator, with its parts for all loads that it covers; returns these."""
        waited, self._waiting = self._waiting, _after_first_ticket(self._waiting)
        return tuple(waited[: len(waited) - len(self._waiting)])

    def none_waits(self) -> None:
        """Without a calibrator no ticket waits."""
        self._waiting = []

    def take_back(
        self, load_numbers: frozenset[int], again: Sequence[ReferenceMass], crop: str, stay: Sequence[ReferenceMass] = ()
    ) -> tuple[ReferenceMass, ...]:
        """Remove the tickets for these loads, and enter others again.

        Parameters
        ----------
        load_numbers : frozenset of int
            Those of `again` and `stay` among them.
        again : sequence of ReferenceMass
        crop : str
            Of all of these; "": the one that is harvested now.
        stay : sequence of ReferenceMass
            Others for these loads, which were handed over before.

        Returns
        -------
        tuple of ReferenceMass
            Tickets kept of that crop, without `again`.
        """
        tickets, waiting = self._of_crop.get(crop, ([], [])) if crop else (list(self._tickets), self._waiting)
        tickets, waiting = [*_without(tickets, load_numbers), *stay], [*_without(waiting, load_numbers), *again]
        if crop:
            self._of_crop[crop] = [*tickets, *again], waiting
        else:
            self._tickets = deque([*tickets, *again], maxlen=self._tickets.maxlen)
            self._waiting = waiting
        return tuple(tickets)

    def change_crop(self, before: str, now: str) -> list[ReferenceMass]:
        """Another crop from now on: tickets of the one before wait for its return.

        Returns those of the crop now that were handed to the calibrator when it was harvested last.
        """
        self._of_crop[before] = list(self._tickets), self._waiting
        tickets, self._waiting = self._of_crop.pop(now, ([], []))
        self._tickets = deque(tickets, maxlen=self._tickets.maxlen)
        return [ticket for ticket in tickets if ticket not in self._waiting]

    def know_load(self, load: LoadSummary, seconds: Iterable[KeptSecond]) -> None:
        """Add a load that an earlier run measured or began, so that a ticket for it updates the parameters."""
        sums = LoadForceSums()
        for second in seconds:
            window = WindowForces(
                second.duration_s, second.force_n, second.plate_angle_rad, second.elevator_speed_rad_s, second.moisture_pct
            )
            sums.add(load.number, second.mass_kg, window)
        self._earlier[load.number] = load, sums.of(load.number)

    def of_earlier_load(self, weighing: Weighing) -> ReferenceMass | None:
        """A ticket that an earlier run took for a load of its own; None for a load that is not known."""
        if weighing.load_number not in self._earlier:
            return None
        return _ticket(*self._earlier[weighing.load_number], weighing, nan)

    def remember(self, tickets: Sequence[ReferenceMass], waiting: Sequence[ReferenceMass], crop: str | None = None) -> None:
        """After a restart: tickets entered before, and those of them that wait; crop: None for the one harvested now."""
        if crop is not None:
            self._of_crop[crop] = list(tickets), list(waiting)
            return
        self._tickets.extend(tickets)
        self._waiting = list(waiting)

    def take_crops_of(self, before: TicketBook) -> None:
        """After a reload: take over the tickets of earlier crops."""
        self._of_crop = dict(before._of_crop)


def _after_first_ticket(waiting: Sequence[ReferenceMass]) -> list[ReferenceMass]:
    """The references of later tickets. A ticket for several loads is divided between them in proportion to their measured mass,
    so its parts have the same ratio and successive numbers."""
    for place in range(1, len(waiting)):
        last, reference = waiting[place - 1], waiting[place]
        same = isclose(reference.reference_kg * last.measured_kg, last.reference_kg * reference.measured_kg, rel_tol=1e-9)
        if not (same and reference.load_number == last.load_number + 1):
            return list(waiting[place:])
    return []


def _without(references: Iterable[ReferenceMass], load_numbers: frozenset[int]) -> list[ReferenceMass]:
    return [reference for reference in references if reference.load_number not in load_numbers]


def _ticket(load: LoadSummary, forces: LoadForces | None, weighing: Weighing, now_s: float) -> ReferenceMass:
    end_s = load.end_s if isfinite(load.end_s) else now_s
    return ReferenceMass(
        source=ReferenceSource.TICKET,
        start_s=load.start_s,
        end_s=end_s,
        reference_kg=weighing.mass_kg,
        std_dev_kg=weighing.std_dev_kg,
        measured_kg=load.measured_kg,
        complete=load.complete,
        load_number=load.number,
        budget=load.budget,
        forces=forces,
        common_kg=weighing.common_kg,
    )
