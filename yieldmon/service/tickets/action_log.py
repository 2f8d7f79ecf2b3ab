"""What operators entered and updates of the parameters, with who and when; nothing in it is changed, only taken back."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from yieldmon.documents.tickets import ListedTicket
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Action, Ticket
from yieldmon.service.storage.ledger import SharedTruck
from yieldmon.service.storage.load_spread import ParameterSpread
from yieldmon.service.tickets.remeasuring_queue import Remeasuring, RemeasuringQueue
from yieldmon.service.tickets.ticket_history import TicketHistory
from yieldmon.service.tickets.ticket_states import ticket_states
from yieldmon.service.tickets.update_queue import UpdateQueue


class ActionLog:
    """All tickets and actions, those that no batch has brought to the store yet, and what they have still to lead to.

    What follows from them is in `history`; `updates` holds the tickets that are to update the parameters, `remeasuring` the loads
    that are to be measured again.
    """

    def __init__(
        self,
        tickets: Sequence[Ticket],
        actions: Sequence[Action],
        now_s: float,
        unfinished: Sequence[int] = (),
        of_crop: Mapping[str, Sequence[int]] | None = None,
        *,
        restored: Sequence[int] = (),
        open_loads: Mapping[int, Remeasuring] | None = None,
    ) -> None:
        """tickets, actions: as the store has them. now_s: Unix time. unfinished, of_crop, restored, open_loads: as a run before
        had them."""
        self.now_s = now_s
        """Unix time of an action of which nothing else is said."""
        self._history = TicketHistory(tuple(tickets), tuple(actions))
        known, newest = range(1, len(tickets) + 1), self._history.newest_version_by_ticket
        left = [number for number in unfinished if number in known]
        crops = {crop: [number for number in numbers if number in known] for crop, numbers in (of_crop or {}).items()}
        self.updates = UpdateQueue([number for number in left if number not in newest], crops)
        self.remeasuring = RemeasuringQueue([number for number in left if number in newest], restored, open_loads or {})
        self._new_tickets: list[Ticket] = []
        self._new_actions: list[Action] = []

    def __iter__(self) -> Iterator[Action]:
        return iter(self._history.actions)

    @property
    def history(self) -> TicketHistory:
        """Tickets and actions until now."""
        return self._history

    # Entries

    def add(self, kind: str, who: str, document: Mapping[str, Any], now_s: float | None = None) -> Action:
        """Something that was entered or taken back. kind: of `ledger`. who: as `Action` has it. now_s: when, Unix time; None: as
        the attribute of that name."""
        action = Action(self._next_number, self.now_s if now_s is None else now_s, kind, who, document)
        self._history = TicketHistory(self._history.tickets, (*self._history.actions, action))
        self._new_actions.append(action)
        return action

    @property
    def _next_number(self) -> int:
        actions = self._history.actions
        return actions[-1].number + 1 if actions else 1

    def ticket(
        self,
        ticket: Ticket,
        who: str = "",
        std_dev_kg: float | None = None,
        *,
        is_reference: bool = False,
        crop: str = "",
        truck: SharedTruck | None = None,
        best_std_dev_kg: float | None = None,
    ) -> int:
        """A ticket; returns its number. std_dev_kg: of the weighing, or of what another combine leaves of `truck`, beside which
        best_std_dev_kg is that of the mass as it counts. is_reference: handed to the calibration. crop: for whose return it waits
        there, where another one is harvested now."""
        self._history = TicketHistory((*self._history.tickets, ticket), self._history.actions)
        self._new_tickets.append(ticket)
        number = len(self._history.tickets)
        document: dict[str, Any] = {"ticket": number, "std_dev_kg": std_dev_kg, "reference": is_reference}
        document |= {} if truck is None else {"truck": truck.document, "best_std_dev_kg": best_std_dev_kg}
        self.add(ledgers.TICKET, who, document, ticket.time_s)
        if is_reference:
            self.updates.add([number], crop)
        return number

    def undo_ticket(self, number: int, who: str, now_s: float) -> Ticket:
        """Take a ticket back; returns it. Raises InputError."""
        ticket = self._history.standing_ticket(number)
        self.add(ledgers.TICKET_UNDO, who, {"ticket": number}, now_s)
        self.wait_no_more([number])
        return ticket

    def remeasure_again(self, number: int) -> None:
        """A ticket of an earlier parameter file, that was replaced, stands again: so does what loads were measured again with by
        what went with it, as it updates nothing anew."""
        for tickets, factors in self._history.factors_with(number).items():
            self._post(tickets, 0, factors, {})

    def remeasured_by_crop(
        self, factors: Mapping[int, float], now_s: float, spreads: Mapping[int, ParameterSpread] = MappingProxyType({})
    ) -> None:
        """Loads that are of another crop than they were measured with were measured again with its parameters."""
        self._post((), 0, factors, spreads, now_s)

    def _post(
        self,
        tickets: Sequence[int],
        version: int,
        factors: Mapping[int, float],
        spreads: Mapping[int, ParameterSpread],
        now_s: float | None = None,
    ) -> None:
        by_load = {str(load): factor for load, factor in sorted(factors.items())}
        of_loads = {str(load): spread.document for load, spread in sorted(spreads.items()) if load in factors}
        document: dict[str, Any] = {"tickets": list(tickets), "version": version, "factors": by_load}
        document |= {"spreads": of_loads} if of_loads else {}
        self.add(ledgers.REMEASURED, "", document, now_s)

    # Tickets that are to update the parameters

    def wait_again(self, numbers: Sequence[int], crop: str) -> None:
        """These tickets are to update the parameters anew. crop: of them, where another one is harvested now, else ""."""
        self.wait_no_more(numbers)
        self.updates.add(numbers, crop)

    def wait_no_more(self, numbers: Sequence[int]) -> None:
        """These tickets are not to update the parameters, nor to be gone on with after a restart."""
        self.updates.remove(numbers)
        self.remeasuring.remove(numbers)

    def take_behind(self, change: ParametersChanged) -> list[int]:
        """Numbers of the tickets that were handed over for a change of the parameters; their loads are to be measured again."""
        behind = self.updates.take_behind(change, self._history)
        self.remeasuring.add(behind)
        return behind

    @property
    def unfinished(self) -> tuple[int, ...]:
        """Numbers of the tickets that wait or whose loads are being measured again, which a restart has to go on with."""
        to_measure = self.remeasuring.tickets
        if to_measure:
            # Of those whose update was taken back by an undo of another no loads are to be measured again.
            led = {number for numbers in self._history.tickets_by_version.values() for number in numbers}
            gone = led.difference(self._history.newest_version_by_ticket)
            to_measure = tuple(number for number in to_measure if number not in gone)
        return (*to_measure, *self.updates.waiting)

    # Loads that are to be measured again

    @property
    def measuring_waits(self) -> bool:
        """Whether there are tickets for `take_to_measure`."""
        return self.remeasuring.tickets_wait(self._history)

    def take_to_measure(self, in_use: int) -> tuple[tuple[int, ...], int]:
        """As `RemeasuringQueue.take`."""
        return self.remeasuring.take(in_use, self._history, self._next_number)

    def measure_lost_again(self) -> None:
        """Loads that were measured again after tickets whose update stands, while that measurement stands no more, are to be
        measured again."""
        known = set(self.unfinished).union(*self.updates.of_crop.values())
        self.remeasuring.add([number for number in self._history.lost_measurements() if number not in known])

    def take_restored(self) -> tuple[tuple[int, ...], int]:
        """As `RemeasuringQueue` has it."""
        return self.remeasuring.take_restored(self._next_number)

    def closed_load(self, open_load: int | None) -> tuple[int, Remeasuring] | None:
        """As `RemeasuringQueue` has it."""
        return self.remeasuring.closed_load(open_load, self._history)

    def remeasured(
        self,
        tickets: Sequence[int],
        version: int,
        factors: Mapping[int, float],
        spreads: Mapping[int, ParameterSpread] = MappingProxyType({}),
        *,
        open_load: int | None = None,
        closed_load: int | None = None,
    ) -> None:
        """Loads were measured again with the parameters of this version, after these tickets.

        factors, spreads: by load number; none where nothing came of it, or it is not known. Loads that were given another crop
        meanwhile keep what that crop's parameters measured. Where it does not stand (`RemeasuringQueue.done`) nothing is entered.
        open_load: that was left out since it was open; closed_load: the one of `open_loads` that this was about, None for all
        other loads.
        """
        if closed_load is not None:
            stands = self.remeasuring.closed_load_done(closed_load, tickets, self._history)
        else:
            stands = self.remeasuring.done(tickets, version, open_load, self._history)
        recropped = ledgers.recropped(action for action in self if action.number >= self.remeasuring.taken_before)
        factors = {number: factor for number, factor in factors.items() if number not in recropped}
        if stands and factors:
            self._post(tickets, version, factors, spreads)

    # For lists and the store

    def ticket_table(self, doubted_loads: Collection[int] = ()) -> list[ListedTicket]:
        """All tickets, with who entered them and who took them back, and what became of each. doubted_loads: those whose tickets
        contradict the ones that count."""
        history = self._history
        of_crop = {number: crop for crop, numbers in self.updates.of_crop.items() for number in numbers}
        to_update = dict.fromkeys(self.updates.waiting, "") | of_crop
        states = ticket_states(history.ledger, history.actions, to_update=to_update, doubted_loads=doubted_loads)
        rows = ledgers.ticket_rows(history.tickets, history.actions)
        return [{**row, "state": states.get(row["number"], "undone")} for row in rows]

    def take(self) -> tuple[tuple[Ticket, ...], tuple[Action, ...]]:
        """Those that no batch has brought yet; they count as brought."""
        new = tuple(self._new_tickets), tuple(self._new_actions)
        self._new_tickets, self._new_actions = [], []
        return new

    def report_all(self) -> None:
        """The next batch brings them all."""
        self._new_tickets, self._new_actions = list(self._history.tickets), list(self._history.actions)
