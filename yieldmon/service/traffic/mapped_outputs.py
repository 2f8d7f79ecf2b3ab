"""Results of the engine as frames of other DBC files, as the configuration's `outputs` binds them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite

import can
from can.typechecking import CanFilter

from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.results import Result, WindowResult
from yieldmon.engine.settings import TotalsSettings
from yieldmon.frames import PLATE_ACTUATOR_COMMAND, Frame, Unusable
from yieldmon.identifiers import GROUP_MASK, IDENTITY_MASK, LARGEST_STANDARD_ID, SOURCE_MASK
from yieldmon.signals.output_mapping import OutputGroup, OutputMap
from yieldmon.signals.packing import packed
from yieldmon.signals.published import CARRIED, FRAME_COUNTER, PUBLISHED

#: From this age on a value is not known any more.
STALE_S = 3.0


@dataclass(frozen=True, slots=True)
class OutputMessage:
    """A frame to send. own_address: from our address, and not without one; else whenever the identifier has 11 bits. may_wait: of
    a second that is over, so that it may go when an address is there."""

    message: can.Message
    own_address: bool
    may_wait: bool


class MappedOutputs:
    """What the frames of each group hold, and when they go out. One thread only."""

    def __init__(self, outputs: OutputMap, settings: TotalsSettings) -> None:
        """outputs: the groups. settings: for dry masses."""
        self._groups = outputs.groups
        self._settings = settings
        self._values: dict[str, tuple[float | None, float]] = {}
        """Of a quantity, with the time when it was said."""
        self._counts = [0] * len(outputs.groups)
        self._due_s = [float("-inf")] * len(outputs.groups)
        self._said = [False] * len(outputs.groups)

    def use(self, settings: TotalsSettings) -> None:
        """Other settings from now on; counters and periods go on."""
        self._settings = settings

    @property
    def sends(self) -> bool:
        """Whether there is any group."""
        return bool(self._groups)

    def filters(self) -> list[CanFilter]:
        """python-can filters that let through frames of others under our identifiers."""
        return [
            CanFilter(can_id=group.frame_id & mask, can_mask=mask, extended=group.extended)
            for group in self._groups
            for mask in (LARGEST_STANDARD_ID if not group.extended else GROUP_MASK if group.own_address else IDENTITY_MASK,)
        ]

    def name_of(self, message: can.Message, address: int | None) -> str | None:
        """The message of ours whose identifier a received frame has; None where it has none of them."""
        for group in self._groups:
            ours = _identifier(group, address)
            mask = IDENTITY_MASK if group.extended else LARGEST_STANDARD_ID
            if message.is_extended_id == group.extended and ours is not None and not (message.arbitration_id ^ ours) & mask:
                return group.name
        return None

    def take(self, results: Iterable[Result], totals: Totals, now_s: float) -> list[OutputMessage]:
        """The frames that new results bring: those of groups without a period."""
        out: list[OutputMessage] = []
        for result in results if self._groups else ():
            new = values_of(result.frames)
            if isinstance(result, WindowResult):
                new |= _of_record(result, new.get("mass_flow"), totals, self._settings)
            self._values |= {name: (value, now_s) for name, value in new.items()}
            for place, group in enumerate(self._groups):
                if group.period_s is None and any(name in new for name, _ in group.quantities):
                    out += self._frame(place, now_s)
                self._said[place] |= any(name in new for name, _ in group.quantities)
        return out

    def poll(self, now_s: float) -> list[OutputMessage]:
        """The frames of groups with a period that have fallen due by now."""
        out: list[OutputMessage] = []
        for place, group in enumerate(self._groups):
            if group.period_s is not None and self._said[place] and now_s >= self._due_s[place]:
                behind = now_s - self._due_s[place]
                self._due_s[place] = self._due_s[place] + group.period_s if behind < group.period_s else now_s + group.period_s
                out += self._frame(place, now_s)
        return out

    def _frame(self, place: int, now_s: float) -> list[OutputMessage]:
        group = self._groups[place]
        signals = list(group.fixed)
        for name, packing in group.quantities:
            value, said_s = (self._counts[place], now_s) if name == FRAME_COUNTER else self._values.get(name, (None, now_s))
            raw = packing.raw(value if now_s - said_s <= STALE_S else None)
            if raw is None:
                # The signal has no way to say that there is no value.
                return []
            signals.append((packing.bits, raw))
        self._counts[place] += 1
        data = packed(group.length, group.ones, signals)
        message = can.Message(arbitration_id=group.frame_id, is_extended_id=group.extended, data=data)
        commands = any(PUBLISHED[name].message == PLATE_ACTUATOR_COMMAND for name, _ in group.quantities)
        return [OutputMessage(message, group.own_address, group.period_s is None and not commands)]


def _identifier(group: OutputGroup, address: int | None) -> int | None:
    if not group.own_address:
        return group.frame_id
    return None if address is None else group.frame_id & ~SOURCE_MASK | address


def values_of(frames: Iterable[Frame]) -> dict[str, float | None]:
    """Quantities that frames of the shipped layout bring; None: not known."""
    found: dict[str, float | None] = {}
    for frame in frames:
        for signal, value in frame.signals.items():
            name = CARRIED.get((frame.message, signal))
            if name is not None:
                found[name] = None if isinstance(value, Unusable) else float(value)
    return found


def _of_record(
    result: WindowResult, flow_kg_s: float | None, totals: Totals, settings: TotalsSettings
) -> Mapping[str, float | None]:
    record = result.record
    dry_kg_s = None
    if flow_kg_s is not None:
        dry_kg_s = dry_mass(flow_kg_s, record.moisture_pct, settings, totals.market_moisture_pct)
    return {
        "moisture": record.moisture_pct if isfinite(record.moisture_pct) else None,
        "dry_mass_flow": dry_kg_s,
        "dry_load_mass": totals.known_load_dry_kg,
        "dry_total_mass": totals.known_total_dry_kg,
        "active_faults": float(len(record.faults)),
    }
