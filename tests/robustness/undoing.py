"""Mends undone in turn: each simulation must find the bug again. What the simulations' command lines share.

A simulation is a function of a number of lives and a seed; it says what was broken. A mend is undone by putting the service back
to what it was before, while lives that concern it are simulated.
"""

from __future__ import annotations

import argparse
import json
import logging
import random
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

_FIRST = 10
_LINE = 160


class Broken(Exception):
    """An invariant that does not hold."""


def require(holds: bool, what: str) -> None:
    """Raises Broken unless it holds."""
    if not holds:
        raise Broken(what)


Trouble = Callable[[random.Random], None]
"""A life that meets one trouble, its chances from a generator; raises Broken."""


def live(count: int, seed: int, troubles: Sequence[Trouble]) -> tuple[list[str], Counter[str]]:
    """What so many lives with these troubles in turn broke, with seed and life, and how often each trouble came."""
    broken, met = list[str](), Counter[str]()
    for number in range(count):
        trouble = troubles[number % len(troubles)]
        met[trouble.__name__] += 1
        try:
            trouble(random.Random(f"{seed}/{number}"))
        except Broken as error:
            broken.append(f"seed {seed}, life {number}, {trouble.__name__}: {error}")
    return broken, met


@dataclass(frozen=True)
class Mend:
    """points: numbers of the findings (`mends`) that it ended. problems: what so many lives from a seed find broken. undone: the
    service as it was before."""

    points: tuple[int, ...]
    problems: Callable[[int, int], list[str]]
    undone: Callable[[], AbstractContextManager[Any]]


@dataclass(frozen=True)
class Found:
    """What the lives found with a mend undone."""

    problems: int
    first: str | None

    @property
    def found(self) -> bool:
        return self.problems > 0


@dataclass(frozen=True)
class Simulation:
    """description: for --help. unit: what is counted. default: how many of them. simulate: (count, seed) to what was broken, and
    how often each trouble came. mends: by name."""

    description: str | None
    unit: str
    default: int
    simulate: Callable[[int, int], tuple[list[str], Mapping[str, int]]]
    mends: Mapping[str, Mend]


def mend(points: tuple[int, ...], trouble: Trouble, undone: Callable[[], AbstractContextManager[Any]]) -> Mend:
    """One whose absence lives with that trouble find."""
    return Mend(points, lambda lives, seed: live(lives, seed, (trouble,))[0], undone)


@contextmanager
def quiet() -> Iterator[None]:
    """Without what the service logs of its troubles."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def found_without(mend: Mend, count: int, seed: int) -> Found:
    """What so many lives find with the mend undone."""
    with mend.undone():
        problems = mend.problems(count, seed)
    return Found(len(problems), problems[0][:_LINE] if problems else None)


def main(simulation: Simulation, arguments: list[str]) -> int:
    """Prints as JSON what a run broke, or what was found with mends undone; 1 when something is broken, or a bug is not found."""
    parser = argparse.ArgumentParser(description=simulation.description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(f"--{simulation.unit}", type=int, default=simulation.default, dest="count", metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--undo", choices=sorted(simulation.mends), help="a mend to undo; ends with 0 when that is found")
    parser.add_argument("--table", action="store_true", help="undo every mend in turn")
    args = parser.parse_args(arguments)
    with quiet():
        if args.table or args.undo:
            names = list(simulation.mends) if args.table else [args.undo]
            table = {name: found_without(simulation.mends[name], args.count, args.seed) for name in names}
            rows = {name: {"found": row.found, "problems": row.problems, "first": row.first} for name, row in table.items()}
            print(json.dumps(rows, indent=2))
            return 0 if all(row.found for row in table.values()) else 1
        broken, troubles = simulation.simulate(args.count, args.seed)
    report = {
        simulation.unit: args.count,
        "seed": args.seed,
        "troubles": troubles,
        "problems": len(broken),
        "first": broken[:_FIRST],
    }
    print(json.dumps(report, indent=2))
    return 1 if broken else 0
