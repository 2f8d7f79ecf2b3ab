"""The discrete-element test facility: single throws, campaigns, the bench rig, and checks of the engine run itself.

Needs the extra: pip install 'yieldmon[dem]'. See studies/dem/README.md.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import cast

import can
import numpy as np

from studies.dem import bench_rig, campaign, checks, records, runner
from studies.dem.job import Contact, Grain, Release, Throw, kernel_defaults, merged, paddle_mass_kg, throw_from_dict
from studies.dem.pulses import CampaignPulses
from yieldmon.bus.codec import Codec
from yieldmon.errors import InputError
from yieldmon.files import machine_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant import scenario, truth_file
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.pulse_table import PulseTable
from yieldmon.resources import shipped

PELLET_KG = 1.2e-4
PELLET_DIAMETER_M = 0.006


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def throw_of(args: argparse.Namespace) -> Throw:
    machine = machine_file.load(Path(args.machine)) if args.machine else Machine()
    preset = throw_from_dict(merged(kernel_defaults(args.kernel), {"paddle_mass_kg": 1.0}))
    rolling = preset.contact.rolling_friction if args.rolling_friction is None else args.rolling_friction
    spin = args.elevator_speed * RPM
    load = args.paddle_mass if args.paddle_mass is not None else paddle_mass_kg(machine, args.mass_flow, spin)
    try:
        throw = replace(
            preset,
            paddle_mass_kg=load,
            elevator_speed_rad_s=spin,
            seed=args.seed,
            machine=machine,
            contact=Contact(args.friction, rolling, args.restitution),
            release=Release(args.release, math.radians(args.release_angle)),
        )
        return replace(throw, time_step_s=args.time_step) if args.time_step else throw
    except ValueError as error:
        raise InputError("throw", str(error)) from error


def do_throw(args: argparse.Namespace) -> int:
    throw = throw_of(args)
    angles = [math.radians(a) for a in args.plate_angle]
    out = Path(args.out)
    runner.run_throw(throw, angles, out, out / "heaps", on_report=lambda report: say(json.dumps(report)))
    release = runner.load(out / "release.npz")
    for angle in angles:
        print(json.dumps(records.row(throw, release, runner.load(runner.plate_file(out, angle)))))
    return 0


def do_bench(args: argparse.Namespace) -> int:
    """The published bench: 6 mm pellets, whole housing, and the rig's own sequence and sensor around the throw."""
    try:
        throw = Throw(
            paddle_mass_kg=args.paddle_mass,
            elevator_speed_rad_s=args.elevator_speed * RPM,
            seed=args.seed,
            time_step_s=2.0e-5,
            grain=Grain(mass_kg=PELLET_KG, volume_m3=math.pi / 6.0 * PELLET_DIAMETER_M**3),
            contact=Contact(args.friction, args.rolling_friction, args.restitution),
            release=Release("open", math.radians(args.release_angle)),
        )
    except ValueError as error:
        raise InputError("bench", str(error)) from error
    settings = bench_rig.BenchSettings()
    out = Path(args.out)
    angles = [math.radians(a) for a in args.plate_angle]
    runner.run_throw(throw, angles, out, out / "heaps", on_report=lambda report: say(json.dumps(report)))
    for angle in angles:
        plate = runner.load(runner.plate_file(out, angle))
        step = float(plate["time_step_s"])
        force = records.resample_force_n(plate["total_force_n"][:, 0], step, 1.0 / settings.sampling_hz)
        for trial in range(1, args.trials + 1):
            seen = bench_rig.simulate(force, throw.elevator_speed_rad_s, np.random.default_rng([args.seed, trial]), settings)
            print(
                json.dumps(
                    {
                        "plate_angle_deg": round(math.degrees(angle), 6),
                        "paddle_mass_kg": throw.paddle_mass_kg,
                        "trial": trial,
                        "response": seen.response.sum,
                        "revolutions": seen.revolutions,
                        "elevator_speed_rpm": seen.elevator_speed_rad_s / RPM,
                        "zero_v": seen.response.zero,
                        "true_momentum_total_kg_m_s": seen.true_impulse_n_s,
                    }
                )
            )
    return 0


