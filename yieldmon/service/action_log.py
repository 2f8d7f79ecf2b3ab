"""What operators entered and what the monitor learnt, in order, with who and when; nothing in it is changed, only taken back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from yieldmon.errors import InputError
from yieldmon.service import ledger as ledgers
from yieldmon.service.batch import Action, Ticket


class ActionLog:
    """All tickets and actions, and those that no batch has brought to the store yet."""

    def __init__(
        self, tickets: Sequence[Ticket], actions: Sequence[Action], now_s: float, unfinished: Sequence[int] = ()
    ) -> None:
        """tickets, actions: as the store has them. now_s: Unix time. unfinished: as the run before had it."""
        self.now_s = now_s
        """Unix time of an action of which nothing else is said."""
        self.waiting: list[int] = [number for number in unfinished if 1 <= number <= len(tickets)]
        """Numbers of the tickets that are to update the parameters, or did and whose loads are not measured again yet."""
        self._taken: tuple[int, ...] = ()
        self._tickets = list(tickets)
        self._actions = list(actions)
        self._new_tickets: list[Ticket] = []
        self._new_actions: list[Action] = []

    def __iter__(self) -> Iterator[Action]:
        return iter(self._actions)

    def add(self, kind: str, who: str, document: Mapping[str, Any], now_s: float | None = None) -> Action:
        """Something that was entered or taken back. kind: of `ledger`. who: as `Action` has it. now_s: when, Unix time; None: as
        the attribute of that name."""
        number = self._actions[-1].number + 1 if self._actions else 1
        action = Action(number, self.now_s if now_s is None else now_s, kind, who, document)
        self._actions.append(action)
        self._new_actions.append(action)
        return action

    def ticket(self, ticket: Ticket, who: str = "", *, is_reference: bool = False) -> int:
        """A ticket; returns its number. is_reference: it was handed to the calibration."""
        self._tickets.append(ticket)
        self._new_tickets.append(ticket)
        number = len(self._tickets)
        self.add(ledgers.TICKET, who, {"ticket": number}, ticket.time_s)
        if is_reference:
            self.waiting.append(number)
        return number

    def undo_ticket(self, number: int, who: str, now_s: float) -> tuple[Ticket, int | None]:
        """Take a ticket back; returns it, and the version of the parameters that came of it. Raises InputError."""
        standing = self.ledger.tickets
        if number not in standing:
            known = ", ".join(map(str, standing)) or "a ticket that was entered; there is none"
            done = "is undone already" if 1 <= number <= len(self._tickets) else "no such ticket"
            raise InputError(f"ticket {number}", done, known)
        self.add(ledgers.TICKET_UNDO, who, {"ticket": number}, now_s)
        if number in self.waiting:
            self.waiting.remove(number)
        updates = [version for version, action in self.updates.items() if number in action.document.get("tickets", ())]
        undone = self.undone_versions
        return standing[number], next((version for version in updates if version not in undone), None)

    def take_waiting(self) -> tuple[int, ...]:
        """The tickets that wait; each is returned once."""
        self._taken, self.waiting = tuple(self.waiting), []
        return self._taken

    @property
    def unfinished(self) -> tuple[int, ...]:
        """Numbers of the tickets that wait or whose loads are being measured again, which a restart has to go on with."""
        return (*self._taken, *self.waiting)

    def posted(self, tickets: Sequence[int], version: int, factors: Mapping[int, float]) -> None:
        """Loads were measured again with the parameters of this version, after these tickets. factors: by load number; none where
        nothing came of it."""
        self._taken = ()
        if not factors:
            return
        document = {
            "tickets": list(tickets), "version": version, "factors": {str(n): factor for n, factor in sorted(factors.items())}
        }  # fmt: skip
        self.add(ledgers.POSTING, "", document)

    @property
    def updates(self) -> Mapping[int, Action]:
        """Changes of the parameters, by the version that they made."""
        return {int(a.document["version"]): a for a in self._actions if a.kind == ledgers.PARAMETERS}

    @property
    def undone_versions(self) -> set[int]:
        """Versions that were taken back."""
        return {int(a.document["version"]) for a in self._actions if a.kind == ledgers.PARAMETERS_UNDO}

    @property
    def calibrated_version(self) -> int:
        """Version with which the newest parameter file came; what was measured before it says nothing about it."""
        return max((version for version, a in self.updates.items() if a.document.get("origin") == "file"), default=0)

    @property
    def ledger(self) -> ledgers.Ledger:
        """Tickets and postings that stand."""
        return ledgers.ledger(self._tickets, self._actions)

    def ticket_table(self) -> list[dict[str, Any]]:
        """All tickets, with who entered them and who took them back."""
        return ledgers.ticket_rows(self._tickets, self._actions)

    def take(self) -> tuple[tuple[Ticket, ...], tuple[Action, ...]]:
        """Those that no batch has brought yet; they count as brought."""
        new = tuple(self._new_tickets), tuple(self._new_actions)
        self._new_tickets, self._new_actions = [], []
        return new

    def report_all(self) -> None:
        """The next batch brings them all."""
        self._new_tickets, self._new_actions = list(self._tickets), list(self._actions)
