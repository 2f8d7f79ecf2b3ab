"""Show what a running daemon is doing."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from rich.console import Console
from rich.table import Table
from rich.text import Text

from yieldmon import units as read
from yieldmon.cli import _notes
from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.cli._json import print_json
from yieldmon.cli._units import add_units
from yieldmon.documents.status import (
    Status,
    StatusCrop,
    StatusLoad,
    StatusNetwork,
    StatusNow,
    StatusParameters,
    StatusSweep,
    StatusWaveform,
)
from yieldmon.files.units import units_of
from yieldmon.units import Units

_SHOWN_SECONDS = 5
_LARGE_SHARE = 0.02
"""Of a load's mass, as its standard deviation."""
_CORRECTED = 0.001
"""Share of a load's mass from which its correction is shown."""


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
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when a daemon answered."""
    status = cast("Status", ask_daemon(args, {"command": "status"}))
    if args.json:
        print_json(status)
    else:
        units = units_of(args.units, status["units"], status["crop"]["name"])
        _show(status, units, Console(highlight=False, markup=False, emoji=False))
    return 0


def _show(status: Status, units: Units, console: Console) -> None:
    facts = Table(show_header=False, box=None, pad_edge=False)
    for name, text in _facts(status, units):
        facts.add_row(name, text)
    console.print(facts)
    if status["windows"]:
        console.print(_seconds(status["windows"][-_SHOWN_SECONDS:], units))
    for fault in status["faults"]:
        detail = f" ({units.in_text(fault['detail'])})" if fault["detail"] else ""
        console.print(Text.assemble((fault["code"], "bold"), f"{detail}: {fault['effect']} {fault['remedy']}"))
    if not status["faults"]:
        console.print("no faults")


def _grain_without_load(status: Status) -> bool:
    """Whether grain comes and no load is open, as after a `yieldmon load stop` that nothing followed."""
    return status["load"]["open"] is False and status["state"] in ("harvesting", "sweeping")


def _facts(status: Status, units: Units) -> Iterator[tuple[str, str]]:
    """Name and text of each row, most wanted first."""
    bus, store, configuration = status["bus"], status["store"], status["configuration"]
    state = f"{_words(status['state'])}, running for {_span(status['uptime_s'])}"
    yield "state", f"STALE, {_span(status['age_s'])} old: {state}" if status["stale"] else state
    if status["zero_waits_for"]:
        yield "zero", f"waits for {units.in_text(status['zero_waits_for'])}"
    yield "now", _now(status["now"], units)
    yield from _load(status["load"], status["crop"], units)
    if (why := status["now"].get("area_missing_because")) is not None:
        yield "", f"no area and no yield now: {why}"
    if corrected := _corrected(status, units):
        yield "", corrected
    if _grain_without_load(status):
        yield "", "no load is open: until `yieldmon load start`, grain counts only in the total"
    total = status["total"]
    contested_kg, spread_kg = total["contested_mass_kg"], total["std_dev_kg"]
    around = f" ± {units.mass(spread_kg)}" if spread_kg is not None else ""
    apart = f", and {units.mass(contested_kg)} contested (more than one node sent samples)" if contested_kg else ""
    yield "total", f"{units.mass(total['mass_kg'])}{around}{apart}"
    for name, text in _sweep(status["sweep"]):
        yield name, units.in_text(text)
    yield from _waveform(status["waveform"], units)
    yield "parameters", _parameters(status["parameters"])
    if scale_error := status["parameters"].get("scale_error"):
        yield "", _notes.not_calibrated(scale_error, status["parameters"].get("carried_from", ""))
    dropped = bus["dropped"] + bus["kernel_drops"]
    yield (
        "bus",
        f"{bus['interface']} {bus['channel']}: {bus['frames_per_s']:.0f} frames/s received, {dropped} dropped, "
        f"{bus['error_frames']} error frames; {bus['sent']} sent, {bus['late'] + bus['refused']} not sent; "
        f"time stamps: {bus['time_stamps']}",
    )
    yield from _network(status["network"])
    for note in status["signals"]["notes"]:
        yield "signals", note
    waiting = f", {store['pending']} s of records not yet written" if store["pending"] else ""
    dropped_s = store["records_dropped"]
    lost = f", {dropped_s} s of records dropped (their mass counts)" if dropped_s else ""
    yield "store", f"{store['file']}: {store['failing'] or store['note'] or 'writing'}{waiting}{lost}"
    yield "configuration", f"{configuration['file']}; reload: {configuration['reload']}"


def _seconds(rows: Sequence[Mapping[str, Any]], units: Units) -> Table:
    flow = units.flow_unit
    table = Table(
        "second",
        f"flow {flow.name}",
        f"± {flow.name}",
        "quality",
        "force N",
        "plate deg",
        "elevator rpm",
        "lost frames",
        box=None,
    )
    for row in rows:
        flows = (_number(row[key], flow.si) for key in ("mass_flow_kg_s", "std_dev_kg_s"))
        numbers = (_number(row[key]) for key in ("force_n", "plate_angle_deg", "elevator_speed_rpm"))
        table.add_row(str(row["number"]), *flows, _words(row["quality"]), *numbers, str(row["lost_frames"]))
    return table


def _now(now: StatusNow, units: Units) -> str:
    quality = f" ({_words(now['quality'])})" if now["quality"] is not None else ""
    if now["mass_flow_kg_s"] is None:
        parts = [f"no mass flow{quality}"]
    else:
        around = f" ± {units.flow(now['std_dev_kg_s'])}" if now["std_dev_kg_s"] is not None else ""
        parts = [f"{units.flow(now['mass_flow_kg_s'])}{around}{quality}"]
    if now["yield_kg_m2"] is not None:
        parts.append(units.crop_yield(now["yield_kg_m2"]))
    if now["moisture_pct"] is not None:
        parts.append(f"moisture {read.moisture(now['moisture_pct'])}")
    if now["ground_speed_m_s"] is not None:
        parts.append(units.speed(now["ground_speed_m_s"]))
    return ", ".join(parts)


def _load(load: StatusLoad, crop: StatusCrop, units: Units) -> Iterator[tuple[str, str]]:
    """The load's rows: its masses, and its area and yields where they are known."""
    names = " ".join(name for name in (load["field"], load["crop"]) if name)
    spread = load["std_dev_kg"]
    around = f" ± {units.mass(spread)}" if spread is not None else ""
    dry = "dry mass not known (moisture was missing or implausible for part of it)"
    if load["dry_mass_kg"] is not None:
        dry = f"{units.mass_with_bushels(load['dry_mass_kg'])} dry, at {crop['market_moisture_pct']:g} % moisture"
    title = f"{load['number']}{'' if load['open'] else ' (closed)'}{' ' if names else ''}{names}"
    yield "load", f"{title}: {units.mass_with_bushels(load['mass_kg'])}{around} wet, {dry}"
    if (unrecorded_s := load.get("unrecorded_s")) is not None:
        gap = f"{_span(unrecorded_s)} without a record"
        yield "", f"goes on from before a stop of the daemon, {gap}: grain of that time is missing here and in the total"
    elif load.get("complete") is False:
        yield "", "not every second of it was measured: grain of the others is missing here and in the total"
    if _by_calibration(load):
        yield "", "± comes mostly from the calibration: weigh a load (`yieldmon ticket`) to reduce it"
    if load["area_m2"] is not None:
        dry_yield = load["dry_yield_kg_m2"]
        text = f"{units.area(load['area_m2'])}, {units.crop_yield(load['yield_kg_m2'])} wet"
        yield "", text + (f", {units.crop_yield(dry_yield)} dry" if dry_yield is not None else "")