def do_combine(args: argparse.Namespace) -> int:
    """A virtual combine whose paddles throw the campaign's pulses: frames into a log, the truth beside it."""
    setting = scenario.load(args.scenario)
    if args.duration is not None:
        setting = setting.model_copy(update={"duration_s": args.duration})
    machine = Machine()
    pulses = cast(PulseTable, CampaignPulses.load(Path(args.forces), args.friction, machine, args.force, args.kernel))
    combine = VirtualCombine(setting, machine, args.seed, pulses)
    codec = Codec()
    count = 0
    with can.Logger(args.log) as log:
        for frame in combine.frames_until(setting.duration_s):
            message = codec.encode(frame)
            message.channel = "can0"
            log.on_message_received(message)
            count += 1
    if args.truth:
        truth_file.write_csv(args.truth, combine.truth)
    say(f"{count} frames in {args.log}")
    return 0


def do_campaign(args: argparse.Namespace) -> int:
    path = Path(args.file)
    plan = campaign.parse(path.read_text(encoding="utf-8"), str(path))
    campaign.run(plan, campaign.Ledger(Path(args.out)), args.jobs, say)
    return collect(plan, campaign.Ledger(Path(args.out)), Path(args.out), path.stem)


def do_collect(args: argparse.Namespace) -> int:
    path = Path(args.file)
    plan = campaign.parse(path.read_text(encoding="utf-8"), str(path))
    return collect(plan, campaign.Ledger(Path(args.out)), Path(args.to), args.name)


def collect(plan: campaign.Campaign, ledger: campaign.Ledger, folder: Path, name: str) -> int:
    """Writes the campaign's tables: rows, layers, heaps, arrivals at the plate, a few throws' grains, forces at 1 kHz."""
    rows = ledger.read(plan)
    campaign.write_csv(folder / f"{name}.csv", rows)
    parts = {"layers": campaign.layer_rows, "heaps": campaign.heap_rows, "arrivals": campaign.arrival_rows}
    for part, table in ((part, rows_of(plan, ledger)) for part, rows_of in parts.items()):
        if table:
            campaign.write_csv(folder / f"{name}_{part}.csv", table)
    grains = campaign.grain_arrays(plan, ledger)
    if grains:
        np.savez_compressed(folder / f"{name}_grains.npz", **grains)  # type: ignore[arg-type]  # the stub takes a column for `allow_pickle`
    histories = folder / f"{name}_forces.csv"
    campaign.write_csv(histories, campaign.history_rows(plan, ledger))
    with gzip.GzipFile(f"{histories}.gz", "wb", mtime=0) as packed:
        packed.write(histories.read_bytes())
    histories.unlink()
    (folder / f"{name}_provenance.json").write_bytes((ledger.folder / "provenance.json").read_bytes())
    say(f"{len(rows)} of {plan.row_count} rows in {folder / name}.csv")
    return 0


def do_check(args: argparse.Namespace) -> int:
    failed = 0
    found = checks.CHECKS_OF[args.kernel]
    if args.only is not None:
        found = tuple(c for chosen in checks.CHECKS_OF.values() for c in chosen if c.__name__ == args.only)
    for check in found:
        result = check()
        failed += not result.passed
        print(
            json.dumps(
                {"check": result.name, "passed": result.passed, "value": result.value, "limit": result.limit, "what": result.what}
            ),
            flush=True,
        )
    return 1 if failed else 0


