"""What the daemon costs: its share of one core, and how long after a window's end the result is on the bus.

    python -m tests.robustness daemon-cost [--seconds S] [--waveform] [--json]

The daemon (`yieldmon run`, a process of its own) and the virtual combine meet on python-can's udp_multicast, so no CAN in the
kernel is needed. The combine's frames are made beforehand and sent in real time; shares are the daemon's own processor time (its
/proc entry), so other load on the machine disturbs them little. First nominal traffic, then with other nodes' frames on top to
1,800 frames a second, what fills 250 kbit/s. Every frame passes through Python here, which drops those of other nodes after
having read them; on SocketCAN the kernel does. Latency: from the instant at which a one-second window ends to the instant at
which its MassFlow frame arrives at another process's socket. It holds the wait for the combine's next frame, up to 4 ms.
--waveform: with `waveform.enabled` and `combine`; exit code 1 where pulses or kernel noise were not looked at in the end.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import can

ROOT = Path(__file__).resolve().parents[2]

GROUP, PORT = "239.74.163.2", 43117
FULL_BUS_FRAMES_S = 1800
#: Empty, to learn the zero, then until the flow is steady.
EMPTY_S, WARM_UP_S = 8.0, 16.0
FLOW_KG_S = 12.0
START_LIMIT_S = 120.0
#: Kernel noise needs the empty machine's for longer.
WAVEFORM_EMPTY_S = 25.0
WAVEFORM = {"enabled": True, "combine": True, "thousand_kernel_weight_g": 350.0}


@dataclass(frozen=True)
class Phase:
    """One kind of traffic: name and what was measured over it."""

    name: str
    frames_per_s: float
    core_share_pct: float
    windows: int
    latency_p50_ms: float
    latency_p99_ms: float
    latency_max_ms: float
    missed: int


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness daemon-cost", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0, metavar="S", help="length of each kind of traffic (default: 120)")
    parser.add_argument("--waveform", action="store_true", help="with pulse shape and kernel noise looked at, and combined")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    options = parser.parse_args(arguments)
    if not 5.0 <= options.seconds <= 3600.0:
        parser.error(f"--seconds is {options.seconds:g}; expected 5 to 3600")
    with tempfile.TemporaryDirectory() as folder:
        phases = measure(Path(folder), options.seconds, waveform=options.waveform)
    if options.json:
        print(json.dumps({"load_average": os.getloadavg(), "phases": [vars(phase) for phase in phases]}))
        return 0
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, nice {os.nice(0)}")
    print(f"{'traffic':10} {'frames/s':>9} {'one core':>9} {'p50':>9} {'p99':>9} {'largest':>9} {'windows':>8} {'missed':>7}")
    for p in phases:
        latency = f"{p.latency_p50_ms:6.1f} ms {p.latency_p99_ms:6.1f} ms {p.latency_max_ms:6.1f} ms"
        print(f"{p.name:10} {p.frames_per_s:9.0f} {p.core_share_pct:7.1f} % {latency} {p.windows:8} {p.missed:7}")
    return 0


def measure(folder: Path, seconds: float, *, waveform: bool = False) -> list[Phase]:
    """Runs the daemon through both kinds of traffic."""
    from yieldmon.service.operator.control_client import ask
    from yieldmon.service.operator.control_protocol import ControlError

    configuration = folder / "yieldmon.yaml"
    bus = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT}}
    # JSON is YAML.
    configuration.write_text(json.dumps({"bus": bus, "waveform": WAVEFORM} if waveform else {"bus": bus}))
    folders = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    empty_s = WAVEFORM_EMPTY_S if waveform else EMPTY_S
    warm_up_s = empty_s + WARM_UP_S - EMPTY_S
    messages = traffic(warm_up_s + 2.0 * seconds + 1.0, empty_s)
    command = [sys.executable, "-m", "yieldmon", "run", "--config", str(configuration)]
    daemon = subprocess.Popen(command, cwd=ROOT, env={**os.environ, **folders})
    try:

        def status() -> dict[str, Any]:
            return ask(folder / "yieldmon.sock", {"command": "status"})

        deadline = time.monotonic() + START_LIMIT_S
        while True:
            try:
                status()
                break
            except ControlError as error:
                if daemon.poll() is not None or time.monotonic() > deadline:
                    raise SystemExit("the daemon did not start") from error
                time.sleep(0.1)
        with can.Bus(GROUP, interface="udp_multicast", port=PORT) as sender, Listener() as listener:
            player = Player(sender, messages)
            player.play(warm_up_s, filler=False)
            phases = []
            for name, filler in (("nominal", False), ("full bus", True)):
                before_s, cpu_s, sent = time.monotonic(), cpu_time_s(daemon.pid), player.sent
                listener.begin()
                player.play(seconds, filler)
                wall_s = time.monotonic() - before_s
                share = 100.0 * (cpu_time_s(daemon.pid) - cpu_s) / wall_s
                phases.append(listener.phase(name, (player.sent - sent) / wall_s, share))
        said = status()
        reported, seen = said["bus"], said["waveform"]
        if waveform and (seen["shape_verdict"] != "used" or seen["kernel_verdict"] in ("not_looked_at", "too_early")):
            raise SystemExit(f"the waveform was not looked at: pulses {seen['shape_verdict']}, kernels {seen['kernel_verdict']}")
        # The status is of the last window's end; a second of nominal traffic came after it at most.
        missing = player.own_sent - reported["received"] - player.own_sent * 1.1 / player.played_s
        if reported["dropped"] or reported["late"] or missing > 0.0:
            received = f"{reported['received']} of {player.own_sent} frames received"
            print(f"daemon: {received}, {reported['dropped']} dropped, {reported['late']} late", file=sys.stderr)
        return phases
    finally:
        daemon.send_signal(signal.SIGTERM)
        daemon.wait(START_LIMIT_S)


def traffic(duration_s: float, empty_s: float = EMPTY_S) -> list[Any]:
    """The virtual combine's frames, encoded, with the time of each from 0."""
    from yieldmon.bus.codec import Codec
    from yieldmon.physics.machine import Machine
    from yieldmon.plant import scenario
    from yieldmon.plant.combine import VirtualCombine

    codec = Codec()
    pieces = [
        {"kind": "steady", "duration_s": empty_s, "flow_kg_s": 0.0},
        {"kind": "steady", "duration_s": 1e5, "flow_kg_s": FLOW_KG_S},
    ]
    chosen = scenario.from_mapping({"flow": {"pieces": pieces}, "duration_s": duration_s + 1.0}, "daemon-cost")
    combine = VirtualCombine(chosen, Machine(), 0)
    return [codec.encode(frame) for frame in combine.frames_until(duration_s)]


