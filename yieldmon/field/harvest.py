"""From a table of points to a map: delays, places, ground, reasons, loads, totals. Pure: no file is read or written here."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from yieldmon.estimation.gaussian import REACH_95
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.units import KG_PER_LB, M2_PER_ACRE, S_PER_DAY, Units, UnitSystem

from .cleaning import Cleaned, clean, mass_by_reason, much_left_out
from .cleaning_rules import Context
from .delay import Decision, Delay
from .header_place import HeaderPlace, at_header
from .loads import LoadResult, correct
from .machines import Machine, machines_of, placed_by_machine
from .pairs import Pairs, opposing_pairs
from .placed import Placed, measured_mass_kg
from .swath import Swaths, swaths
from .table import Array, HarvestTable
from .tracks import Tracks, cut_before_measured, tracks
from .transport import Transport, assess, filtered
from .units import crop

KG_M2_TO_T_HA = 10.0
SEED = 1
DRAWS = 400
_SAME_DELAY_S = 0.5
_LEAST_KG_M2, _MOST_GRAIN_KG_M2, _MOST_KG_M2 = 0.005, 4.0, 20.0
"""Mean yields beyond which units are wrong: of grain 40 t/ha is a record, of cane and beets 200."""
_LEAST_UNMEASURED = 0.005
"""Share of the ground without a flow from which it is said."""
_SLOWEST_M_S, _FASTEST_M_S, _LEAST_TO_TELL = 0.1, 12.0, 10
"""Speeds of a harvest in the median, and rows with grain that tell."""
_SEASONS_APART_DAYS, _SAME_GROUND = 60, 0.1
"""Days without a row between seasons, and share of rows on ground that was cut before, from which seasons are named."""


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
class Totals:
    """Masses in kg, areas in m2.

    Parameters
    ----------
    machine_kg : float or None
        Of all sources, where each has its own.
    measured_kg : float
        Flow times interval over all rows, as measured.
    corrected_kg : float
        The same by the weighed loads.
    low_kg, high_kg : float or None
        Its 95 % interval; None where no load is weighed.
    by_reason : dict
        `kept` and each reason -> kg (corrected), together corrected_kg.
    area_m2 : float
        Ground newly cut.
    kept_area_m2 : float
        Of the points kept.
    yield_kg_m2, low_kg_m2, high_kg_m2 : float
        Kept mass over kept area, and its 95 % interval from passes drawn again.
    """

    machine_kg: float | None
    measured_kg: float
    corrected_kg: float
    low_kg: float | None
    high_kg: float | None
    by_reason: dict[str, float]
    area_m2: float
    kept_area_m2: float
    yield_kg_m2: float
    low_kg_m2: float
    high_kg_m2: float


@dataclass(frozen=True)
class HarvestMap:
    """All of it, row by row of `table`."""

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
    name = _crop_name(table)
    facts = crop(name)
    totals = _totals(
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
        crop=name,
        bushel_kg=None if facts is None else facts.bushel_lb * KG_PER_LB,
        transport=transport,
        notes=(
            *by_weight.notes,
            *_notes(table, machines, options.transport and transport is None),
            *_unmeasured(table, steps),
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


def _notes(table: HarvestTable, machines: Sequence[Machine], transport_left: bool) -> tuple[str, ...]:
    out = [
        f"{machine.name + ': ' if machine.name else ''}the flow delay cannot be estimated from these data ({machine.flow.why}); "
        f"{machine.flow.value_s:g} s is used"
        for machine in machines
        if machine.flow.decision is Decision.CANNOT_TELL
    ]
    if transport_left and len(machines) > 1:
        out.append("the transport is not looked at: the machines' delays differ or are not known")
    crops = crops_of(table)
    if len(crops) > 1:
        out.append(f"the harvest has {len(crops)} crops ({', '.join(crops)}): yield and total are of all together")
    return tuple(out)


def _unmeasured(table: HarvestTable, steps: Tracks) -> list[str]:
    """A note on grain that was cut and has no flow."""
    cutting = steps.down[steps.step_of_row] & (table["distance_m"] > 0) & ~(table["header_down"] == 0)
    lacking = cutting & np.isnan(table["flow_kg_s"])
    way = np.nan_to_num(table["distance_m"] * table["width_m"])
    share = float(way[lacking].sum() / way[cutting].sum()) if lacking.any() else 0.0
    if share < _LEAST_UNMEASURED:
        return []
    said = f"{int(lacking.sum())} rows of passes, {100.0 * share:.2g} % of the ground, have no flow"
    return [f"{said}: their grain is not in the mass"]


def doubts(table: HarvestTable, totals: Totals, cleaned: Cleaned) -> tuple[str, ...]:
    """Notes on a harvest that cannot be as it is read: a yield that no crop has, seasons on the same ground.

    Parameters
    ----------
    table : HarvestTable
    totals : Totals
        Of its map.
    cleaned : Cleaned
        Why its rows are left out.
    """
    out = []
    mean = totals.measured_kg / totals.area_m2 if totals.area_m2 > 0 else 0.0
    grain = all(crop(name) is not None for name in crops_of(table)) and bool(crops_of(table))
    if totals.measured_kg > 0 and not _LEAST_KG_M2 < mean < (_MOST_GRAIN_KG_M2 if grain else _MOST_KG_M2):
        out.append(
            f"a yield of {mean * KG_M2_TO_T_HA:.3g} t/ha is no crop's: expected other units of yield, flow or width (--column)"
        )
    out += _speed_doubts(table)
    days = np.unique(np.floor(table["time_s"][np.isfinite(table["time_s"])] / S_PER_DAY)) if table.unix_time else np.zeros(0)
    pauses = int((np.diff(days) > _SEASONS_APART_DAYS).sum())
    twice = [cleaned.names.index(reason) for reason in ("overlap", "duplicate")]
    if pauses and np.isin(cleaned.reason, twice).sum() >= _SAME_GROUND * len(table):
        first, last = (str(np.datetime64(int(day), "D")) for day in (days[0], days[-1]))
        out.append(
            f"the harvest has {pauses + 1} seasons from {first} to {last} on the same ground, which counts as cut in the first: "
            "expected a map for each"
        )
    return tuple(out)


def _speed_doubts(table: HarvestTable) -> list[str]:
    """A note on a harvest at a speed at which none is."""
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = (table["distance_m"] / table["interval_s"])[(table["flow_kg_s"] > 0) & (table["interval_s"] > 0)]
    speed = speed[np.isfinite(speed)]
    usual = float(np.median(speed)) if speed.size >= _LEAST_TO_TELL else 1.0
    if _SLOWEST_M_S <= usual <= _FASTEST_M_S:
        return []
    return [f"a harvest at {usual:.2g} m/s is none: expected other units of time, place, distance or speed (--column)"]


def crops_of(table: HarvestTable) -> tuple[str, ...]:
    """Names of the crops that rows have, one spelling of each."""
    label = table.labels["crop"]
    there = np.bincount(label.codes, minlength=len(label.names))
    names: dict[str, str] = {}
    for name, number in zip(label.names, there.tolist(), strict=False):
        facts = crop(name)
        if number and name:
            names.setdefault(name.lower() if facts is None else facts.name, name)
    return tuple(names.values())


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


def _crop_name(table: HarvestTable) -> str:
    label = table.labels["crop"]
    if not len(table):
        return ""
    return label.names[int(np.argmax(np.bincount(label.codes, minlength=len(label.names))))]


def _totals(
    table: HarvestTable,
    steps: Tracks,
    placed: Placed,
    ground: Swaths,
    cleaned: Cleaned,
    *,
    loads: Sequence[LoadResult],
    weighed: bool,
    generator: np.random.Generator,
) -> Totals:
    machine = [source.mass_kg for source in table.sources]
    kept = cleaned.kept
    mass = np.nan_to_num(placed.mass_kg)
    kept_kg, kept_m2 = float(mass[kept].sum()), float(ground.area_m2[kept].sum())
    measured = float(measured_mass_kg(table).sum())
    corrected = float(placed.measured_kg.sum())
    low, high = _yield_interval(steps.pass_number[steps.step_of_row][kept], mass[kept], ground.area_m2[kept], generator)
    sd = _mass_sd(loads) if weighed else None
    return Totals(
        machine_kg=None if None in machine else float(sum(one for one in machine if one is not None)),
        measured_kg=measured,
        corrected_kg=corrected,
        low_kg=None if sd is None else corrected - REACH_95 * sd,
        high_kg=None if sd is None else corrected + REACH_95 * sd,
        by_reason=dict(mass_by_reason(cleaned, placed)),
        area_m2=float(ground.area_m2.sum()),
        kept_area_m2=kept_m2,
        yield_kg_m2=kept_kg / kept_m2 if kept_m2 > 0 else float("nan"),
        low_kg_m2=low,
        high_kg_m2=high,
    )


def _mass_sd(loads: Sequence[LoadResult]) -> float:
    weighed = [one for one in loads if one.weighed_kg is not None]
    own = [one.measured_kg * max((one.factor_sd or 0.0) ** 2 - one.common_sd**2, 0.0) ** 0.5 for one in weighed]
    # So do those that another combine's monitor brings.
    common = sum(one.measured_kg * one.common_sd for one in weighed)
    # The factor of loads that were not weighed is one and the same, so their errors go together.
    others = sum(one.measured_kg * (one.factor_sd or 0.0) for one in loads if one.weighed_kg is None)
    return float(np.sqrt(sum(value**2 for value in own) + common**2 + others**2))


def _yield_interval(passes: Array, mass: Array, area: Array, generator: np.random.Generator) -> tuple[float, float]:
    if not len(passes):
        return float("nan"), float("nan")
    _, inverse = np.unique(passes, return_inverse=True)
    by_pass = np.stack((np.bincount(inverse, mass), np.bincount(inverse, area)))
    count = by_pass.shape[1]
    if count < 2:
        return float("nan"), float("nan")
    drawn = by_pass @ generator.multinomial(count, np.full(count, 1.0 / count), size=DRAWS).T
    with np.errstate(invalid="ignore", divide="ignore"):
        low, high = np.nanpercentile(drawn[0] / drawn[1], [2.5, 97.5])
    return float(low), float(high)
