"""Set up a machine: write configuration, machine and parameter files from measured numbers."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from yieldmon.cli import _outputs, _provenance
from yieldmon.cli._json import print_document
from yieldmon.cli._setup import derive, session
from yieldmon.cli._setup.questions import QUESTIONS, bolted
from yieldmon.documents.setup import SetupDocument, SetupRecord
from yieldmon.engine.settings import SweepSettings
from yieldmon.errors import InputError
from yieldmon.files import machine_file, parameter_file, strict_yaml, whole_file
from yieldmon.files.whole_file import READABLE, readable_folder
from yieldmon.service.config import configuration, plausible

CONFIGURATION, MACHINE, RECORD = "yieldmon.yaml", "machine.yaml", "setup-record.yaml"
AFTER = """\
Next, on the machine:
  1. start the daemon and run the elevator empty for 20 s: it measures zero
     and vibration (until then yieldmon status shows "zeroing", and what it
     waits for)
  2. harvest and weigh a load, then two more at other flows
  3. yieldmon calibrate --config yieldmon.yaml --loads STORE \\
         --tickets tickets.csv --out {parameters}.new.yaml
For area and yield add the header's width to machine.yaml, such as
  implement: {{working_width_m: 9.1}}"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "setup",
        help="set up a machine, step by step",
        description=f"{__doc__} The command asks in the terminal, shows drawings of what to measure, and checks the "
        "numbers against each other. Ctrl-C keeps the answers; run the same command to continue.",
        epilog="example: yieldmon setup --out /etc/yieldmon; yieldmon setup --answers answers.yaml --out new",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the files; created if missing")
    parser.add_argument("--answers", metavar="FILE", help="YAML file with answers; only missing ones are asked")
    parser.add_argument("--force", action="store_true", help="replace files of an earlier set-up")
    parser.add_argument("--json", action="store_true", help="print one JSON document; asks nothing")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the files are written."""
    folder = Path(args.out)
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise InputError("--out", f"{nearest} is not a folder", "a folder, or a name that does not exist yet")
    _outputs.require_writable_folder(folder, "--out")
    answers = session.from_file(args.answers) if args.answers else {}
    kept = folder / session.KEPT
    if kept.is_file():
        answers = _going_on(kept, answers, args.answers)
    missing = [q.key for q in QUESTIONS if q.key not in answers and q.applies(answers)]
    asks = sys.stdin.isatty() and not args.json
    if missing and not asks:
        raise InputError(args.answers or "setup", f"has no {missing[0]}", "an answer to each question, or a terminal to ask in")
    readable_folder(folder)
    if missing:
        # Before the questions, not after the last one.
        _refuse_present((CONFIGURATION, MACHINE, RECORD), folder, force=args.force)
        _ask(answers, folder)
    document = _written(answers, folder, force=args.force, asks=asks)
    session.keep(answers, folder)
    print_document(document, text, as_json=args.json, indent=1)
    return 0


def _going_on(kept: Path, answers: dict[str, Any], named: str | None) -> dict[str, Any]:
    """The answers kept of an earlier time under those of a file. Raises InputError where they are of two machines."""
    earlier = session.from_file(kept)
    machines = [known["machine_name"] for known in (answers, earlier) if "machine_name" in known]
    if len(set(machines)) > 1:
        raise InputError(
            f"{named}: machine_name",
            f"is {machines[0]}, but {kept} has answers of {machines[1]}",
            "another folder for --out, or that file moved away",
        )
    print(f"yieldmon: continuing with {kept}", file=sys.stderr)
    return {**earlier, **answers}


def _ask(answers: dict[str, Any], folder: Path) -> None:
    try:
        session.ask(answers, input, print, lambda now: session.keep(now, folder), derive.check_at_once)
    except EOFError:
        # Ctrl-D ends it as Ctrl-C does.
        print()
        raise KeyboardInterrupt from None


def _written(answers: dict[str, Any], folder: Path, *, force: bool, asks: bool) -> SetupDocument:
    """As `write`; in a terminal an answer that does not go with the others is asked again."""
    while True:
        try:
            return write(answers, folder, force=force)
        except InputError as error:
            if not asks or error.where not in answers:
                raise
            print(session.wrapped(f"{error}; `back` leads to the answers before it"))
            del answers[error.where]
        _ask(answers, folder)


def _refuse_present(names: Iterable[str], folder: Path, *, force: bool) -> None:
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        expected = "another folder for --out, or --force to replace it"
        if (folder / session.KEPT).is_file():
            expected += f"; what is taken out of {session.KEPT} is asked again"
        raise InputError(str(folder / there[0]), "exists already", expected)


def write(answers: dict[str, Any], folder: Path, *, force: bool) -> SetupDocument:
    """The files; returns what they rest on. Raises InputError, and then writes none."""
    derive.check_channel(answers)
    machine, parameters = derive.machine(answers), derive.parameters(answers)
    if (problem := plausible.cell_problem(machine, parameters)) is not None:
        raise InputError("cell_full_scale_mv", *problem)
    full_mv, largest_mv = answers["cell_full_scale_mv"], max(answers["cell_readings_mv"])
    if largest_mv > full_mv:
        raise InputError(
            "cell_full_scale_mv", f"is {full_mv:g}, but a weight reads {largest_mv:g} mV", f"at least {largest_mv:g} mV"
        )
    gain = derive.cell_gain(answers["cell_weights_kg"], answers["cell_readings_mv"])
    offset, fixed_deg = derive.offset_deg(answers), derive.bolted_deg(answers)
    names = {"configuration": CONFIGURATION, "machine": MACHINE, "parameters": f"{answers['crop']}.yaml", "record": RECORD}
    _refuse_present(names.values(), folder, force=force)
    for name in names.values():
        whole_file.check_place(folder / name)
    now = _provenance.today()
    found: SetupRecord = {
        "date": now,
        "cell": {
            "gain_n_per_mv": gain.gain_n_per_mv,
            "sd_pct": 100.0 * gain.sd,
            "zero_mv": gain.zero_mv,
            "nonlinearity_pct": 100.0 * gain.worst,
            "direction": "more force, more mV",
        },
        "plate_angle_offset_deg": offset,
        "paddles_per_s": machine.paddle_speed_m_s(machine.nominal_elevator_speed_rad_s) / machine.paddle_spacing_m,
        "answers": answers,
    }
    config = {
        "bus": {"interface": answers["bus_interface"], "channel": answers["bus_channel"]},
        "machine_file": MACHINE,
        "parameter_file": names["parameters"],
    }
    if fixed_deg is not None:
        config["plate"] = {"fixed_angle_deg": fixed_deg}
    angles = _sweep_angles(answers)
    config["sweep"] = {"angles_deg": angles} if angles else {"enabled": False}
    # The configuration last: it never names a file that is not there yet.
    order = (names["parameters"], MACHINE, RECORD, CONFIGURATION)
    with whole_file.scratch_folder_for(folder, order, mode=READABLE) as scratch:
        parameter_file.save(parameters, scratch / names["parameters"])
        for name, content in ((MACHINE, machine_file.to_document(machine)), (RECORD, found), (CONFIGURATION, config)):
            whole_file.write(scratch / name, strict_yaml.dump(content), durable=True)
    configuration.load(folder / CONFIGURATION)
    return {
        **found,
        "files": {
            "configuration": str(folder / CONFIGURATION),
            "machine": str(folder / MACHINE),
            "parameters": str(folder / names["parameters"]),
            "record": str(folder / RECORD),
        },
    }


def _sweep_angles(answers: dict[str, Any]) -> list[float]:
    """The shipped sweep's angles, as far as this plate goes; none for a plate that hardly moves."""
    low, high = answers["min_plate_angle_deg"], answers["max_plate_angle_deg"]
    if high - low < 15.0:
        return []
    return [min(max(angle, low), high) for angle in SweepSettings().angles_deg]


def text(document: SetupDocument) -> str:
    """What was found, for people."""
    cell, measured = document["cell"], document["answers"]["plate_measured_deg"]
    lines = [
        f"force cell: {cell['gain_n_per_mv']:.5f} N/mV, sd {cell['sd_pct']:.2f} %, "
        f"straight within {cell['nonlinearity_pct']:.2f} %",
        f"plate: bolted at {measured[0]:g} deg; no feedback is waited for, and nothing sweeps"
        if bolted(document["answers"])
        else f"plate: {document['plate_angle_offset_deg']:+.2f} deg from what the actuator reports; taken into the parameters",
        f"elevator: {document['paddles_per_s']:.1f} paddles a second at work",
        *(f"{key}: {path}" for key, path in document["files"].items()),
        AFTER.format(parameters=document["answers"]["crop"]),
    ]
    return "\n".join(lines)
