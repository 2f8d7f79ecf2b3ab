"""`yieldmon monitor` on a real terminal of 80 x 24 at a saturated bus: its cost, its screens a second, whether it counts right.

    python -m tests.robustness monitor-load [--seconds S] [--rate F] [--json]

The monitor is a process of its own on a pseudo-terminal and hears the bus by python-can's udp_multicast. The virtual combine's
frames and those that answer them are filled up with three other nodes' to F frames a second; 1,800 fill 250 kbit/s. Every screen
that it draws is kept: a row has jumped when it is not where it was on the screen before although that showed the same rows, and
the last screen's counts, identifier by identifier, are held against what was sent. Where the kernel dropped datagrams at the
monitor's socket, these are those counted and dropped together must be what was sent.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import struct
import sys
import termios
import threading
import time
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

GROUP, PORT = "239.74.163.3", 43118
START_LIMIT_S = 60.0
OTHERS = (0x18EF2A17, 0x18EF2A18, 0x18EF2A19)
#: rich goes to the upper left corner before each screen that it draws.
HOME = b"\x1b[H"
CONTROL = re.compile(rb"\x1b\[[0-9;?]*[A-Za-z]")
ROW = re.compile(r" ([0-9A-F]{8}) .{22} +[0-9.]+ +[0-9.]+!? +([0-9]+) ")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness monitor-load", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="length of the traffic (default: 60)")
    parser.add_argument("--rate", type=float, default=1800.0, metavar="F", help="frames a second (default: 1800)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    options = parser.parse_args(arguments)
    if not (5.0 <= options.seconds <= 3600.0 and 500.0 <= options.rate <= 10000.0):
        parser.error("expected 5 to 3600 seconds and 500 to 10000 frames a second")
    document = measure(options.seconds, options.rate)
    if options.json:
        print(json.dumps(document, indent=2))
        return 0
    print(f"load average {document['load_average']:.1f} on {os.cpu_count()} cores")
    print(f"{document['sent']} frames sent, {document['frames_per_s']:.0f} a second")
    print(f"one core: {document['core_share_pct']:.1f} %, screens a second: {document['screens_per_s']:.2f}")
    exact = "every frame that it received" if document["exact"] else "NOT what it received"
    print(f"counted: {document['counted']}, {exact}; dropped by the kernel before the monitor: {document['dropped']}")
    print(f"rows that jumped: {document['jumps']} in {document['screens']} screens")
    return 0


def measure(seconds: float, rate: float) -> dict[str, Any]:
    """Runs the monitor through the traffic."""
    import can

    messages = traffic(seconds, rate)
    terminal = Terminal(["monitor", "-i", "udp_multicast", "-c", GROUP, "--bus-kwargs", f"port={PORT}"])
    sent: Counter[int] = Counter()
    try:
        with can.Bus(GROUP, interface="udp_multicast", port=PORT) as bus:
            terminal.wait_for(b"message")
            dropped, cpu_s, screens, begin_s = terminal.dropped(), terminal.cpu_s(), terminal.drawn(), time.monotonic()
            for message in messages:
                wait_s = begin_s + message.timestamp - time.monotonic()
                if wait_s > 0.0:
                    time.sleep(wait_s)
                bus.send(message)
                sent[message.arbitration_id] += 1
            wall_s = time.monotonic() - begin_s
            cpu_s, screens = terminal.cpu_s() - cpu_s, terminal.drawn() - screens
            # What is on its way still is on the screens of the next second.
            time.sleep(1.5)
            dropped = terminal.dropped() - dropped
    finally:
        pages = terminal.quit()
    places = [rows_of(page) for page in pages]
    counts = {key: count for key, (_, count) in places[-1].items()}
    return {
        "load_average": os.getloadavg()[0],
        "sent": sum(sent.values()),
        "frames_per_s": sum(sent.values()) / wall_s,
        "core_share_pct": 100.0 * cpu_s / wall_s,
        "screens": len(pages),
        "screens_per_s": screens / wall_s,
        "counted": sum(counts.values()),
        "exact": counts == dict(sent) if not dropped else sum(counts.values()) + dropped == sum(sent.values()),
        "dropped": dropped,
        "jumps": sum(jumped(before, after) for before, after in pairwise(places)),
    }


def traffic(seconds: float, rate: float) -> list[Any]:
    """Frames, encoded, with the time of each from 0."""
    import can

    from yieldmon.bus.codec import Codec
    from yieldmon.engine.results import frames_in
    from yieldmon.plant import scenario
    from yieldmon.plant.combine import VirtualCombine
    from yieldmon.resources import shipped
    from yieldmon.service.assembly import build_monitor
    from yieldmon.service.config import configuration

    loaded, codec = configuration.load(shipped("config/yieldmon.yaml")), Codec()
    combine = VirtualCombine(scenario.from_mapping({"duration_s": seconds + 1.0}, "monitor-load"), loaded.machine, 0)
    monitor = build_monitor(loaded.engine, loaded.machine, loaded.parameters)
    messages = []
    for frame in combine.frames_until(seconds):
        for each in (frame, *frames_in(monitor.feed(frame))):
            message = codec.encode(each)
            message.timestamp = frame.time_s
            messages.append(message)
    others = round(rate * seconds) - len(messages)
    for number in range(others):
        at_s, node = seconds * number / others, OTHERS[number % len(OTHERS)]
        messages.append(can.Message(timestamp=at_s, arbitration_id=node, data=number.to_bytes(8, "little")))
    return sorted(messages, key=lambda message: message.timestamp)


def rows_of(page: bytes) -> dict[int, tuple[int, int]]:
    """Identifier -> line on the screen and count."""
    lines = CONTROL.sub(b"", page).decode(errors="replace").splitlines()
    found = ((place, ROW.match(line)) for place, line in enumerate(lines))
    return {int(match[1], 16): (place, int(match[2])) for place, match in found if match}


def jumped(before: dict[int, tuple[int, int]], after: dict[int, tuple[int, int]]) -> bool:
    """Whether a row of the same rows is on another line."""
    return before.keys() == after.keys() and any(before[key][0] != after[key][0] for key in before)


class Terminal:
    """yieldmon on a pseudo-terminal of 80 x 24, read by a thread."""

    def __init__(self, words: list[str]) -> None:
        self._seen = bytearray()
        self._said = threading.Condition()
        self._process, self._master = pty.fork()
        if self._process == 0:
            os.environ.update(TERM="xterm-256color", PYTHONPATH=str(ROOT))
            os.execv(sys.executable, [sys.executable, "-m", "yieldmon", *words])
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def wait_for(self, text: bytes) -> None:
        """Until the text has been written."""
        with self._said:
            if not self._said.wait_for(lambda: text in self._seen, START_LIMIT_S):
                os.kill(self._process, signal.SIGKILL)
                raise SystemExit(f"the monitor did not start: {bytes(self._seen)[-300:]!r}")

    def drawn(self) -> int:
        """Screens so far."""
        with self._said:
            return self._seen.count(HOME)

    def cpu_s(self) -> float:
        """Processor time so far, s."""
        fields = Path(f"/proc/{self._process}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def dropped(self) -> int:
        """Datagrams that the kernel dropped at the process's sockets."""
        links = (os.readlink(link) for link in Path(f"/proc/{self._process}/fd").iterdir())
        inodes = {link.removeprefix("socket:[").rstrip("]") for link in links if link.startswith("socket:")}
        rows = (line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:])
        return sum(int(row[12]) for row in rows if row[9] in inodes)

    def quit(self) -> list[bytes]:
        """All screens drawn."""
        with contextlib.suppress(OSError):
            os.write(self._master, b"q")
        self._thread.join()
        os.waitpid(self._process, 0)
        return bytes(self._seen).split(HOME)[1:]

    def _read(self) -> None:
        while True:
            try:
                piece = os.read(self._master, 65536)
            except OSError:
                return
            with self._said:
                self._seen += piece
                self._said.notify_all()
