"""Logs of many machines and days into a dataset, and what the dataset says.

The dataset is a folder, or lies in an object store (s3://bucket/name), with a partition for each machine and day.
"""

from __future__ import annotations

import argparse
from types import ModuleType

from yieldmon.cli._fleet import compare, diagnose, prior, report, running

_WORDS: dict[str, ModuleType] = {
    "run": running, "report": report, "compare": compare, "prior": prior, "diagnose": diagnose,
}  # fmt: skip


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "fleet", help="many logs into a dataset, on a distributed engine", description=__doc__,
        epilog="example: yieldmon fleet run logs/ --out season; yieldmon fleet report season",
    )
    words = parser.add_subparsers(dest="word", metavar="WORD", required=True)
    for module in _WORDS.values():
        module.add_parser(words)


def run(args: argparse.Namespace) -> int:
    """Exit code of the word."""
    return int(_WORDS[args.word].run(args))
