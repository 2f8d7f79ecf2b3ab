"""What operators entered and what the monitor learnt, in order, with who and when; nothing in it is changed, only taken back."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isclose
from typing import Any

from yieldmon.documents.tickets import ListedTicket
from yieldmon.engine.self_calibration.learning import ParametersChanged
from yieldmon.errors import InputError
from yieldmon.files.ticket_file import RELATIVE_STD_DEV
from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Action, Ticket
from yieldmon.service.storage.ledger import SharedTruck
from yieldmon.service.tickets.ticket_mass import TicketMass
from yieldmon.service.tickets.ticket_states import ticket_states


@dataclass(frozen=True, slots=True)
class Remeasuring:
    """What a load is measured again by: after these tickets, of an undo where there are none, with the parameters of a version or
    those that followed on it."""

    tickets: tuple[int, ...]
    version: int


class ActionLog:
    """All tickets and actions, and those that no batch has brought to the store yet."""

    def __init__(
        self,
        tickets: Sequence[Ticket],
        actions: Sequence[Action],
        now_s: float,
        unfinished: Sequence[int] = (),
        of_crop: Mapping[str, Sequence[int]] | None = None,
        restored: Sequence[int] = (),
        open_loads: Mapping[int, Remeasuring] | None = None,
    ) -> None:
        """tickets, actions: as the store has them. now_s: Unix time. unfinished, of_crop, restored, open_loads: as a run before
        had them."""
        self.now_s = now_s
        """Unix time of an action of which nothing else is said."""
        known = range(1, len(tickets) + 1)
        self._tickets = list(tickets)
        self._actions = list(actions)
        left, learnt = [number for number in unfinished if number in known], self._learnt
        self.waiting: list[int] = [number for number in left if number not in learnt]
        """Numbers of the tickets that are to update the parameters."""
        self._to_measure: list[int] = [number for number in left if number in learnt]
        """Numbers of those that did and whose loads are not measured again yet; without those taken."""
        self._of_crop = {crop: [number for number in kept if number in known] for crop, kept in (of_crop or {}).items()}
        """Numbers of those that are to update the parameters of another crop than the present one, by its name."""
        self._restored: list[int] = list(restored)
        """Versions that an undo brought back and with which the loads that were measured since are still to be measured again;
        the first `_restoring` of them are being taken."""
        self._restoring = 0
        self._open_loads = dict(open_loads or {})
        self._taken: tuple[int, ...] = ()
        self._taken_before = 0
        """Number of the first action after what is being measured again was taken."""
        self._new_tickets: list[Ticket] = []
        self._new_actions: list[Action] = []

    def __iter__(self) -> Iterator[Action]:
        return iter(self._actions)

    def add(self, kind: str, who: str, document: Mapping[str, Any], now_s: float | None = None) -> Action:
        """Something that was entered or taken back. kind: of `ledger`. who: as `Action` has it. now_s: when, Unix time; None: as
        the attribute of that name."""
        action = Action(self._next_number, self.now_s if now_s is None else now_s, kind, who, document)
        self._actions.append(action)
        self._new_actions.append(action)
        return action

    @property
    def _next_number(self) -> int:
        return self._actions[-1].number + 1 if self._actions else 1

    def ticket(
        self,
        ticket: Ticket,
        who: str = "",
        std_dev_kg: float | None = None,
        *,
        is_reference: bool = False,
        crop: str = "",
        truck: SharedTruck | None = None,
    ) -> int:
        """A ticket; returns its number. std_dev_kg: of the weighing, or of what another combine leaves of `truck`. is_reference:
        handed to the calibration. crop: for whose return it waits there, where another one is harvested now."""
        self._tickets.append(ticket)
        self._new_tickets.append(ticket)
        number = len(self._tickets)
        document: dict[str, Any] = {"ticket": number, "std_dev_kg": std_dev_kg, "reference": is_reference}
        document |= {} if truck is None else {"truck": truck.document}
        self.add(ledgers.TICKET, who, document, ticket.time_s)
        if is_reference:
            (self._of_crop.setdefault(crop, []) if crop else self.waiting).append(number)
        return number

    def entered(self, number: int) -> Ticket:
        """A ticket, whether or not it stands."""
        return self._tickets[number - 1]

    def standing_ticket(self, number: int) -> Ticket:
        """A ticket that stands. Raises InputError where there is none of this number."""
        standing = self.ledger.tickets
        if number not in standing:
            known = ", ".join(map(str, standing)) or "a ticket that was entered; there is none"
            done = "is undone already" if 1 <= number <= len(self._tickets) else "no such ticket"
            raise InputError(f"ticket {number}", done, known)
        return standing[number]

    def replaced_by(self, ticket: Ticket) -> tuple[int, ...]:
        """Numbers of the standing tickets that a new one replaces: one of their loads has a newer one then."""
        before = self.ledger
        after = replace(before, tickets={**before.tickets, len(self._tickets) + 1: ticket})
        return tuple(sorted(after.replaced - before.replaced))

    def stand_again_without(self, number: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Numbers of the references that only a standing ticket keeps from updating the parameters: those entered since the
        parameter file in use came, and those before it."""
        since, silenced = self._handed, self.silenced
        again = [n for n in self.count_again_without(number) if n not in silenced and self._entry(n).get("reference", False)]
        return tuple(n for n in again if n in since), tuple(n for n in again if n not in since)

    def count_again_without(self, number: int) -> tuple[int, ...]:
        """Numbers of the tickets that a standing one alone replaces, whether or not it is replaced itself."""
        now = self.ledger
        without = replace(now, tickets={n: ticket for n, ticket in now.tickets.items() if n != number})
        return tuple(sorted(now.replaced - without.replaced - {number}))

    def first_update(self, number: int, held_against: Callable[[int], bool] | None = None) -> int | None:
        """The first version of the parameters that rests on a ticket; None where none that stands does, or a parameter file has
        replaced it since. held_against: which tickets after it are held against it, though it may have led to no version."""
        undone = self.undone_versions
        for version, led in sorted(self._led.items()):
            if version in undone or version <= self.calibrated_version:
                continue
            if number in led or (held_against and any(other > number and held_against(other) for other in led)):
                return version
        return None

    def update_before_file(self, number: int) -> int | None:
        """The first version that rests on a ticket, of those that a parameter file has replaced since; None: none that stands."""
        undone = self.undone_versions
        led = (v for v, numbers in sorted(self._led.items()) if number in numbers and v not in undone)
        return next((version for version in led if version < self.calibrated_version), None)

    def update_without_replaced(self, number: int) -> int | None:
        """The version that came as a ticket was replaced, where a parameter file has come since; None: none that stands."""
        undos = [a.number for a in self._actions if a.kind == ledgers.PARAMETERS_UNDO and a.document.get("replaced") == number]
        undone = self.undone_versions
        came = next((v for v, a in sorted(self.updates.items()) if undos and a.number > undos[-1]), None)
        by_undo = came is not None and self.updates[came].document.get("origin") == ledgers.UNDO
        return came if came is not None and by_undo and came not in undone and came < self.calibrated_version else None

    def post_again(self, number: int) -> None:
        """A ticket of an earlier parameter file, that was replaced, stands again: so does what loads were measured again with by
        what went with it, as nothing learns it anew."""
        undos = (a for a in self._actions if a.kind == ledgers.PARAMETERS_UNDO and a.document.get("replaced") == number)
        versions = {int(v) for a in undos for v in a.document["versions"] if v < self.calibrated_version}
        counting, found = self._counting, dict[int, tuple[float, tuple[int, ...]]]()
        for action in self._actions:
            document = action.document
            if action.kind != ledgers.POSTING or not counting.issuperset(document["tickets"]):
                continue
            again, stands = document["version"] in versions, document["version"] not in self.undone_versions
            for load, factor in document["factors"].items() if again or stands else ():
                found.pop(int(load), None)
                if again and not stands:
                    found[int(load)] = factor, tuple(sorted({*document["tickets"], number}))
        for tickets in sorted({tickets for _, tickets in found.values()}):
            factors = {str(load): factor for load, (factor, by) in sorted(found.items()) if by == tickets}
            self.add(ledgers.POSTING, "", {"tickets": list(tickets), "version": 0, "factors": factors})

    def undo_ticket(self, number: int, who: str, now_s: float) -> Ticket:
        """Take a ticket back; returns it. Raises InputError."""
        ticket = self.standing_ticket(number)
        self.add(ledgers.TICKET_UNDO, who, {"ticket": number}, now_s)
        self.wait_no_more([number])
        return ticket

    def wait_again(self, numbers: Sequence[int], crop: str) -> None:
        """These tickets are to update the parameters anew. crop: of them, where another one is harvested now, else ""."""
        self.wait_no_more(numbers)
        (self._of_crop.setdefault(crop, []) if crop else self.waiting).extend(numbers)

    def wait_no_more(self, numbers: Sequence[int]) -> None:
        """These tickets are not to update the parameters, nor to be gone on with after a restart."""
        self._taken = tuple(number for number in self._taken if number not in numbers)
        for kept in (self.waiting, self._to_measure, *self._of_crop.values()):
            kept[:] = [number for number in kept if number not in numbers]

    def led_first_to(self, version: int) -> tuple[int, ...]:
        """Numbers of the standing tickets that led to a version and to none before it that stands."""
        standing, gone, led = self.ledger.tickets, self.undone_versions, self._led
        known = {number for earlier, numbers in led.items() if earlier < version and earlier not in gone for number in numbers}
        return tuple(sorted(number for number in led.get(version, ()) if number in standing and number not in known))

    def updates_gone_with(self, version: int) -> tuple[int, ...]:
        """Of a version that an undo made, numbers of the tickets that what it took back rests on and that no longer update: taken
        back, silenced or replaced. None for another version."""
        update = self.updates.get(version)
        if update is None or update.document.get("origin") != ledgers.UNDO:
            return ()
        before = [a for a in self._actions if a.kind == ledgers.PARAMETERS_UNDO and a.number < update.number]
        taken_back = {int(v) for a in before[-1:] for v in a.document.get("versions", ())}
        led = {number for v, numbers in self._led.items() if v in taken_back for number in numbers}
        return tuple(sorted(led.difference(self._updating)))

    def last_ticket_before(self, version: int) -> int:
        """Number of the last ticket that was entered before a version came; 0 for none."""
        update = self.updates.get(version)
        entered = (
            int(a.document["ticket"])
            for a in self._actions
            if a.kind == ledgers.TICKET and (update is None or a.number < update.number)
        )
        return max(entered, default=0)

    @property
    def silenced(self) -> frozenset[int]:
        """As `ledger.silenced`."""
        return ledgers.silenced(self._actions)

    @property
    def _counting(self) -> frozenset[int]:
        """Numbers of the standing tickets that none replaces."""
        standing = self.ledger
        return frozenset(standing.tickets) - standing.replaced

    @property
    def _updating(self) -> frozenset[int]:
        """The same without those that are silenced: what the parameters are to rest on, where they are references."""
        return self._counting - self.silenced

    @property
    def _handed(self) -> tuple[int, ...]:
        """Numbers of the tickets that were handed to the calibration since the parameter file in use came, or waited then."""
        file = self.updates.get(self.calibrated_version)
        since = 0 if file is None else file.number
        led = {n for version, numbers in self._led.items() if version > self.calibrated_version for n in numbers}
        handed = (a for a in self._actions if a.kind == ledgers.TICKET and a.document.get("reference", False))
        return tuple(int(a.document["ticket"]) for a in handed if a.number > since or int(a.document["ticket"]) in led)

    def not_learnt_after(self, number: int) -> tuple[int, ...]:
        """Numbers of the tickets after one, of the parameter file in use, that were handed to the calibration and led to no
        version that stands; without those taken back, replaced or silenced."""
        updating, learnt = self._updating, self._learnt
        return tuple(n for n in self._handed if n > number and n in updating and n not in learnt)

    def handed_for(self, loads: Collection[int]) -> tuple[int, ...]:
        """Numbers of the tickets of the parameter file in use that were handed to the calibration for one of these loads, or for
        one that is on such a ticket too; without those taken back, replaced or silenced."""
        standing, updating = self.ledger.tickets, self._updating
        left = {n: standing[n].loads for n in self._handed if n in updating}
        covered, found = set(loads), list[int]()
        while more := [number for number, of_ticket in left.items() if not covered.isdisjoint(of_ticket)]:
            found += more
            covered.update(load for number in more for load in left.pop(number))
        return tuple(sorted(found))

    def as_entered(self, number: int) -> str:
        """The loads and masses of a ticket as the command line takes them."""
        ticket, truck = self._tickets[number - 1], ledgers.truck_of(self._entry(number))
        loads = str(ticket.first_load) if ticket.first_load == ticket.last_load else f"{ticket.first_load}-{ticket.last_load}"
        if truck is None:
            return f"{loads} {ticket.weighed_mass_kg:.10g}kg"
        other = f"--other {truck.other_kg:.10g}kg --other-std-dev {truck.other_std_dev_kg:.4g}kg"
        return f"{loads} {truck.truck_kg:.10g}kg {other}"

    def _entry(self, number: int) -> Mapping[str, Any]:
        """What was kept beside a ticket; nothing of one of a store before 0.2."""
        return next((a.document for a in self._actions if a.kind == ledgers.TICKET and a.document["ticket"] == number), {})

    def reference_mass(self, number: int) -> TicketMass:
        """The reference mass of a ticket; its standard deviation is the usual one where none was kept."""
        entry = self._entry(number)
        truck, std_dev_kg = ledgers.truck_of(entry), entry.get("std_dev_kg")
        mass_kg = self._tickets[number - 1].weighed_mass_kg if truck is None else truck.own_kg
        sd_kg = RELATIVE_STD_DEV * mass_kg if std_dev_kg is None else float(std_dev_kg)
        return TicketMass(mass_kg, sd_kg, 0.0 if truck is None else truck.other_std_dev_kg)

    def truck(self, number: int) -> SharedTruck | None:
        """What was entered of another combine with a ticket."""
        return ledgers.truck_of(self._entry(number))

    def change_crop(self, before: str, now: str) -> None:
        """Another crop from now on: tickets that have not updated the parameters wait for the return of theirs."""
        self._of_crop[before], self.waiting = self.waiting, self._of_crop.pop(now, [])

    def handed_over(self) -> None:
        """No ticket waits in the monitor any more: those that have not updated the parameters were refused."""
        self.waiting = []

    @property
    def measuring_waits(self) -> bool:
        """Whether there are tickets for `take_to_measure`."""
        return bool(self._to_measure) and not self._learnt.keys().isdisjoint(self._to_measure)

    def take_to_measure(self, in_use: int) -> tuple[tuple[int, ...], int]:
        """Tickets whose loads are to be measured again, each once, and the version of the parameters to do it with.

        in_use: the present version. Where a change of crop came since the tickets updated the parameters, it is the last version
        that they led to; tickets from before or after another change are left for the next time. Those taken before of which
        nothing came are taken again.
        """
        learnt = self._learnt
        left = [number for number in (*self._taken, *self._to_measure) if number in learnt]
        self._taken_before = self._next_number
        changes = sorted(version for version, a in self.updates.items() if a.document.get("origin") == ledgers.CROP)
        harvests = {number: bisect(changes, learnt[number]) for number in left}
        self._taken = tuple(number for number in left if harvests[number] == harvests[left[0]])
        self._to_measure = [number for number in left if number not in self._taken]
        changed = harvests[left[0]] < len(changes)
        return self._taken, max(learnt[number] for number in self._taken) if changed else in_use

    @property
    def _led(self) -> Mapping[int, tuple[int, ...]]:
        """As `ledger.updated_by`."""
        return ledgers.updated_by(self._actions)

    @property
    def _learnt(self) -> Mapping[int, int]:
        """The newest version that each ticket has led to, by the ticket's number."""
        undone = self.undone_versions
        return {number: v for v, numbers in sorted(self._led.items()) if v not in undone for number in numbers}

    def take_behind(self, change: ParametersChanged) -> list[int]:
        """Numbers of the tickets that were handed over for a change of the parameters; they wait no more to update them."""
        behind, ticketed = list[int](), set[tuple[int, int]]()
        for number in self.waiting:
            ticket = self._tickets[number - 1]
            loads = ticket.first_load, ticket.last_load
            # Of two for the same loads one is handed over at a time.
            if loads not in ticketed and self._is_of(number, change.references):
                behind.append(number)
                ticketed.add(loads)
        self.waiting = [number for number in self.waiting if number not in behind]
        self._to_measure += behind
        return behind

    def _is_of(self, number: int, references: Sequence[tuple[int, float]]) -> bool:
        ticket, mass_kg = self._tickets[number - 1], self.reference_mass(number).mass_kg
        return isclose(sum(kg for load, kg in references if ticket.first_load <= load <= ticket.last_load), mass_kg, rel_tol=1e-6)

    def bring_back(self, version: int) -> None:
        """An undo brought this version back: loads that were measured with what it took back are to be measured again."""
        self._restored.append(version)

    @property
    def restored(self) -> tuple[int, ...]:
        """Versions that an undo brought back and with which loads are still to be measured again, for a restart to go on with."""
        return tuple(self._restored)

    @property
    def restored_waits(self) -> bool:
        """Whether there is one for `take_restored`."""
        return len(self._restored) > self._restoring

    def take_restored(self) -> tuple[tuple[int, ...], int]:
        """No ticket, and the first of `restored`. Where nothing comes of it, it is taken again after the next undo."""
        self._restoring, self._taken_before = len(self._restored), self._next_number
        return (), self._restored[0]

    @property
    def open_loads(self) -> Mapping[int, Remeasuring]:
        """Loads that were open as the others were measured again, by number: their turn comes when they are closed."""
        return dict(self._open_loads)

    def closed_load(self, open_load: int | None) -> tuple[int, Remeasuring] | None:
        """The first of `open_loads` that is closed now, with what it is measured again by, of its tickets those that count; None
        where there is none. open_load: number of the load that is open, None for none."""
        first = next(((number, by) for number, by in sorted(self._open_loads.items()) if number != open_load), None)
        if first is None:
            return None
        number, by = first
        counting = self._counting
        return number, replace(by, tickets=tuple(ticket for ticket in by.tickets if ticket in counting))

    @property
    def to_update(self) -> frozenset[int]:
        """Numbers of the tickets in the queue to update the parameters in use, one with each second."""
        return frozenset(self.waiting)

    @property
    def unfinished(self) -> tuple[int, ...]:
        """Numbers of the tickets that wait or whose loads are being measured again, which a restart has to go on with."""
        to_measure = (*self._taken, *self._to_measure)
        if to_measure:
            # Of those whose update was taken back by an undo of another no loads are to be measured again.
            gone = {number for numbers in self._led.values() for number in numbers}.difference(self._learnt)
            to_measure = tuple(number for number in to_measure if number not in gone)
        return (*to_measure, *self.waiting)

    @property
    def unfinished_of_crop(self) -> Mapping[str, Sequence[int]]:
        """Numbers of the tickets that wait for the return of another crop, by its name."""
        return {crop: tuple(kept) for crop, kept in self._of_crop.items() if kept}

    def posted(
        self,
        tickets: Sequence[int],
        version: int,
        factors: Mapping[int, float],
        *,
        open_load: int | None = None,
        closed_load: int | None = None,
    ) -> None:
        """Loads were measured again with the parameters of this version, after these tickets.

        factors: by load number; none where nothing came of it. Loads that were given another crop meanwhile keep what that crop's
        parameters measured. Where one of the tickets or the version was taken back meanwhile, or one was replaced, it stands for
        nothing, and the other tickets' loads are to be measured again. open_load: that was left out since it was open;
        closed_load: the one of `open_loads` that this was about, None for all other loads.
        """
        if closed_load is not None and not self._counting.issuperset(tickets):
            return
        if closed_load is not None:
            self._open_loads.pop(closed_load, None)
        else:
            left, self._taken = self._taken, ()
            if not tickets:
                self._restored, self._restoring = [waiting for waiting in self._restored if waiting != version], 0
            elif set(left) != set(tickets) or version in self.undone_versions:
                self._to_measure = [*left, *self._to_measure]
                return
            if open_load is not None:
                self._open_loads[open_load] = Remeasuring(tuple(tickets), version)
        recropped = ledgers.recropped(action for action in self._actions if action.number >= self._taken_before)
        factors = {number: factor for number, factor in factors.items() if number not in recropped}
        if not factors:
            return
        document = {
            "tickets": list(tickets), "version": version, "factors": {str(n): factor for n, factor in sorted(factors.items())}
        }  # fmt: skip
        self.add(ledgers.POSTING, "", document)

    def not_measured(self) -> None:
        """What was taken could not be measured again yet: it waits as before."""
        self._to_measure, self._taken, self._restoring = [*self._taken, *self._to_measure], (), 0

    def posted_by_crop(self, factors: Mapping[int, float], now_s: float) -> None:
        """Loads that are of another crop than they were measured with were measured again with its parameters."""
        document = {"tickets": [], "version": 0, "factors": {str(n): factor for n, factor in sorted(factors.items())}}
        self.add(ledgers.POSTING, "", document, now_s)

    @property
    def updates(self) -> Mapping[int, Action]:
        """Changes of the parameters, by the version that they made."""
        return {int(a.document["version"]): a for a in self._actions if a.kind == ledgers.PARAMETERS}

    @property
    def undone_versions(self) -> set[int]:
        """As `ledger.undone_versions`."""
        return ledgers.undone_versions(self._actions)

    def standing_of(self, versions: Collection[int]) -> tuple[int, ...]:
        """Numbers of the tickets that led to these versions; without those taken back, replaced or silenced."""
        led = {number for version, numbers in self._led.items() if version in versions for number in numbers}
        return tuple(sorted(led & self._updating))

    def measure_lost_again(self) -> None:
        """Loads that were measured again after tickets whose update stands, while that measurement stands no more, are to be
        measured again."""
        undone, standing = self.undone_versions, self.ledger.tickets
        posted = (a.document for a in self._actions if a.kind == ledgers.POSTING and a.document["version"] not in undone)
        measured = {number for document in posted if set(document["tickets"]) <= set(standing) for number in document["tickets"]}
        known = measured.union(self.unfinished, *self._of_crop.values())
        lost = (n for n, v in self._learnt.items() if n in standing and n not in known and v > self.calibrated_version)
        self._to_measure += sorted(lost)

    def learnt_from(self) -> tuple[int, ...]:
        """Numbers of the standing tickets that led to versions which stand."""
        return tuple(sorted(number for number in self._learnt if number in self.ledger.tickets))

    @property
    def calibrated_version(self) -> int:
        """Version with which the newest parameter file that stands came; what was measured before it says nothing about it."""
        gone = self.undone_versions
        files = (version for version, a in self.updates.items() if a.document.get("origin") == "file" and version not in gone)
        return max(files, default=0)

    @property
    def ledger(self) -> ledgers.Ledger:
        """Tickets and postings that stand."""
        return ledgers.ledger(self._tickets, self._actions)

    def ticket_table(self, doubted_loads: Collection[int] = ()) -> list[ListedTicket]:
        """All tickets, with who entered them and who took them back, and what became of each. doubted_loads: those whose tickets
        contradict the ones that count."""
        rows = ledgers.ticket_rows(self._tickets, self._actions)
        states = ticket_states(
            self.ledger,
            self._actions,
            to_update=dict.fromkeys(self.to_update, "") | {n: crop for crop, kept in self._of_crop.items() for n in kept},
            doubted_loads=doubted_loads,
        )
        return [{**row, "state": states.get(row["number"], "undone")} for row in rows]

    def take(self) -> tuple[tuple[Ticket, ...], tuple[Action, ...]]:
        """Those that no batch has brought yet; they count as brought."""
        new = tuple(self._new_tickets), tuple(self._new_actions)
        self._new_tickets, self._new_actions = [], []
        return new

    def report_all(self) -> None:
        """The next batch brings them all."""
        self._new_tickets, self._new_actions = list(self._tickets), list(self._actions)
