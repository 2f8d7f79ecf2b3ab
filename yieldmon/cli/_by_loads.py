"""`calibrate --loads`: weighed loads and their tickets into parameters."""

from __future__ import annotations

import argparse
import dataclasses
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.cli import _calibrate_options, _named_files, _notes, _provenance
from yieldmon.documents.calibrate import CalibratedParameter, LoadCalibrationDocument
from yieldmon.errors import InputError
from yieldmon.estimation.fitting.calibration_result import CONFIDENCE
from yieldmon.estimation.gaussian import REACH_95
from yieldmon.estimation.load_pattern import EFFECT
from yieldmon.estimation.parameters import SCALE, WEIGHED, ParameterSet
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.load_outcome import LoadCalibration
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.files import calibrated_machine, parameter_file, ticket_file, whole_file
from yieldmon.files.crops import SHIPPED_CROP, crops
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.resources import shipped
from yieldmon.units import counted

if TYPE_CHECKING:
    from yieldmon.service.config.configuration import Configuration
    from yieldmon.service.logs.measured_loads import MeasuredLoad

_SAME_MACHINE = 0.05
"""Relative difference within which masses may be those of a geometry."""


def run(args: argparse.Namespace) -> LoadCalibrationDocument:
    """The report as plain data. Raises InputError."""
    _calibrate_options.refuse_table_options(args, "--loads")
    from yieldmon.service.logs import weighed_loads

    configured, measured, loads = _measured(args)
    prior = _prior(args, measured, configured)
    sweeps = weighed_loads.sweeps_of(measured)
    if sweeps:
        _notes.note(f"{len(sweeps)} plate sweeps are fitted together with the loads")
    try:
        found = calibrate_loads(ForwardModel(configured.machine, prior.effects), prior, loads, sweeps=sweeps)
    except ValueError as error:
        raise InputError(
            ", ".join(args.loads), str(error), "masses in the unit of their column, of the loads they name"
        ) from error
    document = report(found, args)
    if args.out is not None and not found.refused:
        whole_file.check_place(args.out)
        until_s = weighed_loads.weighed_until_s(measured, loads)
        crop = measured[-1].crop if measured else ""
        parameter_file.save(_with_provenance(found, args, prior, until_s, crop, configured.machine), args.out)
        document["written"] = args.out
    return document


def matched(args: argparse.Namespace) -> tuple[Configuration, tuple[WeighedLoad, ...]]:
    """The weighed loads that the arguments name, and what measured them. Raises InputError."""
    configured, _, loads = _measured(args)
    return configured, loads


def _measured(args: argparse.Namespace) -> tuple[Configuration, tuple[MeasuredLoad, ...], tuple[WeighedLoad, ...]]:
    if args.tickets is None:
        raise InputError("--tickets", "is missing", "a table with the columns load and weighed_kg, with --loads")
    _calibrate_options.refuse_table(args, "--loads")
    from yieldmon.service.logs import (  # The daemon's own modules, which a table of a test facility does not need.
        measured_loads,
        weighed_loads,
    )
    from yieldmon.service.logs.record_check import same_times_line

    configured = configuration_of(args)
    tickets = ticket_file.load(args.tickets)
    measured = measured_loads.read(args.loads, configured)
    of_crop = weighed_loads.alike(measured, tickets)
    _require_machine(weighed_loads.times_what_a_machine_makes(of_crop, configured.machine), args)
    loads = weighed_loads.match(measured, tickets, configured.machine)
    for load in {load.name: load for ticket in tickets for load in weighed_loads.loads_on(ticket, measured)}.values():
        if load.unmeasured_s > 0.0:
            _notes.note(
                f"{load.unmeasured_s:.0f} s of load {load.name}, {100.0 * load.unmeasured_share:.1f} % of its time, were not "
                "measured: what was weighed may be more than what was measured"
            )
    if pairs := measured_loads.logs_of_same_times(measured):
        _notes.note(same_times_line(pairs))
    return configured, of_crop, loads


def _require_machine(times: float | None, args: argparse.Namespace) -> None:
    """Raises InputError where the loads of a store were measured by a machine of another geometry than the shipped one, which
    nobody named; a note on one that was named. times: as `weighed_loads.times_what_a_machine_makes`."""
    if times is None or abs(times - 1.0) <= _SAME_MACHINE:
        return
    shipped_one = args.config is None and args.machine is None
    which = "the shipped machine's" if shipped_one else "this machine's"
    problem = f"its masses are {times:.3g} times what {which} geometry makes of the forces"
    if shipped_one:
        raise InputError(args.loads[0], problem, "--config FILE, the configuration of the machine that measured the loads")
    _notes.note(f"{args.loads[0]}: {problem}: is it the configuration of the machine that measured these loads?")


def configuration_of(args: argparse.Namespace) -> Configuration:
    """What measured the loads. Raises InputError."""
    from yieldmon.service.config import configuration

    loaded = configuration.load(args.config if args.config is not None else shipped("config/yieldmon.yaml"))
    if args.machine is not None:
        loaded = dataclasses.replace(loaded, machine=_named_files.machine(args.machine))
    if args.prior is not None:
        loaded = dataclasses.replace(loaded, parameters=_named_files.parameters(args.prior, "--prior"))
    return loaded


def _prior(args: argparse.Namespace, measured: tuple[MeasuredLoad, ...], configured: Configuration) -> ParameterSet:
    """The physics of what --prior names, else of what measured the newest load of the crop."""
    known = configured.parameters
    if args.prior is None and measured:
        newest = measured[-1]
        used = newest.parameters.get(newest.seconds[-1].parameter_version, known)
        # A curve that these loads have updated already is estimated anew beside the parameters that they began with.
        known = _before_curve(measured, known) if EFFECT in used.effects and EFFECT not in known.effects else used
    return dataclasses.replace(known, curve=None)


