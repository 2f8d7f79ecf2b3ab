"""How many small changes of service, bus, engine and network the tests find.

    python -m studies.mutation record --map FILE [TESTS]       # once: which lines each test runs
    python -m studies.mutation carry --map FILE                # moves a map of an earlier commit to the present lines
    python -m studies.mutation unreached --map FILE            # functions with lines that no test runs
    python -m studies.mutation --map FILE --sample 60 --seed 1 # a sample; a line each, then the score
    python -m studies.mutation --map FILE --package engine --sample 20
    python -m studies.mutation --named                         # changes that once went unnoticed

Exit code 1 when fewer than 90 % are killed.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import random
import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from studies.mutation.judge import LOADED, Confirming, Trial, Verdict
from studies.mutation.mutants import PACKAGES, Mutant, mutants, mutated
from studies.mutation.reach import Reach, carry, modules, record

ROOT = Path(__file__).resolve().parents[2]
GOAL = 0.9
#: CPU time of a mutant's tests after which no further one begins: s.
BUDGET_S = 60.0


@dataclass(frozen=True)
class Named:
    """A change by its text, which once went unnoticed."""

    name: str
    path: str
    old: str
    new: str
    tests: tuple[str, ...] = ("tests/service/test_limits_hold.py",)


NAMED = (
    Named(
        "reported faults are kept at a reload", "yieldmon/service/daemon.py",
        "        self._bus.faults.report_all_anew()\n", "",
    ),
    Named(
        "a dead thread is passed over", "yieldmon/service/supervision.py",
        "        if not alive:\n", "        if False:\n",
        ("tests/service/test_stalls.py", "tests/service/test_signs_of_life.py"),
    ),
    Named(
        "bus-off never ends", "yieldmon/service/traffic/service_faults.py",
        'self._conditions.present("bus-off", until_s, detail)', 'self._conditions.present("bus-off", _FOREVER, detail)',
    ),
    Named(
        "bus-off outlives its interface", "yieldmon/service/traffic/service_faults.py",
        '            self._conditions.ended("bus-off")\n', "",
    ),
    Named(
        "old counters are kept when records are given up", "yieldmon/service/storage/writer.py",
        "counters={**oldest.counters, **following.counters}", "counters={**following.counters, **oldest.counters}",
    ),
    Named("room is made without bound", "yieldmon/service/storage/store.py", "_PRUNE_ROWS = 2000", "_PRUNE_ROWS = 2_000_000_000"),
    Named(
        "quick_check without loads", "yieldmon/service/storage/store.py",
        "for table in _NEEDED + _EVENTS:\n", 'for table in [t for t in _NEEDED + _EVENTS if t != "load"]:\n',
    ),
    Named("timeout of a peer", "yieldmon/service/operator/control.py", "timeout_s: float = 5.0", "timeout_s: float = 500.0"),
    Named(
        "size of a request", "yieldmon/service/operator/control_protocol.py",
        "MAX_REQUEST_BYTES = 64 * 1024\n", "MAX_REQUEST_BYTES = 64 * 1024 * 1024\n",
    ),
    Named(
        "a restart takes the bus-off behind it along", "yieldmon/service/traffic/service_faults.py",
        'self._conditions.present("bus-off", _FOREVER, detail)', 'self._conditions.present("bus-off", until_s, detail)',
    ),
    Named("timeout of the speed", "yieldmon/engine/settings.py", "speed_timeout_s: float = 1.0", "speed_timeout_s: float = 3.0"),
    Named(
        "share of a sensor's faults", "yieldmon/engine/faults.py",
        "2 * o.window.sensor_fault_frames >", "20 * o.window.sensor_fault_frames >",
    ),
)  # fmt: skip


def sample(packages: tuple[str, ...], count: int, seed: int) -> list[Mutant]:
    """So many mutants of all of these packages' modules, drawn without preference."""
    everything = [mutant for path in modules(packages, ROOT) for mutant in mutants(ROOT / path, ROOT)]
    return random.Random(seed).sample(everything, count)


