"""List the calibrations of a running daemon, undo one, or start over after a change of the machine.

The list shows parameter files, adopted effects, sweeps, tickets, crops and zeros, with operator and time.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from yieldmon.cli._answers import calibration_undone
from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._json import print_document, print_json
from yieldmon.cli._records import named, show, when
from yieldmon.errors import InputError

_SHOWN = 30


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "calibrations",
        help="list calibrations and zeros, undo one, or start over",
        description=f"{__doc__} undo removes a calibration. Later tickets update the parameters again; an undone ticket "
        "corrects only its load. To undo a zero use `yieldmon zero --undo`.",
        epilog="example: yieldmon calibrations list; yieldmon calibrations undo 14",
    )
    actions = parser.add_subparsers(dest="action", metavar="list|undo|restart", required=True)
    listing = actions.add_parser(
        "list", help=f"show the newest {_SHOWN}; with --json all", epilog="example: yieldmon calibrations list"
    )
    undo = actions.add_parser(
        "undo", help="write a new parameter version without this one", epilog="example: yieldmon calibrations undo 14"
    )
    undo.add_argument("version", metavar="VERSION", type=int, help="version, from the list")
    restart = actions.add_parser(
        "restart",
        help="after a change of the machine: earlier tickets and sweeps no longer count",
        epilog='example: yieldmon calibrations restart --note "new chain"',
    )
    restart.add_argument("--note", metavar="TEXT", help="what was changed")
    for action in (listing, undo, restart):
        add_daemon_arguments(action)
        action.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon did it."""
    if args.action == "undo" and args.version < 1:
        raise InputError("VERSION", f"is {args.version}", "a version from `yieldmon calibrations list`")
    if args.action == "undo":
        answer = ask_daemon(args, {"command": "calibration-undo", "version": args.version})
        print_document(answer, calibration_undone, as_json=args.json)
        return 0
    if args.action == "restart":
        note = {} if args.note is None else {"note": args.note}
        answer = ask_daemon(args, {"command": "calibration-restart", **note})
        print_document(answer, _restarted, as_json=args.json)
        return 0
    answer = ask_daemon(args, {"command": "calibrations"})
    if args.json:
        print_json(answer)
        return 0
    rows = (
        (
            "-" if row["version"] is None else str(row["version"]), row["kind"], row.get("crop") or "-",
            when(row["time_s"]), row["who"] or "-", row["origin"] or "-",
            ", ".join(row["effects"]) or "-", row["state"] or "-", row["what"] or "-",
        )
        for row in answer["calibrations"][-_SHOWN:]
    )  # fmt: skip
    show(("version", "what", "crop", "when", "by", "origin", "effects", "state", "reason"), rows)
    return 0


def _restarted(answer: Mapping[str, Any]) -> str:
    """What beginning anew did, and what is to be done next."""
    parts = [f"calibration starts over with version {answer['version']}" + (f" of {answer['crop']}" if answer["crop"] else "")]
    if answer["tickets"]:
        parts.append(f"{named('ticket', answer['tickets'])} no longer {'update' if len(answer['tickets']) > 1 else 'updates'} it")
    if answer["load"] is not None:
        parts.append(f"load {answer['load']} started")
    parts.append(f"± {answer['std_dev_pct']:.0f} % until you weigh a load; run the elevator empty and `yieldmon zero` first")
    return "; ".join(parts) + f"; to undo this: `yieldmon calibrations undo {answer['version']}`"