def _before_curve(measured: tuple[MeasuredLoad, ...], known: ParameterSet) -> ParameterSet:
    """The parameters without a curve of their own that loads of one crop began with. known: the configured ones, which may be
    another's, or the shipped ones where no configuration is named."""
    crop = measured[-1].crop
    unchanged = parameter_file.digest(known) == parameter_file.digest(parameter_file.load())
    if not crop or (not unchanged and known.provenance.get("crop", crop) == crop):
        return known
    used = (load.parameters.get(row.parameter_version) for load in reversed(measured) for row in reversed(load.seconds))
    # One that was carried from another crop is not of these loads.
    without = (p for p in used if p is not None and (EFFECT not in p.effects or p.carried_from))
    began = (p for p in without if p.provenance.get("crop") == crop)
    shipped_ones = known if crop == SHIPPED_CROP or crop not in crops() else crops()[crop].parameters()
    return next(began, shipped_ones)


def report(found: LoadCalibration, args: argparse.Namespace) -> LoadCalibrationDocument:
    """The result as plain data, as `calibrate` reports a table's."""
    known = found.parameter_set
    parameters: dict[str, CalibratedParameter] = {}
    for name in found.names:
        value, sd = known.values[name], known.standard_deviation(name)
        parameters[name] = {
            "value": value,
            "standard_error": sd,
            "std_dev": sd,
            "interval": [value - REACH_95 * sd, value + REACH_95 * sd],
            "confidence": CONFIDENCE,
            "at_bound": None,
            "open_below": False,
            "open_above": False,
            "determined": found.load_dependence,
        }
    names = [n for n in known.covariance_names if n in found.names]
    covariance = known.covariance_of(names)
    deviation = [known.standard_deviation(n) for n in names]
    residuals = [load.after_kg - load.weighed_kg for load in found.loads if not load.outlier]
    rms_kg = (sum(r * r for r in residuals) / len(residuals)) ** 0.5
    return {
        "file": ", ".join(args.loads),
        "rows": len(found.loads),
        "response_unit": known.response_unit,
        "parameters": parameters,
        "fixed": {k: v for k, v in known.values.items() if k not in found.names},
        "held": list(found.held),
        "correlation": {
            "names": names,
            "matrix": (covariance / np.outer(deviation, deviation)).tolist(),
        },
        "residual": {
            "rms": rms_kg,
            "rms_over_max_pct": 100.0 * rms_kg / max(load.weighed_kg for load in found.loads),
            "outlier_rows": [i for i, load in enumerate(found.loads, 1) if load.outlier],
        },
        "starts": 1,
        "basins": [],
        "loads": [
            {
                "load": load.name,
                "weighed_kg": load.weighed_kg,
                "before_kg": load.before_kg,
                "after_kg": load.after_kg,
                "left_out_error_pct": 100.0 * load.left_out_error,
                "outlier": load.outlier,
            }
            for load in found.loads
        ],
        "scale": found.scale,
        "scale_sd_pct": 100.0 * found.scale_sd,
        "load_dependence": found.load_dependence,
        "next_load_sd_pct": 100.0 * found.next_load_sd,
        "sweeps": found.sweeps_used,
        "refused": found.refused,
        "notes": list(found.sentences),
    }


def text(document: LoadCalibrationDocument) -> str:
    """The report for people."""
    lines = [f"{'load':<12}{'weighed kg':>12}{'before kg':>12}{'':>11}{'after kg':>12}{'':>11}{'left out':>10}"]
    for load in document["loads"]:
        before, after = (100.0 * (load[key] / load["weighed_kg"] - 1.0) for key in ("before_kg", "after_kg"))
        left = load["left_out_error_pct"]
        apart = f"{'-':>10}" if left is None or not isfinite(left) else f"{left:>+8.2f} %"
        end = "  contradicts the others" if load["outlier"] else ""
        lines.append(
            f"{load['load'][:12]:<12}{load['weighed_kg']:>12.0f}{load['before_kg']:>12.0f}{before:>+9.2f} %"
            f"{load['after_kg']:>12.0f}{after:>+9.2f} %" + apart + end
        )
    lines += [f"{name:<34}{p['value']:>13.6g}{p['standard_error']:>13.3g}" for name, p in document["parameters"].items()]
    lines += [f"{name:<34}{value:>13.6g}        held" for name, value in document["fixed"].items()]
    lines += [f"- {sentence}" for sentence in document["notes"]]
    if "written" in document:
        lines.append(f"written: {document['written']}")
    return "\n".join(lines)


def _with_provenance(
    found: LoadCalibration,
    args: argparse.Namespace,
    prior: ParameterSet,
    until_s: float | None,
    crop: str,
    machine: Machine,
) -> ParameterSet:
    """crop: of the loads, "" where none was named."""
    facts = _provenance.of_loads(args.loads, args.tickets, until_s) | {
        "method": f"{len(found.loads) - len(found.outliers)} weighed loads"
        + (f", {counted(found.sweeps_used, 'sweep')}" if found.sweeps_used else ""),
        "parent_version": str(prior.version),
        SCALE: WEIGHED,
        **calibrated_machine.facts(machine),
    }
    if crop or "crop" in prior.provenance:
        facts["crop"] = crop or prior.provenance["crop"]
    return dataclasses.replace(found.parameter_set, provenance=facts)
