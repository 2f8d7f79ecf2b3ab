"""Correct one or several past loads by a weighed mass.

What was measured stays on record beside the correction. A ticket for loads that the running daemon measured also becomes a
reference mass for its calibration.
"""

from __future__ import annotations

import argparse
import json
import sys

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon, mass
from yieldmon.errors import InputError

#: A correction beyond this is a wrong unit or load rather than a drifted calibration.
UNLIKELY_PCT = 30.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "ticket", help="correct past loads by a weighed mass",
        description=__doc__,
        epilog="example: yieldmon ticket 3-5 27.4t --note \"elevator scale\"",
    )
    parser.add_argument("loads", metavar="LOAD", help="number of the load, or FIRST-LAST for several on one ticket")
    parser.add_argument("mass", metavar="MASS", help="weighed mass: 9120, 9120kg or 9.12t")
    parser.add_argument("--std-dev", metavar="MASS", help="standard deviation of the weighing (default: 0.5 %% of it)")
    parser.add_argument("--note", help="a note to keep with it")
    add_daemon_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the ticket was taken."""
    first, last = _loads(args.loads)
    request = {"command": "ticket", "first_load": first, "last_load": last, "mass_kg": mass(args.mass), "note": args.note}
    if args.std_dev is not None:
        request["std_dev_kg"] = mass(args.std_dev)
    answer = ask_daemon(args, request)
    which = f"load {first}" if first == last else f"loads {first} to {last}"
    change_pct = 100.0 * (answer["factor"] - 1.0)
    if abs(change_pct) > UNLIKELY_PCT:
        doubt = f"{change_pct:+.0f} % is a lot; if it is a slip, enter the right mass as another ticket"
        print(f"yieldmon: {which}: {doubt}", file=sys.stderr)
    if args.json:
        json.dump(answer, sys.stdout, indent=2)
        print()
    else:
        why_not = "no reference: not measured whole since the last start or reload"
        use = "a reference for the calibration" if answer["anchor"] else why_not
        print(
            f"{which}: measured {answer['measured_mass_kg']:.1f} kg, weighed "
            f"{answer['weighed_mass_kg']:.1f} kg ({change_pct:+.2f} %); {use}"
        )
    return 0


def _loads(text: str) -> tuple[int, int]:
    first, dash, last = text.partition("-")
    if not first.isdecimal() or (dash and not last.isdecimal()):
        raise InputError("LOAD", repr(text), "a number such as 7, or FIRST-LAST such as 7-9")
    return int(first), int(last) if dash else int(first)
