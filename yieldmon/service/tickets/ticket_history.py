"""Tickets and actions as they are at one time, and what follows from them: which tickets stand, count and have updated what."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from yieldmon.errors import InputError
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.files.ticket_file import RELATIVE_STD_DEV
from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Action, Ticket
from yieldmon.service.tickets.ticket_mass import TicketMass


@dataclass(frozen=True)
class TicketHistory:
    """Everything that was entered, updated and taken back until one time.

    A ticket *stands* unless it was taken back; it *counts* where none newer replaces it; it *updates* the parameters where it
    also was not silenced by an undo of its update. A *reference* was handed to the calibration.

    Parameters
    ----------
    tickets : tuple of Ticket
        In the order of their numbers, from 1.
    actions : tuple of Action
        In order.
    """

    tickets: tuple[Ticket, ...]
    actions: tuple[Action, ...]

    # What stands

    @cached_property
    def ledger(self) -> ledgers.Ledger:
        """Tickets and factors of loads measured again, that stand."""
        return ledgers.ledger(self.tickets, self.actions)

    @cached_property
    def undone_versions(self) -> frozenset[int]:
        """As `ledger.undone_versions`."""
        return frozenset(ledgers.undone_versions(self.actions))

    @cached_property
    def updates(self) -> Mapping[int, Action]:
        """Changes of the parameters, by the version that they made."""
        return {int(a.document["version"]): a for a in self.actions if a.kind == ledgers.PARAMETERS}

    @cached_property
    def calibrated_version(self) -> int:
        """Version with which the newest parameter file that stands came, or with which calibration began anew after a change of
        the machine; what was measured before it says nothing about it."""
        gone = self.undone_versions
        begun = (version for version, a in self.updates.items() if ledgers.begins_anew(a) and version not in gone)
        return max(begun, default=0)

    @cached_property
    def counting(self) -> frozenset[int]:
        """Numbers of the standing tickets that none replaces."""
        return frozenset(self.ledger.tickets) - self.ledger.replaced

    @cached_property
    def silenced(self) -> frozenset[int]:
        """As `ledger.silenced`."""
        return ledgers.silenced(self.actions)

    @cached_property
    def updating(self) -> frozenset[int]:
        """Numbers of the counting tickets that are not silenced: the parameters rest on those of them that are references."""
        return self.counting - self.silenced

    # Which tickets led to which version

    @cached_property
    def tickets_by_version(self) -> Mapping[int, tuple[int, ...]]:
        """As `ledger.updated_by`."""
        return ledgers.updated_by(self.actions)

    @cached_property
    def newest_version_by_ticket(self) -> Mapping[int, int]:
        """The newest standing version that each ticket has led to, by the ticket's number."""
        undone = self.undone_versions
        return {number: v for v, numbers in sorted(self.tickets_by_version.items()) if v not in undone for number in numbers}

    @cached_property
    def references(self) -> tuple[int, ...]:
        """Numbers of the tickets that were handed to the calibration since the parameter file in use came, or waited then."""
        file = self.updates.get(self.calibrated_version)
        since = 0 if file is None else file.number
        led = {n for version, numbers in self.tickets_by_version.items() if version > self.calibrated_version for n in numbers}
        handed = (a for a in self.actions if a.kind == ledgers.TICKET and a.document.get("reference", False))
        return tuple(int(a.document["ticket"]) for a in handed if a.number > since or int(a.document["ticket"]) in led)

    def in_effect(self) -> tuple[int, ...]:
        """Numbers of the standing tickets that led to versions which stand."""
        return tuple(sorted(number for number in self.newest_version_by_ticket if number in self.ledger.tickets))

    def standing_of(self, versions: Collection[int]) -> tuple[int, ...]:
        """Numbers of the tickets that led to these versions; without those taken back, replaced or silenced."""
        led = {number for version, numbers in self.tickets_by_version.items() if version in versions for number in numbers}
        return tuple(sorted(led & self.updating))

    def first_led_to(self, version: int) -> tuple[int, ...]:
        """Numbers of the standing tickets that led to a version and to none before it that stands."""
        standing, gone, led = self.ledger.tickets, self.undone_versions, self.tickets_by_version
        known = {number for earlier, numbers in led.items() if earlier < version and earlier not in gone for number in numbers}
        return tuple(sorted(number for number in led.get(version, ()) if number in standing and number not in known))

    def first_update(self, number: int, held_against: Callable[[int], bool] | None = None) -> int | None:
        """The first version of the parameters that rests on a ticket; None where none that stands does, or a parameter file has
        replaced it since. held_against: which tickets after it are held against it, though it may have led to no version."""
        for version, led in sorted(self.tickets_by_version.items()):
            if version in self.undone_versions or version <= self.calibrated_version:
                continue
            if number in led or (held_against and any(other > number and held_against(other) for other in led)):
                return version
        return None

    def update_before_file(self, number: int) -> int | None:
        """The first version that rests on a ticket, of those that a parameter file has replaced since; None: none that stands."""
        led = (v for v, numbers in sorted(self.tickets_by_version.items()) if number in numbers and v not in self.undone_versions)
        return next((version for version in led if version < self.calibrated_version), None)

    def update_without_replaced(self, number: int) -> int | None:
        """The version that came as a ticket was replaced, where a parameter file has come since; None: none that stands."""
        undos = [a.number for a in self.actions if a.kind == ledgers.PARAMETERS_UNDO and a.document.get("replaced") == number]
        came = next((v for v, a in sorted(self.updates.items()) if undos and a.number > undos[-1]), None)
        by_undo = came is not None and self.updates[came].document.get("origin") == ParameterOrigin.UNDO
        stands = came is not None and came not in self.undone_versions
        return came if came is not None and by_undo and stands and came < self.calibrated_version else None

    def updates_gone_with(self, version: int) -> tuple[int, ...]:
        """Of a version that an undo made, numbers of the tickets that what it took back rests on and that no longer update: taken
        back, silenced or replaced. None for another version."""
        update = self.updates.get(version)
        if update is None or update.document.get("origin") != ParameterOrigin.UNDO:
            return ()
        before = [a for a in self.actions if a.kind == ledgers.PARAMETERS_UNDO and a.number < update.number]
        taken_back = {int(v) for a in before[-1:] for v in a.document.get("versions", ())}
        led = {number for v, numbers in self.tickets_by_version.items() if v in taken_back for number in numbers}
        return tuple(sorted(led - self.updating))

    def last_ticket_before(self, version: int) -> int:
        """Number of the last ticket that was entered before a version came; 0 for none."""
        update = self.updates.get(version)
        entered = (
            int(a.document["ticket"])
            for a in self.actions
            if a.kind == ledgers.TICKET and (update is None or a.number < update.number)
        )
        return max(entered, default=0)

    def without_update_after(self, number: int) -> tuple[int, ...]:
        """Numbers of the tickets after one, of the parameter file in use, that were handed to the calibration and led to no
        version that stands; without those taken back, replaced or silenced."""
        return tuple(n for n in self.references if n > number and n in self.updating and n not in self.newest_version_by_ticket)

    def references_for(self, loads: Collection[int]) -> tuple[int, ...]:
        """Numbers of the tickets of the parameter file in use that were handed to the calibration for one of these loads, or for
        one that is on such a ticket too; without those taken back, replaced or silenced."""
        left = {n: self.ledger.tickets[n].loads for n in self.references if n in self.updating}
        covered, found = set(loads), list[int]()
        while more := [number for number, of_ticket in left.items() if not covered.isdisjoint(of_ticket)]:
            found += more
            covered.update(load for number in more for load in left.pop(number))
        return tuple(sorted(found))

    def lost_measurements(self) -> tuple[int, ...]:
        """Numbers of the standing tickets that updated the parameters in use, of whose loads no measurement after them stands."""
        undone, standing = self.undone_versions, self.ledger.tickets
        remeasured = (a.document for a in self.actions if a.kind == ledgers.REMEASURED and a.document["version"] not in undone)
        measured = {
            number for document in remeasured if set(document["tickets"]) <= set(standing) for number in document["tickets"]
        }
        newest = self.newest_version_by_ticket.items()
        return tuple(sorted(n for n, v in newest if n in standing and n not in measured and v > self.calibrated_version))

    # What replaces what

    def replaced_by(self, ticket: Ticket) -> tuple[int, ...]:
        """Numbers of the standing tickets that a new one replaces: one of their loads has a newer one then."""
        after = replace(self.ledger, tickets={**self.ledger.tickets, len(self.tickets) + 1: ticket})
        return tuple(sorted(after.replaced - self.ledger.replaced))

    def count_again_without(self, number: int) -> tuple[int, ...]:
        """Numbers of the tickets that a standing one alone replaces, whether or not it is replaced itself."""
        now = self.ledger
        without = replace(now, tickets={n: ticket for n, ticket in now.tickets.items() if n != number})
        return tuple(sorted(now.replaced - without.replaced - {number}))

    def stand_again_without(self, number: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Numbers of the references that only a standing ticket keeps from updating the parameters: those entered since the
        parameter file in use came, and those before it."""
        again = [n for n in self.count_again_without(number) if n not in self.silenced and self._entry(n).get("reference", False)]
        return tuple(n for n in again if n in self.references), tuple(n for n in again if n not in self.references)

    def factors_with(self, number: int) -> dict[tuple[int, ...], dict[int, float]]:
        """What loads were measured again with by what went as a ticket was replaced, by the tickets that this rests on.

        Of a ticket of an earlier parameter file, which updates nothing anew: where it stands again, so do these factors.
        """
        undos = (a for a in self.actions if a.kind == ledgers.PARAMETERS_UNDO and a.document.get("replaced") == number)
        versions = {int(v) for a in undos for v in a.document["versions"] if v < self.calibrated_version}
        found = dict[int, tuple[float, tuple[int, ...]]]()
        for action in self.actions:
            document = action.document
            if action.kind != ledgers.REMEASURED or not self.counting.issuperset(document["tickets"]):
                continue
            again, stands = document["version"] in versions, document["version"] not in self.undone_versions
            for load, factor in document["factors"].items() if again or stands else ():
                found.pop(int(load), None)
                if again and not stands:
                    found[int(load)] = factor, tuple(sorted({*document["tickets"], number}))
        by_tickets = dict[tuple[int, ...], dict[int, float]]()
        for load, (factor, tickets) in sorted(found.items()):
            by_tickets.setdefault(tickets, {})[load] = factor
        return dict(sorted(by_tickets.items()))

    # One ticket

    def entered(self, number: int) -> Ticket:
        """A ticket, whether or not it stands."""
        return self.tickets[number - 1]

    def standing_ticket(self, number: int) -> Ticket:
        """A ticket that stands. Raises InputError where there is none of this number."""
        standing = self.ledger.tickets
        if number not in standing:
            numbers = ", ".join(map(str, standing))
            known = f"a ticket that counts: {numbers}" if standing else "a ticket that was entered; there is none"
            done = "is undone already" if 1 <= number <= len(self.tickets) else "no such ticket"
            raise InputError(f"ticket {number}", done, known)
        return standing[number]

    def as_entered(self, number: int) -> str:
        """The loads and masses of a ticket as the command line takes them."""
        ticket, truck = self.entered(number), ledgers.truck_of(self._entry(number))
        loads = str(ticket.first_load) if ticket.first_load == ticket.last_load else f"{ticket.first_load}-{ticket.last_load}"
        if truck is None:
            return f"{loads} {ticket.weighed_mass_kg:.10g}kg"
        other = f"--other {truck.other_kg:.10g}kg --other-std-dev {truck.other_std_dev_kg:.4g}kg"
        return f"{loads} {truck.truck_kg:.10g}kg {other}"

    def reference_mass(self, number: int) -> TicketMass:
        """The reference mass of a ticket; its standard deviation is the usual one where none was kept."""
        entry = self._entry(number)
        truck, std_dev_kg = ledgers.truck_of(entry), entry.get("std_dev_kg")
        mass_kg = self.entered(number).weighed_mass_kg if truck is None else truck.own_kg
        sd_kg = RELATIVE_STD_DEV * mass_kg if std_dev_kg is None else float(std_dev_kg)
        return TicketMass(mass_kg, sd_kg, 0.0 if truck is None else truck.other_std_dev_kg)

    def _entry(self, number: int) -> Mapping[str, Any]:
        """What was kept beside a ticket; nothing of one of a store before 0.2."""
        return next((a.document for a in self.actions if a.kind == ledgers.TICKET and a.document["ticket"] == number), {})
