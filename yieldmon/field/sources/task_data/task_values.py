"""Values of a log of task data by the data dictionary of ISO 11783-11, and the devices whose they are."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yieldmon.data_dictionary import (
    CONDENSED_STATES,
    DEFAULT_WIDTH,
    DRY_PER_AREA,
    DRY_PER_TIME,
    DRY_TOTAL,
    LAG,
    LEAD,
    MASS_PER_AREA,
    MASS_PER_TIME,
    MAX_WIDTH,
    MOISTURE,
    OFFSET_Y,
    TOTAL_AREA,
    TOTAL_MASS,
    WIDTH,
    WORK_STATE,
)
from yieldmon.field.table import Array

from . import timelog

KNOWN = {WIDTH, MASS_PER_AREA, MASS_PER_TIME, TOTAL_MASS, MOISTURE, TOTAL_AREA, WORK_STATE, LAG, LEAD, *CONDENSED_STATES}
_SECTION = "4"
_YIELDS = ((MASS_PER_TIME, MASS_PER_AREA), (DRY_PER_TIME, DRY_PER_AREA), (TOTAL_MASS,), (DRY_TOTAL,))
"""From which a flow follows, the best ones first."""
_COUNTERS = {TOTAL_MASS, DRY_TOTAL, TOTAL_AREA}
_ADD_UP = {WIDTH, DEFAULT_WIDTH, MAX_WIDTH, MASS_PER_TIME, DRY_PER_TIME, *_COUNTERS}
"""What the whole has as a sum of its sections; of all else it has their mean."""


@dataclass(frozen=True)
class Devices:
    """The device descriptions.

    Parameters
    ----------
    constants : mapping of (int, str) to float
        DDI and element -> raw value.
    sections : tuple of str
        Elements that are sections, by their number.
    names : mapping of str to str
        Element -> name of its device.
    of_element : mapping of str to str
        Element -> identifier of its device.
    kinds : mapping of str to str
        Element -> its type.
    couplings : tuple of (str, str)
        Connectors of two devices that are coupled.
    software : str
        That wrote the task file.
    """

    constants: Mapping[tuple[int, str], float] = field(default_factory=dict)
    sections: tuple[str, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    of_element: Mapping[str, str] = field(default_factory=dict)
    kinds: Mapping[str, str] = field(default_factory=dict)
    couplings: tuple[tuple[str, str], ...] = ()
    software: str = ""


def devices(root: ET.Element) -> Devices:
    """The devices of a task file."""
    constants: dict[tuple[int, str], float] = {}
    for device in root.iter("DVC"):
        elements = list(device.iter("DET"))
        # Elements that are alike may share a property.
        referring: dict[str, list[str]] = {}
        for one in elements:
            for reference in one.iter("DOR"):
                referring.setdefault(reference.get("A", ""), []).append(one.get("A", ""))
        first = [elements[0].get("A", "") if elements else ""]
        for property_ in device.iter("DPT"):
            try:
                ddi, value = int(property_.get("B", ""), 16), timelog.process_value(property_.get("C", ""))
            except ValueError:
                continue
            constants |= {(ddi, element): value for element in referring.get(property_.get("A", ""), first)}
    sections = [element for element in root.iter("DET") if element.get("C") == _SECTION]
    return Devices(
        constants,
        tuple(element.get("A", "") for element in sorted(sections, key=_number)),
        {
            element.get("A", ""): " ".join(device.get("B", "").split()) or device.get("A", "")
            for device in root.iter("DVC")
            for element in device.iter("DET")
        },
        {element.get("A", ""): device.get("A", "") for device in root.iter("DVC") for element in device.iter("DET")},
        {element.get("A", ""): element.get("C", "") for element in root.iter("DET")},
        tuple((one.get("B", ""), one.get("D", "")) for one in root.iter("CNN")),
        root.get("ManagementSoftwareManufacturer", ""),
    )


def _number(element: ET.Element) -> int:
    number = element.get("E", "")
    return int(number) if number.isdecimal() and len(number) < 10 else 0


def _from_the_start(counter: Array) -> Array:
    """A counter that has its first value also before it was first sent: what it counted until then is not of this log."""
    known = np.flatnonzero(np.isfinite(counter))
    return np.where(np.arange(len(counter)) < known[0], counter[known[0]], counter) if known.size else counter


def _risen(counter: Array) -> float:
    """What a counter counted; where it falls it began again."""
    known = counter[np.isfinite(counter)]
    steps = np.diff(known)
    return float(np.where(steps >= 0, steps, known[1:]).sum())


@dataclass(frozen=True)
class Values:
    """Values of a log by DDI and element: those of the device that measured the yield, of others where it has none."""

    values: Mapping[tuple[int, str], Array]
    device: Devices

    def of(self, ddi: int) -> list[tuple[str, Array]]:
        """Element and values."""
        found = self._all(ddi)
        own = [one for one in found if self.device.of_element.get(one[0], "") == self.measuring]
        return own or found

    def _all(self, ddi: int) -> list[tuple[str, Array]]:
        return [(element, values) for (key, element), values in self.values.items() if key == ddi]

    @cached_property
    def measuring(self) -> str:
        """The device that measured the yield, by its identifier."""
        found = next((found for ddis in _YIELDS if (found := [one for ddi in ddis for one in self._all(ddi)])), [])
        if not found:
            return ""
        return self.device.of_element.get(max(found, key=lambda one: int(np.isfinite(one[1]).sum()))[0], "")

    def device_name(self) -> str:
        """Of the device that measured the yield."""
        found = [element for ddis in _YIELDS for ddi in ddis for element, _ in self.of(ddi)]
        return next((self.device.names[element] for element in found if element in self.device.names), "")

    def one(self, ddi: int, scale: float) -> Array | None:
        """The values of the element that has most of them, else the sum or the mean of its sections that work."""
        found = self.of(ddi)
        if not found:
            return None
        whole = self._whole(found)
        if whole is not None:
            return scale * whole
        values = np.array([values for _, values in found])
        if ddi in _ADD_UP:
            if ddi in _COUNTERS:
                values = np.array([_from_the_start(one) for one in values])
            together: Array = scale * np.nansum(values, axis=0)
            return together
        weights = np.where(np.isfinite(values), self._weights([element for element, _ in found], values.shape[1]), 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean: Array = scale * (weights * np.nan_to_num(values)).sum(axis=0) / weights.sum(axis=0)
        return mean

    def _whole(self, found: Sequence[tuple[str, Array]]) -> Array | None:
        """Of elements that are no sections the one that has most values; None where all are."""
        whole = [values for element, values in found if element not in self.device.sections]
        return max(whole, key=lambda values: int(np.isfinite(values).sum())) if whole else None

    def _weights(self, elements: Sequence[str], count: int) -> Array:
        """Width of each section where it works, shape (len(elements), count)."""
        widths = dict(zip(self._own_sections, self._of_sections(), strict=False))
        said, which = self._on(count)
        working = {name: which[:, k] | (said != 1) for k, name in enumerate(self._own_sections) if k < which.shape[1]}
        return np.array([widths.get(one, 1.0) * working.get(one, np.ones(count)) for one in elements])

    def single(self, ddi: int) -> float | None:
        """A value that stays: from the log's last record or the device description."""
        found = self.one(ddi, 1.0)
        if found is not None and np.isfinite(found).any():
            return float(found[np.isfinite(found)][-1])
        return self._constant(ddi)

    def _constant(self, ddi: int) -> float | None:
        """Of the device description: of the whole, else of its sections together."""
        found = {element: value for (key, element), value in self.device.constants.items() if key == ddi}
        own = {element: value for element, value in found.items() if self.device.of_element.get(element, "") == self.measuring}
        found = own or found
        whole = [value for element, value in found.items() if element not in self.device.sections]
        return max(whole) if whole else sum(found.values()) or None

    @property
    def _own_sections(self) -> list[str]:
        """Sections of the measuring device, from left to right."""
        return [one for one in self.device.sections if self.device.of_element.get(one, "") == self.measuring]

    def _of_sections(self) -> list[float]:
        """Width of each section of the measuring device, mm, from left to right; empty where one is not known."""
        for ddi in (WIDTH, DEFAULT_WIDTH, MAX_WIDTH):
            widths = [self.device.constants.get((ddi, element)) for element in self._own_sections]
            known = [width for width in widths if width]
            if len(known) == len(widths):
                return known
        return []

    def _on(self, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """By the sections' work states: 1 where one works, 0 where none does, NaN where it is not said; and which sections."""
        own, of_section = self._own_sections, dict(self.of(WORK_STATE))
        if of_section.keys() & set(own):
            each = np.column_stack([of_section.get(section, np.full(count, np.nan)) for section in own])
            return np.where(np.isfinite(each).any(axis=1), (each == 1).any(axis=1).astype(float), np.nan), each == 1
        blocks = [block for block, ddi in enumerate(CONDENSED_STATES) if self.of(ddi)]
        any_on, which = np.full(count, np.nan), np.zeros((count, 16 * (max(blocks, default=-1) + 1)), bool)
        for block, ddi in enumerate(CONDENSED_STATES):
            condensed = self.one(ddi, 1.0)
            if condensed is None:
                continue
            bits = np.nan_to_num(condensed).astype(np.int64)
            for section in range(16):
                which[:, 16 * block + section] = (bits >> (2 * section)) & 3 == 1
            on = which[:, 16 * block : 16 * block + 16].any(axis=1)
            any_on = np.where(np.isfinite(condensed), np.fmax(any_on, on.astype(float)), any_on)
        return any_on, which

    def risen(self, ddi: int) -> float | None:
        """What a counter counted over the log."""
        counter = self.one(ddi, 1.0)
        return None if counter is None else _risen(counter)

    def width_m(self) -> Array | None:
        """Of what works, m; None where neither the log nor a description has it."""
        width = self.one(WIDTH, 1e-3)
        fallback = self._constant(WIDTH) or self.single(DEFAULT_WIDTH) or self.single(MAX_WIDTH)
        if width is None:
            count = len(next(iter(self.values.values()), np.zeros(0)))
            sections = self._of_sections()
            said, which = self._on(count)
            if len(sections) > 1 and (said == 1).any():
                working = 1e-3 * which[:, : len(sections)] @ np.array(sections)
                return np.where(said == 1, working, 1e-3 * (fallback or sum(sections)))
            return None if fallback is None else np.full(count, fallback * 1e-3)
        return width if fallback is None else np.where(np.isfinite(width), width, fallback * 1e-3)

    def cut_right_m(self, count: int) -> Array:
        """From the header's middle right to that of its sections that work, m; NaN where they are not known."""
        widths = np.array(self._of_sections())
        said, which = self._on(count)
        if not widths.size or which.shape[1] < widths.size:
            return np.full(count, np.nan)
        middles = self._middles(widths)
        working = which[:, : widths.size] * widths
        total = working.sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where((said == 1) & (total > 0), 1e-3 * (working @ middles) / total, np.nan)

    def _middles(self, widths: Array) -> Array:
        """Of each section to the right of the middle of all, mm: by their offsets, else in their order from the left."""
        placed = []
        for section in self._own_sections:
            sent = self.values.get((OFFSET_Y, section), np.zeros(0))
            sent = sent[np.isfinite(sent)]
            placed.append(sent[0] if sent.size else self.device.constants.get((OFFSET_Y, section), np.nan))
        middles = np.array(placed)
        if not np.isfinite(middles).all():
            middles = np.cumsum(widths) - 0.5 * widths
        return np.asarray(middles - 0.5 * ((middles - 0.5 * widths).min() + (middles + 0.5 * widths).max()))

    def header_down(self, count: int) -> Array:
        """Header down: 1, up: 0, NaN where it is not said."""
        state = self._whole(self.of(WORK_STATE))
        if state is not None:
            return np.where(np.isfinite(state), (state == 1).astype(float), np.nan)
        return self._on(count)[0]
