"""can.Message <-> Frame, one frame at a time, from the layout that the DBC gives."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from pathlib import Path

import can

from yieldmon.bus.layout import MessageLayout, SignalLayout, load_layouts
from yieldmon.frames import ERROR, NOT_AVAILABLE, Frame, Unusable, Value
from yieldmon.identifiers import GROUP_MASK, IDENTITY_MASK, LARGEST_EXTENDED_ID

#: One entry per signal, in the order in which decode() unpacks them: name, start, mask, scale, offset, largest valid
#: raw value, smallest "not available", codes or None, integral.
_Unpack = tuple[str, int, int, float, float, int, int, frozenset[int] | None, bool]


class FrameError(ValueError):
    """A frame that is not as its DBC says.

    Parameters
    ----------
    problem : str
        What is wrong with it.

    Examples
    --------
    >>> try:
    ...     api.Codec().encode(api.Frame(0.0, "ElevatorSpeed", {"ElevatorSpeed": 1e9}))
    ... except api.FrameError as error:
    ...     print(error)
    ElevatorSpeed.ElevatorSpeed: 1000000000 rpm, expected 0 to 8031.875
    """

    def __init__(self, problem: str) -> None:
        super().__init__(problem)


class Codec:
    """Decodes and encodes the frames of one DBC.

    Parameters
    ----------
    dbc_path : path, optional
        The DBC, of 29-bit identifiers, 1 to 8 bytes, and little-endian signals without sign; None: the shipped one. Other
        layouts are read by a mapping (`signals` of the configuration).

    Attributes
    ----------
    layouts : mapping of str to MessageLayout
        By message name: identifier, length and signals.

    Raises
    ------
    InputError
        For a DBC that cannot be used.

    Notes
    -----
    Values in the J1939 "not available" range decode to `NOT_AVAILABLE`; error and reserved ranges, and codes that the value table
    does not define, to `ERROR`. Counters and coded signals are int, everything else float in the DBC's unit.

    References
    ----------
    SAE J1939-71, ranges of transmitted values.

    Examples
    --------
    >>> codec = api.Codec()
    >>> codec.decode(codec.encode(api.Frame(3.5, "ElevatorSpeed", {"ElevatorSpeed": 400.0})))
    Frame(time_s=3.5, message='ElevatorSpeed', signals={'ElevatorSpeed': 400.0})
    """

    def __init__(self, dbc_path: Path | str | None = None) -> None:
        """Reads the DBC at `dbc_path` (default: the shipped one). Raises InputError when it cannot be used."""
        self.layouts: Mapping[str, MessageLayout] = load_layouts(dbc_path)
        self._names = {name: frozenset(signal.name for signal in layout.signals) for name, layout in self.layouts.items()}
        self._by_identity: dict[int, tuple[MessageLayout, tuple[_Unpack, ...]]] = {}
        self._by_group: dict[int, tuple[MessageLayout, tuple[_Unpack, ...]]] = {}
        for layout in self.layouts.values():
            table = self._by_group if layout.any_source else self._by_identity
            table[layout.identity] = (layout, tuple(_unpack(signal) for signal in layout.signals))

    def layout_of(self, arbitration_id: int) -> MessageLayout | None:
        """Layout of the message that an identifier names, whatever its priority.

        Parameters
        ----------
        arbitration_id : int
            29 bits.

        Returns
        -------
        MessageLayout or None
            None for one not of ours.
        """
        entry = self._entry(arbitration_id)
        return entry[0] if entry is not None else None

    def decode(self, message: can.Message, wanted: Container[str] | None = None) -> Frame | None:
        """A message as a frame.

        Parameters
        ----------
        message : can.Message
        wanted : container of str, optional
            Names of the messages to decode; all by default.

        Returns
        -------
        Frame or None
            With the message's timestamp, s. None for an identifier that the DBC does not name or that is not wanted, an 11-bit
            identifier, a remote frame or an error frame (the receiver reports those).

        Raises
        ------
        FrameError
            For a length that is not the DBC's, and for what is no can.Message.
        """
        if not isinstance(message, can.Message):
            raise FrameError(f"{type(message).__name__}: no can.Message to decode")
        if message.is_error_frame or message.is_remote_frame or not message.is_extended_id:
            return None
        entry = self._entry(message.arbitration_id)
        if entry is None:
            return None
        layout, unpack = entry
        if wanted is not None and layout.name not in wanted:
            return None
        data = message.data
        if len(data) != layout.length:
            raise FrameError(
                f"{layout.name} (0x{message.arbitration_id:08X}): {len(data)} bytes of data, expected {layout.length}"
            )
        payload = int.from_bytes(data, "little")
        signals: dict[str, Value] = {}
        for name, start, mask, scale, offset, raw_max, raw_not_available, codes, integral in unpack:
            raw = payload >> start & mask
            if raw > raw_max:
                signals[name] = NOT_AVAILABLE if raw >= raw_not_available else ERROR
            elif not integral:
                signals[name] = raw * scale + offset
            elif codes is None or raw in codes:
                signals[name] = raw
            else:
                signals[name] = ERROR
        return Frame(message.timestamp, layout.name, signals)

    def encode(self, frame: Frame) -> can.Message:
        """A frame as a message with the frame's time as timestamp; bits that no signal uses are 1.

        Parameters
        ----------
        frame : Frame
            All signals of the message.

        Returns
        -------
        can.Message

        Raises
        ------
        FrameError
            For what is no Frame, a message the DBC does not name, a signal too many or too few, a value outside the signal's
            range (nothing is clipped) or no number, a code that the value table does not define, and for NOT_AVAILABLE or ERROR
            on a signal that has no raw value for it.
        """
        if not isinstance(frame, Frame):
            raise FrameError(f"{type(frame).__name__}: no Frame to encode")
        layout = self.layouts.get(frame.message)
        if layout is None:
            raise FrameError(f"{frame.message}: no such message, expected one of {', '.join(self.layouts)}")
        if frame.signals.keys() != self._names[layout.name]:
            raise FrameError(
                f"{frame.message}: signals {', '.join(frame.signals)}; "
                f"expected {', '.join(signal.name for signal in layout.signals)}"
            )
        payload = (1 << 8 * layout.length) - 1
        for signal in layout.signals:
            raw = _raw(signal, frame.signals[signal.name], layout.name)
            payload ^= (raw ^ signal.mask) << signal.start
        return can.Message(
            timestamp=frame.time_s,
            arbitration_id=layout.frame_id,
            is_extended_id=True,
            data=payload.to_bytes(layout.length, "little"),
        )

    def filters(self, messages: Iterable[str]) -> list[can.typechecking.CanFilter]:
        """python-can filters that let just these messages through, whatever their priority.

        Parameters
        ----------
        messages : iterable of str
            Names in the DBC.

        Returns
        -------
        list of dict
        """
        return [
            {"can_id": self.layouts[name].identity, "can_mask": self.layouts[name].identity_mask, "extended": True}
            for name in messages
        ]

    def _entry(self, arbitration_id: int) -> tuple[MessageLayout, tuple[_Unpack, ...]] | None:
        entry = self._by_identity.get(arbitration_id & IDENTITY_MASK)
        if entry is None:
            entry = self._by_group.get(arbitration_id & GROUP_MASK)
        return entry if arbitration_id <= LARGEST_EXTENDED_ID else None


def _unpack(signal: SignalLayout) -> _Unpack:
    return (
        signal.name,
        signal.start,
        signal.mask,
        signal.scale,
        signal.offset,
        signal.raw_max,
        signal.raw_not_available,
        signal.codes,
        signal.integral,
    )


def _is_finite(value: object) -> bool:
    """False also for what is no number."""
    try:
        return math.isfinite(value)  # type: ignore[arg-type]
    except TypeError:
        return False


def _raw(signal: SignalLayout, value: Value, message: str) -> int:
    if isinstance(value, Unusable):
        if not signal.has_reserved_values:
            raise FrameError(f"{message}.{signal.name}: cannot say {value.value!r}, every raw value is a count")
        return signal.mask if value is NOT_AVAILABLE else signal.raw_error
    if not _is_finite(value):
        raise FrameError(f"{message}.{signal.name}: {value}, expected a finite number or NOT_AVAILABLE")
    if signal.integral and value != int(value):
        raise FrameError(f"{message}.{signal.name}: {value}, expected a whole number")
    raw = round((value - signal.offset) / signal.scale)
    if not 0 <= raw <= signal.raw_max:
        low, high = signal.offset, signal.raw_max * signal.scale + signal.offset
        given = f"{message}.{signal.name}: {value:.10g} {signal.unit}".rstrip()
        raise FrameError(f"{given}, expected {low:.10g} to {high:.10g}")
    if signal.codes is not None and raw not in signal.codes:
        expected = ", ".join(map(str, sorted(signal.codes)))
        raise FrameError(f"{message}.{signal.name}: code {raw}, expected one of {expected}")
    return raw
