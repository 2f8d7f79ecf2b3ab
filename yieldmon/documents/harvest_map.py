"""What `yieldmon map --json` prints."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

from .common import Number


class SkippedPart(TypedDict):
    """A part of a source that was left out."""

    part: str
    why: str


class SourceDocument(TypedDict):
    """A harvest that was read. machine_total_kg, machine_area_ha: as the machine states them."""

    path: str
    kind: str
    points: int
    skipped: list[SkippedPart]
    notes: list[str]
    machine_total_kg: Number
    machine_area_ha: Number


class DelayDocument(TypedDict):
    """From cutting to the sensor, s. value: as used; low, high: 95 % interval; declared: by the machine."""

    value: float
    low: Number
    high: Number
    decision: Literal["estimated", "cannot tell", "declared"]
    declared: Number
    why: str


class MachineDelays(TypedDict):
    """The delays of one of several machines."""

    name: str
    points: int
    flow_s: DelayDocument
    moisture_s: DelayDocument


class Delays(TypedDict):
    """Of the harvest; machines: of each, where there are several."""

    flow_s: DelayDocument
    moisture_s: DelayDocument
    machines: NotRequired[list[MachineDelays]]


class Agreement(TypedDict):
    """Correlation of opposing passes: with no shift, with the delay, and with it on blocks held out; pairs of blocks."""

    no_shift: Number
    shifted: Number
    held_out: Number
    pairs: int


class MapMass(TypedDict):
    """kg of wet grain. machine_total: as the machine states it; integrated: of all points; corrected: by weighed loads, with the
    interval low to high."""

    machine_total: Number
    integrated: float
    corrected: float
    low: Number
    high: Number
    kept: float
    left_out_by_reason: dict[str, float]


class TransportDocument(TypedDict):
    """Of --transport. plain, smoothed, inverted: correlation of opposing passes held out; margin: of the inverse over both."""

    decision: Literal["on", "off"]
    time_constant_s: float
    plain: Number
    smoothed: Number
    inverted: Number
    margin: Number
    margin_sd: Number


class MapLoad(TypedDict):
    """A load, unless it is the only one and was not weighed. factor: corrected over measured mass."""

    load: str
    measured_kg: float
    weighed_kg: Number
    factor: float
    factor_sd: Number
    corrected_kg: float


class MapCrop(TypedDict):
    """A crop of which there is grain, "" for an unknown one. mass_kg: that has a place; kept_kg: of it in the map."""

    crop: str
    mass_kg: float
    kept_kg: float


class MapDocument(TypedDict):
    """`yieldmon map --json`. crop: of all grain, "" for several or an unknown one."""

    sources: list[SourceDocument]
    delay: Delays
    agreement: Agreement
    mass_kg: MapMass
    area_ha: float
    kept_area_ha: float
    yield_t_ha: Number
    yield_t_ha_low: Number
    yield_t_ha_high: Number
    yield_bu_ac: Number
    crop: str
    crops: list[MapCrop]
    transport: TransportDocument | None
    points_by_reason: dict[str, int]
    loads: list[MapLoad]
    notes: list[str]
    files: list[str]
