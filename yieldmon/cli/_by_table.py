"""Calibration by a table of known loads and measured forces, as `yieldmon calibrate DATA.csv` makes it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from yieldmon.cli import (
    _calibrate_options,
    _named_files,
    _notes,
    _outputs,
    _provenance,
    _reading_units,
    _table_model,
    model_options,
)
from yieldmon.cli._json import print_document, print_json
from yieldmon.cli._limits import whole_number
from yieldmon.cli._table_report import report, text
from yieldmon.documents.calibrate import ComparedModel
from yieldmon.errors import InputError
from yieldmon.estimation.fitting import empirical, identifiability
from yieldmon.estimation.fitting.calibration import Searched, calibrate, examine, profile_curves, search
from yieldmon.estimation.fitting.calibration_problem import conditions_told_apart
from yieldmon.estimation.fitting.calibration_result import Calibration
from yieldmon.estimation.fitting.measurements import Measurements, as_copies_do, copied_rows
from yieldmon.estimation.fitting.stop_gap import sentence, with_stop_gap
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import EXCHANGED, Prior
from yieldmon.estimation.self_calibration.moisture import fit as fit_moisture_map
from yieldmon.files import digests, moisture_file, parameter_file, table, whole_file
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PROGRESS_AFTER_S = 2.0
_SEARCH = {"starts": 20, "seed": 0}
"""Options of the search where they are not given, which another way of calibrating refuses."""
_NOT_WITH = {
    "stop_gap": ("prior", "by_moisture", "robust"),
    "by_moisture": ("compare", "identifiability", "profiles"),
}
"""Options that do not go with one, by its name in the namespace."""
MAP_NAME = "moisture-map.yaml"
"""Of `--by-moisture`, in the folder of its parameter files."""


def run(args: argparse.Namespace) -> int:
    """Fit, report, write; the exit code. Raises InputError."""
    args = _with_defaults(args)
    _check_options(args)
    machine = model_options.machine(args)
    data, rows = _read(args, machine)
    asked = _reading_units.checked(data, machine)
    if args.by_moisture:
        done = _by_moisture(args, machine, data, rows)
        _reading_units.ask(asked)
        return done
    result = _fit(args, machine, data, rows)
    _reading_units.ask(asked)
    written = result.parameter_set
    if args.stop_gap:
        written = _with_stop_gap(machine, rows, result)
        result = replace(result, sentences=(*result.sentences, sentence(written)))
    document = report(result, data, rows)
    if args.compare:
        document["comparison"] = _compare(args, result, machine, rows)
    if args.identifiability:
        document["identifiability"] = identifiability.report(
            ForwardModel(machine, result.parameter_set.effects),
            rows.conditions,
            result.parameter_set,
            result.names,
            result.residuals.noise_sd if rows.sigma is None else rows.sigma,
        ).document()
    if args.profiles is not None:
        document["profiles"] = _profiles(args, result, machine, rows)
    if args.out is not None:
        parameter_file.save(written, args.out)
        document["written"] = args.out
    print_document(document, text, as_json=args.json, indent=1)
    return 0


def _with_defaults(args: argparse.Namespace) -> argparse.Namespace:
    """The arguments with numbers for those of the search that are not given."""
    given = {name: value for name, value in vars(args).items() if name not in _SEARCH or value is not None}
    return argparse.Namespace(**{**_SEARCH, **given})


def _check_options(args: argparse.Namespace) -> None:
    """What can be refused before anything is read."""
    _calibrate_options.refuse_load_options(args)
    whole_number("--starts", args.starts, 1)
    whole_number("--seed", args.seed, 0)
    for chosen, others in _NOT_WITH.items():
        if getattr(args, chosen):
            problem = f"cannot be combined with --{chosen.replace('_', '-')}"
            _calibrate_options.refuse(args, others, problem, "one of the two")
    if args.out is not None and not args.by_moisture:
        whole_file.check_place(args.out)
    if args.profiles is not None:
        from yieldmon.plots import canvas

        canvas.check_name(Path(args.profiles), "--profiles")
        whole_file.check_place(args.profiles)


def _read(args: argparse.Namespace, machine: Machine) -> tuple[table.Table, Measurements]:
    """The table and those of its rows that are fitted; what is left out is said."""
    data = table.load(args.data)
    for note in data.notes:
        _notes.note(note)
    rows = model_options.measurements(data, machine, args.response_scale)
    left_out = np.ones(len(data), dtype=bool)
    left_out[np.arange(len(data)) if rows.places is None else rows.places] = False
    if note := data.unread(left_out):
        _notes.note(note)
    if args.plate_angle is None:
        return data, rows
    return data, model_options.at_plate_angle(rows, args.plate_angle, data)


def _fit(args: argparse.Namespace, machine: Machine, data: table.Table, rows: Measurements) -> Calibration:
    """The fit that the arguments ask for; with the exchange coefficients where 1 + e, unasked for, ends at its physical bound.

    A stop-gap takes up what drives it there, and knows nothing of exchange coefficients.
    """
    fitted, searched = _search(args, machine, data, rows, args.impact)
    asked = args.impact or args.free or args.prior or args.by_moisture or args.stop_gap
    asked = asked or any("restitution" in text for text in (*args.fix, *args.bounds))
    # The exchange form has a parameter more.
    enough = conditions_told_apart(fitted.model, rows) > len(searched.problem.names)
    exchanged = not asked and enough and "restitution" in searched.at_bound
    if exchanged:
        fitted, searched = _search(args, machine, data, rows, "exchange")
    result = _examined(args, data, fitted, searched)
    result = _with_copies_named(result, data, rows)
    return replace(result, sentences=(EXCHANGED, *result.sentences)) if exchanged else result


def _with_copies_named(result: Calibration, data: table.Table, rows: Measurements) -> Calibration:
    """The fit with a word about rows that are copies of others, if any are."""
    reading = data.columns[data.reading]
    copied = copied_rows(reading if rows.places is None else reading[rows.places], rows.cells()[1])
    if not copied:
        return result
    each = "standard errors and lack of fit count each as a measurement; give each measurement once."
    word = f"{as_copies_do(copied, rows.momentum.size)}: {each}"
    return replace(result, sentences=(word, *result.sentences))


def _search(
    args: argparse.Namespace, machine: Machine, data: table.Table, rows: Measurements, impact: str | None
) -> tuple[_table_model.Asked, Searched]:
    """What is fitted with a form of the impact gain, and what the searches found."""
    asked = _table_model.asked(args, machine, data, rows, impact)
    try:
        with progress_bar("calibrating") as progress:
            return asked, search(
                asked.model,
                rows,
                asked.start,
                asked.free,
                prior=Prior.of(asked.prior, asked.free) if asked.prior is not None else None,
                bounds=_table_model.bounds(args.bounds),
                starts=args.starts,
                rng=np.random.default_rng(args.seed),
                robust=args.robust,
                progress=progress,
            )
    except ValueError as error:
        raise InputError(data.path, str(error)) from error


def _examined(args: argparse.Namespace, data: table.Table, asked: _table_model.Asked, searched: Searched) -> Calibration:
    """The fit with its errors and where it comes from."""
    if asked.prior is not None:
        _provenance.note_same_table(data, asked.prior, "--prior")
    try:
        result = examine(searched, response_unit=model_options.RESPONSE if asked.scaled else "N")
    except ValueError as error:
        raise InputError(data.path, str(error)) from error
    return replace(result, parameter_set=_with_provenance(result.parameter_set, args, data, asked.prior))


def _with_stop_gap(machine: Machine, rows: Measurements, result: Calibration) -> ParameterSet:
    """The parameters to be written; what is reported of the fit stays the physics' alone."""
    plain = result.parameter_set
    try:
        found = with_stop_gap(ForwardModel(machine, plain.effects), rows, plain, result.names)
    except ValueError as error:
        raise InputError("--stop-gap", str(error), "a table that supports a stop-gap") from error
    return replace(found, provenance={**found.provenance, "stop_gap": "fitted with the grain"})


