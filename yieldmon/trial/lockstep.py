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
    told_s = 0.0
    with (
        can.Bus(channel, interface="virtual", preserve_timestamps=True) as combine_side,
        can.Bus(channel, interface="virtual", preserve_timestamps=True) as monitor_side,
    ):
        for sent in combine.frames_until(combine.scenario.duration_s):
            combine_side.send(codec.encode(sent))
            count += 1
            received = receive(monitor_side, 1.0)
            frame = codec.decode(received) if received is not None else None
            if frame is None:
                raise RuntimeError(f"the virtual bus lost {sent.message} of {sent.time_s:.3f} s")
            for answer in frames_in(monitor.feed(frame)):
                monitor_side.send(codec.encode(answer))
                back = receive(combine_side, 1.0)
                heard = codec.decode(back) if back is not None else None
                if heard is None:
                    raise RuntimeError(f"the virtual bus lost {answer.message} of {answer.time_s:.3f} s")
                count += 1
                published.append(heard)
                combine.handle(heard)
            if progress is not None and sent.time_s - told_s >= 1.0:
                told_s = sent.time_s
                progress(told_s)
    return Run(published, combine.truth, count)
