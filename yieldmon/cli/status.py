"""Show what a running daemon is doing."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from yieldmon import units as read
from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._units import add_units
from yieldmon.files.units import units_of
from yieldmon.units import Units

_SHOWN_WINDOWS = 5


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "status",
        help="show what a running daemon is doing",
        description=__doc__,
        epilog="example: yieldmon status --json",
    )
    add_daemon_arguments(parser)
    add_units(parser, "the daemon's configuration")
    parser.add_argument("--json", action="store_true", help="print everything as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when a daemon answered."""
    status = ask_daemon(args, {"command": "status"})
    if args.json:
        json.dump(status, sys.stdout, indent=2)
        print()
    else:
        units = units_of(args.units, status["units"], status["crop"]["name"])
        _show(status, units, Console(highlight=False, markup=False, emoji=False))
    return 0


def _show(status: Mapping[str, Any], units: Units, console: Console) -> None:
    load, total, bus, store = (status[key] for key in ("load", "total", "bus", "store"))
    sweep, parameters = status["sweep"], status["parameters"]
    facts = Table(show_header=False, box=None, pad_edge=False)
    dropped = bus["dropped"] + bus["kernel_drops"]
    state = f"{status['state'].replace('_', ' ')}, up {_span(status['uptime_s'])}"
    facts.add_row("state", f"STALE, as it was {_span(status['age_s'])} ago: {state}" if status["stale"] else state)
    if status["zero_waits_for"]:
        facts.add_row("zero", f"waits for {status['zero_waits_for']}")
    facts.add_row("now", _now(status["now"], units))
    for name, text in _load(load, status["crop"], units):
        facts.add_row(name, text)
    contested_kg = total["contested_mass_kg"]
    apart = f", and {units.mass(contested_kg)} contested (more than one node sent samples)" if contested_kg else ""
    facts.add_row("total", f"{units.mass(total['mass_kg'])}{apart}")
    facts.add_row(
        "bus",
        f"{bus['interface']} {bus['channel']}: {bus['frames_per_s']:.0f} frames/s, {dropped} dropped, "
        f"{bus['error_frames']} error frames, {bus['sent']} sent, {bus['late'] + bus['refused']} not sent; "
        f"time stamps: {bus['time_stamps']}",
    )
    facts.add_row("store", f"{store['file']}: {store['failing'] or store['note'] or 'writing'}, {store['pending']} waiting")
    facts.add_row("sweep", f"{sweep['state'].replace('_', ' ')}, {_due(sweep['due_in_s'])}, {sweep['sweeps']} so far")
    for name, text in _waveform(status["waveform"], units):
        facts.add_row(name, text)
    values = ", ".join(f"{name} {entry['value']:.4g} ± {entry['std_dev']:.2g}" for name, entry in parameters["values"].items())
    age = "age not known" if parameters["age_s"] is None else f"{_span(parameters['age_s'])} old"
    curve = "" if parameters["estimator"] == "physical" else f", {parameters['estimator']}"
    facts.add_row("parameters", f"version {parameters['version']}{curve}, {age}" + (f": {values}" if values else ""))
    for note in status["signals"]["notes"]:
        facts.add_row("signals", note)
    facts.add_row("reload", status["configuration"]["reload"])
    console.print(facts)
    if status["windows"]:
        flow = units.flow_unit
        windows = Table(
            "window", f"flow {flow.name}", f"± {flow.name}", "quality", "force N", "plate deg", "speed rpm", "lost", box=None
        )
        for row in status["windows"][-_SHOWN_WINDOWS:]:
            flows = (_number(row[key], flow.si) for key in ("mass_flow_kg_s", "std_dev_kg_s"))
            numbers = (_number(row[key]) for key in ("force_n", "plate_angle_deg", "elevator_speed_rpm"))
            windows.add_row(str(row["number"]), *flows, row["quality"].replace("_", " "), *numbers, str(row["lost_frames"]))
        console.print(windows)
    for fault in status["faults"]:
        detail = f" ({fault['detail']})" if fault["detail"] else ""
        console.print(Text.assemble((fault["code"], "bold"), f"{detail}: {fault['effect']} {fault['remedy']}"))
    if not status["faults"]:
        console.print("no faults")


def _now(now: Mapping[str, Any], units: Units) -> str:
    parts = [units.flow(now["mass_flow_kg_s"]) if now["mass_flow_kg_s"] is not None else "no flow"]
    if now["yield_kg_m2"] is not None:
        parts.append(units.crop_yield(now["yield_kg_m2"]))
    if now["moisture_pct"] is not None:
        parts.append(f"moisture {read.moisture(now['moisture_pct'])}")
    if now["ground_speed_m_s"] is not None:
        parts.append(units.speed(now["ground_speed_m_s"]))
    return ", ".join(parts)


def _load(load: Mapping[str, Any], crop: Mapping[str, Any], units: Units) -> Iterator[tuple[str, str]]:
    """The load's rows: its masses, and its area and yields where they are known."""
    names = " ".join(name for name in (load["field"], load["crop"]) if name)
    spread = load["std_dev_kg"]
    around = f" ± {units.mass(spread)}" if spread is not None else ""
    dry = "not known" if load["dry_mass_kg"] is None else units.mass_with_bushels(load["dry_mass_kg"])
    at = f" at {crop['market_moisture_pct']:g} %"
    title = f"{load['number']}{'' if load['open'] else ' (closed)'}{' ' if names else ''}{names}"
    yield "load", f"{title}: {units.mass_with_bushels(load['mass_kg'])}{around} wet, dry {dry}{at}"
    if load["area_m2"] is not None:
        dry_yield = load["dry_yield_kg_m2"]
        text = f"{units.area(load['area_m2'])}, {units.crop_yield(load['yield_kg_m2'])} wet"
        yield "", text + (f", {units.crop_yield(dry_yield)} dry" if dry_yield is not None else "")


def _waveform(seen: Mapping[str, Any] | None, units: Units) -> Iterator[tuple[str, str]]:
    """Flow from the pulses' shape and from kernel noise, or why there is none; nothing where the waveform is switched off."""
    if seen is None:
        return
    for name, kind in (("shape", "shape"), ("kernels", "kernel")):
        flow, around = (seen[f"{kind}_{key}_kg_s"] for key in ("flow", "std_dev"))
        why = seen[f"{kind}_missing_because"]
        yield name, f"no flow: {why}" if flow is None else f"{units.flow(flow)} ± {units.flow(around)}"


def _number(value: float | None, unit_si: float = 1.0) -> str:
    return read.UNKNOWN if value is None else read.rounded(value / unit_si)


def _due(seconds: float | None) -> str:
    return "none due" if seconds is None else "due" if seconds == 0.0 else f"next in {_span(seconds)}"


def _span(seconds: float) -> str:
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
