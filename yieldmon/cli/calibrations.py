"""List the calibrations of a running daemon, or undo one.

The list shows each change of parameters, with operator and time: parameter files with adopted effects, sweeps, tickets, crops,
and zero calibrations.
"""

from __future__ import annotations

import argparse

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._json import print_document, print_json
from yieldmon.cli._records import back, show, when
from yieldmon.errors import InputError

_SHOWN = 30


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "calibrations",
        help="list calibrations and zeros, or undo one",
        description=f"{__doc__} undo removes a calibration. Later tickets update the parameters again; an undone ticket "
        "corrects only its load. To undo a zero use `yieldmon zero --undo`.",
        epilog="example: yieldmon calibrations list; yieldmon calibrations undo 14",
    )
    actions = parser.add_subparsers(dest="action", metavar="list|undo", required=True)
    listing = actions.add_parser(
        "list", help=f"show the newest {_SHOWN}; with --json all", epilog="example: yieldmon calibrations list"
    )
    undo = actions.add_parser(
        "undo", help="write a new parameter version without this one", epilog="example: yieldmon calibrations undo 14"
    )
    undo.add_argument("version", metavar="VERSION", type=int, help="version, from the list")
    for action in (listing, undo):
        add_daemon_arguments(action)
        action.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon did it."""
    if args.action == "undo" and args.version < 1:
        raise InputError("VERSION", f"is {args.version}", "a version from `yieldmon calibrations list`")
    if args.action == "undo":
        answer = ask_daemon(args, {"command": "calibration-undo", "version": args.version})
        print_document(answer, back, as_json=args.json)
        return 0
    answer = ask_daemon(args, {"command": "calibrations"})
    if args.json:
        print_json(answer)
        return 0
    rows = (
        (
            "-" if row["version"] is None else str(row["version"]), row["kind"], when(row["time_s"]), row["who"] or "-",
            row["origin"] or "-", ", ".join(row["effects"]) or "-", row["state"] or "-", row["what"] or "-",
        )
        for row in answer["calibrations"][-_SHOWN:]
    )  # fmt: skip
    show(("version", "what", "when", "by", "origin", "effects", "state", "reason"), rows)
    return 0
