"""A daemon's store: its one-second records, also while the daemon writes it."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from yieldmon import file_kinds
from yieldmon.errors import InputError
from yieldmon.field.table import DEFAULT_FLOW_S, UNKNOWN_SCALE_SD, Array, HarvestTable, KnownLoad, Label, Source, build
from yieldmon.frames import EstimateQuality
from yieldmon.service.logs import recorded
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.load_ends import between_loads, load_of
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.service.tickets.ticket_history import TicketHistory

from .columns.crop_names import crop_names
from .columns.positions import plausible
from .options import ReadOptions
from .store_scales import load_scales

KIND = "yieldmon store"
ORDER = 20
_LEAST_DISTANCE_M = 0.5
"""Of a second whose area tells the width."""
_SECONDS_OF_ONE_HEADER = 61
"""Over which the width is the middle one: an area is noted when its grain comes, some seconds after the distance."""


def recognises(path: Path, head: bytes) -> bool:
    """An SQLite file that is no GeoPackage."""
    return path.is_file() and head.startswith(file_kinds.SQLITE) and path.suffix.lower() not in (".gpkg",)


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """All seconds with their loads. Raises InputError where it has none, or no width."""
    try:
        with recorded.opened(path) as store:
            rows = store.seconds()
            loads = {load.number: load for load in store.loads()}
            known = known_loads(store)
            scales = load_scales(rows, store.parameter_versions(), str(path))
    except (UnicodeError, sqlite3.Error) as error:
        raise InputError(str(path), f"is damaged: {error}", "a daemon's store") from error
    table = table_of(rows, loads, path, KIND, options)
    return replace(table, sources=tuple(replace(_with_loads(source, known), scales=scales) for source in table.sources))


def known_loads(store: Store) -> dict[str, KnownLoad]:
    """The loads that tickets of the store have corrected, or that were recomputed, by number."""
    history = TicketHistory(tuple(store.tickets()), tuple(store.actions()))
    known = {}
    for load in recorded.corrected_loads(store):
        if not load.mass_kg > 0.0 or (load.ticket_id is None and load.posted_mass_kg is None):
            continue
        weighed_kg, sd_kg, common_kg = None, UNKNOWN_SCALE_SD * load.corrected_mass_kg, 0.0
        if load.ticket_id is not None:
            weighed_kg = load.corrected_mass_kg
            whole = history.reference_mass(load.ticket_id)
            # How a ticket's mass divides among several loads is not weighed: their deviations add up to that of the whole.
            sd_kg, common_kg = (
                whole.std_dev_kg * (weighed_kg / whole.mass_kg) ** 0.5,
                whole.common_kg * weighed_kg / whole.mass_kg,
            )
        factor, sd, common_sd = (kg / load.mass_kg for kg in (load.corrected_mass_kg, sd_kg, common_kg))
        known[str(load.number)] = KnownLoad(factor, sd, weighed_kg, common_sd)
    return known


def _with_loads(source: Source, known: Mapping[str, KnownLoad]) -> Source:
    if not known:
        return source
    weighed = sum(load.weighed_kg is not None for load in known.values())
    note = f"{weighed} of its loads as weighed, {len(known) - weighed} as recomputed, as `yieldmon load list` has them"
    return replace(source, known_loads=known, notes=(*source.notes, note))


def table_of(rows: list[SecondRow], loads: Mapping[int, Load], path: Path, kind: str, options: ReadOptions) -> HarvestTable:
    """Recorded seconds as a harvest.

    Parameters
    ----------
    rows : list of SecondRow
        In order of time.
    loads : mapping of int to Load
        By number; those that are not there have no field and no crop.
    path : path
        Where they are from.
    kind : str
        What that is.
    options : ReadOptions

    Returns
    -------
    HarvestTable

    Raises
    ------
    InputError
        Where there are no seconds, none has a position or ground speed, or no width is given and the areas do not tell it.
    """
    if not rows:
        raise InputError(str(path), "has no seconds", f"a {kind} with records")
    count = len(rows)
    harvesting = np.array([row.quality != EstimateQuality.NOT_HARVESTING for row in rows])
    flow = _column(rows, "mass_flow_kg_s")
    duration = _column(rows, "duration_s")
    mass = _column(rows, "mass_kg")
    with np.errstate(invalid="ignore", divide="ignore"):
        # Of a second of too few samples neither frame nor table has a flow.
        flow = np.where((duration > 0) & ~(np.isnan(flow) & (mass > 0)), mass / duration, flow)
    speed = _column(rows, "ground_speed_m_s")
    for what, values in (
        ("position", _column(rows, "longitude_deg") + _column(rows, "latitude_deg")),
        ("ground speed", speed),
    ):
        if not np.isfinite(values).any():
            on_bus = "position (latitude, longitude) and ground speed on the bus while harvesting: `signals` of the configuration"
            raise InputError(str(path), f"no second has a {what}", on_bus)
    if options.width_m is None:
        width, of_width = _width_m(_column(rows, "area_m2"), speed * duration, path)
    else:
        width, of_width = np.full(count, options.width_m), ()
    columns, notes = plausible(
        {
            "time_s": _column(rows, "time_s"),
            "longitude_deg": _column(rows, "longitude_deg"),
            "latitude_deg": _column(rows, "latitude_deg"),
            "flow_kg_s": flow,
            "flow_sd_kg_s": _column(rows, "std_dev_kg_s"),
            "moisture_pct": _column(rows, "moisture_pct"),
            "interval_s": duration,
            "distance_m": speed * duration,
            "width_m": width,
            "heading_deg": _column(rows, "course_deg"),
        }
    )
    crops = [loads[row.load_number].crop if row.load_number in loads else "" for row in rows]
    crop_of_row, of_crop = crop_names(Label.of(crops), options.crop)
    between = between_loads(rows, loads.values())
    numbers = [load_of(row, between) for row in rows]
    # The machine may have gone on to another field before the next load began; the crop is that whose parameters are in use.
    of_all = {load.field for load in loads.values() if load.mass_kg > 0.0}
    anywhere = of_all.pop() if len(of_all) == 1 else ""
    fields = [anywhere if number is None else loads[number].field if number in loads else "" for number in numbers]
    labels = {
        "load": Label.of(["" if number is None else str(number) for number in numbers]),
        "field": Label.constant(options.field, count) if options.field else Label.of(fields),
        "crop": crop_of_row,
    }
    total = rows[-1].total_kg - rows[0].total_kg + rows[0].mass_kg
    source = Source(
        str(path),
        kind,
        count,
        mass_kg=total if total > 0 else None,
        notes=(*of_crop, *of_width, *notes, *([] if harvesting.any() else ["no second of harvest"])),
    )
    return build(columns, labels, source, unix_time=True, default_flow_s=DEFAULT_FLOW_S)


def _width_m(area_m2: Array, distance_m: Array, path: Path) -> tuple[Array, tuple[str, ...]]:
    """Of each second by the areas that the daemon reckoned with its header's width, which may change; and a note on it. Raises
    InputError where they do not tell it."""
    with np.errstate(invalid="ignore"):
        known = np.flatnonzero((area_m2 > 0.0) & (distance_m > _LEAST_DISTANCE_M))
    if known.size < _SECONDS_OF_ONE_HEADER // 2:
        raise InputError(str(path), "has no working width", "--width M")
    widths = np.round(median_filter(area_m2[known] / distance_m[known], _SECONDS_OF_ONE_HEADER, mode="nearest"), 1)
    nearest = np.searchsorted(0.5 * (known[1:] + known[:-1]), np.arange(area_m2.size))
    least, most = widths.min(), widths.max()
    said = f"{least:g} m" if least == most else f"{least:g} to {most:g} m"
    return widths[nearest], (f"width {said}, by the areas that it holds (else --width)",)


def _column(rows: list[SecondRow], name: str) -> Array:
    try:
        return np.array([getattr(row, name) for row in rows], dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"store: {name}", "holds a value that is not a number", "a daemon's store that is not damaged") from None
