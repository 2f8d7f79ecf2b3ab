"""Estimate flows and parameters together from plate sweeps (closed loop), with one unknown flow per group of rows."""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import isfinite

import numpy as np

from yieldmon.cli import _notes, _outputs, _provenance, model_options
from yieldmon.cli._json import print_document
from yieldmon.cli._limits import above_0
from yieldmon.documents.self_calibrate import SelfCalibrationDocument, SweepFlow, UpdateDocument
from yieldmon.errors import InputError
from yieldmon.estimation.closed_loop_settings import FLOW_MODELS, ClosedLoopSettings
from yieldmon.estimation.fitting.measurements import as_copies_do, copied_rows
from yieldmon.estimation.parameters import NOT_CALIBRATED, SCALE
from yieldmon.estimation.self_calibration.closed_loop import self_calibrate
from yieldmon.estimation.self_calibration.closed_loop_inputs import MeasuredDensity, Sweep
from yieldmon.estimation.self_calibration.closed_loop_outcome import Outcome
from yieldmon.estimation.self_calibration.drift import by_change
from yieldmon.files import delimited, parameter_file, table, whole_file
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

LEVEL = 0.9
_ROUNDING = 1e-9
"""Of the largest reading: what repeated rows of one number differ by from their mean."""

_UNCHANGED = (
    "the grain counts as unchanged since its calibration, and a misfit need not show a change: where it may have changed, "
    "--drift friction=SD"
)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "self-calibrate",
        help="estimate flows and parameters from sweeps (closed loop)",
        description=__doc__,
        epilog="example: yieldmon self-calibrate sweeps.csv --group-by sweep --out updated.yaml",
    )
    parser.add_argument(
        "data", metavar="DATA.csv", help="table with plate_angle_deg and a reading; a load column is only for comparison"
    )
    model_options.add_model_arguments(parser)
    parser.add_argument(
        "--group-by",
        metavar="COL",
        help="column that identifies the sweeps (default: group, else the load, else one sweep)",
    )
    parser.add_argument("--separate", action="store_true", help="each sweep alone, from the same prior")
    parser.add_argument("--sigma", type=float, metavar="SD", help="noise of a reading (default: column sigma, else estimated)")
    parser.add_argument(
        "--model-error",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="relative error of the model at each angle (at least the parameter file's)",
    )
    parser.add_argument(
        "--flow",
        choices=FLOW_MODELS,
        default="constant",
        help="change of flow within a sweep",
    )
    parser.add_argument(
        "--density",
        metavar="KG_M3:SD",
        help="a measured `density`",
    )
    parser.add_argument(
        "--drift",
        metavar="NAME=SD",
        action="append",
        default=[],
        help="change of a parameter since its calibration, standard deviation (default: none)",
    )
    parser.add_argument("--out", metavar="FILE.yaml", help="parameter file to write (not with --separate)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    _outputs.add_force(parser, "out")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 also where nothing was updated; the report says so."""
    machine, prior = model_options.machine(args), model_options.parameters(args)
    if args.separate and args.out is not None:
        raise InputError("--out", "given with --separate", "one of them: separate sweeps give separate parameters")
    if args.out is not None:
        whole_file.check_place(args.out)
    if not 0.0 <= args.model_error < 1.0:
        raise InputError("--model-error", f"is {args.model_error:g}", "a share from 0 to 1")
    data = table.load(args.data, need_load=False, used=args.group_by)
    machine = data.at_one_position(machine)
    prior = model_options.in_unit_of(data, prior, args)
    for note in data.notes:
        _notes.note(note)
    if not prior.covariance_names:
        where = "--params" if args.params is None else args.params
        raise InputError(
            where, "has no covariance, so all parameters count as exact", "a covariance, as `calibrate --out` writes"
        )
    _provenance.note_same_table(data, prior, "--params")
    drift = model_options.assignments(args.drift, "--drift")
    try:
        prior = by_change(prior, drift)
    except ValueError as error:
        raise InputError("--drift", str(error)) from error
    labels, names = _groups(data, args.group_by)
    sweeps, true = _sweeps(args, data, machine, labels, names)
    model = ForwardModel(machine, prior.effects)
    settings = ClosedLoopSettings(flow=args.flow, model_error=args.model_error)
    density = _density(args.density)
    try:
        if args.separate:
            outcomes = [self_calibrate(model, prior, [s], density=density, settings=settings) for s in sweeps]
        else:
            outcomes = [self_calibrate(model, prior, sweeps, density=density, settings=settings)]
    except ValueError as error:
        raise InputError(data.path, str(error)) from error
    document = _document(data, machine, outcomes, names, true, sweeps)
    if drift:
        document["drift"] = drift
    if args.out is not None:
        facts = {**prior.provenance, "method": "closed loop", **_provenance.of_table(data), "parent_version": str(prior.version)}
        if prior.scale_error > 0.0 and not prior.carried_from:
            facts[SCALE] = NOT_CALIBRATED
        parameter_file.save(replace(outcomes[0].parameter_set, provenance=facts), args.out)
        document["written"] = args.out
    print_document(document, _text, as_json=args.json, indent=1)
    return 0


def _groups(data: table.Table, column: str | None) -> tuple[np.ndarray, list[str]]:
    """Index of each row's group, -1 where its cell is unknown, and the groups' names in order of appearance."""
    if column is None:
        column = "group" if "group" in data.text else data.load
    if column is None:
        return np.zeros(len(data), dtype=int), ["all rows"]
    if column in data.text:
        cells = ["" if delimited.is_unknown(cell) else cell for cell in data.text[column]]
    elif column in data.columns:
        cells = ["" if np.isnan(v) else f"{v:g}" for v in data.columns[column]]
    else:
        raise InputError("--group-by", f"{column} is not a column of {data.path}", ", ".join((*data.text, *data.columns)))
    if not any(cells):
        return np.zeros(len(data), dtype=int), ["all rows"]
    if column == "paddle_mass_kg":
        cells = _at_each_speed(cells, data)
    unknown = np.array([cell == "" for cell in cells])
    if np.any(unknown):
        _notes.note(data.left_out(unknown, f"without {column}"))
    names = [name for name in dict.fromkeys(cells) if name]
    return np.array([names.index(c) if c else -1 for c in cells]), names


def _at_each_speed(cells: list[str], data: table.Table) -> list[str]:
    """One load of the paddle is another flow at each speed."""
    speeds = [f"{v:g}" for v in data.columns.get("elevator_speed_rpm", np.full(len(cells), np.nan))]
    loads = dict.fromkeys(zip(cells, speeds, strict=True))
    several = {cell for cell in cells if sum(load == cell for load, _ in loads) > 1}
    at = {"nan": "nominal speed"}
    return [
        f"{cell} at {at.get(speed, f'{speed} rpm')}" if cell in several and cell else cell
        for cell, speed in zip(cells, speeds, strict=True)
    ]


def _sweeps(
    args: argparse.Namespace, data: table.Table, machine: Machine, labels: np.ndarray, names: list[str]
) -> tuple[list[Sweep], list[float]]:
    speed = data.speed_rad_s(machine)
    passes = machine.passes_per_s(speed)
    to_force: Array = np.ones(len(data)) if data.reading == "force_n" else passes
    force, angle = data.columns[data.reading] * to_force, np.radians(data.columns["plate_angle_deg"])
    sigma = _sigma(args, data, labels) * to_force
    moisture = data.columns.get("moisture_pct")
    sweeps, true = [], []
    for i, name in enumerate(names):
        rows, time_s = _in_time(np.flatnonzero((labels == i) & np.isfinite(force)), data)
        if np.unique(np.round(angle[rows], 4)).size < 2:
            raise InputError(f"{data.path}: group {name}", "holds fewer than two plate angles", "a sweep")
        moist = None if moisture is None else moisture[rows]
        try:
            sweeps.append(Sweep(time_s, angle[rows], speed[rows], force[rows], sigma[rows], moist))
        except ValueError as error:
            raise InputError(f"{data.path}: group {name}", str(error)) from error
        if data.load is None:
            true.append(float("nan"))
        else:
            load = data.columns[data.load][rows] * (passes[rows] if data.load == "paddle_mass_kg" else 1.0)
            true.append(float(load.mean()) if np.ptp(load) <= 1e-9 * load.max() else float("nan"))
    return sweeps, true


def _in_time(rows: np.ndarray, data: table.Table) -> tuple[np.ndarray, Array]:
    """The rows of a sweep in the order of their times, and these, s; as they stand and a second each where one is not known."""
    time_s = data.columns.get("time_s", np.full(len(data), np.nan))[rows]
    if not np.all(np.isfinite(time_s)):
        return rows, np.arange(rows.size, dtype=float)
    order = np.argsort(time_s, kind="stable")
    return rows[order], time_s[order]


def _sigma(args: argparse.Namespace, data: table.Table, labels: np.ndarray) -> Array:
    """Noise of each row in the reading's unit: in the table, given, or from replicates at one angle and speed of one group."""
    column = data.columns.get("sigma", np.full(len(data), np.nan))
    values = data.columns[data.reading]
    known = np.isfinite(values) & (labels >= 0)
    if np.any(column[known] == 0.0):
        raise InputError(data.path, "column sigma has zeros", "a number above 0, or an empty field if unknown")
    speed = data.columns.get("elevator_speed_rpm", np.full(len(data), np.nan))
    keys = np.stack((data.columns["plate_angle_deg"], np.nan_to_num(speed, nan=-1.0), labels))
    cells = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
    if copied := copied_rows(values[known], cells[known]):
        _notes.note(f"{data.path}: {as_copies_do(copied, int(known.sum()))}: each counts as a measurement; give each once")
    if args.sigma is not None:
        above_0("--sigma", args.sigma)
        return np.where(np.isfinite(column), column, args.sigma)
    if np.all(np.isfinite(column[known])):
        return column
    counts = np.bincount(cells[known], minlength=cells.max() + 1)
    means = np.bincount(cells[known], values[known], minlength=cells.max() + 1) / np.maximum(counts, 1)
    dof = int(np.sum(np.maximum(counts - 1, 0)))
    if dof < 3:
        raise InputError(data.path, "does not state the noise of its readings", "--sigma SD, a column sigma, or repeated rows")
    spread = float(np.sqrt(np.sum((values[known] - means[cells[known]]) ** 2) / dof))
    if spread <= _ROUNDING * float(np.max(np.abs(values[known]))):
        raise InputError(data.path, "holds repeated rows without any scatter", "--sigma SD")
    return np.where(np.isfinite(column), column, spread)


def _density(text: str | None) -> MeasuredDensity | None:
    if text is None:
        return None
    value, colon, sd = text.partition(":")
    if not colon:
        raise InputError("--density", f"is {text!r}", "KG_M3:SD")
    measured = MeasuredDensity(model_options.finite(value, "--density"), model_options.finite(sd, "--density SD"))
    if measured.density_kg_m3 <= 0.0 or measured.std_dev_kg_m3 <= 0.0:
        raise InputError("--density", f"is {text}", "two numbers above 0")
    return measured


def _document(
    data: table.Table, machine: Machine, outcomes: list[Outcome], names: list[str], true: list[float], sweeps: list[Sweep]
) -> SelfCalibrationDocument:
    flows = [flow for outcome in outcomes for flow in outcome.flows]
    groups = list[SweepFlow]()
    for name, flow, known, sweep in zip(names, flows, true, sweeps, strict=True):
        passes = machine.passes_per_s(float(sweep.elevator_speed_rad_s.mean()))
        row: SweepFlow = {
            "group": name,
            "mass_flow_kg_s": flow.mass_flow_kg_s,
            "std_dev_kg_s": flow.std_dev_kg_s,
            "interval_kg_s": list(flow.interval(LEVEL)),
            "paddle_mass_kg": flow.mass_flow_kg_s / passes,
        }
        if isfinite(known):
            row["true_mass_flow_kg_s"] = known
            row["error_pct"] = 100.0 * (flow.mass_flow_kg_s / known - 1.0)
        groups.append(row)
    errors = [abs(row["error_pct"]) for row in groups if "error_pct" in row]
    return {
        "file": data.path,
        "level": LEVEL,
        "groups": groups,
        "error_pct": {"mean_abs": float(np.mean(errors)), "max_abs": max(errors)} if errors else None,
        "updates": [_update(o) for o in outcomes],
    }


def _update(outcome: Outcome) -> UpdateDocument:
    scale = outcome.scale
    return {
        "updated": outcome.updated,
        "consistent": outcome.consistent,
        "reason": outcome.reason,
        "parameters": {
            p.name: {
                "prior": p.prior,
                "prior_sd": p.prior_sd,
                "value": p.value,
                "sd": p.sd,
                "ratio": p.ratio,
                "learned": p.learned,
            }
            for p in outcome.parameters
        },
        "scale": {
            "direction": "(mass flow, density, impact gain) -> (a, a, 1/a)",
            "observable": scale.observable,
            "ratio": scale.ratio if isfinite(scale.ratio) else None,
            "shift": scale.shift,
            "prior_sd": scale.prior_sd,
        },
        "unobservable": [d.words() for d in scale.unobservable_directions],
        "chi2": outcome.chi2,
        "dof": outcome.dof,
        "p_value": outcome.p_value,
    }


def _text(document: SelfCalibrationDocument) -> str:
    lines = [f"{'group':<14}{'flow kg/s':>11}{'sd':>9}   {100 * LEVEL:.0f} % interval{'true':>12}{'error %':>9}"]
    for row in document["groups"]:
        low, high = row["interval_kg_s"]
        end = f"{row['true_mass_flow_kg_s']:>11.4g}{row['error_pct']:>9.2f}" if "error_pct" in row else ""
        flow, sd = row["mass_flow_kg_s"], row["std_dev_kg_s"]
        lines.append(f"{row['group']:<13} {flow:>11.4f} {sd:>8.4f}   {low:7.3f} .. {high:7.3f}{end}")
    if document["error_pct"]:
        lines.append(f"error: mean {document['error_pct']['mean_abs']:.2f} %, worst {document['error_pct']['max_abs']:.2f} %")
    for update in document["updates"]:
        lines.append("")
        lines.append(f"{'parameter':<32}{'prior':>11}{'sd':>10}{'now':>12}{'sd':>10}{'width':>8}")
        for name, p in update["parameters"].items():
            kept = "" if p["learned"] else "  kept"
            before, after = f"{p['prior']:>11.5g}{p['prior_sd']:>10.3g}", f"{p['value']:>12.5g}{p['sd']:>10.3g}"
            lines.append(f"{name:<32}{before}{after}{100 * p['ratio']:>6.0f} %{kept}")
        scale = update["scale"]
        width = "not uncertain" if scale["ratio"] is None else f"width {100 * scale['ratio']:.0f} % of the prior's"
        lines.append(f"scale {scale['direction']}: {width}, moved by {100 * scale['shift']:+.2f} %")
        lines += [f"unobservable: {text}" for text in update["unobservable"]]
        lines.append(f"{update['reason']}. chi2 {update['chi2']:.4g} for {update['dof']}, p = {update['p_value']:.2g}")
    if "drift" not in document:
        lines.append(_UNCHANGED)
    if "written" in document:
        lines.append(f"written: {document['written']}")
    return "\n".join(lines)
