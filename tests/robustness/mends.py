"""What an attack on the service once found, point by point: a simulation finds it again when its mend is undone.

    python -m tests.robustness mends --table              # a line for each mend: point, what was mended, what finds it
    python -m tests.robustness mends --point 4 --point 5

The simulations are `simulation`, `bus-simulation`, `process-simulation` and `files-simulation`, each with a table of its own.
Ends with 1 when a simulation finds something as it is, a mend that is undone is not found, or a point has no mend.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

from tests.robustness import bus_simulation, files_simulation, process_simulation, simulation
from tests.robustness.undoing import Simulation, found_without, quiet

POINTS = {
    1: "one flipped bit in the store, and it never starts again",
    2: "damage in tables that nobody looks at blocks all later batches",
    3: "a clock that is set back holds up waiting on a silent bus",
    4: "signal handlers deadlock the engine's thread",
    5: "files that the service's user cannot read, under umask 027 or 077",
    6: "store files removed or exchanged in use, unsaid",
    7: "a log line that hangs its reader",
    8: "forged samples, speeds and angles, and our own frames repeated, unsaid",
    9: "a transmit thread that hangs, unsaid",
    10: "masses beyond the end of their signals, unsaid",
    11: "an installation without the lock, in place, or of an odd interface",
    12: "peers at the control socket that ask nothing",
    13: "tracebacks on records, options, parents, channels and answers",
    14: "a version that no store counts",
    15: "an exception in the journal, and the process never ends",
    16: "scratch files by names that can be foreseen",
    17: "control characters and formulas in names",
    18: "logs and stores that unpack or go on without end",
    19: "trouble codes in turns instead of together",
    20: "a socket that cannot be bound now ends the service for good",
}


@dataclass(frozen=True)
class Share:
    """A simulation, how many lives of it show that it finds nothing, and how many a mend."""

    name: str
    simulation: Simulation
    lives: int
    lives_each: int
    seed: int


SHARES = (
    Share("simulation", simulation.SIMULATION, 100, 50, 7),
    Share("bus-simulation", bus_simulation.SIMULATION, 9, 8, 2),
    Share("process-simulation", process_simulation.SIMULATION, 10, 4, 1),
    Share("files-simulation", files_simulation.SIMULATION, 24, 4, 1),
)


@dataclass(frozen=True)
class Line:
    """points: those that the mend ended, none where nobody attacked it. first: what was found."""

    points: tuple[int, ...]
    mend: str
    by: str
    problems: int
    first: str


def lines(points: frozenset[int] | None) -> Iterator[Line]:
    """A line for each mend of these points, of all for None."""
    for share in SHARES:
        for name, mend in share.simulation.mends.items():
            if points is None or points & set(mend.points):
                found = found_without(mend, share.lives_each, share.seed)
                yield Line(mend.points, name, share.name, found.problems, found.first or "NOT FOUND")


def clean() -> Iterator[tuple[str, list[str]]]:
    """What each simulation finds with everything as it is."""
    for share in SHARES:
        broken, _ = share.simulation.simulate(share.lives, share.seed)
        yield f"{share.name}, {share.lives} {share.simulation.unit}, seed {share.seed}", broken


def main(arguments: list[str]) -> int:
    """Prints a line for each mend, in the order of the points."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", action="store_true", help="all points, and the simulations as they are")
    parser.add_argument("--point", type=int, action="append", choices=sorted(POINTS), help="one point; repeatable")
    args = parser.parse_args(arguments)
    if not args.table and not args.point:
        parser.error("--table or --point")
    chosen = None if args.table else frozenset(args.point)
    fine = True
    with quiet():
        found = list(lines(chosen))
        for number in [*POINTS, 0] if chosen is None else sorted(chosen):
            rows = [row for row in found if number in row.points or (number == 0 and not row.points)]
            print(f"{number:2}  {POINTS[number]}" if number else " -  besides", flush=True)
            for row in rows:
                print(f"    {row.mend} | {row.by} | {row.problems} | {row.first}")
            fine &= bool(rows) and all(row.problems for row in rows)
        for what, broken in clean() if args.table else ():
            print(f"as it is: {what}: {len(broken)} problems {broken[:1] or ''}", flush=True)
            fine &= not broken
    return 0 if fine else 1
