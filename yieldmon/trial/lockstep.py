"""Virtual combine and monitor on one virtual CAN bus, in lock step on bus time, as fast as the machine goes."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass

import can

from yieldmon.bus.codec import Codec
from yieldmon.bus.waiting import receive
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import frames_in
from yieldmon.frames import Frame
from yieldmon.plant.combine import Truth, VirtualCombine

Progress = Callable[[float], None]
"""Called with the bus time reached, s, about once a second of it."""


@dataclass(frozen=True)
class Run:
    """What a run left: the frames that the monitor published, the truth, and the number of frames on the bus."""

    published: list[Frame]
    truth: Truth
    frames_on_bus: int


def run(combine: VirtualCombine, monitor: Monitor, codec: Codec, progress: Progress | None = None) -> Run:
    """Let the combine run to its scenario's end with the monitor listening and answering.

    Every frame is encoded, sent on a python-can virtual bus of its own, received by the other node and decoded there; each
    frame is answered before the next is sent, so the outcome does not depend on the speed of the machine.
    Raises RuntimeError where the virtual bus loses one.
    """
    channel = f"yieldmon-{uuid.uuid4()}"
    published: list[Frame] = []
    count = 0
    reported_s = 0.0
    with (
        can.Bus(channel, interface="virtual", preserve_timestamps=True) as combine_side,
        can.Bus(channel, interface="virtual", preserve_timestamps=True) as monitor_side,
    ):
        for sent in combine.frames_until(combine.scenario.duration_s):
            count += 1
            for answer in frames_in(monitor.feed(_passed_on(sent, combine_side, monitor_side, codec))):
                heard = _passed_on(answer, monitor_side, combine_side, codec)
                count += 1
                published.append(heard)
                combine.handle(heard)
            if progress is not None and sent.time_s - reported_s >= 1.0:
                reported_s = sent.time_s
                progress(reported_s)
    return Run(published, combine.truth, count)


def _passed_on(frame: Frame, sender: can.BusABC, recipient: can.BusABC, codec: Codec) -> Frame:
    """The frame as the other side of the bus decodes it. Raises RuntimeError where the bus loses it."""
    sender.send(codec.encode(frame))
    message = receive(recipient, 1.0)
    received = codec.decode(message) if message is not None else None
    if received is None:
        raise RuntimeError(f"the virtual bus lost {frame.message} of {frame.time_s:.3f} s")
    return received
