"""Measure logs of many machines and days into a dataset; report on it and derive priors from it.

The dataset is a folder or an object store (s3://bucket/name), with a partition for each machine and day.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from yieldmon.cli._fleet import arguments

#: Each word's arguments, and the module that does it.
_WORDS = {
    "run": (arguments.run, "running"),
    "report": (arguments.report, "report"),
    "compare": (arguments.compare, "compare"),
    "prior": (arguments.prior, "prior"),
    "diagnose": (arguments.diagnose, "diagnose"),
}

_MEND = {"run": "; run again, what is finished stays"}
_ADDRESSES = "source", "out", "dataset", "first", "second"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "fleet",
        help="measure and compare the logs of many machines",
        description=__doc__,
        epilog="example: yieldmon fleet run logs/ --out season",
    )
    words = parser.add_subparsers(dest="word", metavar="WORD", required=True)
    for add_arguments, _ in _WORDS.values():
        add_arguments(words)


def run(args: argparse.Namespace) -> int:
    """Exit code of the word. Raises OSError with the storage's address where that fails, which says little of itself."""
    from yieldmon.fleet.filesystem import slow_storage

    try:
        with slow_storage(lambda line: print(f"yieldmon: {line}", file=sys.stderr)):
            return int(import_module(f"yieldmon.cli._fleet.{_WORDS[args.word][1]}").run(args))
    except OSError as error:
        storages = [value for name in _ADDRESSES if "://" in (value := str(getattr(args, name, "")))]
        if not storages or error.filename is not None or any(address in str(error) for address in storages):
            raise
        raise OSError(f"{', '.join(storages)}: {error.strerror or error}{_MEND.get(args.word, '')}") from error
