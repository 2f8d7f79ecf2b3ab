"""Messages of a bus as the frames that the engine takes: those of the shipped DBC, and those of a mapping."""

from __future__ import annotations

from collections.abc import Sequence

import can

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.frames import OUTPUTS, Frame
from yieldmon.identifiers import EXTENDED_FLAG, LARGEST_EXTENDED_ID
from yieldmon.service.traffic.side_inputs import SideInputs
from yieldmon.signals.decoding import MapDecoder
from yieldmon.signals.mapping import SignalMap


class InputFrames:
    """One bus as one engine receives it."""

    def __init__(self, codec: Codec, signals: SignalMap) -> None:
        self._codec = codec
        self._decoder = MapDecoder(signals)
        self._mapped = bool(signals.groups)
        self._side = SideInputs()
        self._own = signals.own_messages & codec.layouts.keys() | frozenset(OUTPUTS)
        self._wanted = frozenset(signals.sources.messages) | frozenset(OUTPUTS)
        self._plain = frozenset(
            name
            for name in self._own & self._wanted - frozenset(OUTPUTS)
            if not self._side.supersedes(codec.layouts[name].identity)
        )
        """Messages whose frames go on as they are: most of what comes."""

    def frames(self, message: can.Message) -> list[Frame]:
        """The frames for the engine that a message brings, usually none or one. Raises FrameError for one of the wrong length."""
        return self.receive(message)[0]

    def receive(self, message: can.Message) -> tuple[list[Frame], Sequence[str]]:
        """The same, and the names of frames in it that only a yield monitor sends."""
        if message.is_error_frame or message.is_remote_frame:
            return [], ()
        found = self._mapped_frames(message) if self._mapped else []
        own = self._codec.decode(message, self._own)
        if own is not None and own.message in self._plain and not found:
            return [own], ()
        found += [frame for frame in self._side.frames(message, own) if frame.message in self._wanted]
        published = [frame.message for frame in found if frame.message in OUTPUTS]
        return [frame for frame in found if frame.message not in OUTPUTS] if published else found, published

    @property
    def incomplete(self) -> int:
        """Messages of several frames that were begun and are given up: a part is lost."""
        return self._decoder.incomplete

    @property
    def under_way(self) -> int:
        """Messages of which parts are still to come."""
        return self._decoder.under_way

    def filters(self) -> list[can.typechecking.CanFilter]:
        """python-can filters that let through what the engine takes, and what only a yield monitor sends."""
        return self._codec.filters(sorted(OUTPUTS)) + self.input_filters()

    def input_filters(self) -> list[can.typechecking.CanFilter]:
        """Those for what the engine takes."""
        own = self._codec.filters(sorted(self._own - frozenset(OUTPUTS)))
        mapped: list[can.typechecking.CanFilter] = [
            {
                "can_id": match.identity & LARGEST_EXTENDED_ID,
                "can_mask": match.mask & LARGEST_EXTENDED_ID,
                "extended": bool(match.identity & EXTENDED_FLAG),
            }
            for match in self._decoder.matches
        ]
        return own + mapped + self._side.filters()

    def _mapped_frames(self, message: can.Message) -> list[Frame]:
        refused = self._decoder.refused
        found = self._decoder.decode(message.timestamp, message.arbitration_id, message.is_extended_id, bytes(message.data))
        if self._decoder.refused > refused and not found:
            raise FrameError(f"0x{message.arbitration_id:X}: a message with fewer bytes of data than its DBC says")
        return found
