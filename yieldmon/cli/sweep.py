"""Start or abort a self-calibration sweep of a running daemon."""

from __future__ import annotations

import argparse

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "sweep",
        help="start or abort a self-calibration sweep",
        description=__doc__,
        epilog="example: yieldmon sweep start",
    )
    parser.add_argument(
        "action",
        choices=("start", "abort"),
        help="start: sweep as soon as flow and speed are steady; abort: return the plate home",
    )
    add_daemon_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon took it."""
    said = ask_daemon(args, {"command": f"sweep-{args.action}"})["sweep"]
    print(f"a sweep begins {said}" if args.action == "start" else f"sweep {said}")
    return 0
