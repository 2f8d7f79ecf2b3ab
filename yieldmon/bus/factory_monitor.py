"""What the factory's own yield monitor says on the bus, by DBC files of the layouts that are public.

A signal whose attribute `Quantity` names a quantity is one of them; all others are passed over. Only the sender that the DBC
names is used. These values are recorded beside ours and are never an input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from cantools.database.can import Message as DbcMessage
from cantools.database.can import Signal as DbcSignal

from yieldmon.bus import dbc_file
from yieldmon.bus.layout import largest_valid_raw
from yieldmon.errors import InputError
from yieldmon.identifiers import DESTINATION_MASK, IDENTITY_MASK, is_broadcast
from yieldmon.resources import shipped

SHIPPED = ("dbc/factory_deere.dbc", "dbc/factory_case.dbc")
MASS_FLOW, MOISTURE = "factory_mass_flow", "factory_moisture"
UNITS = {MASS_FLOW: "kg/s", MOISTURE: "%"}


@dataclass(frozen=True, slots=True)
class _Field:
    quantity: str
    start: int
    mask: int
    scale: float
    offset: float
    raw_max: int
    selector: tuple[int, int, frozenset[int]] | None
    """Start, mask and values of the signal that must say that this one is there."""


_Layouts = dict[int, tuple[str, int, tuple[_Field, ...]]]
"""Identity of a frame -> its message's name and length, and what is read of it."""


def identity_of(identifier: int) -> int:
    """What distinguishes the layouts: group and source, without priority and destination."""
    identity = identifier & IDENTITY_MASK
    return identity if is_broadcast(identity >> 8) else identity & ~DESTINATION_MASK


class FactoryMonitor:
    """Reads the values of factory monitors out of single frames.

    Parameters
    ----------
    paths : sequence of path, optional
        DBC files; the shipped ones by default.

    Raises
    ------
    InputError
        For a file that cannot be read, or a signal that is not an unsigned little-endian one in the quantity's unit.

    Examples
    --------
    >>> FactoryMonitor().decode(0x10EFFFD3, bytes.fromhex("4F092003C8040102"))
    {'factory_mass_flow': 8.0, 'factory_moisture': 12.24}
    """

    def __init__(self, paths: Sequence[Path | str] | None = None) -> None:
        self._layouts = _layouts(paths) if paths is not None else _shipped_layouts()

    @property
    def identifiers(self) -> tuple[int, ...]:
        """Identities, as identity_of() makes them, of the frames that are read."""
        return tuple(self._layouts)

    def name_of(self, identifier: int) -> str | None:
        """The DBC's name of a frame that is read."""
        layout = self._layouts.get(identity_of(identifier))
        return layout[0] if layout is not None else None

    def decode(self, identifier: int, data: bytes) -> dict[str, float]:
        """Quantity -> value of what a frame says; empty for other frames and what is not available."""
        layout = self._layouts.get(identity_of(identifier))
        if layout is None or len(data) < layout[1]:
            return {}
        raw = int.from_bytes(data, "little")
        found = {}
        for part in layout[2]:
            if part.selector is not None and raw >> part.selector[0] & part.selector[1] not in part.selector[2]:
                continue
            value = raw >> part.start & part.mask
            if value <= part.raw_max:
                found[part.quantity] = value * part.scale + part.offset
        return found


@cache
def _shipped_layouts() -> _Layouts:
    return _layouts([shipped(name) for name in SHIPPED])


def _layouts(paths: Sequence[Path | str]) -> _Layouts:
    found = {}
    for path in paths:
        for message in dbc_file.read(path).messages:
            fields = tuple(field for signal in message.signals if (field := _field(message, signal, str(path))))
            if fields:
                found[identity_of(message.frame_id)] = (message.name, message.length, fields)
    return found


def _field(message: DbcMessage, signal: DbcSignal, path: str) -> _Field | None:
    attributes = signal.dbc.attributes if signal.dbc is not None else {}
    if "Quantity" not in attributes:
        return None
    where, quantity = f"{path}: {message.name}: {signal.name}", str(attributes["Quantity"].value)
    if quantity not in UNITS:
        raise InputError(where, f"quantity {quantity!r}", f"one of {', '.join(UNITS)}")
    if signal.unit != UNITS[quantity]:
        raise InputError(where, f"unit {signal.unit!r}", f"{UNITS[quantity]!r}")
    if signal.byte_order != "little_endian" or signal.is_signed or signal.is_float:
        raise InputError(where, "signed, float or big-endian", "an unsigned little-endian signal")
    selector = None
    if signal.multiplexer_ids is not None:
        by = next(s for s in message.signals if s.name == signal.multiplexer_signal)
        selector = (by.start, (1 << by.length) - 1, frozenset(signal.multiplexer_ids))
    mask = (1 << signal.length) - 1
    return _Field(
        quantity, signal.start, mask, float(signal.scale), float(signal.offset), largest_valid_raw(signal.length), selector
    )
