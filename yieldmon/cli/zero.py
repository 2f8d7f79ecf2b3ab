"""Calibrate the zero-load voltage of a running daemon. The elevator must run empty."""

from __future__ import annotations

import argparse

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._json import print_json
from yieldmon.files.units import units_of


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "zero",
        help="calibrate the zero-load voltage",
        description=f"{__doc__} The daemon refuses while pulses, plate or tank indicate grain. --undo restores the previous zero "
        "and recomputes the seconds since.",
        epilog="example: yieldmon zero",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--force", action="store_true", help="calibrate in spite of signs of grain")
    what.add_argument("--undo", action="store_true", help="undo the last zero calibration")
    add_daemon_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon has begun, or has taken it back."""
    answer = ask_daemon(args, {"command": "zero-undo"} if args.undo else {"command": "zero", "force": args.force})
    if args.json:
        print_json(answer)
    elif args.undo:
        units, kg = units_of(None, answer.get("units", "metric")), answer["restored_kg"]
        restored = f"{'-' if kg < 0.0 else '+'}{units.mass(abs(kg))}"
        print(f"zero calibration undone; {restored} since then")
    else:
        print(f"zero calibration {answer['zero']}")
    return 0
