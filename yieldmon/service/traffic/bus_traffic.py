"""How many frames came and went since the start."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.bus.opening import time_stamps_of
from yieldmon.bus.receiver import ReceiverCounters
from yieldmon.documents.status import StatusBus
from yieldmon.service.config.service_sections import Bus
from yieldmon.service.traffic.transmit import TransmitCounters

_SPAN_S = 5.0


class FrameRate:
    """Frames received per second, over the last few seconds."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, int]] = []
        self.frames_per_s = 0.0

    def second(self, now_s: float, received: int) -> None:
        """Called about once a second with the count so far; now_s is monotonic."""
        self._seen = [entry for entry in self._seen if now_s - entry[0] <= _SPAN_S] + [(now_s, received)]
        (first_s, first), (last_s, last) = self._seen[0], self._seen[-1]
        self.frames_per_s = (last - first) / (last_s - first_s) if last_s > first_s else 0.0


@dataclass(frozen=True)
class BusTraffic:
    """malformed: frames of ours that could not be decoded. incomplete: messages of several frames of which a part is lost."""

    received: ReceiverCounters
    sent: TransmitCounters
    frames_per_s: float
    malformed: int
    incomplete: int

    def counters(self) -> dict[str, int]:
        """What the store adds up over all starts."""
        received, sent = self.received, self.sent
        return {
            "starts": 1,
            "frames_received": received.received,
            "frames_dropped": received.dropped,
            "kernel_drops": received.kernel_drops,
            "error_frames": received.error_frames,
            "bus_offs": received.bus_offs,
            "interface_losses": received.interface_losses,
            "frames_malformed": self.malformed,
            "frames_sent": sent.sent,
            "frames_late": sent.late,
            "frames_refused": sent.failed,
        }

    def status(self, bus: Bus) -> StatusBus:
        """What `yieldmon status` says of the bus."""
        received, sent = self.received, self.sent
        return {
            "interface": bus.interface,
            "channel": bus.channel,
            "time_stamps": time_stamps_of(bus.interface),
            "frames_per_s": round(self.frames_per_s, 1),
            "received": received.received,
            "dropped": received.dropped,
            "kernel_drops": received.kernel_drops,
            "error_frames": received.error_frames,
            "bus_offs": received.bus_offs,
            "interface_losses": received.interface_losses,
            "failures": received.failures,
            "malformed": self.malformed,
            "incomplete": self.incomplete,
            "sent": sent.sent,
            "late": sent.late,
            "refused": sent.failed,
            "last_refusal": sent.last_failure or None,
        }
