"""Two daemons on one bus: who keeps the address, how soon both say so, and that the one without an address publishes nothing.

    python -m tests.robustness two-daemons [--seconds S] [--case NAME]

Each case starts two `yieldmon run` processes with stores of their own on python-can's udp_multicast, the second one while the
first measures nominal traffic in real time. The NAMEs' identity numbers say who must win. For S seconds it is heard which
addresses MassFlow comes from, and asked when each daemon shows which fault. Exit code 1 where the loser publishes from the
winner's address, or anything at all where it may take no other one; where OutputConflict or the loser's NetworkFault takes
longer than --fault-s from the other's first MassFlow or claim; or where the first one, as the winner, misses a window.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import can

from tests.robustness.daemon_cost import ROOT, START_LIMIT_S, WARM_UP_S, Player, traffic
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError

GROUP, PORT, ADDRESS = "239.74.163.3", 43118, 131
LOW, HIGH = 1000, 2000
"""Identity numbers: the lower NAME keeps an address."""
_LOOK_S = 0.05


@dataclass(frozen=True)
class Case:
    """Identity numbers of the first and the second, whether they may take another address, and whether they claim at all."""

    name: str
    first: int
    second: int
    movable: bool = True
    claims: bool = True


CASES = (
    Case("the first one keeps the address", LOW, HIGH),
    Case("the second one takes it", HIGH, LOW),
    Case("the first one keeps it and the second has no other", LOW, HIGH, movable=False),
    Case("the second one takes it and the first has no other", HIGH, LOW, movable=False),
    Case("one NAME for both", LOW, LOW),
    Case("no claims", LOW, HIGH, claims=False),
)


@dataclass
class Daemon:
    """One of the two, with the time at which each fault was first shown."""

    folder: Path
    process: subprocess.Popen[bytes]
    faults_s: dict[str, float] = field(default_factory=dict)
    status: dict[str, Any] = field(default_factory=dict)

    def look(self) -> None:
        """Ask for the status."""
        with suppress(ControlError):
            self.status = ask(self.folder / "yieldmon.sock", {"command": "status"}, 2.0)
            for fault in self.status["faults"]:
                self.faults_s.setdefault(fault["code"], time.time())


@contextmanager
def started(folder: Path, identity: int, case: Case) -> Iterator[Daemon]:
    """A daemon, once its socket answers."""
    folder.mkdir()
    bus = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT}}
    network = {
        "enabled": case.claims, "identity_number": identity, "preferred_address": ADDRESS,
        "arbitrary_address_capable": case.movable,
    }  # fmt: skip
    (folder / "c.yaml").write_text(json.dumps({"bus": bus, "network": network}))
    environment = {**os.environ, "STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    command = [sys.executable, "-m", "yieldmon", "run", "--config", str(folder / "c.yaml")]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=log)
    try:
        daemon = Daemon(folder, process)
        until_s = time.monotonic() + START_LIMIT_S
        while not daemon.status:
            if process.poll() is not None or time.monotonic() > until_s:
                raise SystemExit(f"the daemon did not start: {(folder / 'log').read_text()[-500:]}")
            time.sleep(_LOOK_S)
            daemon.look()
        yield daemon
    finally:
        process.terminate()
        process.wait(60.0)


class Listener:
    """On a thread: the source of each MassFlow and address claim, with the kernel's time."""

    def __init__(self) -> None:
        from yieldmon import frames
        from yieldmon.bus.codec import Codec

        self._codec = Codec()
        [accepted] = self._codec.filters([frames.MASS_FLOW])
        group = (accepted["can_id"] >> 8) & 0x3FFFF
        self._groups = {group: "flow", 0xEE00 | 0xFF: "claim"}
        self._bus = can.Bus(GROUP, interface="udp_multicast", port=PORT)
        self.heard: list[tuple[str, float, int, int]] = []
        """Kind, time, source address; window's counter or identity number."""
        self._notifier = can.Notifier(self._bus, [self._hear])

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *exception: object) -> None:
        self._notifier.stop()
        self._bus.shutdown()

    def _hear(self, message: can.Message) -> None:
        kind = self._groups.get((message.arbitration_id >> 8) & 0x3FFFF)
        if kind is None:
            return
        if kind == "claim":
            number = int.from_bytes(message.data[:3], "little") & 0x1FFFFF
        else:
            frame = self._codec.decode(message)
            number = int(frame.signals["WindowCounter"]) if frame is not None else -1  # type: ignore[arg-type]
        self.heard.append((kind, message.timestamp, message.arbitration_id & 0xFF, number))


