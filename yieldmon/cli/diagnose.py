"""Find where model and measurement disagree, name the missing effect, and test that adding it helps."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from yieldmon.cli import _named_files, _notes, _outputs, _reading_units
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import whole_number
from yieldmon.discrepancy import adoption, diagnosis, planning, report
from yieldmon.discrepancy.choice import Step
from yieldmon.discrepancy.diagnosis_document import to_document
from yieldmon.discrepancy.fit import Fit
from yieldmon.errors import InputError
from yieldmon.estimation.fitting.stop_gap import without_stop_gap
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import calibrated_machine, parameter_file, table, whole_file
from yieldmon.files.table import Table
from yieldmon.files.whole_file import check_place, real_path
from yieldmon.physics.effects import registry
from yieldmon.physics.machine import Machine
from yieldmon.resources import shipped
from yieldmon.service.logs import recorded, sweep_table


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "diagnose",
        help="find and name missing effects of the model",
        description=__doc__,
        epilog="example: yieldmon diagnose facility.csv --params corn.yaml --report found",
    )
    parser.add_argument(
        "data", nargs="?", metavar="DATA", help="CSV table with plate angle, load and reading, or a daemon's store (.sqlite, .db)"
    )
    parser.add_argument(
        "--params",
        metavar="FILE.yaml",
        help="parameters of the model (default: shipped corn; for a store, its latest parameter file)",
    )
    parser.add_argument("--machine", metavar="FILE.yaml", help="file or shipped name (default: sprocket-8)")
    parser.add_argument(
        "--form",
        choices=("auto", "restitution", "exchange"),
        default="auto",
        help="impact gain of the model: 1 + e, or k1 and k2; auto: the parameter file's, but k1, k2 if 1 + e cannot fit",
    )
    parser.add_argument(
        "--hold-out",
        default="cells",
        metavar="WHICH",
        help="rows held out of the fits: cells, trials, none, or COLUMN=VALUE such as plate_angle_deg=60 (default: cells)",
    )
    parser.add_argument("--without", action="append", default=[], metavar="EFFECT", help="leave an effect out of the search")
    parser.add_argument(
        "--keep-effects",
        action="store_true",
        help="for a table: keep the parameter file's effects in the model and do not search for them (for a store: always)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of splits and bootstraps (default: 1)")
    parser.add_argument("--sweeps", type=int, metavar="N", help="for a store: use the newest N sweeps (default: all)")
    parser.add_argument("--table", metavar="FILE.csv", help="for a store: write the diagnosed table")
    parser.add_argument("--adopt", metavar="FILE.yaml", help="write the next version of the parameters, with the effects found")
    parser.add_argument("--rollback", metavar="FILE.yaml", help="restore the previous version of an adopted file, and exit")
    parser.add_argument(
        "--plan", metavar="FILE.csv", help="write the next experiment, and beside it a sweep section for the daemon"
    )
    parser.add_argument("--report", metavar="DIR", help="write an HTML page with plots")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    _outputs.add_force(parser, "table", "plan")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the workflow ran, whatever the verdict; 1 when there was nothing to adopt."""
    if args.rollback is not None:
        version = adoption.rollback(Path(args.rollback))
        print(f"{args.rollback}: version {version} again", file=sys.stderr)
        return 0
    _check(args)
    machine = _named_files.machine(args.machine)
    source = _from_store(args, machine) if recorded.is_store(args.data) else _from_csv(args)
    _check_adopt(args, source)
    data, parameters = source.data, source.parameters
    machine = data.at_one_position(machine)
    asked = _reading_units.no_question if recorded.is_store(args.data) else _reading_units.checked(data, machine)
    options = replace(
        diagnosis.Options(),
        form=args.form,
        hold_out=args.hold_out,
        without=tuple(args.without),
        seed=args.seed,
        keep_effects=source.keep_effects,
    )
    with _progress() as progress:
        found = diagnosis.diagnose(data, machine, parameters, options, progress)
    for note in data.notes:
        _notes.note(note)
    _reading_units.ask(asked)
    if args.json:
        print_json(to_document(found))
    else:
        print_text(found)
    if args.report is not None:
        page = report.write_report(found, Path(args.report), f"Diagnosis of {Path(args.data).name}")
        print(f"report: {page}", file=sys.stderr)
    if args.plan is not None:
        schedule = planning.write_plan(found.plan, Path(args.plan))
        print(f"plan: {args.plan}, {schedule}", file=sys.stderr)
    if args.adopt is not None:
        if found.verdict != "effect":
            print(f"yieldmon: no effect to adopt: the verdict is {found.verdict}", file=sys.stderr)
            return 1
        parent = source.parameter_path
        if parent is None:
            parent = Path(args.adopt).with_suffix(f".v{parameters.version}.store.yaml")
            parameter_file.save(parameters, parent)
        copy = adoption.adopt(
            found,
            parameters,
            parent_path=parent,
            out=Path(args.adopt),
            data=(args.data, data.sha256),
            now=datetime.now(UTC),
            scale_sd=source.scale_sd,
        )
        print(f"adopted: {args.adopt} (version {parameters.version + 1}); parent kept as {copy}", file=sys.stderr)
    return 0