def add_throw(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = verbs.add_parser("throw", help="one load at one or more plate angles; a JSON line per angle")
    load = p.add_mutually_exclusive_group(required=True)
    load.add_argument("--paddle-mass", type=float, metavar="KG")
    load.add_argument("--mass-flow", type=float, metavar="KG_S")
    add_conditions(p, rolling_friction=None)
    p.add_argument("--kernel", choices=["sphere", "clump"], default="sphere", help="clump: the published overlapping spheres")
    p.add_argument("--release", choices=["edge", "open"], default="edge", help="housing ends, or vanishes at once")
    p.add_argument("--release-angle", type=float, default=270.0, metavar="DEG", help="270 is straight up")
    p.add_argument("--machine", metavar="YAML")
    p.add_argument("--time-step", type=float, metavar="S")
    p.set_defaults(run=do_throw)


def add_bench(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = verbs.add_parser("bench", help="the bench rig: pellets, whole housing, release after 40 revolutions, summed response")
    p.add_argument("--paddle-mass", type=float, required=True, metavar="KG")
    add_conditions(p, rolling_friction=0.01)
    p.add_argument("--release-angle", type=float, default=270.0, metavar="DEG", help="paddle's direction when the housing goes")
    p.add_argument("--trials", type=int, default=1, help="readings of the same throw, each with its own noise")
    p.set_defaults(run=do_bench)


def add_conditions(p: argparse.ArgumentParser, rolling_friction: float | None) -> None:
    p.add_argument("--plate-angle", type=float, nargs="+", default=[70.0], metavar="DEG")
    p.add_argument("--elevator-speed", type=float, default=400.0, metavar="RPM")
    p.add_argument("--friction", type=float, default=0.3)
    note = "default: the kernel's own, 0.1 of the sphere and 0.01 of the clump" if rolling_friction is None else None
    p.add_argument("--rolling-friction", type=float, default=rolling_friction, help=note)
    p.add_argument("--restitution", type=float, default=0.75)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--out", required=True, metavar="DIR", help="per-grain records go here")


def add_campaign(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = verbs.add_parser("campaign", help="all throws of a YAML file; goes on where it was stopped")
    p.add_argument("file")
    p.add_argument("--out", required=True, metavar="DIR")
    p.add_argument("--jobs", type=int, default=2, help="engine processes at a time (default 2)")
    p.set_defaults(run=do_campaign)
    p = verbs.add_parser("collect", help="tables of what a campaign has done so far")
    p.add_argument("file")
    p.add_argument("--out", required=True, metavar="DIR", help="the campaign's folder")
    p.add_argument("--to", required=True, metavar="DIR")
    p.add_argument("--name", default="dem_campaign")
    p.set_defaults(run=do_collect)


def add_combine(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = verbs.add_parser("combine", help="a campaign's pulses as CAN frames in a log")
    p.add_argument("forces", help="a campaign's 1 kHz forces (CSV, gzipped or not)")
    p.add_argument("--friction", type=float, default=0.3)
    p.add_argument("--force", choices=["normal", "total"], default="total")
    p.add_argument("--kernel", choices=["sphere", "clump"], default="sphere", help="of a campaign with both")
    p.add_argument("--scenario", default=str(shipped("config/scenarios/steady.yaml")), metavar="YAML")
    p.add_argument("--duration", type=float, metavar="S")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--log", required=True, metavar="F")
    p.add_argument("--truth", metavar="CSV")
    p.set_defaults(run=do_combine)


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(
        prog="python -m studies.dem", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = top.add_subparsers(dest="verb", required=True)
    for add in (add_throw, add_bench, add_campaign, add_combine):
        add(verbs)
    p = verbs.add_parser("check", help="physics checks of the engine run itself; a JSON line each")
    p.add_argument("--kernel", choices=list(checks.CHECKS_OF), default="sphere")
    p.add_argument("--only", choices=[c.__name__ for chosen in checks.CHECKS_OF.values() for c in chosen], metavar="CHECK")
    p.set_defaults(run=do_check)
    return top


def main() -> int:
    args = parser().parse_args()
    try:
        return int(args.run(args))
    except (InputError, runner.EngineError, OSError) as error:
        say(f"python -m studies.dem: {error}")
        return 2 if isinstance(error, InputError) else 1


if __name__ == "__main__":
    sys.exit(main())
