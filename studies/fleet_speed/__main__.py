"""How much faster are two workers of `yieldmon fleet run` than one, and do four processes on two cores lose anything?

    python -m studies.fleet_speed [--partitions N] [--minutes N] [--workers 1 2 4] [--json]

One simulated harvest, its times shifted by days, is the log of every machine: a machine's days hold one log each. For each
number of workers: time by the clock, CPU time of all processes together, and the load average at the start. The clock says
something on an idle machine only; the CPU time that several workers take beyond one's is what they lose, whoever else
computes: with that many free cores N workers are N x (CPU of one) / (CPU of N) times as fast, start and end apart. All
datasets must be the same to the byte, and their records those of `process`.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from studies.bulk_speed.__main__ import SEED, TILE_S, ours, tiled, write_text
from yieldmon.units import S_PER_DAY

MACHINES = 8
_SET_CHILD_SUBREAPER = 36
"""Of Linux' prctl."""
PROGRAM = [sys.executable, "-m", "yieldmon.cli.main"]
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def run(words: list[str]) -> tuple[float, float]:
    """Seconds by the clock and CPU seconds, with all processes that it started."""
    # The process that workers are forked from outlives the command: its end is waited for here, which counts its time.
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run([*PROGRAM, *words], check=True, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall_s = time.monotonic() - began
    with suppress(ChildProcessError):
        while True:
            os.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def tree(folder: Path, partitions: int, minutes: float) -> dict[str, Path]:
    """Folder MACHINE/DAY/LOG; returns the log of each day, by the day's name."""
    one, logs = ours(), dict[str, Path]()
    for number in range(partitions):
        name = f"d{number // MACHINES:03d}"
        if name not in logs:
            logs[name] = folder / f"{name}.log"
            shifted = replace(one, time_s=one.time_s + len(logs) * S_PER_DAY)
            write_text(tiled(shifted, int(len(one) * minutes * 60.0 / TILE_S)), logs[name])
        day = folder / "logs" / f"m{number % MACHINES}" / name
        day.mkdir(parents=True)
        os.link(logs[name], day / "a.log")
    return logs


def content(dataset: Path) -> dict[str, bytes]:
    """All files of a dataset."""
    return {path.relative_to(dataset).as_posix(): path.read_bytes() for path in sorted(dataset.rglob("*")) if path.is_file()}


def main() -> int:
    """Exit code 0 when all datasets are the same and hold what `process` writes."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.fleet_speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--partitions", type=int, default=64)
    parser.add_argument("--minutes", type=float, default=60.0, help="of harvest in a partition")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found: dict[str, dict[str, float]] = {}
    same = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        records, first = dict[str, bytes](), None
        for day, log in tree(folder, args.partitions, args.minutes).items():
            alone = folder / f"{day}.parquet"
            alone_s, alone_cpu_s = run(["process", str(log), "--out", str(alone), "--jobs", "1"])
            records[f"day={day}"] = alone.read_bytes()
        for workers in args.workers:
            out, load = folder / f"season-{workers}", os.getloadavg()[0]
            wall_s, cpu_s = run(["fleet", "run", str(folder / "logs"), "--out", str(out), "--workers", str(workers)])
            made = content(out)
            first = made if first is None else first
            rows = {path: data for path, data in made.items() if path.endswith("/records.parquet")}
            equal = all(data == records[path.split("/")[1]] for path, data in rows.items())
            same = same and made == first and len(rows) == args.partitions and equal
            found[str(workers)] = {"wall_s": wall_s, "cpu_s": cpu_s, "load_average": load}
            shutil.rmtree(out)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    document = {
        "partitions": args.partitions, "minutes": args.minutes, "seed": SEED, "commit": commit.stdout.strip(),
        "cores": os.cpu_count(), "process": {"wall_s": alone_s, "cpu_s": alone_cpu_s}, "workers": found, "same": same,
    }  # fmt: skip
    print(json.dumps(document, indent=2) if args.json else _text(document))
    return 0 if same else 1


def _text(document: dict[str, Any]) -> str:
    one = document["workers"][min(document["workers"], key=int)]
    lines = [
        f"{document['partitions']} partitions of {document['minutes']:g} min; `process` of one: "
        f"{document['process']['cpu_s']:.1f} CPU-s; datasets equal to each other and to `process`: {document['same']}"
    ]
    for workers, entry in document["workers"].items():
        lines.append(
            f"{workers} workers: {entry['wall_s']:.1f} s by the clock ({one['wall_s'] / entry['wall_s']:.2f} times), "
            f"{entry['cpu_s']:.1f} CPU-s ({entry['cpu_s'] / one['cpu_s']:.2f} of one's), "
            f"load average {entry['load_average']:.1f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
