"""A harvest table from named columns of any file: units, clocks, flow from yield by area, distances from positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from yieldmon.errors import InputError
from yieldmon.field.crop_figures import crop as known_crop
from yieldmon.field.mixed import machine_names
from yieldmon.field.plane import places_m
from yieldmon.field.repeated_hour import counted_on
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import LABELS, REQUIRED, Array, HarvestTable, Label, Source, build
from yieldmon.field.units import FACTORS, factor, is_bushels
from yieldmon.physics.grain import DRIEST_PCT

from .crop_names import crop_names
from .derived import derive
from .driven import distances_checked, each_of_a_sum
from .header_states import down_of, states_of
from .held_places import between_fixes
from .naming import QUANTITIES, Column
from .positions import on_the_globe, plausible, without_marks
from .raw_table import Raw
from .repeated_rows import without_repeats
from .row_times import ColumnTimes, column_times, row_times
from .side_by_side import beside, numbered

_TABLE_NAMES = {
    "longitude": "longitude_deg",
    "latitude": "latitude_deg",
    "flow": "flow_kg_s",
    "flow_sd": "flow_sd_kg_s",
    "moisture": "moisture_pct",
    "interval": "interval_s",
    "distance": "distance_m",
    "width": "width_m",
    "heading": "heading_deg",
    "elevation": "elevation_m",
    "position_sd": "position_sd_m",
    "header": "header_down",
    "pass": "pass_number",
    "section": "section",
}
_LARGEST = 1e12
"""In SI, of what has no limits of its own."""


def assemble(raw: Raw, where: str, kind: str, options: ReadOptions) -> HarvestTable:
    """The table. Raises InputError where a quantity that every map needs can neither be read nor follows."""
    values, of_crops = _numbers(raw, where, options.crop)
    header = raw.columns.get("header")
    strange: tuple[str, ...] = ()
    if header is not None and header.name in raw.texts:
        values["header"], strange = states_of(raw.texts[header.name], header.name)
    if "longitude" not in values or "latitude" not in values:
        raise InputError(where, "has no longitude and latitude", "--column longitude=NAME --column latitude=NAME")
    values["longitude"], values["latitude"], turned = on_the_globe(values["longitude"], values["latitude"])
    clock = column_times(raw, options, where)
    raw, values, clock = without_repeats(raw, values, clock)
    raw, clock = _machines_apart(raw, values, clock)
    if options.width_m is not None:
        values["width"] = np.full(raw.count, options.width_m)
    if "width" not in values:
        raise InputError(where, "has no working width", "--width M")
    unknown = _limited(values, raw.columns)
    if clock.time_s is not None and "section" not in values:
        places = values["longitude"], values["latitude"]
        section = numbered(*places, values["width"], clock.time_s, raw.machine_of_row)
        if section is not None:
            values["section"] = section
            unknown += (beside(section),)
    times = row_times(raw, values, clock, where)
    time = times.time_s
    held: tuple[str, ...] = ()
    if "section" not in values:
        places = values["longitude"], values["latitude"]
        values["longitude"], values["latitude"], held = between_fixes(*places, time, raw.machine_of_row)
    distance_notes = distances_checked(raw, values, time)
    if "mass" in values and (each := each_of_a_sum(raw, values["mass"], time)) is not None:
        values["mass"] = each
        distance_notes += (f"{raw.columns['mass'].name} is a running total: its differences are used as masses",)
    derived = derive(values, time, raw.machine_of_row, where)
    columns, limits = plausible({"time_s": time} | {_TABLE_NAMES[q]: v for q, v in values.items() if q in _TABLE_NAMES})
    lost = [name for name in REQUIRED if name in columns and not np.isfinite(columns[name]).any()]
    if lost and limits and raw.count:
        raise InputError(where, f"cannot be a harvest: {limits[0]}", "other units (--column)")
    if "header_down" in columns:
        columns["header_down"], heights = down_of(columns["header_down"], header.name if header else "header")
        strange += heights
    labels, of_names = _labels(raw, options)
    source = Source(
        where,
        kind,
        raw.count,
        raw.skipped,
        notes=(
            *raw.notes,
            *turned,
            *of_crops,
            *of_names,
            *unknown,
            *held,
            *distance_notes,
            *times.notes,
            *strange,
            *(_backwards(time) if clock.time_s is not None and not clock.hour_again else ()),
            *derived,
            *limits,
        ),
        date_order=clock.date_order,
    )
    return build(columns, labels, source, unix_time=times.unix, default_flow_s=raw.default_flow_s)


def _limited(values: dict[str, Array], columns: Mapping[str, Column]) -> tuple[str, ...]:
    """Takes as not known what no harvest has, before anything is derived from it; and notes.

    A distance may be a sum that goes on, and is looked at after that.
    """
    chosen = [q for q in values if q in _TABLE_NAMES and q != "distance"]
    limited, notes = plausible({_TABLE_NAMES[q]: values[q] for q in chosen})
    values.update({q: limited[_TABLE_NAMES[q]] for q in chosen})
    for quantity in sorted(set(values) - set(chosen)):
        with np.errstate(invalid="ignore"):
            huge = np.abs(values[quantity]) > _LARGEST
        if huge.any():
            values[quantity] = np.where(huge, np.nan, values[quantity])
            notes += (f"{int(huge.sum())} values of {quantity} over {_LARGEST:g} are taken as unknown",)
    for quantity in ("flow", "yield", "width"):
        if quantity in values:
            values[quantity], note = without_marks(values[quantity], columns[quantity].name if quantity in columns else quantity)
            notes += note
    moisture = values.get("moisture", np.zeros(0))
    usual = float(np.nanmedian(moisture)) if np.isfinite(moisture).any() else DRIEST_PCT
    if usual < DRIEST_PCT and "moisture" in columns:
        name = columns["moisture"].name
        notes += (f"{name}: no crop has a moisture of {usual:.2g} %; expected another unit (--column moisture={name}:fraction)",)
    return notes


def _machines_apart(raw: Raw, values: Mapping[str, Array], clock: ColumnTimes) -> tuple[Raw, ColumnTimes]:
    """With a name of its own for each of several machines whose rows are mixed, as intervals and distances are those of one; and
    with times that go on where local time comes twice."""
    if clock.time_s is None or "section" in values:
        return raw, clock
    column = raw.columns.get("machine")
    label = None if column is None else raw.texts.get(column.name)
    places, _ = plausible({"longitude_deg": values["longitude"], "latitude_deg": values["latitude"]})
    x_m, y_m = places_m(places["longitude_deg"], places["latitude_deg"])
    machine = label or Label.constant("", raw.count)
    time_s, twice = counted_on(clock.time_s, x_m, y_m, machine)
    clock = replace(clock, time_s=time_s, notes=(*clock.notes, twice), hour_again=True) if twice else clock
    named, note = machine_names(time_s, x_m, y_m, machine)
    if not note:
        return raw, clock
    name = " machine"
    columns = {**raw.columns, "machine": Column(name, "machine", "")}
    return replace(raw, columns=columns, texts={**raw.texts, name: named}, notes=(*raw.notes, note)), clock


def _numbers(raw: Raw, where: str, crop: str) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Columns of numbers by quantity, in the quantities' own units; and a note where bushels are of several crops.

    crop: of rows whose own is not known, for bushels.
    """
    values: dict[str, Array] = {}
    notes: tuple[str, ...] = ()
    for quantity, column in raw.columns.items():
        of = QUANTITIES[quantity].kind
        if of not in (*FACTORS, "state") or column.name not in raw.numbers:
            continue
        place = f"{where}: {column.name}"
        scale: float | Array = 1.0
        if is_bushels(column.unit, of):
            scale, notes = _bushels(raw, column, of, place, crop)
        elif column.unit and of not in ("none", "state"):
            scale = factor(column.unit, of, place)
        values[quantity] = raw.numbers[column.name] * scale
    return values, notes


