"""How the DBC packs its frames: messages and signals reduced to shifts, masks and J1939 raw ranges.

Everything that decodes or encodes, frame by frame (codec) or in bulk, works from these tables, so that there is one
reading of the DBC.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from yieldmon.arguments import require_path
from yieldmon.bus import dbc_file
from yieldmon.errors import InputError
from yieldmon.identifiers import CLASSIC_BYTES, GROUP_MASK, IDENTITY_MASK
from yieldmon.resources import shipped

if TYPE_CHECKING:
    from cantools.database.can import Message as DbcMessage
    from cantools.database.can import Signal as DbcSignal


#: Choices with these names are the J1939 reserved raw values, listed in the DBC for human readers.
_RESERVED_CHOICES = ("SignalError", "SignalNotAvailable")


def largest_valid_raw(bits: int) -> int:
    """Largest raw value that is a measurement (SAE J1939-71 ranges, by the leading 8 bits whatever the width)."""
    return (0xFB << bits - 8) - 1 if bits >= 8 else (1 << bits) - 3


def smallest_not_available_raw(bits: int) -> int:
    """Smallest raw value that says "not available"; every larger one does too."""
    return 0xFF << bits - 8 if bits >= 8 else (1 << bits) - 1


def error_raw(bits: int) -> int:
    """Raw value sent for "error"; with 8 bits and more, 0xFE in the leading eight and zeros behind."""
    return 0xFE << bits - 8 if bits >= 8 else (1 << bits) - 2


@dataclass(frozen=True)
class SignalLayout:
    """Place and meaning of one unsigned little-endian signal.

    Physical value = raw * scale + offset. Raw values above `raw_max` are no measurement: from `raw_not_available` on
    they say "not available", below it "error" (error and reserved ranges). A signal that uses its whole range has
    raw_max = mask and no such values. `codes` holds the defined codes of a coded signal, else it is None.
    """

    name: str
    start: int
    bits: int
    scale: float
    offset: float
    unit: str
    raw_max: int
    raw_not_available: int
    raw_error: int
    codes: frozenset[int] | None
    integral: bool

    @property
    def mask(self) -> int:
        """All ones over the signal's width."""
        return (1 << self.bits) - 1

    @property
    def has_reserved_values(self) -> bool:
        """True where the signal can say "not available" and "error"."""
        return self.raw_max < self.mask


@dataclass(frozen=True)
class MessageLayout:
    """One message: the identifier it is sent with, its length in bytes, and its signals.

    any_source: the parameter group is accepted from every source address, not only the DBC's.
    """

    name: str
    frame_id: int
    length: int
    cycle_time_s: float
    any_source: bool
    signals: tuple[SignalLayout, ...]

    @property
    def identity(self) -> int:
        """The part of the identifier that is compared on reception."""
        return self.frame_id & self.identity_mask

    @property
    def identity_mask(self) -> int:
        """GROUP_MASK for a message that is accepted from any sender, else IDENTITY_MASK."""
        return GROUP_MASK if self.any_source else IDENTITY_MASK


def load_layouts(dbc_path: Path | str | None = None) -> dict[str, MessageLayout]:
    """Message name -> layout, from the DBC at `dbc_path` (default: the shipped one).

    Raises InputError for a file that is missing, no DBC, or uses what these frames never do (11-bit identifiers,
    multiplexing, signed, float or big-endian signals, frames of other than 1 to 8 bytes).
    """
    if dbc_path is None:
        return dict(_shipped())
    require_path(dbc_path)
    return _read(Path(dbc_path))


@cache
def _shipped() -> dict[str, MessageLayout]:
    return _read(shipped("dbc/yieldmon.dbc"))


def _read(path: Path) -> dict[str, MessageLayout]:
    return {message.name: _message_layout(message, str(path)) for message in dbc_file.read(path).messages}


def _message_layout(message: DbcMessage, path: str) -> MessageLayout:
    where = f"{path}: {message.name}"
    if not message.is_extended_frame:
        raise InputError(where, "11-bit identifier", "a 29-bit identifier")
    if not 1 <= message.length <= CLASSIC_BYTES:
        raise InputError(where, f"{message.length} bytes long", f"1 to {CLASSIC_BYTES} bytes")
    attributes = message.dbc.attributes if message.dbc is not None else {}
    any_source = "AnySourceAddress" in attributes and attributes["AnySourceAddress"].value in (1, "yes")
    return MessageLayout(
        name=message.name,
        frame_id=message.frame_id,
        length=message.length,
        cycle_time_s=(message.cycle_time or 0) / 1000,
        any_source=any_source,
        signals=tuple(_signal_layout(signal, where) for signal in message.signals),
    )


def _signal_layout(signal: DbcSignal, where: str) -> SignalLayout:
    where = f"{where}: {signal.name}"
    if signal.byte_order != "little_endian" or signal.is_signed or signal.is_float or signal.is_multiplexer:
        raise InputError(where, "signed, float, big-endian or multiplexed", "an unsigned little-endian signal")
    bits = signal.length
    mask = (1 << bits) - 1
    scale, offset = float(signal.scale), float(signal.offset)
    uses_all_values = signal.maximum is not None and round((signal.maximum - offset) / scale) >= mask
    codes = None
    if signal.choices is not None:
        codes = frozenset(raw for raw, choice in signal.choices.items() if str(choice) not in _RESERVED_CHOICES)
    return SignalLayout(
        name=signal.name,
        start=signal.start,
        bits=bits,
        scale=scale,
        offset=offset,
        unit=signal.unit or "",
        raw_max=mask if uses_all_values else largest_valid_raw(bits),
        raw_not_available=mask + 1 if uses_all_values else smallest_not_available_raw(bits),
        raw_error=error_raw(bits),
        codes=codes,
        integral=not signal.unit and scale == 1.0 and offset == 0.0,
    )