class Player:
    """Sends frames against absolute deadlines, others' frames between them where asked for."""

    def __init__(self, bus: Any, messages: list[Any]) -> None:
        self.sent = self.own_sent = 0
        self._bus = bus
        self._messages = messages
        self._next = 0
        self._begin_s = time.monotonic()
        self._until_s = 0.0
        # A proprietary message of another node, with a priority of its own.
        self._other = can.Message(arbitration_id=0x18EF2A17, data=bytes(range(8)))
        self._owed = 0.0

    @property
    def played_s(self) -> float:
        """Time played so far."""
        return self._until_s

    def play(self, duration_s: float, filler: bool) -> None:
        """The next duration_s of traffic, in real time."""
        self._until_s += duration_s
        nominal_per_s = len(self._messages) / self._messages[-1].timestamp
        others = (FULL_BUS_FRAMES_S - nominal_per_s) / nominal_per_s if filler else 0.0
        while self._messages[self._next].timestamp < self._until_s:
            message = self._messages[self._next]
            self._next += 1
            wait_s = self._begin_s + message.timestamp - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            self._send(message)
            self.own_sent += 1
            self._owed += others
            while self._owed >= 1.0:
                self._owed -= 1.0
                self._send(self._other)

    def _send(self, message: Any) -> None:
        self._bus.send(message)
        self.sent += 1


class Listener:
    """Takes MassFlow frames on a thread, with the kernel's time of each."""

    def __init__(self) -> None:
        from yieldmon import frames
        from yieldmon.bus.codec import Codec
        from yieldmon.engine.settings import WindowSettings

        self._codec = Codec()
        self._grid_offset_s = WindowSettings().grid_offset_s
        filters = self._codec.filters([frames.MASS_FLOW])
        self._bus = can.Bus(GROUP, interface="udp_multicast", port=PORT, can_filters=filters)
        self._heard: list[tuple[float, int]] = []
        self._from = 0
        self._notifier = can.Notifier(self._bus, [self._hear])

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *exception: object) -> None:
        self._notifier.stop()
        self._bus.shutdown()

    def begin(self) -> None:
        """What comes from now on counts."""
        self._from = len(self._heard)

    def delays_ms(self) -> list[float]:
        """From each window's end to its frame, of those heard since `begin`; by the counter, so also of more than a second."""
        heard = self._heard[self._from :]
        if not heard:
            return []
        end_s = math.floor(heard[0][0] - self._grid_offset_s) + self._grid_offset_s
        passed = accumulate(((b[1] - a[1]) % 256 for a, b in pairwise(heard)), initial=0)
        return [1000.0 * (time_s - end_s - count) for (time_s, _), count in zip(heard, passed, strict=True)]

    def phase(self, name: str, frames_per_s: float, core_share_pct: float) -> Phase:
        """What was heard since `begin`."""
        heard = self._heard[self._from :]
        if len(heard) < 2:
            raise SystemExit(f"{name}: no MassFlow came; is multicast allowed on this machine?")
        latencies = sorted(1000.0 * ((time_s - self._grid_offset_s) % 1.0) for time_s, _ in heard)
        steps = [(b[1] - a[1]) % 256 for a, b in pairwise(heard)]
        return Phase(
            name=name,
            frames_per_s=frames_per_s,
            core_share_pct=core_share_pct,
            windows=len(heard),
            latency_p50_ms=nearest_rank(latencies, 0.5),
            latency_p99_ms=nearest_rank(latencies, 0.99),
            latency_max_ms=latencies[-1],
            missed=sum(step - 1 for step in steps),
        )

    def _hear(self, message: can.Message) -> None:
        frame = self._codec.decode(message)
        counter = frame.signals["WindowCounter"] if frame is not None else None
        assert isinstance(counter, (int, float)), f"{message}: not a flow frame of ours"
        self._heard.append((message.timestamp, int(counter)))


def nearest_rank(ordered: list[float], share: float) -> float:
    """The quantile of sorted values, by nearest rank."""
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def cpu_time_s(pid: int) -> float:
    """Processor time of a process and its threads so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