def _corrected(status: Status, units: Units) -> str:
    """What tickets or another crop have made of the load's mass; "" where they have not."""
    load = status["load"]
    known = next((row for row in status["loads"] if row["number"] == load["number"]), None)
    if load["open"] or known is None or abs(known["corrected_mass_kg"] - load["mass_kg"]) <= _CORRECTED * load["mass_kg"]:
        return ""
    spread = known["corrected_std_dev_kg"]
    around = f" ± {units.mass(spread)}" if spread is not None else ""
    return f"corrected since: {units.mass_with_bushels(known['corrected_mass_kg'])}{around} (`yieldmon load list`)"


def _by_calibration(load: StatusLoad) -> bool:
    """Whether a load's standard deviation is large, and more than half of its variance the parameters'."""
    spread, parameters = load["std_dev_kg"], load["std_dev_by_cause_kg"]["parameters"]
    if spread is None or parameters is None or spread <= _LARGE_SHARE * load["mass_kg"]:
        return False
    return parameters**2 > 0.5 * spread**2


def _sweep(sweep: StatusSweep) -> Iterator[tuple[str, str]]:
    """Sweeps of the plate, and what came of the last one."""
    waits = sweep["state"] == "waiting"
    when = "for steady flow and elevator speed with the plate at home" if waits else _due(sweep["due_in_s"])
    yield "sweep", f"{_words(sweep['state'])}{' ' if waits else ', '}{when}, {sweep['sweeps']} so far"
    if sweep["aborted_because"] is not None:
        yield "", f"last sweep aborted: {sweep['aborted_because']}"
    if sweep.get("declined_because") is not None:
        yield "", f"{sweep['declined']} due sweeps not made; last reason: {sweep['declined_because']}"
    if sweep["last_update"] is not None:
        yield "", f"last update: {sweep['last_update']}"


