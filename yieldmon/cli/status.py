"""Show what a running daemon is doing."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon

_SHOWN_WINDOWS = 5


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "status", help="show what a running daemon is doing",
        description=__doc__,
        epilog="example: yieldmon status --json",
    )
    add_daemon_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print everything as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when a daemon answered."""
    status = ask_daemon(args, {"command": "status"})
    if args.json:
        json.dump(status, sys.stdout, indent=2)
        print()
    else:
        _show(status, Console(highlight=False, markup=False, emoji=False))
    return 0


def _show(status: Mapping[str, Any], console: Console) -> None:
    load, total, bus, store = (status[key] for key in ("load", "total", "bus", "store"))
    sweep, parameters = status["sweep"], status["parameters"]
    facts = Table(show_header=False, box=None, pad_edge=False)
    names = " ".join(name for name in (load["field"], load["crop"]) if name)
    dropped = bus["dropped"] + bus["kernel_drops"]
    state = f"{status['state'].replace('_', ' ')}, up {_span(status['uptime_s'])}"
    facts.add_row("state", f"STALE, as it was {_span(status['age_s'])} ago: {state}" if status["stale"] else state)
    facts.add_row(
        "load",
        f"{load['number']}{'' if load['open'] else ' (closed)'} {names}: {load['mass_kg']:.1f} kg, "
        f"dry {_mass(load['dry_mass_kg'])}",
    )
    contested_kg = total["contested_mass_kg"]
    apart = f", and {contested_kg:.1f} kg contested (more than one node sent samples)" if contested_kg else ""
    facts.add_row("total", f"{total['mass_kg']:.1f} kg{apart}")
    facts.add_row(
        "bus",
        f"{bus['interface']} {bus['channel']}: {bus['frames_per_s']:.0f} frames/s, {dropped} dropped, "
        f"{bus['error_frames']} error frames, {bus['sent']} sent, {bus['late'] + bus['refused']} not sent",
    )
    facts.add_row("store", f"{store['file']}: {store['failing'] or store['note'] or 'writing'}, {store['pending']} waiting")
    facts.add_row("sweep", f"{sweep['state'].replace('_', ' ')}, {_due(sweep['due_in_s'])}, {sweep['sweeps']} so far")
    values = ", ".join(f"{name} {entry['value']:.4g} ± {entry['std_dev']:.2g}" for name, entry in parameters["values"].items())
    age = "age not known" if parameters["age_s"] is None else f"{_span(parameters['age_s'])} old"
    facts.add_row("parameters", f"version {parameters['version']}, {age}: {values}")
    for note in status["signals"]["notes"]:
        facts.add_row("signals", note)
    facts.add_row("reload", status["configuration"]["reload"])
    console.print(facts)
    if status["windows"]:
        windows = Table("window", "flow kg/s", "± kg/s", "quality", "force N", "plate deg", "speed rpm", "lost", box=None)
        for row in status["windows"][-_SHOWN_WINDOWS:]:
            numbers = ("mass_flow_kg_s", "std_dev_kg_s", "quality", "force_n", "plate_angle_deg", "elevator_speed_rpm")
            windows.add_row(str(row["number"]), *(_cell(row[key]) for key in numbers), str(row["lost_frames"]))
        console.print(windows)
    for fault in status["faults"]:
        detail = f" ({fault['detail']})" if fault["detail"] else ""
        console.print(Text.assemble((fault["code"], "bold"), f"{detail}: {fault['effect']} {fault['remedy']}"))
    if not status["faults"]:
        console.print("no faults")


def _cell(value: float | str | None) -> str:
    if value is None:
        return "-"
    return value.replace("_", " ") if isinstance(value, str) else f"{value:.2f}"


def _mass(mass_kg: float | None) -> str:
    return "not known" if mass_kg is None else f"{mass_kg:.1f} kg"


def _due(seconds: float | None) -> str:
    return "none due" if seconds is None else "due" if seconds == 0.0 else f"next in {_span(seconds)}"


def _span(seconds: float) -> str:
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