def _with_provenance(
    fitted: ParameterSet, args: argparse.Namespace, data: table.Table, parent: ParameterSet | None
) -> ParameterSet:
    facts = _provenance.of_table(data) | {
        "method": "least squares" + (", soft-L1 loss" if args.robust else "") + f", {args.starts} starts, seed {args.seed}",
    }
    if args.response_scale is not None:
        facts["response_scale"] = repr(args.response_scale)
    if parent is not None:
        prior = _named_files.parameters_path(args.prior, "--prior")
        facts["parent"] = f"{prior.name} sha256 {digests.of_file(prior)}"
        facts["parent_version"] = str(parent.version)
    return replace(fitted, provenance=facts, version=1 if parent is None else parent.version + 1)


def _by_moisture(args: argparse.Namespace, machine: Machine, data: table.Table, rows: Measurements) -> int:
    moisture = rows.columns()[3]
    if not np.all(np.isfinite(moisture)):
        raise InputError(data.path, "has rows without moisture_pct", "a moisture for each row")
    documents, sets = [], []
    names = {value: f"{Path(data.path).stem}-{value:g}.yaml" for value in np.unique(moisture).tolist()}
    if args.out is not None:
        _outputs.check_folder(Path(args.out), (*names.values(), MAP_NAME), "--out", force=args.force)
    for value, name in names.items():
        part = rows.select(moisture == value)
        result = _fit(args, machine, data, part)
        document = report(result, data, part)
        document["moisture_pct"] = value
        if args.out is not None:
            folder = Path(args.out)
            whole_file.readable_folder(folder)
            document["written"] = str(folder / name)
            parameter_file.save(result.parameter_set, document["written"])
        documents.append(document)
        sets.append(result.parameter_set)
    if args.out is not None and len(sets) > 1:
        moisture_file.save(fit_moisture_map(np.unique(moisture).tolist(), sets), Path(args.out) / MAP_NAME)
    if args.json:
        print_json({"by_moisture": documents}, indent=1)
    else:
        print("\n\n".join(f"moisture {d['moisture_pct']:g} %\n{text(d)}" for d in documents))
    return 0


