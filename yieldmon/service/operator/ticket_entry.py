"""A scale ticket as it is entered: what it corrects, which crop it updates, and what is asked about it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from math import exp, hypot, log
from statistics import fmean

from yieldmon.documents.tickets import TicketEntered
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.self_calibration.reference_mass import Weighing
from yieldmon.errors import InputError
from yieldmon.estimation.estimators import estimator_of
from yieldmon.files import ticket_file
from yieldmon.files.crops import shipped_name
from yieldmon.service.history.reference_tickets import why_no_reference
from yieldmon.service.history.undo import without_replaced
from yieldmon.service.operator.control_protocol import TICKET_KG
from yieldmon.service.operator.order import Order, covered_loads
from yieldmon.service.operator.requests import Request
from yieldmon.service.storage.batch import Load, Ticket
from yieldmon.service.storage.empty_loads import empty_loads
from yieldmon.service.storage.ledger import SharedTruck
from yieldmon.service.tickets import ticket_doubt
from yieldmon.service.tickets.ticket_mass import TicketMass

_CLOCK_SET_BACK = "the clock was set back while it was measured, and the forces over it were not kept"
_EXACT = 1e-3
"""Relative standard deviation of a mass that adds nothing to that of what was measured."""
_WEIGHED_SD = 0.03
"""Of ln of a load, by parameters that a ticket or two have updated."""


def enter_ticket(order: Order) -> TicketEntered:
    """Correct loads by a weighed mass, and let it update the parameters where it can.

    Parameters
    ----------
    order : Order
        first_load, last_load, mass_kg, std_dev_kg (kg; 0.5 % of the mass where it is missing) and note; other_kg and
        other_std_dev_kg (kg; 3 % where it is missing) of what another combine filled in, by its own monitor.

    Returns
    -------
    TicketEntered

    Raises
    ------
    InputError
        For loads that are unknown, open or without a measured mass, for masses that no load has, and where nothing is left.
    """
    request, journal = order.request, order.journal
    first, last = request.load_numbers()
    truck, own = _weighed(request)
    covered = _closed_loads(order, first, last)
    measured_kg = sum(load.mass_kg for load in covered)
    ticket = Ticket(order.now_s, first, last, own.mass_kg, measured_kg, request.name("note") or "")
    before = journal.actions.history
    _refuse_impossible(order, own.mass_kg, covered)
    counting = (before.ledger.ticket_of(load.number) for load in covered)
    stood_for = sorted({found[0] for found in counting if found is not None})
    # First of all, so that the parameters are what they would be without the tickets that it replaces.
    replaced = before.replaced_by(ticket)
    left = {load for number in replaced for load in before.entered(number).loads}
    left -= set(empty_loads(journal.loads))
    taken_back = without_replaced(replaced, order)
    again = journal.actions.history.ledger.factors
    known_kg = sum(load.mass_kg * again.get(load.number, 1.0) for load in covered)
    crop = _other_crop(order, covered)
    why_not = ticket_file.unit_slip(own.mass_kg, measured_kg) or why_no_reference(covered, order, crop)
    shares = own.shared_out(covered, measured_kg)
    departs = None if why_not else _departure(shares, order, crop)
    question = _question(ticket, departs, order, covered, crop)
    best_std_dev_kg = None
    if truck is not None:
        exact = TicketMass(own.mass_kg, _EXACT * own.mass_kg).shared_out(covered, measured_kg)
        best_kg, best_std_dev_kg = _best(own, known_kg, None if why_not else _departure(exact, order, crop))
        ticket = replace(ticket, weighed_mass_kg=best_kg)
    sets_scale_pct = _sets_scale_pct(departs, order, crop)
    why_not = why_not or _hand_over(shares, order, crop)
    number = journal.actions.ticket(
        ticket,
        order.who,
        own.std_dev_kg,
        is_reference=not why_not,
        crop=crop,
        truck=truck,
        best_std_dev_kg=best_std_dev_kg,
    )
    after = journal.actions.history
    return {
        "crop": journal.parameters.crop_of_load(covered[-1]),
        "ticket": number,
        "first_load": first,
        "last_load": last,
        "weighed_mass_kg": ticket.weighed_mass_kg,
        "truck": None if truck is None else truck.document,
        "own_mass_kg": own.mass_kg,
        "own_std_dev_kg": own.std_dev_kg,
        "measured_mass_kg": measured_kg,
        "known_mass_kg": known_kg,
        "factor": ticket.factor,
        "is_reference": not why_not,
        "why_no_reference": why_not,
        "waits_for_crop": "" if why_not else crop,
        "question": question,
        "replaces": stood_for,
        "taken_back": taken_back,
        "without_ticket": sorted(left.difference(range(first, last + 1))),
        "still_replaced": [{"ticket": older, "by": n} for n in replaced for older in after.count_again_without(n)],
        "sets_scale_pct": sets_scale_pct,
    }


def _hand_over(shares: Sequence[Weighing], order: Order, crop: str) -> str:
    """Hand a ticket's masses to the calibration. Why that cannot use them; "" where it can."""
    taken = [
        order.monitor.ticket(number, mass_kg, std_dev_kg, crop=crop, common_kg=common_kg)
        for number, mass_kg, std_dev_kg, common_kg in shares
    ]
    return "" if any(mass.comparable for mass in taken) else _CLOCK_SET_BACK


