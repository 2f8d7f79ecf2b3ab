"""What stands of tickets, loads measured again and calibrations, after all that took something back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING, Any

from yieldmon.documents.calibrations import CalibrationRow, CalibrationState
from yieldmon.documents.loads import ListedLoad
from yieldmon.documents.tickets import TicketRow, TruckDocument
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.files.ticket_file import RELATIVE_STD_DEV
from yieldmon.service.storage.load_spread import LoadSpread, ParameterSpread, shares_std_dev

if TYPE_CHECKING:
    from yieldmon.service.storage.batch import Action, Load, Ticket

TICKET, TICKET_UNDO, ZERO, ZERO_UNDO = "ticket", "ticket-undo", "zero", "zero-undo"
PARAMETERS, PARAMETERS_UNDO, REMEASURED, TOTALS_RESET = "parameters", "parameters-undo", "posting", "totals-reset"
LOAD_NAMES = "load-names"
"""Another field or crop for loads."""

_CONTRADICTION = 3.0
"""Standard deviations of ticket and measurement together from which a ticket is no surer than what it is off by."""


@dataclass(frozen=True)
class SharedTruck:
    """A weighed truck that another combine filled as well. other_kg: by that one's own monitor, with its standard deviation."""

    truck_kg: float
    other_kg: float
    other_std_dev_kg: float

    @property
    def document(self) -> TruckDocument:
        """As it is kept with a ticket."""
        return {"truck_kg": self.truck_kg, "other_kg": self.other_kg, "other_std_dev_kg": self.other_std_dev_kg}

    @property
    def own_kg(self) -> float:
        """What the other combine leaves of it."""
        return self.truck_kg - self.other_kg


