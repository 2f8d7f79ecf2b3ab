"""Faults that only the service sees: those of the bus, its threads, the network and the store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from yieldmon.bus.receiver import BusEvent, BusEventKind
from yieldmon.engine.faults import FaultCode
from yieldmon.service.conditions import Conditions
from yieldmon.service.storage.writer import StoreHealth
from yieldmon.service.traffic.transmit import TransmitCounters
from yieldmon.units import counted

#: How long a condition counts as present after it was last seen or has ended: the shortest must outlast a window.
_HOLD_S = 3.0
_FOREVER = float("inf")
#: A thread that gives no sign of life for so long is a fault.
_HANGS_S = 2.0
#: From this wait on a disk that is slow rather than broken is a fault.
_SLOW_STORE_S = 10.0
#: Faults and the conditions that are behind each.
_NAMES = {
    FaultCode.BUS_ERROR: ("interface", "bus-off", "errors", "transmit", "late", "receive-thread", "transmit-thread"),
    FaultCode.FRAMES_LOST: ("dropped",),
    FaultCode.OUTPUT_CONFLICT: ("conflict",),
}


class ServiceFaults:
    """What holds at present, and what of it has been reported. Times are monotonic seconds."""

    def __init__(self) -> None:
        self._conditions = Conditions()
        self._reported: dict[FaultCode, str] = {}

    def bus_event(self, event: BusEvent, now_s: float) -> None:
        """The receiver has found this on the bus."""
        kind, until_s = event.kind, now_s + _HOLD_S
        detail = f"{kind.value}: {event.detail}" if event.detail else kind.value
        if kind in (BusEventKind.INTERFACE_LOST, BusEventKind.RECEIVER_FAILED):
            self._conditions.present("interface", _FOREVER, detail)
        elif kind is BusEventKind.INTERFACE_RESTORED:
            self._conditions.present("interface", until_s, detail)
            self._conditions.ended("bus-off")
        elif kind is BusEventKind.BUS_OFF:
            self._conditions.present("bus-off", _FOREVER, detail)
        elif kind is BusEventKind.BUS_RESTARTED:
            self._conditions.present("bus-off", until_s, detail)
        elif kind is BusEventKind.FRAMES_DROPPED:
            self._conditions.present("dropped", until_s, f"{counted(event.count, 'frame')}: {event.detail}")
        else:
            self._conditions.present("errors", until_s, detail)

    def conflict(self, name: str, now_s: float) -> None:
        """Another node sends a frame of this name, which is ours."""
        self._conditions.present("conflict", now_s + _HOLD_S, f"{name} from another node")

    def changes(
        self,
        now_s: float,
        *,
        sent: TransmitCounters,
        hangs_s: Mapping[str, float],
        store: StoreHealth,
        store_note: str,
        network: Sequence[str],
    ) -> dict[FaultCode, str]:
        """Each fault that came, went or changed since the last call, and what is said of it; empty where it has gone.

        hangs_s: for how long each thread has given no sign of life. store_note: what is said of a store that works.
        network: the network's troubles.
        """
        if sent.failing(now_s):
            self._conditions.present("transmit", now_s + _HOLD_S, f"frames not sent: {sent.last_failure}")
        if sent.late_now(now_s):
            self._conditions.present("late", now_s + _HOLD_S, "frames not sent in time")
        for name, silent_s in hangs_s.items():
            if silent_s > _HANGS_S:
                self._conditions.present(f"{name}-thread", now_s + _HOLD_S, f"the {name} thread hangs")
        found = {code: "; ".join(self._conditions.details(now_s, names)) for code, names in _NAMES.items()}
        found[FaultCode.NETWORK_FAULT] = "; ".join(network)
        found[FaultCode.STORE_FAILING] = store_trouble(store, store_note)
        if found == self._reported:
            return {}
        changed = {code: detail for code, detail in found.items() if self._reported.get(code, "") != detail}
        self._reported = found
        return changed

    def report_all_anew(self) -> None:
        """The next `changes` has every fault that holds: a new monitor knows of none."""
        self._reported.clear()


def store_trouble(health: StoreHealth, note: str) -> str:
    """What is wrong with the store; empty where nothing is."""
    if health.failing:
        return health.failing
    if health.waiting_s > _SLOW_STORE_S:
        return f"the disk is slow, {counted(health.pending, 'second')} waiting"
    if health.batches_refused:
        return f"{health.batches_refused} records could not be stored"
    return "; ".join(part for part in (note, health.replaced_because) if part)
