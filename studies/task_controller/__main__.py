"""Our task controller client against a server made of AgIsoStack++: does it take the pool, and does our flow come at 1 Hz?

    python -m studies.task_controller --source FOLDER --build FOLDER [--seconds S] [--log FILE]

`--source` is a checkout of AgIsoStack++ (github.com/Open-Agriculture/AgIsoStack-plus-plus), which is not part of this repository;
`--build` takes what cmake and g++ make of it. The daemon and the virtual combine run as they are, on python-can's udp_multicast;
each frame of that bus goes to the server's port of this machine, and back. Prints one JSON document; the server's log: FILE.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import can

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
GROUP, PORT = "239.74.163.9", 43171
SERVER_PORT, BRIDGE_PORT = 43172, 43173
#: ISO 11783-11: actual yield as mass per time, mg/s.
FLOW_DDI = 87
_VALUE = re.compile(r"^([\d.]+) value ddi (\d+) element (\d+) value (-?\d+)$", re.MULTILINE)


def main() -> int:
    """Exit code 0 when the pool was taken and the flow came at 1 Hz."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", type=Path, required=True, metavar="FOLDER", help="checkout of AgIsoStack++")
    parser.add_argument("--build", type=Path, required=True, metavar="FOLDER", help="for what is compiled")
    parser.add_argument("--seconds", type=float, default=120.0, metavar="S", help="of harvest (default: 120)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="keeps what the server prints")
    options = parser.parse_args()
    server = built(options.source.resolve(), options.build.resolve())
    said = played(server, options.seconds)
    if options.log is not None:
        options.log.write_text(said)
    figures = judged(said)
    print(json.dumps(figures, indent=2))
    return 0 if figures["pool_activated"] and abs(figures["flow_interval_median_s"] - 1.0) < 0.1 else 1


def built(source: Path, build: Path) -> Path:
    """The server's program."""
    settings = ["-DCAN_DRIVER=VirtualCAN", "-DCMAKE_BUILD_TYPE=MinSizeRel"]
    subprocess.run(["cmake", "-S", source, "-B", build, "-G", "Ninja", *settings], check=True, stdout=sys.stderr)
    subprocess.run(["ninja", "-C", build], check=True, stdout=sys.stderr)
    program = build / "yieldmon-task-controller-server"
    includes = [f"-I{source / part / 'include'}" for part in ("isobus", "utility", "hardware_integration")]
    libraries = [str(next(build.rglob(f"lib{name}.a"))) for name in ("HardwareIntegration", "Isobus", "Utility")]
    command = ["g++", "-std=c++14", "-O1", *includes, str(HERE / "server.cpp"), *libraries, "-lpthread", "-o", str(program)]
    subprocess.run(command, check=True)
    return program


def played(server: Path, duration_s: float) -> str:
    """What the server printed while the daemon measured a harvest."""
    bus = {"interface": "udp_multicast", "channel": GROUP, "options": {"port": PORT}}
    yieldmon = [sys.executable, "-m", "yieldmon"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "c.yaml").write_text(json.dumps({"bus": bus, "network": {"task_controller": True}}))
        environment = {**os.environ, "STATE_DIRECTORY": name, "RUNTIME_DIRECTORY": name}
        combine = ["simulate", "-i", "udp_multicast", "-c", GROUP, "--bus-kwargs", f"port={PORT}", "--duration", str(duration_s)]
        with (
            Bridge(),
            open(folder / "server.txt", "w") as out,
            subprocess.Popen([str(server), str(SERVER_PORT), str(BRIDGE_PORT)], stdout=out) as running,
            subprocess.Popen([*yieldmon, "run", "--config", str(folder / "c.yaml")], cwd=ROOT, env=environment) as daemon,
        ):
            try:
                subprocess.run([*yieldmon, *combine], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            finally:
                daemon.send_signal(signal.SIGTERM)
                daemon.wait(20)
                time.sleep(1.0)
                running.send_signal(signal.SIGTERM)
        return (folder / "server.txt").read_text()


class Bridge:
    """Frames of the bus to the server's port, and the server's frames to the bus."""

    def __enter__(self) -> None:
        self._bus = can.Bus(GROUP, interface="udp_multicast", port=PORT)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", BRIDGE_PORT))
        self._socket.settimeout(0.1)
        self._stop = threading.Event()
        self._ours: list[tuple[int, bytes]] = []
        self._lock = threading.Lock()
        self._threads = [threading.Thread(target=work) for work in (self._to_server, self._to_bus)]
        for thread in self._threads:
            thread.start()

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._socket.close()
        self._bus.shutdown()

    def _to_server(self) -> None:
        while not self._stop.is_set():
            message = self._bus.recv(0.1)
            if message is None or not message.is_extended_id:
                continue
            key = (message.arbitration_id, bytes(message.data))
            with self._lock:
                # This kind of bus gives a sender its own frames back.
                if key in self._ours:
                    self._ours.remove(key)
                    continue
            packed = struct.pack(">IB", message.arbitration_id, len(message.data)) + bytes(message.data)
            self._socket.sendto(packed, ("127.0.0.1", SERVER_PORT))

    def _to_bus(self) -> None:
        while not self._stop.is_set():
            try:
                packed = self._socket.recv(64)
            except TimeoutError:
                continue
            identifier, length = struct.unpack_from(">IB", packed)
            data = packed[5 : 5 + length]
            with self._lock:
                self._ours.append((identifier, data))
            self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True))


def judged(said: str) -> dict[str, Any]:
    """What the server's log says of the pool and of the values."""
    values: dict[tuple[int, int], list[tuple[float, int]]] = {}
    for at_s, ddi, element, value in _VALUE.findall(said):
        values.setdefault((int(ddi), int(element)), []).append((float(at_s), int(value)))
    flow = next((found for (ddi, _), found in values.items() if ddi == FLOW_DDI), [])
    steps = [after[0] - before[0] for before, after in itertools.pairwise(flow)]
    return {
        "pool_activated": "pool activated" in said,
        "objects": next((int(found) for found in re.findall(r"pool parsed objects (\d+)", said)), None),
        "offered": [int(ddi) for ddi in re.findall(r"offered ddi (\d+)", said)],
        "client_timeouts": said.count("client timeout"),
        "values": {f"ddi {ddi} element {element}": len(found) for (ddi, element), found in sorted(values.items())},
        "flow_values": len(flow),
        "flow_interval_median_s": round(statistics.median(steps), 3) if steps else float("nan"),
        "flow_interval_largest_s": round(max(steps), 3) if steps else float("nan"),
        "flow_kg_s": [round(value / 1e6, 3) for _, value in flow[-5:]],
    }


if __name__ == "__main__":
    sys.exit(main())