@dataclass(frozen=True)
class Ledger:
    """tickets: those that stand, by number (from 1, in the order they were entered). factors: mass measured again over the mass
    as measured, by load number. spreads: of what was measured again by the parameters, with the number of the action that did it,
    by load number; without those of which it is not known. std_devs_kg: of the tickets' masses, by number; 0.5 % where it was not
    kept."""

    tickets: Mapping[int, Ticket]
    factors: Mapping[int, float]
    spreads: Mapping[int, tuple[int, ParameterSpread]] = field(default_factory=dict)
    std_devs_kg: Mapping[int, float] = field(default_factory=dict)

    @cached_property
    def newest(self) -> Mapping[int, int]:
        """Number of the newest ticket that covers each load, whether or not it is replaced, by the load's number."""
        return {load: number for number, t in sorted(self.tickets.items()) for load in t.loads}

    @cached_property
    def replaced(self) -> frozenset[int]:
        """Numbers of the tickets of which a load has a newer one: they correct no load and update no parameters, as it is not
        known which of the two is wrong, nor what is left for the rest of their loads."""
        newest = self.newest
        return frozenset(n for n, t in self.tickets.items() if any(newest[load] != n for load in t.loads))

    def ticket_of(self, load_number: int) -> tuple[int, Ticket] | None:
        """The ticket that counts for a load, with its number: the newest that stands and covers it, where none replaces that."""
        number = self.newest.get(load_number)
        return None if number is None or number in self.replaced else (number, self.tickets[number])

    def rows(self, loads: Iterable[Load]) -> list[ListedLoad]:
        """Loads as measured, as measured again, as weighed, and the best of these. loads: all that there are."""
        found = [(load, self.ticket_of(load.number)) for load in loads]
        together: dict[int, list[Load]] = {}
        for load, ticket in found:
            if ticket is not None:
                together.setdefault(ticket[0], []).append(load)
        scales = {number: self._scale(self.tickets[number], covered) for number, covered in together.items()}
        shares: dict[int, float | None] = {}
        for number, covered in together.items():
            shares |= self._std_devs_of_shares(number, covered)
        return [
            self._row(load, ticket, 1.0 if ticket is None else scales[ticket[0]], shares.get(load.number))
            for load, ticket in found
        ]

    def _scale(self, ticket: Ticket, covered: Sequence[Load]) -> float:
        """Weighed mass over what its loads hold as measured again: other parameters may have measured some of them at first."""
        whole_kg = self._whole_kg(ticket, covered)
        return ticket.weighed_mass_kg / whole_kg if whole_kg > 0.0 else ticket.factor

    def _whole_kg(self, ticket: Ticket, covered: Sequence[Load]) -> float:
        """What a ticket's loads hold as measured again, with what the store has lost of them."""
        known_kg = sum(load.mass_kg * self.factors.get(load.number, 1.0) for load in covered)
        return known_kg + max(ticket.measured_mass_kg - sum(load.mass_kg for load in covered), 0.0)

    def _std_devs_of_shares(self, number: int, covered: Sequence[Load]) -> dict[int, float | None]:
        """Relative standard deviation of the corrected mass of each of a ticket's loads, by load number; None where it is not
        known."""
        ticket = self.tickets[number]
        std_dev_kg = self.std_devs_kg.get(number)
        of_all = RELATIVE_STD_DEV if std_dev_kg is None else std_dev_kg / ticket.weighed_mass_kg
        whole_kg = self._whole_kg(ticket, covered)
        with_grain = [load for load in covered if load.mass_kg > 0.0]
        spreads = {load.number: self._spread(load) for load in with_grain}
        known = [spread for spread in spreads.values() if spread is not None]
        if len(known) < len(with_grain) or not whole_kg > 0.0:
            return dict.fromkeys(spreads, of_all if ticket.first_load == ticket.last_load else None)
        shares = [load.mass_kg * self.factors.get(load.number, 1.0) / whole_kg for load in with_grain]
        # What the store has lost of them may be anything.
        lost = max(1.0 - sum(shares), 0.0)
        of_measured = lost + sum(share * spread.std_dev for share, spread in zip(shares, known, strict=True))
        off = 1.0 - whole_kg / ticket.weighed_mass_kg
        if abs(off) > _CONTRADICTION * hypot(of_all, of_measured * whole_kg / ticket.weighed_mass_kg):
            # Which of the two is wrong is not known.
            of_all = hypot(of_all, off)
        return dict(zip(spreads, shares_std_dev(known, shares, of_all), strict=True))

    def _spread(self, load: Load) -> LoadSpread | None:
        """Of a load as measured again, or as measured; None where it is not known."""
        if not load.mass_kg > 0.0 or load.std_dev_kg is None:
            return None
        measured_by, again = self.spreads.get(load.number, (0, None))
        if load.budget is None:
            return None if load.number in self.factors else LoadSpread((), load.std_dev_kg / load.mass_kg)
        return LoadSpread.of(load.mass_kg, load.budget, again, measured_by)

    def _row(self, load: Load, found: tuple[int, Ticket] | None, scale: float, of_ticket: float | None) -> ListedLoad:
        """scale: corrected mass over what the load holds as measured again, or as measured. of_ticket: relative standard
        deviation of a load that has a ticket, None where it is not known."""
        again = self.factors.get(load.number)
        factor = scale * (1.0 if again is None else again)
        spread = self._spread(load)
        relative = of_ticket if found is not None else None if spread is None else spread.std_dev
        return {
            "number": load.number,
            "field": load.field,
            "crop": load.crop,
            "started_s": load.started_s,
            "ended_s": load.ended_s,
            "mass_kg": load.mass_kg,
            "dry_mass_kg": load.dry_mass_kg,
            "area_m2": load.area_m2,
            "posted_mass_kg": None if again is None else load.mass_kg * again,
            "ticket_mass_kg": None if found is None else found[1].weighed_mass_kg,
            "corrected_mass_kg": load.mass_kg * factor,
            "corrected_dry_mass_kg": None if load.dry_mass_kg is None else load.dry_mass_kg * factor,
            "ticket_id": None if found is None else found[0],
            "std_dev_kg": load.std_dev_kg,
            "corrected_std_dev_kg": None if relative is None else relative * load.mass_kg * factor,
        }