def run(case: Case, folder: Path, seconds: float, fault_s: float) -> tuple[dict[str, Any], bool]:
    """Figures of a case, and whether all held."""
    messages = traffic(WARM_UP_S + seconds + START_LIMIT_S)
    with ExitStack() as stack:
        sender = stack.enter_context(can.Bus(GROUP, interface="udp_multicast", port=PORT))
        listener = stack.enter_context(Listener())
        first = stack.enter_context(started(folder / "first", case.first, case))
        player = Player(sender, messages)
        player.play(WARM_UP_S, filler=False)
        begun_s = time.time()
        over = threading.Event()
        second: list[Daemon] = []

        def watch() -> None:
            with started(folder / "second", case.second, case) as other:
                second.append(other)
                while not over.wait(_LOOK_S):
                    first.look()
                    other.look()

        watching = threading.Thread(target=watch)
        watching.start()
        while not second:
            player.play(0.5, filler=False)
        player.play(seconds, filler=False)
        over.set()
        watching.join()
    return _judged(case, first, second[0], listener.heard, begun_s, fault_s)


def _judged(
    case: Case, first: Daemon, second: Daemon, heard: Sequence[tuple[str, float, int, int]], begun_s: float, fault_s: float
) -> tuple[dict[str, Any], bool]:
    claims = [(at, source, number) for kind, at, source, number in heard if kind == "claim" and at >= begun_s]
    flows = [(at, source, number) for kind, at, source, number in heard if kind == "flow" and at >= begun_s]
    contested_s = next((at for at, source, number in claims if source == ADDRESS and number == case.second), None)
    winner, loser = (first, second) if case.first <= case.second else (second, first)
    begin = contested_s if contested_s is not None else begun_s
    twice = case.first == case.second or not case.claims
    # Without a claim that decides, both go on from one address.
    counters = [number for at, source, number in flows if source == ADDRESS]
    steps = {(b - a) % 256 for a, b in pairwise(counters)} if not twice and winner is first else {1}
    others = {source for at, source, _ in flows if at > begin + 0.5} - {ADDRESS}
    both_s = _both_publish_s(flows, begin, case, twice)

    def delay(daemon: Daemon, code: str, from_s: float | None) -> float | None:
        shown = daemon.faults_s.get(code)
        return None if shown is None or from_s is None else round(shown - from_s, 2)

    conflicts = [delay(daemon, "OutputConflict", both_s) for daemon in (first, second)]
    network = delay(loser, "NetworkFault", begin)
    held = steps == {1} and all(daemon.process.returncode in (0, None) for daemon in (first, second))
    if twice or case.movable:
        held &= all(shown is not None and shown <= fault_s for shown in conflicts)
    if not twice:
        held &= loser.status["network"]["address"] != ADDRESS and winner.status["network"]["address"] == ADDRESS
        held &= bool(others) if case.movable else not others
        # Whoever finds an address taken when it starts has lost nothing that it had.
        held &= not (loser is first or not case.movable) or (network is not None and network <= fault_s)
    elif case.claims:
        held &= network is not None and network <= fault_s
    return {
        "case": case.name, "held": held, "winner_window_steps": sorted(steps), "addresses_of_flow": sorted(others | {ADDRESS}),
        "conflict_after_s": conflicts, "network_fault_after_s": network,
        "addresses": [daemon.status["network"]["address"] for daemon in (first, second)],
        "claims": [daemon.status["network"]["claim"] for daemon in (first, second)],
        "faults": [sorted(daemon.faults_s) for daemon in (first, second)],
    }, held  # fmt: skip


def _both_publish_s(flows: Sequence[tuple[float, int, int]], begin_s: float, case: Case, twice: bool) -> float | None:
    """When for the first time both have published a flow."""
    if not twice:
        return next((at for at, source, _ in flows if source != ADDRESS), None)
    return next((b[0] for a, b in pairwise(flows) if (b[2] - a[2]) % 256 != 1), None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when all held."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness two-daemons", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=8.0, metavar="S", help="with both (default: 8)")
    parser.add_argument("--fault-s", type=float, default=2.0, metavar="S", help="for a fault to be shown (default: 2)")
    parser.add_argument("--case", choices=[case.name for case in CASES], help="default: all")
    options = parser.parse_args(arguments)
    found = []
    for case in [case for case in CASES if options.case in (None, case.name)]:
        with tempfile.TemporaryDirectory() as folder:
            found.append(run(case, Path(folder), options.seconds, options.fault_s))
        print(json.dumps(found[-1][0]), flush=True)
    held = all(holds for _, holds in found)
    print(json.dumps({"cases": len(found), "held": held, "load_average": round(os.getloadavg()[0], 1)}))
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
