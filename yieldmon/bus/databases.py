"""Any DBC file as plain tables: where each signal's bits are, whatever the byte order, sign, multiplexing or identifier."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from yieldmon.bus import dbc_file
from yieldmon.bus.dbc_essentials import LeftOut
from yieldmon.bus.layout import largest_valid_raw, smallest_not_available_raw
from yieldmon.errors import InputError
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, group_of
from yieldmon.repeats import repeated

if TYPE_CHECKING:
    from cantools.database.can import Message as DbcMessage
    from cantools.database.can import Signal as DbcSignal


SOUND_MESSAGE = "a message whose signals fit, do not overlap and have finite numbers"
"""Expected in place of one with a contradiction."""


@dataclass(frozen=True, slots=True)
class SignalBits:
    """A signal of a message.

    little: least significant byte first; byte: the first of the eight bytes that hold it, 0 in a message of no more; shift: of
    its lowest bit in these, read as one number in that order. kind: "int", "uint" or "float". Physical value = raw * scale +
    offset. raw_max: largest raw value that is a measurement (J1939 signals; None elsewhere). mux_by, mux: multiplexer, and its
    values in frames that hold the signal; None and empty: all do. choices: name of a raw value -> the value; names_differ: the
    file has others as well. turns_at: raw values that a counter runs through by the DBC's range, which often is less than its
    bits hold; 2**bits where that names none.
    """

    name: str
    little: bool
    shift: int
    bits: int
    kind: str
    scale: float
    offset: float
    unit: str
    raw_max: int | None
    raw_not_available: int | None
    mux_by: str | None
    mux: tuple[int, ...]
    choices: Mapping[str, int]
    byte: int = 0
    turns_at: int = 0
    names_differ: bool = False

    @property
    def readable(self) -> bool:
        """Whether eight successive bytes hold it whole."""
        return self.shift >= 0 and self.shift + self.bits <= 8 * CLASSIC_BYTES

    @property
    def places(self) -> frozenset[int]:
        """The bits of the message that it takes: eight times the byte, and 0 to 7 from its lowest bit on."""
        bits = range(self.shift, self.shift + self.bits)
        if self.little:
            return frozenset(8 * self.byte + bit for bit in bits)
        return frozenset(8 * (self.byte + CLASSIC_BYTES - 1 - bit // 8) + bit % 8 for bit in bits)

    @property
    def end(self) -> int:
        """Bytes that a message must have to hold it."""
        return self.byte + ((self.shift + self.bits + 7) // 8 if self.little else CLASSIC_BYTES - self.shift // 8)


@dataclass(frozen=True, slots=True)
class MessageBits:
    """A message. multiplexer: the signal whose value says what a frame holds, None for none; below it may be others. j1939: as
    the DBC calls it. contradiction: why its signals cannot be used; empty where they can."""

    name: str
    frame_id: int
    extended: bool
    length: int
    multiplexer: str | None
    signals: Mapping[str, SignalBits]
    j1939: bool = False
    contradiction: str = ""

    @property
    def is_long(self) -> bool:
        """Whether it does not fit a classic frame: it comes in several, or in one of CAN FD."""
        return self.length > CLASSIC_BYTES

    def pages(self, signal: SignalBits) -> list[tuple[SignalBits, tuple[int, ...]]]:
        """Multiplexers above a signal, the nearest first, and their values in frames that hold it."""
        found: list[tuple[SignalBits, tuple[int, ...]]] = []
        while signal.mux_by is not None and len(found) < len(self.signals):
            above = self.signals[signal.mux_by]
            found.append((above, signal.mux))
            signal = above
        return found

    @property
    def group(self) -> int:
        """J1939 parameter group number of the identifier."""
        return group_of(self.frame_id)


def load_messages(path: Path | str) -> dict[str, MessageBits]:
    """Message name -> its bits, from the DBC at `path`. Of several messages of one name each has its identifier behind it, as in
    `gnss_pos 0x13`. A message that stands there again with the same signals counts once.

    Makers' files often have a message whose signals overlap, do not fit or have a factor of 0, or two of one name and identifier
    with different signals, or a name or identifier that no DBC may have: it has no signals then, and `contradiction` says why.
    Raises InputError, one line, for a file that cannot be read, is no DBC, or is in an encoding other than UTF-8 or Windows-1252.
    """
    where, text = str(path), dbc_file.text_of(path)
    database, left_out = dbc_file.sound(where, text)
    renamed = dbc_file.names_that_differ(text)
    if not database.messages:
        raise InputError(where, "names no message", "a DBC file")
    messages = [_with_differing_names(_message(message), renamed) for message in database.messages]
    messages += [_left_out(one) for one in left_out]
    alike = set(repeated(message.name for message in messages))
    named = [
        replace(message, name=with_identifier(message.name, message.frame_id)) if message.name in alike else message
        for message in messages
    ]
    twice = set(repeated(message.name for message in named))
    return {message.name: _contradicted(message) if message.name in twice else message for message in named}


def _left_out(found: LeftOut) -> MessageBits:
    """A message that cannot be read, in its place: other messages take none of its frames."""
    extended = found.number >= EXTENDED_FLAG
    frame_id = found.number - EXTENDED_FLAG if extended else found.number
    return MessageBits(found.name, frame_id, extended, CLASSIC_BYTES, None, {}, contradiction=f"{found.name}: {found.why}")


def _with_differing_names(message: MessageBits, signals: Collection[tuple[int, str]]) -> MessageBits:
    """The message with those of its signals marked that are among these of identifier and name."""
    if not any((message.frame_id, name) in signals for name in message.signals):
        return message
    marked = {name: replace(bits, names_differ=(message.frame_id, name) in signals) for name, bits in message.signals.items()}
    return replace(message, signals=marked)


def _contradicted(message: MessageBits) -> MessageBits:
    """A message beside which another of its name and identifier stands."""
    return replace(message, multiplexer=None, signals={}, contradiction=f"{message.name} is there twice, and the two differ")


def with_identifier(name: str, frame_id: int) -> str:
    """A message's name where others have the same."""
    return f"{name} 0x{frame_id:X}"