def _profiles(args: argparse.Namespace, result: Calibration, machine: Machine, rows: Measurements) -> list[dict[str, Any]]:
    """Draws the profiles; returns them as plain data."""
    # Only here: matplotlib is an extra.
    from yieldmon.plots import canvas, profiles

    out = Path(args.profiles)
    known = _named_files.parameters(args.prior, "--prior") if args.prior is not None else None
    curves = profile_curves(
        ForwardModel(machine, result.parameter_set.effects),
        rows,
        result,
        prior=Prior.of(known, result.names) if known is not None else None,
        bounds=_table_model.bounds(args.bounds),
        robust=args.robust,
    )
    canvas.save(profiles.draw(curves), out)
    print(f"written: {out}", file=sys.stderr)
    return [{"name": c.name, "values": c.values.tolist(), "rise": c.rise.tolist(), "limit": c.limit} for c in curves]


def _compare(args: argparse.Namespace, result: Calibration, machine: Machine, rows: Measurements) -> list[ComparedModel]:
    model = ForwardModel(machine, result.parameter_set.effects)

    def physical(part: Measurements) -> empirical.LoadModel:
        again = calibrate(
            model,
            part,
            dict(result.parameter_set.values),
            result.names,
            bounds=_table_model.bounds(args.bounds),
            starts=1,
            robust=args.robust,
            intervals=False,
            response_unit=result.parameter_set.response_unit,
        )
        return empirical.Physical(model, again.parameter_set)

    load = rows.columns()[2]
    fewest = min(conditions_told_apart(model, rows.select(load != each)) for each in np.unique(load)) if np.ptp(load) else 0
    fixed = fewest >= len(result.names)
    if fewest and not fixed:
        left_out = f"cannot fix the physical model's {len(result.names)} parameters, and it is not compared"
        _notes.note(f"--compare: without a load the others {left_out}")
    try:
        compared = empirical.compare(rows, machine, {"physical model": physical} if fixed else {})
    except ValueError as error:
        raise InputError("--compare", str(error), "a table that can be cross-validated") from error
    return [
        {
            "model": row.model,
            "rms_over_max_pct": row.rms_over_max_pct,
            "mean_abs_pct": row.mean_abs_pct,
            "max_abs_pct": row.max_abs_pct,
            "rows_without_answer": row.unanswered,
        }
        for row in compared
    ]


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr, if it is a terminal and the work takes over PROGRESS_AFTER_S; give the callable a share from 0 to 1."""
    begin, bar, task = monotonic(), None, None

    def report(share: float) -> None:
        nonlocal bar, task
        if bar is None and monotonic() - begin > PROGRESS_AFTER_S and sys.stderr.isatty():
            bar, task = _bar(label)
        if bar is not None and task is not None:
            bar.update(task, completed=share)

    try:
        yield report
    finally:
        if bar is not None:
            bar.stop()


def _bar(label: str) -> tuple[Progress, TaskID]:
    """A bar that is on the terminal, and its one task."""
    from rich.console import Console
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task(label, total=1.0)
    bar.start()
    return bar, task
