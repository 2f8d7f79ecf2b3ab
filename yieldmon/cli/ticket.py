"""Correct one or several past loads by a weighed mass, list the tickets, or take one back.

What was measured stays on record beside the correction. A ticket for loads that the running daemon measured also becomes a
reference mass for its calibration, and the loads of the last three days are recomputed with the new parameters.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from yieldmon.cli._answers import ticket_undone, tickets_replaced
from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._json import print_json
from yieldmon.cli._records import load_numbers, show, undone_at, when
from yieldmon.cli._typed_mass import in_thousands, mass
from yieldmon.cli._units import add_units
from yieldmon.errors import InputError
from yieldmon.files.units import units_of
from yieldmon.units import Units

_OPTIONAL = {"--std-dev": "std_dev_kg", "--other": "other_kg", "--other-std-dev": "other_std_dev_kg"}
"""Options that are masses, with their names in a request."""
#: A correction beyond this is a wrong unit or load rather than a drifted calibration.
UNLIKELY_PCT = 30.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "ticket",
        help="correct past loads by a weighed mass",
        description=__doc__,
        epilog="example: yieldmon ticket 3-5 27.4t; yieldmon ticket list; yieldmon ticket undo 2",
    )
    parser.add_argument("loads", metavar="LOAD|list|undo", help="number of the load, or FIRST-LAST for several on one ticket")
    parser.add_argument(
        "mass",
        metavar="MASS|N",
        nargs="*",
        help="mass: 9120kg, 9.12t, 91.2dt, 91.2q or 20106lb, weighed in parts 9.1t+8.4t; undo: number of the ticket",
    )
    parser.add_argument("--std-dev", metavar="MASS", help="standard deviation of the weighing (default: 0.5 %% of it)")
    parser.add_argument("--other", metavar="MASS", help="part of MASS from another combine, by its monitor")
    parser.add_argument("--other-std-dev", metavar="MASS", help="standard deviation of --other (default: 3 %% of it)")
    parser.add_argument("--note", metavar="TEXT", help="note to keep with the ticket")
    add_daemon_arguments(parser)
    add_units(parser, "the daemon's configuration")
    parser.add_argument("--json", action="store_true", help="print the answer as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the ticket was taken."""
    # `9.12 t` is one mass.
    args.mass = " ".join(args.mass) if args.mass else None
    if args.loads in ("list", "undo"):
        for name in ("std_dev", "other", "other_std_dev", "note"):
            if getattr(args, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise InputError(option, f"has no meaning with {args.loads}", "a load and its mass with it")
        return _listed(args) if args.loads == "list" else _undone(args)
    first, last = load_numbers(args.loads)
    if args.mass is None:
        raise InputError("MASS", "is missing", "the weighed mass: 9120, 9120kg or 9.12t")
    request = {
        "command": "ticket",
        "first_load": first,
        "last_load": last,
        "mass_kg": _sum_kg(args.mass),
        "note": args.note,
    }
    for option, key in _OPTIONAL.items():
        text = getattr(args, key.removesuffix("_kg"))
        if text is not None:
            request[key] = mass(text, option)
    _require_units(args)
    _require_decimals(args, first, last)
    _require_no_tonnes(args, first, last)
    answer = ask_daemon(args, request)
    which = f"load {first}" if first == last else f"loads {first} to {last}"
    change_pct = 100.0 * (answer["factor"] - 1.0)
    units = units_of(args.units, answer.get("units", "metric"), answer.get("crop", ""))
    for warning in _warnings(answer, units):
        print(f"yieldmon: {which}: {warning}", file=sys.stderr)
    if args.json:
        print_json(answer)
    else:
        why_not = f"no reference: {units.in_text(answer['why_no_reference'])}"
        crop = answer.get("waits_for_crop", "")
        use = f"a reference for {crop or 'the calibration'}" if answer["is_reference"] else why_not
        measured, weighed = (units.mass_with_bushels(answer[key]) for key in ("measured_mass_kg", "weighed_mass_kg"))
        print(f"{which}: measured {measured}, weighed {weighed} ({change_pct:+.2f} %); {use}")
        if truck := answer.get("truck"):
            print(_of_truck(truck, answer, units))
        if crop:
            print(
                f"it updates the parameters of {crop}, and loads of the last three days are recomputed, once {crop} is "
                "harvested again: ",
                end="",
            )
            print(f"`yieldmon load start --crop {crop}`, also for some seconds with the elevator empty")
        elif answer["is_reference"]:
            print("the loads of the last three days are recomputed with the updated parameters: `yieldmon load list`")
    return 0


def _warnings(answer: Mapping[str, Any], units: Units) -> Iterator[str]:
    """What is to be looked at again in a ticket that was taken."""
    # What earlier tickets made of the load tells a slip from a calibration that was off.
    off_pct = 100.0 * (answer["weighed_mass_kg"] / answer.get("known_mass_kg", answer["measured_mass_kg"]) - 1.0)
    doubt = answer.get("question") or (f"{off_pct:+.0f} % is a lot" if abs(off_pct) > UNLIKELY_PCT else "")
    if doubt:
        yield f"{units.in_text(doubt)}; if it is a slip, enter the right mass as another ticket"
    if answer.get("replaces"):
        yield tickets_replaced(answer)
    if (alone := answer.get("sets_scale_pct")) is not None:
        yield (
            f"as the first ticket, it alone sets the scale ({alone:+.1f} %); compare it with the slip, and weigh a second load, "
            "which confirms or contradicts it"
        )


def _of_truck(truck: Mapping[str, float], answer: Mapping[str, Any], units: Units) -> str:
    """How the mass of a truck that two combines filled was shared out."""
    whole, other, deviation = (units.mass(truck[key]) for key in ("truck_kg", "other_kg", "other_std_dev_kg"))
    own, own_deviation = units.mass(answer["own_mass_kg"]), units.mass(answer["own_std_dev_kg"])
    best, left = units.mass(answer["weighed_mass_kg"]), units.mass(truck["truck_kg"] - answer["weighed_mass_kg"])
    leaves = f"of the truck's {whole} the other combine's {other} +- {deviation} leave {own} +- {own_deviation}"
    return f"{leaves}; with what was measured it is {best}, and {left} of the other"


def _parts(text: str) -> list[str]:
    """The masses of a load that was weighed in parts, as 9.1t+8.4t has them."""
    return [part.strip() for part in text.strip().removeprefix("+").split("+")]


def _sum_kg(text: str) -> float:
    """The mass of a load from its parts, kg. Raises InputError, also where only some of them have a unit."""
    parts = _parts(text)
    if len(parts) > 1 and not all(parts):
        raise InputError("MASS", f"{text!r} lacks the mass of a part", "a mass on each side of +, such as 9.1t+8.4t")
    masses_kg = [mass(part) for part in parts]
    if len({part[-1].isalpha() for part in parts}) > 1:
        raise InputError("MASS", f"{text!r} has a unit at some parts only", "a unit at each part, such as 9.1t+8.4t")
    return sum(masses_kg)


def _require_units(args: argparse.Namespace) -> None:
    """Raises InputError for a mass without its unit where masses are shown in pounds."""
    given = {"MASS": args.mass} | {option: getattr(args, key.removesuffix("_kg")) for option, key in _OPTIONAL.items()}
    bare = {where: part for where, text in given.items() for part in _parts(text or "") if part[-1:].isdigit()}
    if bare and (args.units or ask_daemon(args, {"command": "loads"}).get("units")) == "us":
        where, text = next(iter(bare.items()))
        raise InputError(where, f"{text!r} is without its unit, where masses are shown in pounds", f"{text}lb or {text}kg")


def _require_decimals(args: argparse.Namespace, first: int, last: int) -> None:
    """Raises InputError for a mass such as 9.120kg where the loads' measured mass is nearer to that with a point between
    thousands, as slips in some languages have it."""
    texts = [(where, _parts(text)) for where, text in (("MASS", args.mass), ("--other", args.other)) if text]
    texts = [(where, parts) for where, parts in texts if any(map(in_thousands, parts))]
    loads = ask_daemon(args, {"command": "loads"})["loads"] if texts else ()
    measured_kg = sum(load["mass_kg"] for load in loads if first <= load["number"] <= last)
    for where, parts in texts:
        thousands = [in_thousands(part) or part for part in parts]
        kg = sum(map(mass, parts))
        if measured_kg > 0.0 and measured_kg**2 > kg * sum(map(mass, thousands)):
            may_be, as_kg = "+".join(thousands), "+".join(f"{mass(part):g}kg" for part in parts)
            problem = f"{'+'.join(parts)!r} may be {may_be} or a thousandth of that, where {measured_kg:,.0f} kg were measured"
            raise InputError(where, problem, f"{may_be}, or {as_kg}")


def _require_no_tonnes(args: argparse.Namespace, first: int, last: int) -> None:
    """Raises InputError for a mass without its unit, such as 9.12, that as tonnes is about what was measured."""
    parts = _parts(args.mass)
    if not all(part[-1:].isdigit() for part in parts) or any(map(in_thousands, parts)):
        return
    kg = sum(map(mass, parts))
    loads = ask_daemon(args, {"command": "loads"}).get("loads", ())
    measured_kg = sum(load["mass_kg"] for load in loads if first <= load["number"] <= last)
    if 0.5 * measured_kg < 1000.0 * kg < 2.0 * measured_kg:
        problem = f"{args.mass!r} is without its unit, and {kg:g} kg where {measured_kg:,.0f} kg were measured"
        tonnes, kilograms = ("+".join(part + unit for part in parts) for unit in ("t", "kg"))
        raise InputError("MASS", problem, f"{tonnes} or {kilograms}")


def _listed(args: argparse.Namespace) -> int:
    if args.mass is not None:
        raise InputError("ticket list", f"{args.mass!r} has no meaning here", "no further word")
    answer = ask_daemon(args, {"command": "tickets"})
    if args.json:
        print_json(answer)
        return 0
    units = units_of(args.units, answer.get("units", "metric"))
    rows = (
        (
            str(t["number"]), when(t["time_s"]), t["who"] or "-",
            str(t["first_load"]) if t["first_load"] == t["last_load"] else f"{t['first_load']}-{t['last_load']}",
            units.mass(t["measured_mass_kg"]), units.mass(t["weighed_mass_kg"]), _whole(t, units), t.get("state", "-"),
            undone_at(t["undone_s"], t["undone_by"]), t["note"] or "-",
        )
        for t in answer["tickets"]
    )  # fmt: skip
    show(("ticket", "entered", "by", "loads", "measured", "weighed", "truck - other", "state", "undone", "note"), rows)
    return 0


def _whole(ticket: Mapping[str, Any], units: Units) -> str:
    """The truck's mass and what another combine filled in."""
    truck = ticket.get("truck")
    return "-" if truck is None else f"{units.mass(truck['truck_kg'])} - {units.mass(truck['other_kg'])}"


def _undone(args: argparse.Namespace) -> int:
    if args.mass is None or not args.mass.isdecimal():
        given = "no number" if args.mass is None else f"is {args.mass!r}"
        raise InputError("ticket undo", given, "the number of a ticket, as `yieldmon ticket list` shows it")
    answer = ask_daemon(args, {"command": "ticket-undo", "ticket": int(args.mass)})
    if args.json:
        print_json(answer)
        return 0
    print(ticket_undone(answer))
    return 0
