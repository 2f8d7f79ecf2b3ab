"""A ticket or a calibration is taken back: the parameters from before it, updated again from there by the tickets that stand."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from yieldmon.documents.undo import CalibrationUndone, NotUpdated, TicketUndone
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.self_calibration.reference_mass import Weighing
from yieldmon.errors import InputError
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.service.assembly import calibration_age_s
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.reference_tickets import why_no_reference
from yieldmon.service.history.request_context import RequestContext
from yieldmon.service.storage.batch import Ticket
from yieldmon.service.tickets.ticket_history import TicketHistory

_NOT_WEIGHED = frozenset({ParameterOrigin.SWEEP, ParameterOrigin.KERNELS})
"""Origins of parameters that nothing updates again."""


@dataclass(frozen=True, slots=True)
class Restored:
    """Parameters from before versions that an undo took back.

    Parameters
    ----------
    undone, until : int
        The first and the last version that was taken back.
    version : int
        Of the restored parameters.
    effects : tuple of str
        Of the restored parameters.
    crop : str
        Whose parameters they are; "" for the crop harvested now.
    """

    undone: int
    until: int
    version: int
    effects: tuple[str, ...]
    crop: str


@dataclass(frozen=True, slots=True)
class Updating:
    """Numbers of the tickets that update the parameters again, and why others do not."""

    again: tuple[int, ...]
    why_not: Mapping[int, str]

    @property
    def not_again(self) -> list[NotUpdated]:
        """The others, by number."""
        return [{"ticket": number, "why": why} for number, why in sorted(self.why_not.items())]


def without_ticket(number: int, context: RequestContext) -> TicketUndone:
    """Take a ticket back, as far as possible as if it had never been entered.

    If it has updated the parameters, those from before it come back and the standing tickets after it update them again; what
    sweeps and kernel noise changed since then is lost. If a parameter file has replaced the parameters since, the file stays, and
    masses measured again after the ticket go back to what they were before. A ticket that it replaced stands again and updates.

    Returns
    -------
    TicketUndone
        What was taken back and what was not.

    Raises
    ------
    InputError
        For a ticket that does not stand.
    """
    return _without(number, context, stands=())


def without_version(version: int, context: RequestContext) -> CalibrationUndone:
    """Take a calibration back, as if it had never come: the standing tickets that updated after it do so again.

    The tickets that led to it (`silenced`) from now on only correct their loads. What sweeps and kernel noise changed since then
    is lost.

    Raises
    ------
    InputError
        For a version that cannot be taken back.
    """
    journal, actions = context.journal, context.journal.actions
    before = actions.history
    silenced = before.first_led_to(version)
    since = min(silenced, default=before.last_ticket_before(version))
    loads = [load for n in silenced for load in before.entered(n).loads]
    back = _back_before(version, context, silenced)
    actions.wait_no_more(silenced)
    after = actions.history
    undone = after.undone_versions - before.undone_versions
    of_crop = back.crop or journal.crop_in_use(context.monitor.estimator.parameters)

    def counts(ticket: int) -> bool:
        return not of_crop or _crop_of(journal, ticket) in (of_crop, "")

    later = filter(counts, after.without_update_after(since))
    numbers, stay = _updating({*after.standing_of(undone), *later}, loads, counts, after)
    updating = _update_again(numbers, loads, back.crop, context, goes_back=True, stay=stay)
    return {
        "undone": back.undone,
        "until": back.until,
        "version": back.version,
        "effects": list(back.effects),
        "crop": back.crop,
        "silenced": list(silenced),
        "updated_again": list(updating.again),
        "standing_tickets": sorted(updating.why_not),
        "not_updated_again": updating.not_again,
        "sweeps_undone": _not_weighed(undone - {version}, after),
    }


def without_updates(numbers: Sequence[int], context: RequestContext) -> list[TicketUndone]:
    """Take back the updates of tickets that stand, for loads of another crop than the one they have updated."""
    return [_without(number, context, stands=numbers) for number in numbers]


def without_replaced(numbers: Sequence[int], context: RequestContext) -> list[TicketUndone]:
    """Take back the updates of tickets that stand, which a newer one is about to replace."""
    return [_without(number, context, stands=numbers, replaced=number) for number in numbers]


def _without(number: int, context: RequestContext, *, stands: Sequence[int], replaced: int = 0) -> TicketUndone:
    """stands: tickets that are not taken back but no longer update the parameters. replaced: see `ParameterHistory.undo`."""
    journal, actions = context.journal, context.journal.actions
    removal = _removal(number, context, stands)
    answer: TicketUndone = {"ticket": number, "first_load": removal.ticket.first_load, "last_load": removal.ticket.last_load}
    _withdraw(removal, context, replaced)
    undone_before, back = actions.history.undone_versions, None
    if removal.first_update is not None:
        try:
            back = _back_before(removal.first_update, context, replaced=replaced)
        except InputError as error:
            # Its correction of the mass is taken back nevertheless.
            answer["update_kept_because"] = str(error)
    if number in stands:
        actions.wait_no_more([number])
    else:
        actions.undo_ticket(number, context.who, context.now_s)
        for older in removal.of_file_before:
            actions.remeasure_again(older)
    after = actions.history
    undone = after.undone_versions - undone_before
    # Those that it replaced update again, each before the tickets after it.
    later = filter(removal.counts, after.without_update_after(min((number, *removal.again))))
    led = {*after.standing_of(undone)}.difference(stands)
    numbers, stay = _updating({*led, *later}, removal.ticket.loads, removal.counts, after)
    other = _if_other(removal.crop, context.monitor, journal) if back is None else back.crop
    updating = _update_again(numbers, removal.ticket.loads, other, context, goes_back=back is not None, stay=stay)
    for ticket_of_other in removal.again_of_others:
        update_crop([ticket_of_other], _crop_of(journal, ticket_of_other), context)
    if back is not None or updating.again:
        answer["updated_again"] = list(updating.again)
    if back is not None or updating.why_not:
        answer["not_updated_again"] = updating.not_again
    if back is not None:
        answer |= {
            "undone": back.undone,
            "until": back.until,
            "version": back.version,
            "effects": list(back.effects),
            "crop": back.crop,
            "standing_tickets": sorted(updating.why_not),
            "sweeps_undone": _not_weighed(undone, after),
        }
    return answer


@dataclass(frozen=True, slots=True)
class _Removal:
    """What goes with a ticket that is taken back.

    Parameters
    ----------
    number : int
    ticket : Ticket
    crop : str
        Of the ticket's first load.
    again, again_of_others : tuple of int
        Tickets that it replaced and that stand again, of its crop and of others.
    of_file_before : tuple of int
        Tickets that it replaced before a parameter file came.
    first_update : int or None
        First version that goes with it; None where it has updated nothing.
    counts : callable
        Whether a ticket updates the same parameters, by its number.
    """

    number: int
    ticket: Ticket
    crop: str
    again: tuple[int, ...]
    again_of_others: tuple[int, ...]
    of_file_before: tuple[int, ...]
    first_update: int | None
    counts: Callable[[int], bool]


def _removal(number: int, context: RequestContext, stands: Sequence[int]) -> _Removal:
    """What goes with a ticket, before anything is changed. stands: as of `_without`. Raises InputError where it does not
    stand."""
    journal, history = context.journal, context.journal.actions.history
    ticket = history.standing_ticket(number)
    again, of_file_before = ((), ()) if number in stands else history.stand_again_without(number)
    # One for loads of two crops has updated none itself.
    crop = _crop_of(journal, again[0] if again else number)
    of_others = tuple(n for n in again if _crop_of(journal, n) != crop)
    again = tuple(n for n in again if n not in of_others)

    def counts(other: int) -> bool:
        return _crop_of(journal, other) == crop and other not in stands

    has_counted = any(load in context.monitor.counted_loads for load in ticket.loads)
    updates = [history.first_update(number, counts if has_counted else None), *(history.first_update(n, counts) for n in again)]
    first = min((version for version in updates if version is not None), default=None)
    return _Removal(number, ticket, crop, again, of_others, of_file_before, first, counts)


def _withdraw(removal: _Removal, context: RequestContext, replaced: int) -> None:
    """Withdraw the updates that a parameter file has replaced since. replaced: see `ParameterHistory.undo`."""
    history, parameters = context.journal.actions.history, context.journal.parameters
    gone = [history.update_before_file(removal.number), *(history.update_without_replaced(n) for n in removal.of_file_before)]
    versions = [version for version in gone if version]
    if versions:
        parameters.withdraw(min(versions), context.who, context.now_s, replaced)


def _not_weighed(versions: Iterable[int], history: TicketHistory) -> int:
    """How many of these versions nothing updates again."""
    return sum(history.updates[version].document.get("origin") in _NOT_WEIGHED for version in versions)


def _updating(
    judged: Collection[int], gone: Iterable[int], counts: Callable[[int], bool], history: TicketHistory
) -> tuple[list[int], list[int]]:
    """Which tickets are to update the parameters again.

    Parameters
    ----------
    judged : collection of int
        Tickets whose update was lost.
    gone : iterable of int
        Loads whose tickets go.
    counts : callable
        Whether a ticket counts, by its number.
    history : TicketHistory

    Returns
    -------
    list of int
        Those to update again: `judged`, and those that count for the same loads or for `gone`.
    list of int
        Of the latter, those on which the parameters rest.
    """
    ticketed = (history.entered(number) for number in judged)
    loads = {*gone, *(load for ticket in ticketed for load in ticket.loads)}
    same, effective = [number for number in history.references_for(loads) if counts(number)], history.in_effect()
    again = sorted({*judged, *same}.difference(effective))
    return again, [number for number in same if number in effective]


def update_crop(numbers: Sequence[int], crop: str, context: RequestContext) -> Updating:
    """Tickets update the crop that their loads are of."""
    return _update_again(numbers, (), _if_other(crop, context.monitor, context.journal), context, goes_back=False)


def _if_other(crop: str, monitor: Monitor, journal: Journal) -> str:
    """A crop, where another one is harvested now, else ""."""
    now = journal.crop_in_use(monitor.estimator.parameters)
    return crop if crop and now and crop.lower() != now.lower() else ""


def _crop_of(journal: Journal, number: int) -> str:
    """Of a ticket's first load."""
    first = journal.actions.history.entered(number).first_load
    return next((journal.parameters.crop_of_load(load) for load in journal.loads if load.number == first), "")


