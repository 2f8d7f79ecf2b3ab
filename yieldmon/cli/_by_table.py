"""Calibration by a table of known loads and measured forces, as `yieldmon calibrate DATA.csv` makes it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.cli import _named_files, _outputs, _provenance, model_options
from yieldmon.cli._json import print_document, print_json
from yieldmon.documents.calibrate import CalibrationDocument, ComparedModel
from yieldmon.errors import InputError
from yieldmon.estimation import empirical, identifiability
from yieldmon.estimation.calibration import calibrate, default_start, profile_curves
from yieldmon.estimation.calibration_result import CONFIDENCE, Calibration
from yieldmon.estimation.measurements import Measurements, copied_rows
from yieldmon.estimation.moisture import fit as fit_moisture_map
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import EXCHANGED, Prior
from yieldmon.estimation.stop_gap import sentence, with_stop_gap
from yieldmon.files import digests, moisture_file, parameter_file, table, whole_file
from yieldmon.physics.effects import get_effect
from yieldmon.physics.grain import fitted
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import EXCHANGE_FORM, RESTITUTION_FORM, ForwardModel
from yieldmon.physics.stages import GRAVITY_M_S2
from yieldmon.repeats import repeated

PROGRESS_AFTER_S = 2.0
MAP_NAME = "moisture-map.yaml"
"""Of `--by-moisture`, in the folder of its parameter files."""
_CONSTANTS = ("gravity.acceleration_m_s2",)
"""Parameters of effects that no table is to move, unless --free names them."""


def run(args: argparse.Namespace) -> int:
    """Fit, report, write; the exit code. Raises InputError."""
    _check_options(args)
    machine = model_options.machine(args)
    data, rows = _read(args, machine)
    asked = model_options.check_force(data, machine)
    if args.by_moisture:
        done = _by_moisture(args, machine, data, rows)
        model_options.ask(asked)
        return done
    result = _fit(args, machine, data, rows)
    model_options.ask(asked)
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


def _check_options(args: argparse.Namespace) -> None:
    """What can be refused before anything is read."""
    if args.starts < 1:
        raise InputError("--starts", f"is {args.starts}", "1 or more")
    if args.seed < 0:
        raise InputError("--seed", f"is {args.seed}", "a whole number from 0")
    if args.stop_gap:
        for option, given in (("--prior", args.prior), ("--by-moisture", args.by_moisture), ("--robust", args.robust)):
            if given:
                raise InputError(option, "does not go with --stop-gap", "one of the two")
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
        print(f"yieldmon: {note}", file=sys.stderr)
    rows = model_options.measurements(data, machine, args.response_scale)
    left_out = np.ones(len(data), dtype=bool)
    left_out[np.arange(len(data)) if rows.places is None else rows.places] = False
    if note := data.unread(left_out):
        print(f"yieldmon: {note}", file=sys.stderr)
    if args.plate_angle is None:
        return data, rows
    return data, model_options.at_plate_angle(rows, args.plate_angle, data)


def report(result: Calibration, data: table.Table, rows: Measurements) -> CalibrationDocument:
    """The result as plain data."""
    return {
        "file": data.path,
        "rows": result.residuals.rows,
        "response_unit": result.parameter_set.response_unit,
        "parameters": {
            p.name: {
                "value": p.value,
                "standard_error": p.standard_error,
                "std_dev": result.parameter_set.standard_deviation(p.name),
                "interval": list(p.interval),
                "confidence": CONFIDENCE,
                "at_bound": p.at_bound or None,
                "open_below": p.open_below,
                "open_above": p.open_above,
                "determined": p.determined,
            }
            for p in result.parameters
        },
        "fixed": {k: v for k, v in result.parameter_set.values.items() if k not in result.names},
        "correlation": {"names": list(result.names), "matrix": result.correlation.tolist()},
        "residual": {
            "rms": result.residuals.rms,
            "rms_over_max_pct": result.residuals.rms_over_max_pct,
            "pure_error_sd": result.residuals.pure_error_sd,
            "pure_error_dof": result.residuals.pure_error_dof,
            "pure_error_over_max_pct": 100.0 * result.residuals.pure_error_sd / float(np.max(np.abs(rows.momentum))),
            "lack_of_fit_f": result.residuals.lack_of_fit_f,
            "lack_of_fit_p": result.residuals.lack_of_fit_p,
            "outlier_rows": [i + 1 for i in result.residuals.outlier_rows],
        },
        "starts": result.starts,
        "basins": [{"starts": b.starts, "relative_cost": b.relative_cost, "values": list(b.values)} for b in result.basins],
        "notes": list(result.sentences),
    }


def text(document: CalibrationDocument) -> str:
    """The report for people."""
    unit = document["response_unit"]
    lines = [f"{document['file']}: {document['rows']} rows, {document['starts']} starts"]
    lines.append(f"{'parameter':<34}{'value':>13}{'std error':>13}   {100 * CONFIDENCE:.0f} % interval")
    for name, p in document["parameters"].items():
        low, high = p["interval"]
        ends = f"{'<' if p['open_below'] else ''}{low:.6g} .. {high:.6g}{'>' if p['open_above'] else ''}"
        mark = f"  at its {p['at_bound']} bound" if p["at_bound"] else ""
        lines.append(f"{name:<34}{p['value']:>13.6g}{p['standard_error']:>13.3g}   {ends}{mark}")
    lines += [f"{name:<34}{value:>13.6g}        fixed" for name, value in document["fixed"].items()]
    r = document["residual"]
    per = "kg m/s" if unit == "N" else unit
    lines.append(f"residual rms {r['rms']:.4g} {per}, {r['rms_over_max_pct']:.3g} % of the largest reading")
    if r["pure_error_dof"]:
        lines.append(
            f"replicates scatter by {r['pure_error_sd']:.4g} {per} ({r['pure_error_over_max_pct']:.3g} %); lack of fit "
            f"F = {r['lack_of_fit_f']:.3g}, p = {r['lack_of_fit_p']:.2g}"
        )
    lines.append("basins (starts): " + ", ".join(f"{b['starts']} at {b['relative_cost']:.4g} x" for b in document["basins"]))
    lines += [f"- {sentence}" for sentence in document["notes"]]
    if "comparison" in document:
        lines.append(f"{'load from reading, each load left out in turn':<48}{'rms/max %':>11}{'mean %':>9}{'worst %':>9}")
        lines += [
            f"{row['model']:<48}{row['rms_over_max_pct']:>11.3g}{row['mean_abs_pct']:>9.3g}{row['max_abs_pct']:>9.3g}"
            for row in document["comparison"]
        ]
    if "identifiability" in document:
        lines += ["identifiability:", *(f"- {sentence}" for sentence in document["identifiability"]["sentences"])]
    if "written" in document:
        lines.append(f"written: {document['written']}")
    return "\n".join(lines)


def _fit(args: argparse.Namespace, machine: Machine, data: table.Table, rows: Measurements) -> Calibration:
    """The fit that the arguments ask for; with the exchange coefficients where 1 + e, unasked for, ends at its physical bound.

    A stop-gap takes up what drives it there, and knows nothing of exchange coefficients.
    """
    result = _with_copies_named(_fit_form(args, machine, data, rows, args.impact), data, rows)
    asked = args.impact or args.free or args.prior or args.by_moisture or args.stop_gap
    asked = asked or any("restitution" in text for text in (*args.fix, *args.bounds))
    if asked or not any(p.name == "restitution" and p.at_bound for p in result.parameters):
        return result
    result = _with_copies_named(_fit_form(args, machine, data, rows, "exchange"), data, rows)
    return replace(result, sentences=(EXCHANGED, *result.sentences))


def _with_copies_named(result: Calibration, data: table.Table, rows: Measurements) -> Calibration:
    """The fit with a word about rows that are copies of others, if any are."""
    reading = data.columns[data.reading]
    copied = copied_rows(reading if rows.places is None else reading[rows.places], rows.cells()[1])
    if not copied:
        return result
    word = (
        f"{copied} of {rows.momentum.size} rows repeat another reading of the same condition in every digit, as copies do: "
        "standard errors and lack of fit take each for a measurement; give each measurement once."
    )
    return replace(result, sentences=(word, *result.sentences))


def _fit_form(
    args: argparse.Namespace, machine: Machine, data: table.Table, rows: Measurements, asked: str | None
) -> Calibration:
    known = _named_files.parameters(args.prior, "--prior") if args.prior is not None else None
    # Without a word about effects the prior's belong to the model: left out, its other parameters would stand for them.
    effects = [name.strip() for name in args.effects.split(",") if name.strip()]
    if not effects and known is not None:
        effects = list(known.effects)
    scaled = data.reading == model_options.RESPONSE and args.response_scale is None
    impact = asked or ("exchange" if scaled else "restitution")
    form = RESTITUTION_FORM if impact == "restitution" else EXCHANGE_FORM
    if scaled and impact == "restitution":
        raise InputError(
            "--impact restitution", "cannot carry the scale of a `response`", "--impact exchange, or --response-scale S"
        )
    try:
        for name in effects:
            get_effect(name)
        model = ForwardModel(machine, effects)
    except ValueError as error:
        raise InputError("--effects", str(error)) from error
    fixed = model_options.assignments(args.fix, "--fix")
    for name, value in fixed.items():
        model_options.check_parameter(name, value, "--fix")
    start = default_start(model, rows, form, dict(known.values if known is not None else {}) | fixed)
    unknown = [name for name in fixed if name not in start]
    if unknown:
        raise InputError("--fix", f"{unknown[0]} is not in this model", f"one of {', '.join(start)}")
    given = set(known.values) if known is not None else set()
    held = {n for n in model.effect_parameters if n in _CONSTANTS or (not args.effects and n in given)}
    free = [n for n in (*fitted(impact), *model.effect_parameters) if n not in fixed and n not in held]
    if "gravity.acceleration_m_s2" in held and "gravity.acceleration_m_s2" not in given | set(fixed):
        start["gravity.acceleration_m_s2"] = GRAVITY_M_S2
    if args.free is not None:
        free = [name.strip() for name in args.free.split(",") if name.strip()]
        if twice := repeated(free):
            raise InputError("--free", f"names {twice[0]} twice", "each parameter once")
        wrong = [n for n in free if n not in start]
        if wrong or set(free) & set(fixed):
            raise InputError("--free", f"is {args.free!r}", f"some of {', '.join(n for n in start if n not in fixed)}")
    if not free:
        raise InputError("--fix", "leaves nothing to fit", "at least one parameter that is free")
    try:
        with progress_bar("calibrating") as progress:
            result = calibrate(
                model,
                rows,
                start,
                free,
                prior=Prior.of(known, free) if known is not None else None,
                bounds=_bounds(args.bounds),
                starts=args.starts,
                rng=np.random.default_rng(args.seed),
                robust=args.robust,
                response_unit=model_options.RESPONSE if scaled else "N",
                progress=progress,
            )
    except ValueError as error:
        raise InputError(data.path, str(error)) from error
    return replace(result, parameter_set=_with_provenance(result.parameter_set, args, data, known))


def _with_stop_gap(machine: Machine, rows: Measurements, result: Calibration) -> ParameterSet:
    """The parameters to be written; what is reported of the fit stays the physics' alone."""
    plain = result.parameter_set
    try:
        found = with_stop_gap(ForwardModel(machine, plain.effects), rows, plain, result.names)
    except ValueError as error:
        raise InputError("--stop-gap", str(error), "a table that allows one") from error
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