def _sets_scale_pct(departs: ticket_doubt.Departure | None, order: Order, crop: str) -> float | None:
    """By how much the ticket moves the scale, %, where it is the first that does; else None."""
    actions = order.journal.actions
    waits = actions.updates.of_crop.get(crop) if crop else actions.updates.waiting
    return 100.0 * (exp(departs.ln) - 1.0) if departs is not None and departs.first and not waits else None


def _closed_loads(order: Order, first: int, last: int) -> Sequence[Load]:
    """The loads from first to last. Raises InputError where one is open, or nothing was measured for them."""
    totals = order.monitor.totals
    if totals.load_open and first <= totals.load_number <= last:
        where = f"ticket for load {totals.load_number}"
        raise InputError(where, "it is still open, so more grain may come", "`yieldmon load stop` first, or another load")
    covered = covered_loads(order.journal, first, last)
    if not sum(load.mass_kg for load in covered) > 0.0:
        raise InputError(f"ticket for load {first}", "nothing was measured for it", "a load with a measured mass")
    return covered


def _refuse_impossible(order: Order, mass_kg: float, covered: Sequence[Load]) -> None:
    """Raises InputError for a mass that loads cannot have which were measured whole on a machine whose scale was weighed."""
    again = order.journal.actions.history.ledger.factors
    slip = ticket_file.unit_slip(mass_kg, sum(load.mass_kg * again.get(load.number, 1.0) for load in covered))
    if not slip or why_no_reference(covered, order, _other_crop(order, covered)):
        return
    counted = _counted_loads(order)
    # Of these loads a ticket that counts is what this one would replace.
    by = _calibrated_by(order, counted - {load.number for load in covered} or counted)
    if by:
        expected = "the mass of this load with its unit, such as 9.12t; "
        alone = _only_tickets(order, ())
        if alone:
            expected += f"if ticket {alone[-1]} is wrong, `yieldmon ticket undo {alone[-1]}`; "
        expected += "after a change of the machine `yieldmon calibrations restart`"
        raise InputError(f"ticket for load {covered[0].number}", f"{slip}, by {by}", expected)


def _calibrated_by(order: Order, counted: Collection[int]) -> str:
    """What the scale of the machine is known from, "" where nothing was weighed."""
    if counted:
        numbers = sorted(counted)
        return f"the calibration of load{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"
    if order.monitor.scale_counted:
        return "the calibration of the tank scale"
    in_use = order.monitor.estimator.parameters
    if in_use.carried_from:
        return f"the scale of {in_use.carried_from}"
    return "the parameters in use, whose scale was weighed" if in_use.is_weighed else ""


