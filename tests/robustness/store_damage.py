"""Damage a daemon's store and its journal at random and start from it: it opens each time, and nothing is silently other.

    python -m tests.robustness store-damage --count 5000 --seed 1

A case is sound when the totals, loads and parameters are those of the undamaged store, or when something is said and no total
is above the true one. Ends with 1 when a case is not sound.
"""

from __future__ import annotations

import argparse
import json
import logging
import random
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.service.bench import running
from yieldmon.errors import InputError
from yieldmon.files.parameter_file import digest
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.recovery import recover
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError

KINDS = ("bit", "byte", "sector", "page", "zeros", "cut")
LONGEST_START_S = 3.0


@dataclass(frozen=True)
class Original:
    """The files of a store as a killed daemon leaves them, what they say, and the total of each of its seconds."""

    main: bytes
    journal: bytes
    witness: bytes
    memory: Memory
    totals_kg: tuple[float, ...]


@dataclass(frozen=True)
class Finding:
    """What became of one damaged store: `problem` is None where it is sound."""

    kind: str
    outcome: str
    problem: str | None
    start_s: float


def original(folder: Path, seconds: int = 24) -> Original:
    """A store that a daemon has written for so many seconds: two loads, tickets, one taken back, and a field corrected."""
    path = folder / "yieldmon.sqlite"
    with running(folder) as bench:
        bench.play(14, 0.0)
        bench.play(seconds - 14, 60.0)
        bench.played()
        bench.daemon.command({"command": "load-start", "field": "north"})
        bench.daemon.command({"command": "ticket", "first_load": 1, "mass_kg": 50.0})
        bench.daemon.command({"command": "ticket", "first_load": 1, "mass_kg": 49.0})
        bench.daemon.command({"command": "ticket-undo", "ticket": 1})
        bench.daemon.command({"command": "load-correct", "first_load": 1, "field": "south"})
        bench.play(4, 60.0)
        bench.played()
        assert bench.daemon.writer.wait_until_written(10.0)
        main, journal, witness = (path.with_name(path.name + end).read_bytes() for end in ("", "-wal", ".last"))
    apart = folder / "apart"
    apart.mkdir()
    place = _placed(apart, main, journal, witness)
    with Store(place) as store:
        totals_kg = tuple(row.total_kg for row in store.seconds())
    place = _placed(apart, main, journal, witness)
    return Original(main, journal, witness, _recovered(place).memory, totals_kg)


def damaged(content: bytes, kind: str, rng: random.Random) -> bytes:
    """The content with one damage of that kind at a random place."""
    out = bytearray(content)
    at = rng.randrange(len(out))
    if kind == "bit":
        out[at] ^= 1 << rng.randrange(8)
    elif kind == "byte":
        out[at] = rng.randrange(256)
    elif kind == "cut":
        del out[at:]
    else:
        size = {"sector": 512, "page": 4096, "zeros": 512}[kind]
        at -= at % size
        out[at : at + size] = bytes(size) if kind == "zeros" else rng.randbytes(len(out[at : at + size]))
    return bytes(out)


def attempt(folder: Path, true: Original, kind: str, rng: random.Random) -> Finding:
    """One damage, and a start from it."""
    main, journal = true.main, true.journal
    if rng.random() < 0.5:
        main = damaged(main, kind, rng)
    else:
        journal = damaged(journal, kind, rng)
    path = _placed(folder, main, journal, true.witness)
    began_s = time.monotonic()
    try:
        recovery = _recovered(path)
    except (StoreError, InputError) as error:
        return Finding(kind, "does not start", str(error), time.monotonic() - began_s)
    start_s = time.monotonic() - began_s
    outcome, problem = judge(true, recovery.memory, recovery.note)
    return Finding(kind, outcome, problem, start_s)


def judge(true: Original, memory: Memory, note: str) -> tuple[str, str | None]:
    """What the memory is beside the true one, and what is wrong with that."""
    whole = true.memory
    assert whole.engine is not None
    true_kg = whole.engine.totals.total_kg
    if memory.engine is None:
        return "nothing left", None if note else "nothing is left, unsaid"
    total_kg = memory.engine.totals.total_kg
    if total_kg not in (*true.totals_kg, 0.0):
        return "other", f"total {total_kg} kg, which no second had"
    if total_kg == true_kg and _told(memory) == _told(whole):
        return ("whole, said" if note else "whole"), None
    return "less", None if note else f"total {total_kg} kg of {true_kg} kg, {memory.loads}, unsaid"


def _told(memory: Memory) -> tuple[object, ...]:
    parameters = "" if memory.parameters is None else digest(memory.parameters)
    entered = memory.loads, memory.tickets, memory.actions, memory.unfinished_tickets
    return *entered, memory.last_version, parameters, memory.field, memory.crop, memory.faults


def _placed(folder: Path, main: bytes, journal: bytes, witness: bytes) -> Path:
    for left in folder.iterdir():
        left.unlink()
    path = folder / "yieldmon.sqlite"
    path.write_bytes(main)
    path.with_name(f"{path.name}-wal").write_bytes(journal)
    path.with_name(f"{path.name}.last").write_bytes(witness)
    return path


def _recovered(path: Path):  # type: ignore[no-untyped-def]
    return recover(path, Retention(), lambda: Store(path))


def campaign(folder: Path, count: int, seed: int, kinds: tuple[str, ...] = KINDS) -> list[Finding]:
    """`count` damages, the kinds in turn."""
    rng = random.Random(seed)
    made = folder / "made"
    made.mkdir()
    true = original(made)
    place = folder / "place"
    place.mkdir()
    return [attempt(place, true, kinds[n % len(kinds)], rng) for n in range(count)]


def main(arguments: list[str]) -> int:
    """Prints the counts as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(arguments)
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        findings = campaign(Path(folder), args.count, args.seed)
    problems = [f"{f.kind}: {f.problem}" for f in findings if f.problem]
    slow = max(f.start_s for f in findings)
    report = {
        "damages": len(findings),
        "outcomes": dict(Counter(f.outcome for f in findings)),
        "slowest_start_s": round(slow, 2),
        "problems": problems[:20],
        "problem_count": len(problems),
    }
    json.dump(report, sys.stdout, indent=2)
    print()
    return 1 if problems or slow > LONGEST_START_S else 0