def _bounds(texts: list[str]) -> dict[str, tuple[float, float]]:
    out = {}
    for given in texts:
        name, _, limits = given.partition("=")
        low, colon, high = limits.partition(":")
        if not colon:
            raise InputError("--bounds", f"is {given!r}", "NAME=LOW:HIGH")
        first, last = model_options.finite(low, f"--bounds {name}"), model_options.finite(high, f"--bounds {name}")
        if first >= last:
            raise InputError(f"--bounds {name}", f"is {limits}", "the lower end first")
        model_options.check_parameter(name, first, "--bounds")
        model_options.check_parameter(name, last, "--bounds")
        out[name] = (first, last)
    return out


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
        bounds=_bounds(args.bounds),
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
            bounds=_bounds(args.bounds),
            starts=1,
            robust=args.robust,
            intervals=False,
            response_unit=result.parameter_set.response_unit,
        )
        return empirical.Physical(model, again.parameter_set)

    return [
        {
            "model": row.model,
            "rms_over_max_pct": row.rms_over_max_pct,
            "mean_abs_pct": row.mean_abs_pct,
            "max_abs_pct": row.max_abs_pct,
            "rows_without_answer": row.unanswered,
        }
        for row in empirical.compare(rows, machine, {"physical model": physical})
    ]


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr, if it is a terminal and the work takes over PROGRESS_AFTER_S; give the callable a share from 0 to 1."""
    from time import monotonic

    from rich.console import Console
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    begin, task = monotonic(), bar.add_task(label, total=1.0)
    started = False

    def report(share: float) -> None:
        nonlocal started
        if not started and monotonic() - begin > PROGRESS_AFTER_S and sys.stderr.isatty():
            bar.start()
            started = True
        bar.update(task, completed=share)

    try:
        yield report
    finally:
        if started:
            bar.stop()
