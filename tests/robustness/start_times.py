"""How long commands that are called often take to start, and how much of that is importing.

    python -m tests.robustness start-times [--starts N]

Every command runs in a process of its own, once to compile the modules that it imports, as pip does for a wheel, then N times.
Prints one JSON document, seconds by the clock: median and least of the starts, and the least sum of all imports of three more
(`python -X importtime`); exit code 1 where imports take 0.4 s or more. A time taken on a busy machine is no figure.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence

import yieldmon
from tests.robustness.daemon_cost import ROOT

LIMIT_S = 0.4
COMMANDS: dict[str, tuple[str, ...]] = {
    "status": ("status",),
    "monitor --once": ("monitor", "tests/data/tractor_bus.log", "--once"),
    "check-config": ("check-config", "config/yieldmon.yaml"),
}
IMPORT_RUNS = 3


def start_s(command: Sequence[str], environment: Mapping[str, str]) -> float:
    """Seconds from the start of a process to its end."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-m", "yieldmon", *command], cwd=ROOT, env=environment, capture_output=True, check=False)
    return time.perf_counter() - begin


def imports_s(command: Sequence[str], environment: Mapping[str, str]) -> float:
    """Seconds that all imports of a process take, each without those inside it."""
    program = [sys.executable, "-X", "importtime", "-m", "yieldmon", *command]
    done = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    rows = [line.removeprefix("import time:").split("|") for line in done.stderr.splitlines() if line.startswith("import time:")]
    return 1e-6 * sum(int(own) for own, *_ in rows if own.strip().isdigit())


def measured(starts: int) -> dict[str, dict[str, float]]:
    """Median and least start and least imports of each command, s."""
    found = {}
    with tempfile.TemporaryDirectory() as compiled:
        inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment = {**inherited, "PYTHONPYCACHEPREFIX": compiled}
        for name, command in COMMANDS.items():
            start_s(command, environment)
            times = [start_s(command, environment) for _ in range(starts)]
            imports = min(imports_s(command, environment) for _ in range(IMPORT_RUNS))
            found[name] = {"median_s": statistics.median(times), "least_s": min(times), "imports_s": imports}
    return {name: {key: round(value, 3) for key, value in row.items()} for name, row in found.items()}


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line; 0: the imports of every command take less than 0.4 s."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="start-times", description=__doc__, formatter_class=raw)
    parser.add_argument("--starts", type=int, default=9, metavar="N", help="of each command (default 9)")
    args = parser.parse_args(argv)
    found = measured(args.starts)
    print(json.dumps({"version": yieldmon.__version__, "load_average": round(os.getloadavg()[0], 2), **found}, indent=1))
    return int(any(row["imports_s"] >= LIMIT_S for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
