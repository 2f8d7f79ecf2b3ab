"""What a large map costs: CPU time of each step on one core, and memory.

    python -m tests.robustness map-size [--source FILE] [--copies N]

The harvest (Ag Leader text; without --source a drawn field of 37,000 points) is laid side by side N times, each copy further
north and later, and mapped with all products by a process on one core. Prints one JSON document; exit code 1 where 37,000 points
or fewer take over 5 s of CPU time, their delay and cleaning over 2 s, a million over 2 min, or any over 2 GB.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.field.synthetic import ag_leader

SMALL, LARGE = 37_000, 1_050_000
SMALL_S, SMALL_JUDGING_S, LARGE_S, MOST_MB = 5.0, 2.0, 120.0, 2000.0
_NORTH_DEG, _LATER_S = 0.05, 100_000
_JUDGING = ("delay", "cleaning")
_CODE = "import sys; from yieldmon.cli.main import main; sys.exit(main(sys.argv[1:]))"


def laid_out(source: Path, copies: int, target: Path) -> int:
    """The source's rows, `copies` times beside each other; how many there are."""
    rows = [line.split(",") for line in source.read_text(encoding="utf-8").splitlines() if line.strip()]
    with target.open("w", encoding="utf-8") as stream:
        for copy in range(copies):
            for row in rows:
                north, clock = float(row[1]) + copy * _NORTH_DEG, float(row[3]) + copy * _LATER_S
                stream.write(",".join([row[0], f"{north:.8f}", row[2], f"{clock:.2f}", *row[4:]]) + "\n")
    return copies * len(rows)


def measured(path: Path, out: Path) -> dict[str, object]:
    """CPU time and memory of `yieldmon map` on one core, and the steps by the clock."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", _CODE, "map", str(path), "--out", str(out)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}),
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = [(float(s), step) for s, step in re.findall(r"^ *([\d.]+) s  (.+)$", done.stderr, re.MULTILINE)]
    ends = [s for s, _ in begun[1:]] + [begun[-1][0] if begun else 0.0]
    steps_s = {step.split()[0] if "/" in step else step: round(end - s, 1) for (s, step), end in zip(begun, ends, strict=True)}
    return {
        "exit_code": done.returncode,
        "cpu_s": round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 2),
        "memory_mb": round(after.ru_maxrss / 1024.0, 1),
        "steps_s": steps_s,
        "said": done.stderr.splitlines()[-1:],
    }


def main(arguments: Sequence[str]) -> int:
    """Exit code 1 beyond what is promised."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness map-size", description=__doc__)
    parser.add_argument("--source", type=Path)
    parser.add_argument("--copies", type=int, default=1)
    args = parser.parse_args(list(arguments))
    with tempfile.TemporaryDirectory() as folder:
        source = args.source
        if source is None:
            source = Path(folder) / "drawn.txt"
            ag_leader(source, delay_s=12, seed=1, passes=74, length_s=488)
        field = Path(folder) / "field.txt"
        points = laid_out(source, args.copies, field)
        found = measured(field, Path(folder) / "map")
    print(json.dumps({"points": points, "load_average": os.getloadavg()[0], **found}, indent=1))
    steps = found["steps_s"]
    assert isinstance(steps, dict)
    cpu_s, memory_mb = float(str(found["cpu_s"])), float(str(found["memory_mb"]))
    kept = found["exit_code"] == 0 and memory_mb <= MOST_MB
    if points <= SMALL:
        kept = kept and cpu_s <= SMALL_S and sum(steps.get(step, 0.0) for step in _JUDGING) <= SMALL_JUDGING_S
    elif points <= LARGE:
        kept = kept and cpu_s <= LARGE_S
    return 0 if kept else 1
