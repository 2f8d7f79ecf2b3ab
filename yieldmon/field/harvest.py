"""From a table of points to a map: delays, places, ground, reasons, loads, totals. Pure: no file is read or written here."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.units import M2_PER_ACRE, Units, UnitSystem

from .cleaning import Cleaned, clean, much_left_out
from .cleaning_rules import Context
from .delay import Decision, Delay
from .harvest_notes import delays_and_crops, doubts, unmeasured
from .header_flicker import bridged_header, flicker_note, flickers
from .header_place import HeaderPlace, at_header
from .loads import LoadResult, correct
from .machines import Machine, machines_of, placed_by_machine
from .pairs import Pairs, opposing_pairs
from .placed import Placed, measured_mass_kg
from .row_crops import common_bushel_kg, row_bushels_kg, row_crops
from .swath import Swaths, swaths
from .table import Array, Flags, HarvestTable, Label
from .totals import Totals, totals_of
from .tracks import Tracks, cut_before_measured, tracks
from .transport import Transport, assess, filtered

SEED = 1
_SAME_DELAY_S = 0.5


@dataclass(frozen=True)
class MapOptions:
    """What a person says about a map.

    Parameters
    ----------
    flow_delay_s, moisture_delay_s : float or None
        Given instead of estimated.
    header : HeaderPlace
        Offset of the header from the antenna, in place of what the sources have.
    without : collection of str
        Cleaning rules that are off.
    tickets : sequence of WeighedTicket
        Weighed loads.
    transport : bool
        Try to undo the machine's smear; it is done only where it beats its control.
    seed : int
        Of the draws for intervals.
    """

    flow_delay_s: float | None = None
    moisture_delay_s: float | None = None
    header: HeaderPlace = field(default_factory=HeaderPlace)
    without: Collection[str] = ()
    tickets: Sequence[WeighedTicket] = ()
    transport: bool = False
    seed: int = SEED


@dataclass(frozen=True)
class HarvestMap:
    """All of it, row by row of `table`. crop: of all grain, "" for several or an unknown one. bushel_kg: the same, None
    where crops differ in it."""

    table: HarvestTable
    steps: Tracks
    pairs: Pairs
    machines: tuple[Machine, ...]
    placed: Placed
    ground: Swaths
    cleaned: Cleaned
    loads: tuple[LoadResult, ...]
    totals: Totals
    yield_kg_m2: Array
    raw_yield_kg_m2: Array
    crops: Label
    crop: str
    bushel_kg: float | None
    transport: Transport | None
    notes: tuple[str, ...] = field(default=())
    system: UnitSystem = UnitSystem.METRIC

    @property
    def flow_delay(self) -> Delay:
        """Of the machine that measured most."""
        return self.machines[0].flow

    @property
    def moisture_delay(self) -> Delay:
        """Of the machine that measured most."""
        return self.machines[0].moisture

    @property
    def units(self) -> Units:
        """What people read."""
        return Units(self.system, self.bushel_kg)

    def bushels_per_acre(self, yield_kg_m2: float) -> float | None:
        """None where the crop's bushel is not known."""
        return None if self.bushel_kg is None else yield_kg_m2 * M2_PER_ACRE / self.bushel_kg


def _silent(_: str) -> None:
    return None


def make_map(table: HarvestTable, options: MapOptions, progress: Callable[[str], None] = _silent) -> HarvestMap:
    """The map of a table.

    Parameters
    ----------
    table : HarvestTable
        One or several harvests.
    options : MapOptions
        What a person says.
    progress : callable
        Called with each step.

    Raises
    ------
    InputError
        For tickets that do not fit.
    """
    progress("passes")
    table = at_header(table, options.header)
    steps = tracks(table)
    flicker = flickers(table, steps)
    if flicker.any():
        table = bridged_header(table, flicker)
        steps = tracks(table)
    pairs = opposing_pairs(steps)
    progress("delay")
    machines = _machines(table, steps, pairs, options)
    transport = None
    if options.transport and len(pairs) and _one_delay(machines):
        progress("transport")
        transport = assess(steps, pairs, machines[0].flow.value_s, np.random.default_rng([options.seed, 2]))
        if transport.better:
            table = inverted(table, steps, transport)
            steps = tracks(table)
            machines = _machines(table, steps, pairs, options)
    steps = cut_before_measured(steps, table, {machine.stream: machine.flow.value_s for machine in machines})
    by_weight = correct(table, options.tickets)
    loads = by_weight.loads
    progress("ground")
    weighed = any(load.factor_sd is not None for load in loads)
    placed = placed_by_machine(table, steps, machines, by_weight.factor if weighed else None)
    ground = swaths(table, steps)
    progress("cleaning")
    at = Context(table, steps, placed, ground)
    cleaned = clean(at, options.without)
    with np.errstate(invalid="ignore", divide="ignore"):
        raw = np.where(ground.gross_m2 > 0, measured_mass_kg(table) / ground.gross_m2, np.nan)
    crops = row_crops(table)
    totals = totals_of(
        table, steps, placed, ground, cleaned,
        loads=loads, weighed=weighed, generator=np.random.default_rng(options.seed),
    )  # fmt: skip
    return HarvestMap(
        table=table,
        steps=steps,
        pairs=pairs,
        machines=machines,
        placed=placed,
        ground=ground,
        cleaned=cleaned,
        loads=loads,
        totals=totals,
        yield_kg_m2=at.yield_kg_m2,
        raw_yield_kg_m2=raw,
        crops=crops,
        crop=_only(crops, table["flow_kg_s"] > 0.0),
        bushel_kg=common_bushel_kg(row_bushels_kg(crops)[table["flow_kg_s"] > 0.0]),
        transport=transport,
        notes=(
            *((flicker_note(flicker),) if flicker.any() else ()),
            *by_weight.notes,
            *delays_and_crops(table, machines, transport_left=options.transport and transport is None),
            *unmeasured(table, steps),
            *doubts(table, totals, cleaned),
            *much_left_out(cleaned, totals.by_reason),
        ),
    )


def _machines(table: HarvestTable, steps: Tracks, pairs: Pairs, options: MapOptions) -> tuple[Machine, ...]:
    return machines_of(table, steps, pairs, options.flow_delay_s, options.moisture_delay_s, options.seed)


def _one_delay(machines: Sequence[Machine]) -> bool:
    """Whether one delay is known, of all machines."""
    values = [machine.flow.value_s for machine in machines]
    return all(machine.flow.decision is not Decision.CANNOT_TELL for machine in machines) and np.ptp(values) < _SAME_DELAY_S


def inverted(table: HarvestTable, steps: Tracks, transport: Transport) -> HarvestTable:
    """The table with the smear taken back: each row's flow changes as its step's does, the mass of each run stays."""
    flow = filtered(steps, transport.chosen)
    row_flow = table["flow_kg_s"]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(steps.flow_kg_s > 0, flow / steps.flow_kg_s, np.nan)[steps.step_of_row]
    alone = np.bincount(steps.step_of_row, minlength=len(steps))[steps.step_of_row] == 1
    # A step of several sections that measured nothing has no shares to go by, and stays.
    return table.with_columns(
        flow_kg_s=np.where(alone, flow[steps.step_of_row], np.where(np.isfinite(share), row_flow * share, row_flow))
    )


def _only(crops: Label, grain: Flags) -> str:
    """The crop of all rows with grain, without any of all rows; "" for several."""
    codes = np.unique(crops.codes[grain] if grain.any() else crops.codes)
    return crops.names[int(codes[0])] if len(codes) == 1 else ""