def _bushels(raw: Raw, column: Column, kind: str, place: str, crop: str) -> tuple[Array, tuple[str, ...]]:
    """SI per bushel of each row's own crop, of `crop` where that is not known; and a note where there are several."""
    named = raw.columns.get("crop", raw.columns.get("product"))
    label = None if named is None else raw.texts.get(named.name)
    label = Label.constant("", raw.count) if label is None else label
    there = np.unique(label.codes).tolist()
    own = {code: label.names[code] if known_crop(label.names[code]) is not None or not crop else crop for code in there}
    scale = np.full(len(label.names), np.nan)
    for code, name in own.items():
        scale[code] = factor(column.unit, kind, place, name)
    other = sorted({name for name in own.values() if crop and known_crop(name) != known_crop(crop)})
    several = len(set(own.values())) > 1
    note = (f"{column.name}: bushels are those of each row's own crop ({', '.join(sorted(set(own.values())))})",)
    return scale[label.codes], note if several or other else ()


def _labels(raw: Raw, options: ReadOptions) -> tuple[dict[str, Label], tuple[str, ...]]:
    """Columns of texts, and what was taken for granted; the field of the options comes first."""
    labels = {
        name: raw.texts[raw.columns[name].name] for name in LABELS if name in raw.columns and raw.columns[name].name in raw.texts
    }
    if "crop" not in labels and (product := labels.get("product")) is not None and all(map(known_crop, product.names)):
        labels["crop"] = product
    labels["crop"], notes = crop_names(labels.get("crop", Label.constant("", raw.count)), options.crop)
    if options.field:
        labels["field"] = Label.constant(options.field, raw.count)
    return labels, notes


def _backwards(time: Array) -> tuple[str, ...]:
    number = int((np.diff(time[np.isfinite(time)]) < 0).sum())
    return (f"time runs backwards {number} times",) if number else ()


def labels_from(texts: Sequence[object]) -> Label:
    """From any objects; None as an empty text."""
    return Label.of(["" if text is None else " ".join(str(text).split()) for text in texts])
