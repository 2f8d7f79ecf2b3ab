"""Faults that the service alone sees, against a plain list of what holds until when; only what changed is handed on."""

from __future__ import annotations

from math import inf
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.bus.receiver import BusEvent, BusEventKind
from yieldmon.engine.faults import FaultCode
from yieldmon.service.storage.writer import StoreHealth
from yieldmon.service.traffic.service_faults import ServiceFaults
from yieldmon.service.traffic.transmit import TransmitCounters

HELD_S = 3.0
"""How long what has no end of its own is shown."""
HANGS_S = 2.0
"""Without a sign of life, a thread hangs beyond this."""
KIND = BusEventKind
ORDER = {
    FaultCode.BUS_ERROR: ("interface", "bus-off", "errors", "transmit", "late", "receive-thread", "transmit-thread"),
    FaultCode.FRAMES_LOST: ("dropped",),
    FaultCode.OUTPUT_CONFLICT: ("conflict",),
}

EVENTS = st.tuples(st.sampled_from(list(KIND)), st.sampled_from(["", "can0"]), st.integers(1, 3))
LOOKS = st.fixed_dictionaries({
    "failed_ago_s": st.sampled_from([inf, 0.0, 1.5, 2.0]), "late_ago_s": st.sampled_from([inf, 0.0, 1.5, 2.0]),
    "receive_hangs_s": st.sampled_from([0.0, HANGS_S, HANGS_S + 0.5]), "network": st.sampled_from([(), ("a",), ("a", "b")]),
    "store": st.sampled_from([StoreHealth(), StoreHealth(failing="full"), StoreHealth(batches_refused=2)]),
    "note": st.sampled_from(["", "was damaged"]),
})  # fmt: skip
STEPS = st.lists(
    st.tuples(st.sampled_from([0.0, 0.5, 1.0, HELD_S]), st.one_of(EVENTS, st.just("conflict"), st.just("anew"), LOOKS)),
    max_size=25,
)


class Plain:
    """name -> (until, what is said)."""

    def __init__(self) -> None:
        self.held: dict[str, tuple[float, str]] = {}

    def event(self, kind: BusEventKind, detail: str, count: int, now_s: float) -> None:
        said, until_s = f"{kind.value}: {detail}" if detail else kind.value, now_s + HELD_S
        if kind in (KIND.INTERFACE_LOST, KIND.RECEIVER_FAILED):
            self.held["interface"] = inf, said
        elif kind is KIND.INTERFACE_RESTORED:
            self.held["interface"] = until_s, said
            self.held.pop("bus-off", None)
        elif kind is KIND.BUS_OFF:
            self.held["bus-off"] = inf, said
        elif kind is KIND.BUS_RESTARTED:
            self.held["bus-off"] = until_s, said
        elif kind is KIND.FRAMES_DROPPED:
            self.held["dropped"] = until_s, f"{count} frame{'s' if count > 1 else ''}: {detail}"
        else:
            self.held["errors"] = until_s, said

    def shown(self, now_s: float, look: dict) -> dict[FaultCode, str]:  # type: ignore[type-arg]
        until_s = now_s + HELD_S
        if look["failed_ago_s"] < 2.0:
            self.held["transmit"] = until_s, "frames not sent: no buffer"
        if look["late_ago_s"] < 2.0:
            self.held["late"] = until_s, "frames not sent in time"
        if look["receive_hangs_s"] > HANGS_S:
            self.held["receive-thread"] = until_s, "the receive thread hangs"
        self.held = {name: held for name, held in self.held.items() if held[0] > now_s}
        found = {code: "; ".join(self.held[name][1] for name in names if name in self.held) for code, names in ORDER.items()}
        store = look["store"]
        troubled = store.failing or (
            f"{store.batches_refused} records could not be stored" if store.batches_refused else look["note"]
        )
        return {**found, FaultCode.NETWORK_FAULT: "; ".join(look["network"]), FaultCode.STORE_FAILING: troubled}


@settings(max_examples=200)
@given(STEPS)
def test_what_is_handed_on_is_what_a_list_of_conditions_says(steps: list) -> None:  # type: ignore[type-arg]
    faults, plain, now_s = ServiceFaults(), Plain(), 100.0
    told: dict[FaultCode, str] = {}
    for wait_s, step in steps:
        now_s += wait_s
        if step == "anew":
            faults.report_all_anew()
            told = {}
        elif step == "conflict":
            faults.conflict("MassFlow", now_s)
            plain.held["conflict"] = now_s + HELD_S, "MassFlow from another node"
        elif isinstance(step, tuple):
            kind, detail, count = step
            faults.bus_event(BusEvent(kind, 5.0, detail, count), now_s)
            plain.event(kind, detail, count, now_s)
        else:
            look = SimpleNamespace(**step)
            sent = TransmitCounters(
                last_failure="no buffer", last_failure_at_s=now_s - look.failed_ago_s, last_late_at_s=now_s - look.late_ago_s
            )
            hangs_s = {"receive": look.receive_hangs_s, "transmit": 0.0}
            changed = faults.changes(
                now_s, sent=sent, hangs_s=hangs_s, store=look.store, store_note=look.note, network=look.network
            )
            shown = plain.shown(now_s, step)
            assert changed == {code: detail for code, detail in shown.items() if told.get(code, "") != detail}
            told = shown
