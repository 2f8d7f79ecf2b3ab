"""Messages of makers' DBC files as the monitor shows its own: what a frame's signals are called, and their values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import can

from yieldmon.bus.databases import MessageBits, SignalBits
from yieldmon.bus.layout import MessageLayout, SignalLayout
from yieldmon.frames import NOT_AVAILABLE, Frame, Value
from yieldmon.identifiers import group_of

_FINE = 1e-4
"""Resolution of a floating-point number, for its digits."""
_FAR = 1 << 64
"""Beyond any raw value."""


class OtherMessages:
    """Of several DBC files, the first that names an identifier counts; one of 29 bits may come from another source address."""

    def __init__(self, databases: Sequence[Mapping[str, MessageBits]] = ()) -> None:
        self._exact: dict[tuple[int, bool], MessageBits] = {}
        self._groups: dict[int, MessageBits] = {}
        for message in (message for messages in databases for message in messages.values() if not message.contradiction):
            self._exact.setdefault((message.frame_id, message.extended), message)
            if message.extended:
                self._groups.setdefault(message.group, message)

    def layout_of(self, identifier: int, extended: bool) -> MessageLayout | None:
        """Names and units of the message that an identifier names; None for one of no DBC."""
        message = self._message(identifier, extended)
        if message is None:
            return None
        signals = tuple(_layout(signal) for signal in message.signals.values() if signal.readable)
        return MessageLayout(message.name, message.frame_id, message.length, 0.0, any_source=False, signals=signals)

    def decode(self, frame: can.Message) -> Frame | None:
        """A frame's values; None for one of no DBC, or shorter than its DBC says."""
        message = self._message(frame.arbitration_id, frame.is_extended_id)
        data = bytes(frame.data)
        if message is None or frame.is_remote_frame or len(data) < message.length:
            return None
        values = {signal.name: _value(message, signal, data) for signal in message.signals.values() if signal.readable}
        return Frame(frame.timestamp, message.name, values)

    def _message(self, identifier: int, extended: bool) -> MessageBits | None:
        found = self._exact.get((identifier, extended))
        return self._groups.get(group_of(identifier)) if found is None and extended else found


def _layout(signal: SignalBits) -> SignalLayout:
    scale = _FINE if signal.kind == "float" else abs(signal.scale)
    return SignalLayout(
        signal.name, 0, signal.bits, scale, signal.offset, signal.unit, _FAR, _FAR, _FAR, codes=None, integral=False
    )


def _value(message: MessageBits, signal: SignalBits, data: bytes) -> Value:
    """NOT_AVAILABLE also for a signal that a frame with this value of the multiplexer does not hold."""
    # They bring numpy along, which a monitor without other DBC files does without.
    from yieldmon.signals.extraction import Extraction, named_no_value
    from yieldmon.signals.long_messages import number

    for page, wanted in message.pages(signal):
        if Extraction(page, 1.0, 0.0).raw(*number(data, page.byte)) not in wanted:
            return NOT_AVAILABLE
    extraction = Extraction(signal, signal.scale, signal.offset, not_available=named_no_value(signal))
    value = extraction.value(*number(data, signal.byte))
    if value != value:  # noqa: PLR0124
        return NOT_AVAILABLE
    whole = signal.kind != "float" and signal.scale == int(signal.scale) and value == int(value)
    return int(value) if whole else value