def interval(killed: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    z, share = 1.96, killed / count
    middle = share + z**2 / (2 * count)
    half = z * math.sqrt(share * (1.0 - share) / count + z**2 / (4 * count**2))
    return (middle - half) / (1 + z**2 / count), (middle + half) / (1 + z**2 / count)


def main() -> int:
    """Prints a line for each mutant, and the score as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("judge", "record", "carry", "unreached"), nargs="?", default="judge")
    parser.add_argument("tests", nargs="*", help="record: files or folders of tests; default: those of and around the packages")
    parser.add_argument("--map", type=Path, help="file of the map from lines to tests, outside the checkout")
    parser.add_argument("--workers", type=int, default=2, help="record: so many processes")
    parser.add_argument("--package", choices=PACKAGES, action="append", help="repeatable; default: all")
    parser.add_argument("--sample", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), metavar=("I", "N"), help="each Nth of the sample, from I on")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no further mutant after so long")
    parser.add_argument("--budget", type=float, default=BUDGET_S, help="s of CPU time after which no further test begins")
    parser.add_argument("--again", type=Path, nargs="+", help="lines of a run before: of its survivors the tests not run yet")
    parser.add_argument("--named", action="store_true", help="the changes that once went unnoticed")
    args = parser.parse_intermixed_args()
    os.chdir(ROOT)
    if args.map is None and not args.named:
        parser.error("expected --map FILE; make one with: python -m studies.mutation record --map FILE")
    packages = tuple(args.package or PACKAGES)
    if args.what == "record":
        return record(args.map.absolute(), args.tests, args.workers, ROOT)
    if args.what == "carry":
        for path in carry(args.map.absolute(), ROOT):
            print(f"{path}: its text when the map was made is in no commit; judged by all tests of the module")
        return 0
    if args.what == "unreached":
        return _unreached(Reach(args.map, ROOT), packages)
    for name in LOADED:
        importlib.import_module(name)
    if args.named:
        work = [(f"{named.name}", Trial(ROOT / named.path, _replaced(named), named.tests, 300.0, {})) for named in NAMED]
    else:
        reach = Reach(args.map, ROOT)
        before = _run_before(args.again) if args.again else None
        work = []
        for m in sample(packages, args.sample, args.seed):
            name, tests = f"{m.path}:{m.line} {m.what}", reach.tests(m)
            if before is not None:
                # Kept outputs see any change of a number.
                tests = sorted(tests[before.get(name, len(tests)) :], key=lambda test: not test.startswith("tests/golden"))
            if before is None or tests:
                work.append((name, Trial(ROOT / m.path, mutated(m, ROOT), tests, args.budget, reach.cpu_s)))
        work = work[args.part[0] :: args.part[1]]
    rows = _judged(work, args.minutes)
    return _told(rows, None if args.named else args.seed)


def _run_before(files: list[Path]) -> dict[str, int]:
    """How many tests were run on each survivor, by the lines of a run."""
    lines = [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    found = (re.fullmatch(r"survived  (.+)  \[(\d+) tests run, [1-9]\d* not run\]", line) for line in lines)
    return {match[1]: int(match[2]) for match in found if match}


def _judged(work: list[tuple[str, Trial]], minutes: float) -> list[tuple[str, Verdict]]:
    begun_s = time.monotonic()
    judging = Confirming()
    rows = []
    for name, trial in work:
        if time.monotonic() - begun_s > 60.0 * minutes:
            break
        verdict = judging.judged(trial)
        rows.append((name, verdict))
        detail = verdict.test if verdict.outcome != "survived" else f"{verdict.run} tests run, {verdict.not_run} not run"
        print(f"{verdict.outcome:9} {name}  [{detail}]", flush=True)
    return rows


def _told(rows: list[tuple[str, Verdict]], seed: int | None) -> int:
    commit = subprocess.run(("git", "rev-parse", "--short", "HEAD"), capture_output=True, text=True, check=False).stdout
    killed = sum(verdict.outcome != "survived" for _, verdict in rows)
    score = {
        "commit": commit.strip(),
        "seed": seed,
        "mutants": len(rows),
        "killed": killed,
        "interval": [round(bound, 3) for bound in interval(killed, len(rows))] if rows else None,
        "survivors": [name for name, verdict in rows if verdict.outcome == "survived"],
        "of these no test runs": [name for name, verdict in rows if verdict.outcome == "survived" and not verdict.run],
    }
    json.dump(score, sys.stdout, indent=2)
    print()
    return 0 if rows and killed >= GOAL * len(rows) else 1


def _unreached(reach: Reach, packages: tuple[str, ...]) -> int:
    for path in modules(packages, ROOT):
        for name, statements in reach.unreached(path):
            print(f"{path} {name}: {statements}")
    return 0


def _replaced(named: Named) -> str:
    text = (ROOT / named.path).read_text(encoding="utf-8")
    if text.count(named.old) != 1:
        raise SystemExit(f"{named.path} has {text.count(named.old)} times {named.old!r}; expected once")
    return text.replace(named.old, named.new)


if __name__ == "__main__":
    sys.exit(main())