@dataclass(frozen=True)
class LoadRecord:
    """A load with all its masses.

    Parameters
    ----------
    number : int
    field, crop : str
        As an operator named them.
    started_s, ended_s : float or None
        Unix time, s.
    mass_kg, dry_mass_kg : float or None
        As measured, kg; None where the moisture of some of it is not known.
    area_m2 : float or None
        Harvested for it, m2.
    posted_mass_kg : float or None
        As measured again, kg.
    ticket_mass_kg : float or None
        As weighed, kg.
    corrected_mass_kg, corrected_dry_mass_kg : float or None
        The best of these, kg.
    ticket_id : int or None
        Number of the ticket that counts.
    std_dev_kg : float or None
        Of mass_kg, kg, as sweeps have shown it to be since; None in a store that does not have it.
    corrected_std_dev_kg : float or None
        Of corrected_mass_kg, kg, with what the loads' errors have in common; None where it is not known.

    Examples
    --------
    See `read_loads`.
    """

    number: int
    field: str
    crop: str
    started_s: float | None
    ended_s: float | None
    mass_kg: float
    dry_mass_kg: float | None
    area_m2: float | None
    posted_mass_kg: float | None
    ticket_mass_kg: float | None
    corrected_mass_kg: float
    corrected_dry_mass_kg: float | None
    ticket_id: int | None
    std_dev_kg: float | None = None
    corrected_std_dev_kg: float | None = None


def ledger(tickets: Sequence[Ticket], actions: Iterable[Action]) -> Ledger:
    """From all tickets and actions, in order."""
    known = list(actions)
    gone = {int(a.document["ticket"]) for a in known if a.kind == TICKET_UNDO}
    undone = undone_versions(known)
    factors: dict[int, float] = {}
    spreads: dict[int, tuple[int, ParameterSpread]] = {}
    for action in known:
        stands = action.kind == REMEASURED and action.document["version"] not in undone
        if stands and not gone.intersection(action.document["tickets"]):
            of_loads = action.document.get("spreads", {})
            for name, factor in action.document["factors"].items():
                factors[int(name)] = float(factor)
                spreads.pop(int(name), None)
                if name in of_loads:
                    spreads[int(name)] = action.number, ParameterSpread.of_document(of_loads[name])
    standing = {n: t for n, t in enumerate(tickets, 1) if n not in gone}
    return Ledger(standing, factors, spreads, _std_devs_kg(known))


def _std_devs_kg(actions: Iterable[Action]) -> dict[int, float]:
    """Of the corrected mass of each ticket's loads together, by number; without those of which it was not kept."""
    entered = {int(a.document["ticket"]): a.document for a in actions if a.kind == TICKET}
    kept = {n: document.get("best_std_dev_kg", document.get("std_dev_kg")) for n, document in entered.items()}
    return {number: float(std_dev_kg) for number, std_dev_kg in kept.items() if std_dev_kg is not None}


def ticket_rows(tickets: Sequence[Ticket], actions: Iterable[Action]) -> list[TicketRow]:
    """Each ticket with who entered it, who took it back when, and the `SharedTruck` that it is of, None where there is none."""
    known = list(actions)
    entered = {int(a.document["ticket"]): a for a in known if a.kind == TICKET}
    undone = {int(a.document["ticket"]): a for a in known if a.kind == TICKET_UNDO}
    return [
        {
            "time_s": ticket.time_s,
            "first_load": ticket.first_load,
            "last_load": ticket.last_load,
            "weighed_mass_kg": ticket.weighed_mass_kg,
            "measured_mass_kg": ticket.measured_mass_kg,
            "note": ticket.note,
            "number": number,
            "who": entered[number].who if number in entered else "",
            "truck": entered[number].document.get("truck") if number in entered else None,
            "undone_s": undone[number].time_s if number in undone else None,
            "undone_by": undone[number].who if number in undone else None,
        }
        for number, ticket in enumerate(tickets, 1)
    ]


