"""Long and hard runs of the service, one runner for all.

python -m tests.robustness NAME [options]      --help after a name tells its options
"""

from __future__ import annotations

import importlib
import sys

RUNS = {
    "crash-test": "kill the daemon and cut the power at random instants; the store must add up",
    "daemon-cost": "share of a core and latency of the result",
    "fleet-kill": "kill -9 of workers, client and scheduler of a fleet run; the dataset must be that of an undisturbed one",
    "fuzz-config": "mutated configuration, machine and parameter files",
    "fuzz-frames": "random and mutated frames through codec and engine",
    "fuzz-harvests": "damaged harvests of every kind through the map",
    "fuzz-network": "random network traffic through node, transport, task controller client and side inputs",
    "map-size": "what a large map costs: CPU time by step on one core, and memory",
    "monitor-load": "the live monitor on a saturated bus",
    "replay-timing": "how well a replay keeps time",
    "request-times": "requests to a daemon that measures, by the clock; none to others is answered",
    "start-times": "starts of commands that are called often, and how much of them is importing",
    "store-damage": "random damage to the store and its journal; the daemon starts, and nothing is silently other",
    "signals": "signals in bursts at a running daemon: alive, and SIGTERM ends it",
    "fuzz-readers": "mutated logs, tables, stores and requests through every reader",
    "simulation": "the service on a disk, a clock and a process that fail at random; invariants after each life",
    "bus-simulation": "forgers, clocks, echoes, threads that hang: the engine and what is around it, by seed, mends undone",
    "process-simulation": "signals between any two instructions, peers at the socket, parts that fail, by seed; mends undone",
    "files-simulation": "hostile logs, records, stores and names, umasks and installs, by seed; mends undone",
    "mends": "every point that an attack once found, with its mend undone: which simulation finds it again",
    "verdict-starts": "diagnose from random start parameters and from calibrate's: one verdict, the same names, the same F",
    "two-daemons": "two daemons on one bus: address, faults, what the one without an address publishes",
    "web-attack": "the page and the control socket under attack beside a daemon that measures",
    "web-page": "the page in a browser: heap at sixty times the pace, a large map, faults, and what pages cost the daemon",
    "soak": "a day of traffic with faults: neither growth nor drift",
}


def main() -> int:
    """Exit code of the named run; 2 without a name."""
    name, *arguments = sys.argv[1:] or [""]
    if name not in RUNS:
        asked = name in ("-h", "--help")
        lines = [(__doc__ or "").rstrip(), "", *(f"  {key:14} {what}" for key, what in RUNS.items())]
        print("\n".join(lines), file=sys.stdout if asked else sys.stderr)
        return 0 if asked else 2
    return int(importlib.import_module(f"tests.robustness.{name.replace('-', '_')}").main(arguments))


if __name__ == "__main__":
    sys.exit(main())
