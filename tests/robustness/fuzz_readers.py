"""Mutated files through every reader: logs, YAML, tables, harvests, stores, requests. No traceback, no hang, bounded memory.

    python -m tests.robustness fuzz-readers --count 2000 --reader candump
    python -m tests.robustness fuzz-readers --cpu-minutes 60 --reader candump      # guided by coverage
    python -m tests.robustness fuzz-readers --rotate 90 --cpu-minutes 2            # 90 minutes by the clock, all in turn
    python -m tests.robustness fuzz-readers --rotate 90 --cpu-minutes 5 --reader asc --reader blf      # these two in turn
    python -m tests.robustness fuzz-readers --recorded                             # what was run so far, a line a reader

Mutations of good files (bits, slices doubled, cut, swapped, long runs; within zips and Parquet as well). With --cpu-minutes those
that reach new steps of the reader's code, or of the package that it stands on, are mutated further, here and in later runs;
inputs that escape are kept in out/fuzz. An escape is an exception that is no InputError, a file that takes more than --seconds
of processor time (for each MB), a process that dies, or one above --memory-mb. Ends with 1 when there is one.

--rotate gives each turn to the reader with the least processor time in the record, in a process of its own and with a seed of its
own, and adds a line to the record for each.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.robustness.guided import Corpus, Coverage, cpu_s, kept, spliced
from tests.robustness.readers import READERS, Reader
from yieldmon.errors import InputError

#: Code whose steps guide: the project's, and what reads its files.
TRACED = ("/yieldmon/", "/can/io/", "/yaml/", "/asammdf/", "/cantools/database/can/formats/")
KEPT = Path("out/fuzz")
RECORD = Path(__file__).with_name("fuzz_readers.jsonl")
#: Processor time of one file, traced, beyond which its reader is taken to read for ever.
ENDLESS_S = 60.0
#: Inputs of earlier runs that a run begins with.
_FROM_BEFORE = 200


class Endless(BaseException):
    """Raised in a reader that does not end; no reader catches it."""


@contextmanager
def ended() -> Iterator[None]:
    """Within it, reading ends after ENDLESS_S seconds of processor time."""

    def end(*_: object) -> None:
        raise Endless(f"more than {ENDLESS_S:g} s")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, ENDLESS_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def fuzz(name: str, count: int, seed: int, seconds: float) -> Counter[str]:
    """Outcomes of one reader; an escape's key begins with `escape`."""
    reader = READERS[name]
    rng, outcomes = random.Random(f"{seed}/{name}"), Counter[str]()
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / reader.file
        reader.make(path)
        good = path.read_bytes()
        reader.read(path)
        for _ in range(count):
            _only(path, reader.damage(good, rng))
            began_s = cpu_s()
            try:
                _to_an_end(path, reader.read)
                outcomes["read"] += 1
            except InputError:
                outcomes["refused"] += 1
            except Exception as error:  # noqa: BLE001 - what is looked for
                outcomes[f"escape {_said(error)}"] += 1
            if cpu_s() - began_s > _allowed_s(path, reader, seconds):
                outcomes["escape too slow"] += 1
    return outcomes


def guided(name: str, cpu_minutes: float, seed: int, seconds: float) -> Counter[str]:
    """The same for so much processor time, guided by coverage."""
    reader = READERS[name]
    rng, outcomes, coverage = random.Random(f"{seed}/{name}"), Counter[str](), Coverage(TRACED)
    folder = KEPT / "corpus" / name
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / reader.file
        reader.make(path)
        good = path.read_bytes()
        reader.read(path)
        corpus = Corpus(good)
        before = sorted(folder.iterdir()) if folder.is_dir() else []
        waiting = [good, *(one.read_bytes() for one in rng.sample(before, min(len(before), _FROM_BEFORE)))]
        until_s = cpu_s() + 60.0 * cpu_minutes
        while cpu_s() < until_s:
            fresh = not waiting
            content = _next(reader, corpus, good, rng) if fresh else waiting.pop(0)
            _only(path, content)
            steps, raised = coverage.of(lambda: _to_an_end(path, reader.read))
            if corpus.take(content, steps) and fresh:
                outcomes["new"] += 1
                kept(folder, name, content)
            outcomes["refused" if isinstance(raised, InputError) else "read" if raised is None else "raised"] += 1
            escape = "" if raised is None or isinstance(raised, InputError) else _said(raised)
            escape = escape or _slow(path, reader, seconds)
            if escape:
                outcomes[f"escape {escape}"] += 1
                if outcomes[f"escape {escape}"] == 1:
                    print(f"{name}: {escape}: {kept(KEPT, name, content)}", file=sys.stderr, flush=True)
    outcomes["steps"] = len(corpus.reached)
    return outcomes


def _next(reader: Reader, corpus: Corpus, good: bytes, rng: random.Random) -> bytes:
    base = corpus.chosen(rng)
    content = spliced(base, corpus.chosen(rng), rng)[: 4 * len(good)] if rng.random() < 0.1 else base
    return reader.damage(content or good, rng)


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error)[:80]}"


def _only(path: Path, content: bytes) -> None:
    """The file alone in its folder: readers look at what is beside it."""
    for left in path.parent.iterdir():
        left.unlink()
    path.write_bytes(content)


def _to_an_end(path: Path, read: Callable[[Path], object]) -> None:
    try:
        with ended():
            read(path)
    except Endless as error:
        raise RuntimeError(f"reads for ever: {error}") from error