def _back_before(version: int, context: RequestContext, silenced: Sequence[int] = (), replaced: int = 0) -> Restored:
    """The parameters before a version again, as a new version; for another crop than the present one, once it is harvested.

    silenced, replaced: see `ParameterHistory.undo`. Raises InputError.
    """
    monitor, journal, now_s = context.monitor, context.journal, context.now_s
    in_use = monitor.estimator.parameters
    if in_use.curve is not None:
        raise InputError(
            f"version {version}", "the flow comes from estimator_file, which nothing updates", "another estimator_file"
        )
    chosen, crop = journal.parameters.undo(
        version, in_use, named=journal.crop, who=context.who, now_s=now_s, silenced=silenced, replaced=replaced
    )
    monitor.set_estimator(estimator_of(monitor.machine, chosen), calibration_age_s(chosen, now_s))
    return Restored(version, in_use.version, chosen.version, chosen.effects, crop)


def _update_again(
    numbers: Sequence[int],
    gone: Sequence[int],
    crop: str,
    context: RequestContext,
    *,
    goes_back: bool,
    stay: Sequence[int] = (),
) -> Updating:
    """Let tickets update the parameters again, as far as they can. gone: loads whose tickets go. crop: as `Monitor.update_again`
    has it. goes_back: the parameters are those from before a ticket. stay: tickets for the same loads on which these rest."""
    monitor, journal = context.monitor, context.journal
    history = journal.actions.history
    tickets = history.ledger.tickets
    updated: list[int] = []
    again: list[Weighing] = []
    stays: list[Weighing] = []
    why_not: dict[int, str] = {}
    for number in sorted((*numbers, *stay)):
        ticket = tickets[number]
        covered = journal.loads.among(ticket.loads)
        why = why_no_reference(covered, context, crop)
        shares = () if why else history.reference_mass(number).shared_out(covered, ticket.measured_mass_kg)
        if number in stay:
            stays += shares
        elif why:
            why_not[number] = why
        else:
            updated.append(number)
            again += shares
    effective = [load for n in history.in_effect() if n not in updated for load in tickets[n].loads]
    journal.happened(monitor.update_again(gone, again, rests_on=effective if goes_back or stays else None, crop=crop, stay=stays))
    journal.actions.wait_again(updated, crop)
    journal.actions.measure_lost_again()
    return Updating(tuple(updated), why_not)
