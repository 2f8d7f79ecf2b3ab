"""Our task controller client against a server made of AgIsoStack++: does it take the pool, and does our flow come at 1 Hz?

    python -m studies.task_controller --source FOLDER --build FOLDER
    tools/vcan-vm --machine qemu --host-time --share OUT -- python -m studies.task_controller --build FOLDER
        [--seconds S] [--log OUT/FILE]

`--source` is a checkout of AgIsoStack++ (github.com/Open-Agriculture/AgIsoStack-plus-plus), which is not part of this repository;
`--build` takes what cmake and g++ make of it. Server, daemon and virtual combine run as they are on a SocketCAN interface. Prints
one JSON document; the server's log: FILE.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SERVER, EXAMPLE = "yieldmon-task-controller-server", "task-controller-server-example"
#: ISO 11783-11: actual yield as mass per time, mg/s.
FLOW_DDI = 87
_VALUE = re.compile(r"^([\d.]+) value ddi (\d+) element (\d+) value (-?\d+)$", re.MULTILINE)


def main() -> int:
    """Exit code 0 when the programs are built, or the pool was taken and values came; the example asks for none."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", type=Path, required=True, metavar="FOLDER", help="for what is compiled")
    parser.add_argument("--source", type=Path, metavar="FOLDER", help="checkout of AgIsoStack++: compile it, and play nothing")
    parser.add_argument("--channel", default="vcan0", help="SocketCAN interface to play on (default: vcan0)")
    parser.add_argument("--example", action="store_true", help="the library's own example program, which knows can0 only")
    parser.add_argument("--seconds", type=float, default=120.0, metavar="S", help="of harvest (default: 120)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="keeps what the server prints")
    options = parser.parse_args()
    if options.source is not None:
        build(options.source.resolve(), options.build.resolve())
        return 0
    command = [str(options.build / (EXAMPLE if options.example else SERVER))]
    channel = "can0" if options.example else options.channel
    said = played(command if options.example else [*command, channel], channel, options.seconds)
    if options.log is not None:
        options.log.write_text(said)
    figures = {"pool_activated": "Object pool activated" in said} if options.example else judged(said)
    print(json.dumps(figures, indent=2))
    return 0 if figures["pool_activated"] and (options.example or abs(figures["flow_interval_median_s"] - 1.0) < 0.1) else 1


def build(source: Path, folder: Path) -> None:
    """The library, our server and its own example program."""
    settings = ["-DCAN_DRIVER=SocketCAN", "-DCMAKE_BUILD_TYPE=MinSizeRel"]
    subprocess.run(["cmake", "-S", source, "-B", folder, "-G", "Ninja", *settings], check=True, stdout=sys.stderr)
    subprocess.run(["ninja", "-C", folder], check=True, stdout=sys.stderr)
    includes = [f"-I{source / part / 'include'}" for part in ("isobus", "utility", "hardware_integration")]
    libraries = [str(next(folder.rglob(f"lib{name}.a"))) for name in ("HardwareIntegration", "Isobus", "Utility")]
    programs = {SERVER: HERE / "server.cpp", EXAMPLE: source / "examples" / "task_controller_server" / "main.cpp"}
    for name, code in programs.items():
        options = ["-std=c++14", "-O1", "-DISOBUS_SOCKETCAN_AVAILABLE", *includes]
        subprocess.run(["g++", *options, str(code), *libraries, "-lpthread", "-o", str(folder / name)], check=True)


def played(server: list[str], channel: str, duration_s: float) -> str:
    """What the server printed while the daemon measured a harvest."""
    bus = {"interface": "socketcan", "channel": channel}
    yieldmon = [sys.executable, "-m", "yieldmon"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "c.yaml").write_text(json.dumps({"bus": bus, "network": {"task_controller": True}}))
        environment = {**os.environ, "STATE_DIRECTORY": name, "RUNTIME_DIRECTORY": name}
        combine = ["simulate", "-i", "socketcan", "-c", channel, "--duration", str(duration_s)]
        with (
            open(folder / "server.txt", "w") as out,
            subprocess.Popen(server, stdout=out, stderr=subprocess.STDOUT) as running,
            subprocess.Popen([*yieldmon, "run", "--config", str(folder / "c.yaml")], cwd=ROOT, env=environment) as daemon,
        ):
            try:
                subprocess.run([*yieldmon, *combine], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            finally:
                daemon.send_signal(signal.SIGTERM)
                daemon.wait(20)
                time.sleep(1.0)
                running.send_signal(signal.SIGINT)
        return (folder / "server.txt").read_text()


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