def _weighed(request: Request) -> tuple[SharedTruck | None, TicketMass]:
    """The truck, where another combine filled it as well, and what was weighed of these loads."""
    weighed_kg = request.mass("mass_kg", *TICKET_KG, "kg")
    std_dev_kg = request.mass_or_none("std_dev_kg", *TICKET_KG, "kg")
    if std_dev_kg is None:
        std_dev_kg = ticket_file.RELATIVE_STD_DEV * weighed_kg
    if std_dev_kg > weighed_kg:
        raise InputError(
            "std_dev_kg", f"is {std_dev_kg:g} kg, of {weighed_kg:g} kg", "the standard deviation of the weighing, below the mass"
        )
    truck = _shared_truck(request, weighed_kg)
    if truck is None:
        return None, TicketMass(weighed_kg, std_dev_kg)
    others = truck.other_kg, truck.other_std_dev_kg
    own_kg, own_std_dev_kg = ticket_file.own_part(weighed_kg, std_dev_kg, *others, "mass from the other combine")
    return truck, TicketMass(own_kg, own_std_dev_kg, truck.other_std_dev_kg)


def _shared_truck(request: Request, weighed_kg: float) -> SharedTruck | None:
    """What was entered of another combine; None for a truck of this one's grain alone."""
    other_kg = request.mass_or_none("other_kg", *TICKET_KG, "kg")
    std_dev_kg = request.mass_or_none("other_std_dev_kg", *TICKET_KG, "kg")
    if other_kg is None:
        if std_dev_kg is not None:
            raise InputError("other_std_dev_kg", "is given without other_kg", "both")
        return None
    return SharedTruck(weighed_kg, other_kg, ticket_file.OTHER_RELATIVE_STD_DEV * other_kg if std_dev_kg is None else std_dev_kg)


def _best(own: TicketMass, known_kg: float, measured: ticket_doubt.Departure | None) -> tuple[float, float]:
    """What another combine leaves of a truck, and what was measured, each by how well it is known; with its standard deviation,
    kg. measured: of a mass known exactly; None where nothing is known of the load's deviation."""
    own_kg, std_dev_kg = own.mass_kg, own.std_dev_kg
    ln, sd = (log(own_kg / known_kg), ticket_doubt.UNWEIGHED_SD) if measured is None else (measured.ln, measured.std_dev)
    best_kg = own_kg * exp(-ln / (1.0 + (sd * own_kg / std_dev_kg) ** 2))
    return best_kg, best_kg / hypot(own_kg / std_dev_kg, 1.0 / sd)


def _other_crop(order: Order, covered: Sequence[Load]) -> str:
    """The crop of loads that are all of one, where its parameters are others than those in use; else ""."""
    monitor, journal = order.monitor, order.journal
    in_use = journal.crop_in_use(monitor.estimator.parameters)
    crops_of = {journal.parameters.crop_of_load(load) for load in covered}
    crop = crops_of.pop() if len(crops_of) == 1 else ""
    # A curve is one grain's: another crop does not change it.
    one_curve = monitor.estimator.parameters.curve is not None
    return "" if one_curve or not in_use or crop.lower() == in_use.lower() else shipped_name(crop) or crop


def _departure(shares: Sequence[Weighing], order: Order, crop: str) -> ticket_doubt.Departure | None:
    """Of a ticket with these shares of loads; None where there is no number. crop: of the loads, where another one is harvested
    now."""
    monitor, journal = order.monitor, order.journal
    known = journal.parameters.of(crop, monitor.estimator.parameters, journal.crop) if crop else None
    if crop and known is None:
        return None
    of_crop = None if known is None else estimator_of(monitor.machine, known)
    found = [(mass_kg, monitor.ticket_departure(number, mass_kg, sd_kg, of_crop=of_crop)) for number, mass_kg, sd_kg, _ in shares]
    parts = [(mass_kg, part) for mass_kg, part in found if part is not None]
    if not parts or len(parts) != len(shares):
        return None
    if known is not None:
        waiting = _waiting_tickets(order, crop, [share.load_number for share in shares])
        scale = _ln_of_waiting(waiting, order, of_crop)
        if known.is_weighed or scale is None:
            return ticket_doubt.combined(parts, weighed_before=known.is_weighed)
        sds = [hypot(_WEIGHED_SD, share.std_dev_kg / share.mass_kg) for share in shares]
        apart = [(mass_kg, (ln - scale, min(sd, most))) for (mass_kg, (ln, sd)), most in zip(parts, sds, strict=True)]
        return ticket_doubt.combined(apart, weighed_before=True, only_one=len(waiting) == 1)
    return ticket_doubt.combined(
        parts,
        weighed_before=bool(_counted_loads(order)) or order.monitor.scale_counted,
        only_one=bool(_only_tickets(order, [share.load_number for share in shares])),
    )


