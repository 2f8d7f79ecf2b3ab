"""Calibrate the zero-load voltage of a running daemon; the elevator must run empty meanwhile."""

from __future__ import annotations

import argparse

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "zero", help="calibrate the zero-load voltage",
        description=__doc__,
        epilog="example: yieldmon zero",
    )
    add_daemon_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon has begun."""
    print(f"zero calibration {ask_daemon(args, {'command': 'zero'})['zero']}")
    return 0
