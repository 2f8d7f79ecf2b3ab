"""Frames on their way out: encoded, from our address, into the transmitter's queue."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

import can

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.frames import PLATE_ACTUATOR_COMMAND, Frame
from yieldmon.identifiers import SOURCE_MASK
from yieldmon.service.traffic.link import Link
from yieldmon.service.traffic.mapped_outputs import OutputMessage
from yieldmon.service.traffic.transmit import Transmitter

_log = logging.getLogger(__name__)


class FrameSender:
    """What the engine, the mapping and the network send."""

    def __init__(self, codec: Codec, link: Link, transmitter: Transmitter, clock: Callable[[], float]) -> None:
        """clock: times the network's protocols."""
        self._codec = codec
        self._link = link
        self._transmitter = transmitter
        self._clock = clock
        self._unsendable = 0

    def send(self, messages: Iterable[can.Message]) -> None:
        """Messages as they are to go."""
        self._transmitter.submit(*messages)

    def send_frames(self, out: Iterable[Frame]) -> None:
        """The engine's frames; the first that cannot be encoded is said in the log."""
        messages = []
        for frame in out:
            try:
                # A late command is worse than none.
                waits_from_s = None if frame.message == PLATE_ACTUATOR_COMMAND else self._clock()
                message = self._link.addressed(self._codec.encode(frame), waits_from_s)
            except FrameError as error:
                self._unsendable += 1
                if self._unsendable == 1:
                    _log.error("%s", error)
                continue
            if message is not None:
                messages.append(message)
        self._transmitter.submit(*messages)

    def send_mapped(self, out: Iterable[OutputMessage]) -> None:
        """Frames of the configuration's `outputs`."""
        for item in out:
            message: can.Message | None = item.message
            if item.own_address:
                if self._link.address is not None:
                    item.message.arbitration_id = item.message.arbitration_id & ~SOURCE_MASK | self._link.address
                message = self._link.addressed(item.message, self._clock() if item.may_wait else None)
            if message is not None:
                self._transmitter.submit(message)