def _waiting_tickets(order: Order, crop: str, covered: Sequence[int]) -> list[int]:
    """Standing tickets that wait for another crop, for other loads than these."""
    standing = order.journal.actions.history.ledger.tickets
    waiting = [n for n in order.journal.actions.updates.of_crop.get(crop, ()) if n in standing]
    return [n for n in waiting if not set(standing[n].loads) & set(covered)]


def _ln_of_waiting(numbers: Sequence[int], order: Order, of_crop: FlowEstimator | None) -> float | None:
    """Mean of ln by which the loads of tickets that wait are off by their crop's parameters; None where there is none."""
    history, found = order.journal.actions.history, list[float]()
    tickets = history.ledger.tickets
    for number in numbers:
        ticket = tickets[number]
        loads = order.journal.loads.among(ticket.loads)
        for load, mass_kg, sd_kg, _ in history.reference_mass(number).shared_out(loads, ticket.measured_mass_kg):
            # Of a load that an earlier run measured nothing may be known now.
            with suppress(ValueError):
                part = order.monitor.ticket_departure(load, mass_kg, sd_kg, of_crop=of_crop)
                found += [] if part is None else [part[0]]
    return fmean(found) if found else None


def _counted_loads(order: Order) -> frozenset[int]:
    """Loads of the crop that is harvested now whose tickets have counted."""
    monitor, journal = order.monitor, order.journal
    in_use = journal.crop_in_use(monitor.estimator.parameters).lower()
    crop_of = {load.number: journal.parameters.crop_of_load(load).lower() for load in journal.loads}
    return frozenset(load for load in monitor.counted_loads if crop_of.get(load, "") in ("", in_use) or not in_use)


def _only_tickets(order: Order, covered: Sequence[int]) -> list[int]:
    """Standing tickets for all the loads whose tickets have counted, where these loads are others: a single weighing has set the
    scale."""
    counted = _counted_loads(order)
    if counted & set(covered) or order.monitor.scale_counted:
        return []
    standing = order.journal.actions.history.ledger.tickets.items()
    return [n for n, t in standing if counted and counted <= set(t.loads)]


def _question(ticket: Ticket, departs: ticket_doubt.Departure | None, order: Order, covered: Sequence[Load], crop: str) -> str:
    """See ticket_doubt. crop: as `_departure` has it."""
    if departs is None:
        return ""
    known = order.journal.actions.history.ledger
    known_kg = {load.number: load.mass_kg * known.factors.get(load.number, 1.0) for load in order.journal.loads}
    weighed = {n for number, t in known.tickets.items() if number not in known.replaced for n in t.loads}
    same = {n: t for n, t in known.tickets.items() if (t.first_load, t.last_load) == (ticket.first_load, ticket.last_load)}
    before_kg = {max(same): same[max(same)].weighed_mass_kg} if same else {}
    asked = ticket_doubt.question(ticket.weighed_mass_kg, departs, covered, known_kg, weighed, before_kg)
    numbers = [load.number for load in covered]
    waiting = _waiting_tickets(order, crop, numbers) if crop and departs.second else []
    alone = waiting if crop else _only_tickets(order, numbers)
    # A scale that one ticket alone has set is no better than that ticket.
    if not (asked and alone):
        return asked
    return f"{asked}; or ticket {alone[-1]}, the only one before it, is wrong (`yieldmon ticket undo {alone[-1]}`)"
