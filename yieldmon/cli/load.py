"""Start or stop a load, list loads, or correct past ones, on a running daemon."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from yieldmon.cli._answers import loads_corrected
from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._json import print_json
from yieldmon.cli._load_sums import PAUSE_DAYS, load_sums, sum_rows
from yieldmon.cli._records import load_numbers, show
from yieldmon.cli._units import add_units
from yieldmon.files.units import units_of
from yieldmon.service.storage.empty_loads import not_listed
from yieldmon.units import UNKNOWN, crop_yield_kg_m2


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "load",
        help="start, stop, list or correct loads",
        description=__doc__,
        epilog="example: yieldmon load start --field north; yieldmon load stop; yieldmon load correct 7-8 --crop wheat",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    start = actions.add_parser("start", help="begin a new load", epilog="example: yieldmon load start --field north --crop corn")
    start.add_argument("--field", metavar="NAME", help="field name of this load and later ones")
    start.add_argument("--crop", metavar="NAME", help="crop of this load and later ones; selects its parameters")
    start.add_argument(
        "--thousand-kernel-weight",
        type=float,
        metavar="G",
        help="mass of a thousand kernels, g, of this load and later ones; scales the flow from kernel noise",
    )
    stop = actions.add_parser("stop", help="complete the load", epilog="example: yieldmon load stop")
    listing = actions.add_parser(
        "list", help="list loads, as measured and as corrected by tickets", epilog="example: yieldmon load list --json"
    )
    listing.add_argument(
        "--sums",
        action="store_true",
        help=f"show sums by field and crop; a new harvest begins after {PAUSE_DAYS} days without a load",
    )
    listing.add_argument("--all", action="store_true", help="also list complete loads without grain")
    correct = actions.add_parser(
        "correct",
        help="change crop or field of complete loads, or the field of the open one",
        epilog="example: yieldmon load correct 7-8 --crop wheat",
    )
    correct.add_argument("loads", metavar="LOAD", help="number, or FIRST-LAST")
    correct.add_argument("--field", metavar="NAME", help="field name")
    correct.add_argument("--crop", metavar="NAME", help="crop; its parameters recompute the loads")
    for action in (start, stop, listing, correct):
        add_daemon_arguments(action)
        add_units(action, "the daemon's configuration")
        action.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the daemon did it."""
    answer = ask_daemon(args, _request(args))
    if args.action == "list" and args.sums:
        answer = {**answer, "sums": load_sums(answer["loads"])}
    if args.json:
        print_json(answer)
    elif args.action == "list":
        _list(args, answer)
    elif args.action == "correct":
        print(loads_corrected(answer))
    elif args.action == "start":
        _say_started(answer)
    else:
        units = units_of(args.units, answer.get("units", "metric"), answer.get("crop", ""))
        print(f"load {answer['load']} complete: {units.mass_with_bushels(answer['mass_kg'])}")
        print("yieldmon: until the next `yieldmon load start`, grain counts only in the total", file=sys.stderr)
    return 0


def _request(args: argparse.Namespace) -> dict[str, object]:
    if args.action == "list":
        return {"command": "loads", "all": True} if args.all else {"command": "loads"}
    request: dict[str, object] = {"command": f"load-{args.action}"}
    if args.action == "correct":
        request["first_load"], request["last_load"] = load_numbers(args.loads)
    if args.action in ("start", "correct"):
        request |= {key: value for key in ("field", "crop") if (value := getattr(args, key)) is not None}
    if args.action == "start" and args.thousand_kernel_weight is not None:
        request["thousand_kernel_weight_g"] = args.thousand_kernel_weight
    return request


def _list(args: argparse.Namespace, answer: dict[str, Any]) -> None:
    system = args.units or answer.get("units", "metric")
    show(*(sum_rows(answer["sums"], system) if args.sums else _rows(answer["loads"], system)))
    if (empty := answer.get("empty_loads")) and not (args.all or args.sums):
        print(f"yieldmon: {not_listed(len(empty))}", file=sys.stderr)


def _say_started(answer: dict[str, Any]) -> None:
    names = " ".join(name for name in (answer["field"], answer["crop"]) if name)
    print(f"load {answer['load']} started" + (f": {names}" if names else ""))
    if answer["parameters"]["changed"]:
        other = answer["parameters"].get("carried_from", "")
        scale = f", and the scale of {other} until a load of {answer['crop']} is weighed" if other else ""
        print(f"measuring with the parameters of {answer['crop']}, version {answer['parameters']['version']}{scale}")
    elif not answer["crop_known"]:
        from yieldmon.files.crops import crops  # parameters, and numpy with them, which nothing else here needs

        known = ", ".join(crops())
        print(
            f"yieldmon: {answer['crop']} is not a known crop; the parameters are unchanged; known crops: {known}",
            file=sys.stderr,
        )


_MASSES = (
    "mass_kg",
    "std_dev_kg",
    "dry_mass_kg",
    "posted_mass_kg",
    "ticket_mass_kg",
    "corrected_mass_kg",
    "corrected_std_dev_kg",
)


def _rows(loads: list[dict[str, Any]], system: str) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of all loads; yields where the area is known, by the corrected mass."""
    units = units_of(system)
    mass, area = units.mass_unit, units.area_unit
    masses = (f"{name} {mass.name}" for name in ("measured", "±", "dry", "recomputed", "ticket", "corrected", "±"))
    heads = ["load", "field", "crop", *masses, f"area {area.name}", "yield"]
    rows = []
    for load in loads:
        found = (load[key] for key in _MASSES)
        cells = [UNKNOWN if kg is None else f"{mass.of(kg):,.0f}" for kg in found]
        cells.append(UNKNOWN if load["area_m2"] is None else f"{area.of(load['area_m2']):,.2f}")
        known = units_of(system, crop=load["crop"])
        cells.append(known.crop_yield(crop_yield_kg_m2(load["corrected_mass_kg"], load["area_m2"])))
        rows.append([str(load["number"]), load["field"] or UNKNOWN, load["crop"] or UNKNOWN, *cells])
    return heads, rows