def _contradiction(message: DbcMessage) -> str:
    """Why a message cannot be used; empty where it can."""
    problems = (f"{signal.name} has {given}" for signal in message.signals if (given := _odd_numbers(signal)))
    return dbc_file.contradiction(message) or next(problems, "")


def _odd_numbers(signal: DbcSignal) -> str:
    """Factor, offset and range of a signal that do not make a number; empty where they do."""
    numbers = (signal.scale, signal.offset, signal.minimum or 0, signal.maximum or 0)
    try:
        sound = bool(signal.scale) and all(isfinite(number) for number in numbers)
    except OverflowError:
        sound = False
    given = f"factor {signal.scale}, offset {signal.offset}, range {signal.minimum} to {signal.maximum}"
    return "" if sound else f"{given[:200]}, which are not finite numbers with a factor other than 0"


def _message(message: DbcMessage) -> MessageBits:
    name, j1939 = message.name, message.protocol == "j1939" or _is_j1939(message)
    if problem := _contradiction(message):
        extended = message.is_extended_frame
        return MessageBits(name, message.frame_id, extended, message.length, None, {}, j1939, contradiction=problem)
    multiplexer = next((signal.name for signal in message.signals if signal.is_multiplexer and not signal.multiplexer_ids), None)
    signals = {signal.name: _signal(signal, j1939, message.length) for signal in message.signals}
    return MessageBits(name, message.frame_id, message.is_extended_frame, message.length, multiplexer, signals, j1939)


def _is_j1939(message: DbcMessage) -> bool:
    attributes = message.dbc.attributes if message.dbc is not None else {}
    return "VFrameFormat" in attributes and attributes["VFrameFormat"].value in (3, "J1939PG")


def _signal(signal: DbcSignal, j1939: bool, length: int) -> SignalBits:
    little = signal.byte_order == "little_endian"
    byte = signal.start // 8 if length > CLASSIC_BYTES else 0
    start = signal.start - 8 * byte
    # Big-endian: the start is that of the highest bit, counted 7..0 within each byte.
    shift = start if little else 8 * CLASSIC_BYTES - (start // 8 * 8 + 7 - start % 8) - signal.length
    kind = "float" if signal.is_float else "int" if signal.is_signed else "uint"
    bits = signal.length
    # Half a step below the highest raw value: as DBC files have it, rounded to a few decimals.
    whole = signal.maximum is not None and (signal.maximum - signal.offset) / signal.scale >= (1 << bits) - 1.5
    reserved = j1939 and kind == "uint" and bits > 1 and not whole
    return SignalBits(
        name=signal.name,
        little=little,
        shift=shift,
        bits=bits,
        kind=kind,
        scale=float(signal.scale),
        offset=float(signal.offset),
        unit=signal.unit or "",
        raw_max=largest_valid_raw(bits) if reserved else None,
        raw_not_available=smallest_not_available_raw(bits) if reserved else None,
        mux_by=signal.multiplexer_signal if signal.multiplexer_ids else None,
        mux=tuple(signal.multiplexer_ids or ()),
        choices={str(name): int(raw) for raw, name in (signal.choices or {}).items()},
        byte=byte,
        turns_at=_turns_at(signal),
    )


def _turns_at(signal: DbcSignal) -> int:
    """Of a counter, by the DBC's range where that begins at the raw value 0 and ends at another."""
    every = 1 << signal.length
    if signal.is_float or signal.is_signed or signal.minimum is None or signal.maximum is None:
        return every
    first, last = ((end - signal.offset) / signal.scale for end in (signal.minimum, signal.maximum))
    return round(last) + 1 if first == 0 and 1 <= round(last) < every else every
