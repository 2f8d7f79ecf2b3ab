"""Another field or crop for loads that were begun under a wrong one.

What was measured stays on record. Of another crop follow dry mass, the mass by that crop's parameters (column `again`), and where
the loads' tickets belong: their update of the wrong crop is taken back, and they update their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan

from yieldmon.documents.undo import TicketUndone
from yieldmon.engine.mass.totals import dry_mass
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.settings import TotalsSettings
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.crops import find_crop
from yieldmon.service.history import undo
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.load_factor import load_factor
from yieldmon.service.history.parameter_spread import parameter_spread, states_its_scale
from yieldmon.service.history.reference_loads import StoredLoad
from yieldmon.service.history.request_context import RequestContext
from yieldmon.service.logs.measured_loads import MeasuredLoad
from yieldmon.service.storage import ledger
from yieldmon.service.storage.batch import Load, Ticket
from yieldmon.service.storage.load_spread import ParameterSpread


@dataclass(frozen=True)
class Correction:
    """field, crop: None where it stays."""

    loads: Sequence[Load]
    field: str | None
    crop: str | None


@dataclass(frozen=True)
class CropCorrected:
    """What another crop brought. measured_again: loads, by its parameters; not_measured_again: why others were not, by load.
    updating: tickets that update its parameters; taken_back: their updates of the crop before."""

    measured_again: tuple[int, ...]
    not_measured_again: Mapping[int, str]
    updating: undo.Updating
    taken_back: Sequence[TicketUndone]


def correct(wanted: Correction, context: RequestContext) -> CropCorrected | None:
    """Give closed loads other names; None where no load gets another crop. Raises InputError."""
    monitor, journal, now_s = context.monitor, context.journal, context.now_s
    first, last = wanted.loads[0].number, wanted.loads[-1].number
    others = [load for load in wanted.loads if wanted.crop is not None and load.crop != wanted.crop]
    fields = [load for load in wanted.loads if wanted.field is not None and load.field != wanted.field]
    if not others and not fields:
        problem = " and ".join(repr(name) for name in (wanted.crop, wanted.field) if name is not None)
        raise InputError(
            f"load {first}" if first == last else f"loads {first} to {last}", f"has {problem} already", "another name"
        )
    tickets = _tickets_of(others, journal)
    before = [{"load": load.number, "field": load.field, "crop": load.crop} for load in wanted.loads]
    back = undo.without_updates(list(tickets), context)
    document = {"first_load": first, "last_load": last, "field": wanted.field, "crop": wanted.crop, "before": before}
    journal.actions.add(ledger.LOAD_NAMES, context.who, document, now_s)
    for load in wanted.loads:
        journal.loads.named(load.number, wanted.field, wanted.crop)
    if not others:
        return None
    crop = wanted.crop or ""
    parameters = journal.parameters.of(crop, monitor.estimator.parameters, journal.crop)
    by_number = {load.load.number: load for load in context.stored}
    factors, spreads, why_not = dict[int, float](), dict[int, ParameterSpread](), dict[int, str]()
    for load in others:
        if not load.mass_kg > 0.0:
            # Nothing was measured that could be measured again.
            continue
        kept = by_number.get(load.number)
        dry_kg = None if kept is None else _dry_kg(kept, crop, monitor.settings.totals)
        journal.loads.dried(load.number, dry_kg)
        found = _factor(kept, parameters, crop, monitor)
        if isinstance(found, str):
            why_not[load.number] = found
        else:
            factors[load.number], spread = found
            spreads |= {} if spread is None else {load.number: spread}
    if factors:
        # By no version that an undo takes back: the loads are of this crop whatever becomes of it.
        journal.actions.remeasured_by_crop(factors, now_s, spreads)
    updating = undo.Updating((), dict.fromkeys(tickets, f"nothing is known of {crop}"))
    if parameters is not None:
        updating = undo.update_crop(list(tickets), crop, context)
    return CropCorrected(tuple(sorted(factors)), why_not, updating, back)


def _factor(
    kept: StoredLoad | None, parameters: ParameterSet | None, crop: str, monitor: Monitor
) -> tuple[float, ParameterSpread | None] | str:
    """Mass by the crop's parameters over the mass as measured with what it may be off by, or why there is none."""
    if kept is None:
        return "its seconds are not on record"
    if parameters is None:
        return f"nothing is known of {crop}"
    measured = _measured(kept)
    found = load_factor(measured, parameters, monitor.machine)
    if found is None:
        return "too little of it rests on a known force"
    return found, parameter_spread(measured, parameters, monitor.machine) if states_its_scale(parameters) else None


def _tickets_of(loads: Sequence[Load], journal: Journal) -> dict[int, Ticket]:
    """The tickets that count for these loads. Raises InputError for one that is for further loads as well."""
    numbers, standing = {load.number for load in loads}, journal.actions.history.ledger
    replaced, found = standing.replaced, {}
    for number, ticket in standing.tickets.items():
        if number in replaced:
            continue
        covered = {load.number for load in journal.loads.among(ticket.loads)}
        if not covered & numbers:
            continue
        if not covered <= numbers:
            expected = f"all of {ticket.first_load}-{ticket.last_load}, or `yieldmon ticket undo {number}` first"
            raise InputError(f"load {min(covered & numbers)}", f"is on ticket {number} with other loads", expected)
        found[number] = ticket
    return found


def _measured(stored: StoredLoad) -> MeasuredLoad:
    rows = tuple(second for second in stored.seconds if second.mass_kg > 0.0)
    return MeasuredLoad(str(stored.load.number), "", rows, stored.parameters)


def _dry_kg(stored: StoredLoad, crop: str, settings: TotalsSettings) -> float | None:
    known = find_crop(crop)
    if known is None and settings.moisture_reference_pct is None:
        return None
    market_pct = nan if known is None else known.market_moisture_pct
    dried = [
        dry_mass(s.mass_kg, nan if s.moisture_pct is None else s.moisture_pct, settings, market_pct)
        for s in stored.seconds if s.mass_kg > 0.0
    ]  # fmt: skip
    return None if any(kg is None for kg in dried) else float(sum(kg for kg in dried if kg is not None))
