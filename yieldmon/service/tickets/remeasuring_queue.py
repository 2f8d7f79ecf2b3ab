"""Loads that are to be measured again: after tickets that updated the parameters, after an undo, and those open at the time."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.service.tickets.ticket_history import TicketHistory


@dataclass(frozen=True, slots=True)
class Remeasuring:
    """What a load is measured again by: after these tickets, of an undo where there are none, with the parameters of a version or
    those that followed on it."""

    tickets: tuple[int, ...]
    version: int


class RemeasuringQueue:
    """What is still to be measured again; one job of it is *taken* at a time and ends with `done` or `not_measured`."""

    def __init__(self, tickets: Sequence[int], restored: Sequence[int], open_loads: Mapping[int, Remeasuring]) -> None:
        """tickets: that updated the parameters and whose loads are not measured again yet. restored, open_loads: as the
        properties of these names."""
        self._tickets = list(tickets)
        """Without those taken."""
        self._taken: tuple[int, ...] = ()
        self._restored = list(restored)
        self._restoring = 0
        """So many of `_restored`, from the first on, are being taken."""
        self._open_loads = dict(open_loads)
        self._taken_before = 0

    # What is there

    @property
    def tickets(self) -> tuple[int, ...]:
        """Tickets whose loads are to be measured again, those taken first."""
        return (*self._taken, *self._tickets)

    @property
    def restored(self) -> tuple[int, ...]:
        """Versions that an undo brought back and with which loads are still to be measured again."""
        return tuple(self._restored)

    @property
    def restored_waits(self) -> bool:
        """Whether there is one for `take_restored`."""
        return len(self._restored) > self._restoring

    @property
    def open_loads(self) -> Mapping[int, Remeasuring]:
        """Loads that were open as the others were measured again, by number: their turn comes when they are closed."""
        return dict(self._open_loads)

    @property
    def taken_before(self) -> int:
        """Number of the first action after what is being measured again was taken."""
        return self._taken_before

    def tickets_wait(self, history: TicketHistory) -> bool:
        """Whether there are tickets for `take`."""
        return bool(self._tickets) and not history.newest_version_by_ticket.keys().isdisjoint(self._tickets)

    # What comes and goes

    def add(self, numbers: Sequence[int]) -> None:
        """Loads of these tickets are to be measured again."""
        self._tickets += numbers

    def remove(self, numbers: Collection[int]) -> None:
        """Loads of these tickets are not to be measured again."""
        self._taken = tuple(number for number in self._taken if number not in numbers)
        self._tickets = [number for number in self._tickets if number not in numbers]

    def bring_back(self, version: int) -> None:
        """An undo brought this version back: loads that were measured with what it took back are to be measured again."""
        self._restored.append(version)

    def take(self, in_use: int, history: TicketHistory, next_action: int) -> tuple[tuple[int, ...], int]:
        """Tickets whose loads are to be measured again, each once, and the version of the parameters to do it with.

        in_use: the present version. Where a change of crop came since the tickets updated the parameters, it is the last version
        that they led to; tickets from before or after another change are left for the next time. Those taken before of which
        nothing came are taken again.
        """
        newest = history.newest_version_by_ticket
        left = [number for number in self.tickets if number in newest]
        self._taken_before = next_action
        changes = sorted(version for version, a in history.updates.items() if a.document.get("origin") == ParameterOrigin.CROP)
        harvests = {number: bisect(changes, newest[number]) for number in left}
        self._taken = tuple(number for number in left if harvests[number] == harvests[left[0]])
        self._tickets = [number for number in left if number not in self._taken]
        changed = harvests[left[0]] < len(changes)
        return self._taken, max(newest[number] for number in self._taken) if changed else in_use

    def take_restored(self, next_action: int) -> tuple[tuple[int, ...], int]:
        """No ticket, and the first of `restored`. Where nothing comes of it, it is taken again after the next undo."""
        self._restoring, self._taken_before = len(self._restored), next_action
        return (), self._restored[0]

    def closed_load(self, open_load: int | None, history: TicketHistory) -> tuple[int, Remeasuring] | None:
        """The first of `open_loads` that is closed now, with what it is measured again by, of its tickets those that count; None
        where there is none. open_load: number of the load that is open, None for none."""
        first = next(((number, by) for number, by in sorted(self._open_loads.items()) if number != open_load), None)
        if first is None:
            return None
        number, by = first
        return number, replace(by, tickets=tuple(ticket for ticket in by.tickets if ticket in history.counting))

    # How a job ends

    def done(self, tickets: Sequence[int], version: int, open_load: int | None, history: TicketHistory) -> bool:
        """Loads were measured again after these tickets with this version; whether that stands.

        It does not where one of the tickets or the version was taken back meanwhile, or one was replaced; the other tickets'
        loads are to be measured again then. open_load: was left out since it was open.
        """
        left, self._taken = self._taken, ()
        if not tickets:
            self._restored, self._restoring = [waiting for waiting in self._restored if waiting != version], 0
        elif set(left) != set(tickets) or version in history.undone_versions:
            self._tickets = [*left, *self._tickets]
            return False
        if open_load is not None:
            self._open_loads[open_load] = Remeasuring(tuple(tickets), version)
        return True

    def closed_load_done(self, number: int, tickets: Sequence[int], history: TicketHistory) -> bool:
        """One of `open_loads` was measured again; whether that stands: all of its tickets count still."""
        if not history.counting.issuperset(tickets):
            return False
        self._open_loads.pop(number, None)
        return True

    def not_measured(self) -> None:
        """What was taken could not be measured again yet: it waits as before."""
        self._tickets, self._taken, self._restoring = [*self._taken, *self._tickets], (), 0