def _check(args: argparse.Namespace) -> None:
    """What can be refused before the work. Raises InputError."""
    if args.data is None:
        raise InputError("diagnose", "no table given", "DATA.csv, a store, or --rollback FILE.yaml")
    unknown = [name for name in args.without if name not in registry()]
    if unknown:
        raise InputError("--without", f"{unknown[0]!r} is not an effect", f"one of {', '.join(registry())}")
    if args.report is not None:
        report.check_pictures()
        if Path(args.report).is_file():
            raise InputError(f"--report {args.report}", "is a file", "a folder")
    if args.report is not None:
        _outputs.check_folder(Path(args.report), report.FILES, "--report", force=args.force)
    for place in (args.table, args.plan, args.adopt):
        if place is not None:
            check_place(place)
    if args.plan is not None:
        _outputs.refuse(planning.schedule_path(Path(args.plan)), "--plan", force=args.force)
    whole_number("--seed", args.seed, 0)


def _check_adopt(args: argparse.Namespace, source: _Source) -> None:
    """Raises InputError for a file that adopting would replace and nothing keeps: the parameters' own file has its copy."""
    if args.adopt is None:
        return
    out = Path(args.adopt)
    in_place = source.parameter_path is not None and real_path(out) == real_path(source.parameter_path)
    if not in_place:
        _outputs.refuse(out, "--adopt", force=args.force, inputs={real_path(args.data)})
    copy = adoption.parent_copy(out, source.parameters.version)
    if copy.is_file() and (source.parameter_path is None or copy.read_bytes() != source.parameter_path.read_bytes()):
        _outputs.refuse(copy, "--adopt", force=args.force)


@dataclass(frozen=True)
class _Source:
    """What is diagnosed. parameter_path: None for parameters that are in no file yet."""

    data: Table
    parameters: ParameterSet
    parameter_path: Path | None
    keep_effects: bool = False
    scale_sd: float = 0.0


def _from_csv(args: argparse.Namespace) -> _Source:
    for option, value in (("--sweeps", args.sweeps), ("--table", args.table)):
        if value is not None:
            raise InputError(option, f"{args.data} is not a store", f"a file name ending in {', '.join(recorded.STORE_SUFFIXES)}")
    path = _named_files.parameters_path(args.params) if args.params is not None else shipped(parameter_file.DEFAULT)
    source = _Source(table.load(args.data), without_stop_gap(parameter_file.load(path)), path, keep_effects=args.keep_effects)
    if args.params is not None and source.parameters.effects and not args.keep_effects:
        names = ", ".join(source.parameters.effects)
        _notes.note(f"{path.name} has {names}, searched for here like other effects; --keep-effects keeps it in the model")
    return source


def _from_store(args: argparse.Namespace, machine: Machine) -> _Source:
    """A daemon's model has effects that its parameters speak of; they are not looked for again."""
    if args.sweeps is not None:
        whole_number("--sweeps", args.sweeps, 1)
    path = _named_files.parameters_path(args.params) if args.params is not None else None
    parameters = parameter_file.load(path) if path is not None else sweep_table.given_parameters(args.data)
    parameters = without_stop_gap(parameters)
    if difference := calibrated_machine.difference(parameters, machine):
        said = f"its parameters were made for another machine ({difference})"
        _notes.note(f"{args.data}: {said}: is --machine the one that measured these sweeps?")
    found = sweep_table.read(args.data, machine, parameters, args.sweeps)
    if args.table is not None:
        whole_file.write(args.table, found.text)
    return _Source(found.table, parameters, path, keep_effects=True, scale_sd=found.scale_sd)


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda text, share: bar.update(task, description=text, completed=share)


def print_text(found: diagnosis.Diagnosis) -> None:
    print(report.summary(found))
    print(f"\nverdict: {found.verdict}")
    if found.verdict == "effect":
        _print_steps(found.choice.steps, found.best)
    elif found.leading is not None:
        print("leading candidates, none of them certain:")
        _print_steps(found.choice.steps, found.leading)
    measures = [("before", found.before), ("after", found.after)]
    if found.with_leading is not None:
        measures[1] = ("with these", found.with_leading)
    for name, measure in measures:
        print(
            f"  {name}, {found.fitted_rows}: rms {measure.rms:.4g} ({measure.rms_over_max_pct:.2f} % of largest), "
            f"lack of fit F = {measure.lack_of_fit_f:.2f}, p = {measure.p_value:.2g}"
        )
    if found.held_out is not None and found.verdict != "unknown":
        held = found.held_out
        print(f"  {report.unseen(held)} (rms {held.before.rms:.4g} -> {held.after.rms:.4g}, noise {held.noise_floor_rms:.4g})")
    for line in (*report.region_lines(found.regions), *report.plan_lines(found.plan)):
        print(line)
    for note in found.notes:
        print(f"  note: {note}")


def _print_steps(steps: Sequence[Step], fitted: Fit) -> None:
    for step in steps:
        ties = f"; not distinguishable from {report.tied_names(step)}" if step.equivalent else ""
        print(f"  {step.added} ({report.confidence_words(step)}{ties})")
        for p, sd in zip(fitted.parameters, fitted.covariance().diagonal() ** 0.5, strict=True):
            if p.name.startswith(f"{step.law}."):
                print(f"    {p.name.partition('.')[2]} = {fitted.values[p.name]:.4g} +- {sd:.2g} {p.unit}")
