"""Run a virtual combine and the monitor on a virtual CAN bus, and print the error of the flow."""

from __future__ import annotations

import argparse
import sys
from math import isfinite
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from yieldmon.bus.codec import Codec
from yieldmon.cli import _outputs
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import whole_number, within
from yieldmon.cli._named_files import scenario_path
from yieldmon.errors import InputError
from yieldmon.files import whole_file
from yieldmon.physics.machine import RPM
from yieldmon.plant import scenario as scenarios
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plots import canvas
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.trial import accuracy, lockstep, picture

_HEADINGS = ("true flow, kg/s", "windows", "no number", "bias, kg/s", "rms, kg/s", "mean |error|, %", "95 % |error|, %")
EXAMPLE = "yieldmon demo --duration 120 --seed 1 --picture demo.png"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "demo", help="run a virtual combine and the monitor", description=__doc__, epilog=f"example: {EXAMPLE}"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="simulated time, s (default: the scenario's)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="random seed (default: %(default)s)")
    parser.add_argument("--scenario", metavar="FILE", help="scenario file or shipped name (default: demo)")
    parser.add_argument("--config", metavar="FILE", help="configuration file (default: the shipped one)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="plot true and measured flow to this file (PNG or SVG)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    _outputs.add_force(parser, "picture")


def run(args: argparse.Namespace) -> int:
    """Run the demo; 0 unless something failed."""
    if args.picture is not None:
        canvas.check_name(args.picture, "--picture")
        whole_file.check_place(args.picture)
    whole_number("--seed", args.seed, 0)
    chosen = scenarios.load(scenario_path(args.scenario or "demo"))
    if args.duration is not None:
        within("--duration", args.duration, 10.0, 400_000.0, "s")
        chosen = chosen.model_copy(update={"duration_s": args.duration})
    settings = configuration.load(args.config or shipped("config/yieldmon.yaml"))
    machine = settings.machine
    if args.scenario is not None and chosen.machine != machine.name:
        raise InputError(args.scenario, f"machine is {chosen.machine!r}", f"{machine.name!r} as configured")
    monitor = build_monitor(settings.engine, machine, settings.parameters, settings.calibrator)
    console = Console(stderr=True)
    with Progress(
        TextColumn("simulated"), BarColumn(), TextColumn("{task.completed:.0f} / {task.total:.0f} s"), TimeRemainingColumn(),
        console=console, transient=True, disable=not sys.stderr.isatty(),
    ) as progress:  # fmt: skip
        task = progress.add_task("simulated", total=chosen.duration_s)
        combine = VirtualCombine(chosen, machine, args.seed)
        result = lockstep.run(combine, monitor, Codec(), lambda t: progress.update(task, completed=t))
    delay_s = 0.5 * machine.pattern_length_m / machine.paddle_speed_m_s(chosen.elevator.speed_rpm * RPM)
    found = accuracy.assess(result.published, combine.delivered_kg, delay_s, chosen.duration_s)
    if args.json:
        print_json(found.to_json())
    else:
        _show(found, result.frames_on_bus, chosen.duration_s)
    if args.picture:
        picture.draw(found, args.picture)
        print(f"picture: {args.picture}", file=sys.stderr)
    return 0


def _show(found: accuracy.Accuracy, frames: int, duration_s: float) -> None:
    print(f"measured against true flow, 1 Hz, {duration_s:.0f} s, {frames} frames")
    for row in (_HEADINGS, *map(_cells, found.bands)):
        print("   ".join(f"{cell:>{len(heading)}}" for cell, heading in zip(row, _HEADINGS, strict=True)))
    print(
        f"from {accuracy.RATED_FROM_KG_S:.0f} kg/s: mean |error| {found.mean_abs_pct:.2f} %, "
        f"95th percentile {found.p95_abs_pct:.2f} %, "
        f"{found.missing_rated_windows} of {found.rated_windows} windows without a number"
    )
    print(
        f"accumulated: {found.measured_mass_kg:.1f} kg of {found.true_mass_kg:.1f} kg ({found.mass_error_pct:+.2f} %), "
        f"{found.sweeps} sweeps"
    )


def _cells(band: accuracy.Band) -> tuple[str, ...]:
    errors = (band.bias_kg_s, band.rms_kg_s, band.mean_abs_pct, band.p95_abs_pct)
    counts = (f"{band.low_kg_s:.0f}-{band.high_kg_s:.0f}", str(band.windows), str(band.missing))
    return counts + tuple(f"{value:z.2f}" if isfinite(value) else "-" for value in errors)
