"""Requests to a daemon that measures, by the clock: how long until the answer, and whether those to others get one.

    python -m tests.robustness request-times [--count N] [--seed S]

A daemon on python-can's virtual bus, nominal traffic in real time, and N requests of each kind at random moments from a node of
its own: address claim, software identification (by a connection, which the node ends at once), the last mass flow, a group that
we do not have; and N requests to another address. Prints one JSON document; exit code 1 where an answer takes over 250 ms, is
missing, or comes unasked.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import can

from tests.service.bench import CODEC, traffic
from yieldmon.network.identifier import ACKNOWLEDGEMENT, ADDRESS_CLAIMED, TRANSPORT_CONNECTION, Identifier
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon

LIMIT_S = 0.25
CHANNEL = "request-times"
ASKER, OTHER = 0x17, 0x84
SOFTWARE, MASS_FLOW, NOT_OURS = 0xFEDA, 0xFF16, 0xFEE5
#: What is asked -> the group by which it is answered.
KINDS = {
    "address claim": (ADDRESS_CLAIMED, ADDRESS_CLAIMED), "software identification": (SOFTWARE, TRANSPORT_CONNECTION),
    "mass flow": (MASS_FLOW, MASS_FLOW), "group that we do not have": (NOT_OURS, ACKNOWLEDGEMENT),
}  # fmt: skip
#: Groups to all that only a request brings.
UNASKED = (ACKNOWLEDGEMENT, ADDRESS_CLAIMED)
_REQUEST_TO_SEND, _ABORT = 16, 255


class Asker:
    """A node that asks; `answers` has the time of the first frame of each group from our address since `ask`."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.heard: list[tuple[float, int]] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        while True:
            message = self._bus.recv(1.0)
            if message is None or not message.is_extended_id:
                continue
            self.heard.append((time.monotonic(), message.arbitration_id))
            parts = Identifier.of(message.arbitration_id)
            if parts.group == TRANSPORT_CONNECTION and parts.destination == ASKER and message.data[0] == _REQUEST_TO_SEND:
                abort = bytes([_ABORT, 1, 255, 255, 255, *message.data[5:8]])
                identifier = 0x1CEC0000 | parts.source << 8 | ASKER
                self._bus.send(can.Message(arbitration_id=identifier, data=abort, is_extended_id=True))

    def ask(self, group: int, address: int) -> float:
        """Sends a request; when."""
        self.heard.clear()
        data = group.to_bytes(3, "little")
        at_s = time.monotonic()
        self._bus.send(can.Message(arbitration_id=0x18EA0000 | address << 8 | ASKER, data=data, is_extended_id=True))
        return at_s

    def answer_s(self, group: int, since_s: float, address: int) -> float | None:
        """When the first frame of a group came from an address, None within twice the limit."""
        while time.monotonic() - since_s < 2.0 * LIMIT_S:
            for at_s, identifier in tuple(self.heard):
                parts = Identifier.of(identifier)
                if parts.group == group and parts.source == address and at_s >= since_s:
                    return at_s - since_s
            time.sleep(0.002)
        return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when all answers to us come in time, and none to others."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness request-times", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, metavar="N", help="of each kind (default: 200)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="(default: 1)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        figures, within = measured(Path(name), options.count, random.Random(options.seed))
    print(json.dumps({"load_average": round(os.getloadavg()[0], 1), "count": options.count, **figures, "within": within}))
    return 0 if within else 1


def measured(folder: Path, count: int, draw: random.Random) -> tuple[dict[str, object], bool]:
    """Times of the answers by kind, and how often others' requests were answered."""
    path = folder / "c.yaml"
    path.write_text("bus: {transmit_max_age_s: 5}")
    loaded = configuration.load(path, {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)})
    daemon = Daemon(loaded, bus_factory=lambda: can.Bus(interface="virtual", channel=CHANNEL))
    running = threading.Thread(target=daemon.run)
    running.start()
    stop = threading.Event()
    playing = threading.Thread(target=play, args=(stop,))
    try:
        assert daemon.started.wait(30.0)
        playing.start()
        asker = Asker(can.Bus(interface="virtual", channel=CHANNEL))
        time.sleep(5.0)
        us = loaded.document.network.preferred_address
        times: dict[str, list[float | None]] = {kind: [] for kind in KINDS}
        unasked = 0
        for _ in range(count):
            for kind, (group, answer) in KINDS.items():
                time.sleep(draw.uniform(0.01, 0.15))
                times[kind].append(asker.answer_s(answer, asker.ask(group, us), us))
            asked_s = asker.ask(draw.choice([SOFTWARE, NOT_OURS, ADDRESS_CLAIMED]), OTHER)
            time.sleep(LIMIT_S)
            answers = [Identifier.of(i) for at_s, i in tuple(asker.heard) if at_s >= asked_s]
            unasked += sum(one.source == us and (one.destination == ASKER or one.group in UNASKED) for one in answers)
    finally:
        stop.set()
        daemon.request_stop()
        running.join(20.0)
    figures: dict[str, object] = {}
    for kind, found in times.items():
        known = [one for one in found if one is not None]
        worst = round(max(known), 3) if known else None
        median = round(statistics.median(known), 4) if known else None
        figures[kind] = {"answers": len(known), "median_s": median, "largest_s": worst}
    within = not unasked and all(one is not None and one <= LIMIT_S for found in times.values() for one in found)
    return {**figures, "requests_to_others": count, "answers_to_those": unasked}, within


def play(stop: threading.Event) -> None:
    """Nominal traffic at its own pace."""
    began_s = time.monotonic()
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        for frame in traffic(0.0, 3600.0, 30.0):
            if stop.is_set():
                return
            wait_s = began_s + frame.time_s - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            message = CODEC.encode(frame)
            message.timestamp = time.time()
            bus.send(message)


if __name__ == "__main__":
    sys.exit(main())
