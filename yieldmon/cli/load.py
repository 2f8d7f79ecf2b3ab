"""Start or stop a load, or list all loads, on a running daemon."""

from __future__ import annotations

import argparse
import json
import sys

from rich.console import Console
from rich.table import Table

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "load", help="start or stop a load, or list all loads",
        description=__doc__,
        epilog="example: yieldmon load start --field north    and later: yieldmon load stop",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    start = actions.add_parser("start", help="begin a new load")
    start.add_argument("--field", help="field name, for this load and the next ones")
    start.add_argument("--crop", help="crop, for this load and the next ones; measures with what is known of it")
    start.add_argument(
        "--thousand-kernel-weight", type=float, metavar="G",
        help="mass of a thousand kernels, g, for this load and the next ones; the scale of flow from kernel noise",
    )
    stop = actions.add_parser("stop", help="the load is complete")
    listing = actions.add_parser("list", help="list all loads, as measured and as corrected by tickets")
    for action in (start, stop, listing):
        add_daemon_arguments(action)
        action.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon did it."""
    request: dict[str, object] = {"command": "loads" if args.action == "list" else f"load-{args.action}"}
    if args.action == "start":
        request |= {key: value for key in ("field", "crop") if (value := getattr(args, key)) is not None}
        if args.thousand_kernel_weight is not None:
            request["thousand_kernel_weight_g"] = args.thousand_kernel_weight
    answer = ask_daemon(args, request)
    if args.json:
        json.dump(answer, sys.stdout, indent=2)
        print()
    elif args.action == "list":
        table = Table("load", "field", "crop", "measured kg", "dry kg", "ticket kg", "corrected kg", box=None)
        for load in answer["loads"]:
            masses = ("mass_kg", "dry_mass_kg", "ticket_mass_kg", "corrected_mass_kg")
            cells = ("-" if load[key] is None else f"{load[key]:.1f}" for key in masses)
            table.add_row(str(load["number"]), load["field"] or "-", load["crop"] or "-", *cells)
        Console(highlight=False, markup=False, emoji=False).print(table)
    elif args.action == "start":
        names = " ".join(name for name in (answer["field"], answer["crop"]) if name)
        print(f"load {answer['load']} started" + (f": {names}" if names else ""))
        if answer["parameters"]["changed"]:
            print(f"measuring with the parameters of {answer['crop']}, version {answer['parameters']['version']}")
    else:
        print(f"load {answer['load']} complete: {answer['mass_kg']:.1f} kg")
    return 0