def truck_of(document: Mapping[str, Any]) -> SharedTruck | None:
    """Of a ticket's action; None where no other combine filled it."""
    return SharedTruck(**document["truck"]) if "truck" in document else None


def begins_anew(update: Action) -> bool:
    """Whether parameters, by the action that brought them, have nothing to do with what was measured before."""
    return update.document.get("origin") in (ParameterOrigin.FILE, ParameterOrigin.HARDWARE)


def recropped(actions: Iterable[Action]) -> set[int]:
    """Numbers of the loads that were given another crop than they began with."""
    return {
        int(row["load"])
        for action in actions
        if action.kind == LOAD_NAMES and action.document.get("crop") is not None
        for row in action.document["before"]
    }


def silenced(actions: Iterable[Action]) -> frozenset[int]:
    """Numbers of the tickets whose update was taken back by the version: they only correct their loads."""
    undos = (action for action in actions if action.kind == PARAMETERS_UNDO)
    return frozenset(int(number) for action in undos for number in action.document.get("tickets", ()))


def undone_versions(actions: Iterable[Action]) -> set[int]:
    """Versions of the parameters that were taken back, with those that followed on them."""
    return {
        int(version)
        for action in actions
        if action.kind == PARAMETERS_UNDO
        for version in action.document.get("versions", (action.document["version"],))
    }


def updated_by(actions: Iterable[Action]) -> dict[int, tuple[int, ...]]:
    """Numbers of the tickets that led to each version of the parameters.

    In earlier stores a version also names those that had led to one before it and whose loads were still to be measured again.
    """
    found, standing = dict[int, tuple[int, ...]](), dict[int, int]()
    for action in actions:
        if action.kind == PARAMETERS_UNDO:
            gone = undone_versions([action])
            standing = {number: version for number, version in standing.items() if version not in gone}
        elif action.kind == PARAMETERS:
            version = int(action.document["version"])
            named = tuple(map(int, action.document.get("tickets", ())))
            found[version] = tuple(number for number in named if number not in standing)
            standing |= dict.fromkeys(found[version], version)
    return found


def calibration_rows(actions: Iterable[Action], in_use: int, crop_of: Callable[[int], str]) -> list[CalibrationRow]:
    """Each change of parameters and each operator's zero, with who and when, and whether it stands.

    crop_of: whose parameters a version is, "" where nothing says so.
    """
    known = list(actions)
    undone = undone_versions(known)
    undone_zeros = {int(a.document["action"]) for a in known if a.kind == ZERO_UNDO}
    # With one goes what was taken before it from the same second on.
    back = {a.document.get("second") for a in known if a.kind == ZERO and a.number in undone_zeros}
    rows: list[CalibrationRow] = []
    for action in known:
        document = action.document
        if action.kind == PARAMETERS:
            version = int(document["version"])
            state: CalibrationState = "in use" if version == in_use else "undone" if version in undone else ""
            rows.append({
                "kind": "parameters", "version": version, "time_s": action.time_s, "who": action.who,
                "origin": document.get("origin", ""), "what": document.get("reason", ""), "effects": document.get("effects", []),
                "state": state, "crop": crop_of(version),
            })  # fmt: skip
        elif action.kind == ZERO:
            what = "zero calibration" + (f", forced although {document['signs']}" if document.get("signs") else "")
            state = "undone" if document.get("second") in back else ""
            rows.append({
                "kind": "zero", "version": None, "time_s": action.time_s, "who": action.who, "origin": "operator", "what": what,
                "effects": [], "state": state, "crop": "",
            })  # fmt: skip
    return rows