def _network(network: StatusNetwork) -> Iterator[tuple[str, str]]:
    """Our address, where it is not the one that was asked for."""
    address, preferred = network["address"], network.get("preferred_address", network["address"])
    if address is None:
        yield "network", f"no address ({network['claim']}): nothing is sent"
    elif address != preferred:
        yield "network", f"address {address}: another node has the preferred {preferred}"


def _parameters(parameters: StatusParameters) -> str:
    """Version, age and values; a value without a deviation counts as exactly known."""
    values = ", ".join(
        f"{name} {entry['value']:.4g}" + (f" ± {entry['std_dev']:.2g}" if entry["std_dev"] else "")
        for name, entry in parameters["values"].items()
    )
    age = "age not known" if parameters["age_s"] is None else f"{_span(parameters['age_s'])} old"
    curve = "" if parameters["estimator"] == "physical" else f", {parameters['estimator']}"
    return f"version {parameters['version']}{curve}, {age}" + (f": {values}" if values else "")


def _waveform(seen: StatusWaveform | None, units: Units) -> Iterator[tuple[str, str]]:
    """Flow from the pulses' shape and from kernel noise, or why there is none; nothing where the waveform is switched off."""
    if seen is None:
        return
    for name, flow, around, why in (
        ("shape", seen["shape_flow_kg_s"], seen["shape_std_dev_kg_s"], seen["shape_missing_because"]),
        ("kernels", seen["kernel_flow_kg_s"], seen["kernel_std_dev_kg_s"], seen["kernel_missing_because"]),
    ):
        yield name, f"no flow: {why}" if flow is None else f"{units.flow(flow)} ± {units.flow(around)}"
    if seen.get("only_kernels_set_scale"):
        weight = f"{_number(seen['thousand_kernel_weight_g'])} g for a thousand kernels"
        yield "", f"that flow's scale rests on {weight}: no weighed load confirms it (`yieldmon ticket`)"


def _words(code: str) -> str:
    return code.replace("_", " ")


def _number(value: float | None, unit_si: float = 1.0) -> str:
    return read.UNKNOWN if value is None else read.rounded(value / unit_si)


def _due(seconds: float | None) -> str:
    return "none due" if seconds is None else "due" if seconds == 0.0 else f"next in {_span(seconds)}"


def _span(seconds: float) -> str:
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