def _allowed_s(path: Path, reader: Reader, seconds: float) -> float:
    return reader.start_s + seconds * max(1.0, path.stat().st_size / 1e6)


def _slow(path: Path, reader: Reader, seconds: float) -> str:
    """Whether reading takes too long, without the tracing that makes everything slow."""
    if not path.exists():
        return ""
    began_s = cpu_s()
    with suppress(Exception):
        _to_an_end(path, reader.read)
    return "too slow" if cpu_s() - began_s > _allowed_s(path, reader, seconds) else ""


def recorded(record: Path) -> list[dict[str, Any]]:
    """The runs in a record."""
    return [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []


def summed(runs: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Of each reader: runs, processor time, files, escapes, highest memory."""
    return {
        name: {
            "runs": len(mine),
            "cpu_s": round(sum(run["cpu_s"] for run in mine)),
            "files": sum(run["files"] for run in mine),
            "escapes": sum(sum(run["escapes"].values()) for run in mine),
            "peak_memory_mb": max((run["peak_memory_mb"] for run in mine), default=0),
        }
        for name in READERS
        for mine in [[run for run in runs if run["reader"] == name]]
    }


def rotate(names: list[str], minutes: float, cpu_minutes: float, record: Path, options: list[str]) -> bool:
    """Turns of so much processor time, by the clock; whether one escaped."""
    until_s, escaped = time.monotonic() + 60.0 * minutes, False
    while time.monotonic() < until_s:
        runs = recorded(record)
        so_far = summed(runs)
        name = min(names, key=lambda reader: (so_far[reader]["cpu_s"], so_far[reader]["runs"]))
        seed = 1 + max((run["seed"] for run in runs if run["reader"] == name), default=0)
        run = _turn(name, cpu_minutes, seed, options)
        with record.open("a") as stream:
            stream.write(json.dumps(run) + "\n")
        escaped |= bool(run["escapes"])
    return escaped


def _turn(name: str, cpu_minutes: float, seed: int, options: list[str]) -> dict[str, Any]:
    command = [sys.executable, "-m", "tests.robustness", "fuzz-readers", "--reader", name, "--seed", str(seed), *options]
    before_s = cpu_s()
    with tempfile.TemporaryDirectory() as scratch:
        done = subprocess.run(
            [*command, "--cpu-minutes", str(cpu_minutes)],
            env={**os.environ, "TMPDIR": scratch},
            stdout=subprocess.PIPE,
            check=False,
        )
        try:
            reported = json.loads(done.stdout)
        except ValueError:
            reported = {"outcomes": {name: {f"escape process ended with {done.returncode}": 1}}, "peak_memory_mb": 0}
            for left in Path(scratch).rglob(READERS[name].file):
                print(f"{name}: ended with {done.returncode}: {kept(KEPT, name, left.read_bytes())}", file=sys.stderr, flush=True)
    outcomes, escapes = reported["outcomes"][name], {}
    for key in [key for key in outcomes if key.startswith("escape")]:
        escapes[key.removeprefix("escape ")] = outcomes.pop(key)
    return {
        "reader": name,
        "commit": _commit(),
        "seed": seed,
        "cpu_s": round(cpu_s() - before_s, 1),
        "files": sum(outcomes.get(key, 0) for key in ("read", "refused", "raised")),
        **outcomes,
        "escapes": escapes,
        "peak_memory_mb": reported["peak_memory_mb"],
    }


def _commit() -> str:
    reported = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return reported.stdout.strip()


def main(arguments: list[str]) -> int:
    """Prints the outcomes as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reader", action="append", choices=sorted(READERS), help="again for several; default: all")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--cpu-minutes", type=float, help="guided by coverage, for so much processor time a reader")
    parser.add_argument("--rotate", type=float, metavar="MINUTES", help="all readers in turn, for so long by the clock")
    parser.add_argument("--record", type=Path, default=RECORD, help="of --rotate and --recorded")
    parser.add_argument("--recorded", action="store_true", help="print the sums of the record and end")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--memory-mb", type=float, default=500.0)
    args = parser.parse_args(arguments)
    if args.recorded:
        for name, sums in summed(recorded(args.record)).items():
            print(name.ljust(16), "  ".join(f"{key} {value}" for key, value in sums.items()))
        return 0
    names = args.reader or list(READERS)
    if args.rotate is not None:
        limits = ["--seconds", str(args.seconds), "--memory-mb", str(args.memory_mb)]
        return int(rotate(names, args.rotate, args.cpu_minutes or 2.0, args.record, limits))
    logging.disable(logging.CRITICAL)
    found: dict[str, dict[str, int]] = {}
    for name in names:
        if args.cpu_minutes is not None:
            found[name] = dict(guided(name, args.cpu_minutes, args.seed, args.seconds))
        else:
            found[name] = dict(fuzz(name, args.count, args.seed, args.seconds))
    # A reader's processes count as well.
    peak_mb = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024.0
    if peak_mb > args.memory_mb:
        found[names[-1]][f"escape {peak_mb:.0f} MB of memory"] = 1
    json.dump({"outcomes": found, "peak_memory_mb": round(peak_mb)}, sys.stdout, indent=2)
    print()
    return int(any(key.startswith("escape") for outcomes in found.values() for key in outcomes))
