"""`calibrate --taps`: the time constant of plate and force cell from taps on the plate, into a machine file."""

from __future__ import annotations

import argparse
import dataclasses
from typing import TYPE_CHECKING

from yieldmon.cli import _by_loads, _calibrate_options, _notes
from yieldmon.documents.calibrate import TapDocument
from yieldmon.errors import InputError
from yieldmon.files import machine_file, strict_yaml, whole_file

if TYPE_CHECKING:
    from yieldmon.estimation.waveform.tap_response import TapResponse


def run(args: argparse.Namespace) -> TapDocument:
    """Fit and write; the report as plain data. Raises InputError."""
    _calibrate_options.refuse_table_options(args, "--taps")
    _calibrate_options.refuse_table(args, "--taps")
    others = ("loads", "tickets", "estimator", "pulse_shape", "prior")
    _calibrate_options.refuse(args, others, "is given together with --taps", "logs of taps alone")
    if args.out is not None:
        whole_file.check_place(args.out)
    # The daemon's own modules and scipy's statistics, which a table of a test facility does not need.
    from yieldmon.estimation.waveform.tap_response import LEAST_TAPS, tap_response
    from yieldmon.service.logs import tap_samples

    configured = _by_loads.configuration_of(args)
    samples = tap_samples.read(args.taps, configured.signals, configured.log_channels, configured.engine)
    for note in samples.notes:
        _notes.note(note)
    machine = configured.machine
    try:
        found = tap_response(samples.stretches, samples.source.interval_s, full_scale_mv=machine.sensor.full_scale_mv)
    except ValueError as error:
        hint = f"{LEAST_TAPS} or more, a second apart, elevator at rest, with something hard and light"
        raise InputError(", ".join(args.taps), str(error), hint) from error
    document = report(found, machine.sensor.response_s, args)
    if args.out is not None and not found.refused:
        sensor = dataclasses.replace(machine.sensor, response_s=float(f"{found.response_s:.4g}"))
        content = machine_file.to_document(dataclasses.replace(machine, sensor=sensor))
        whole_file.write(args.out, strict_yaml.dump(content))
        document["written"] = args.out
    return document


def report(found: TapResponse, before_s: float, args: argparse.Namespace) -> TapDocument:
    """The result as plain data."""
    return {
        "file": ", ".join(args.taps), "taps": found.each_s.size, "left_out": found.left_out, "response_s": found.response_s,
        "std_dev_s": found.std_dev_s, "each_s": found.each_s.tolist(), "misfit_pct": 100.0 * found.misfit, "before_s": before_s,
        "refused": found.refused,
    }  # fmt: skip


def text(document: TapDocument) -> str:
    """The report for people."""
    left_out = ", ".join(f"{count} {reason}" for reason, count in document["left_out"].items())
    lines = [
        f"{document['taps']} taps" + (f"; left out: {left_out}" if left_out else ""),
        f"response_s: {1e3 * document['response_s']:.2f} ms (sd {1e3 * document['std_dev_s']:.2f}); the machine file has "
        f"{1e3 * document['before_s']:g} ms",
        f"not explained by the model: {document['misfit_pct']:.1f} % of its height",
    ]
    if document["refused"]:
        lines.append(f"refused: {document['refused']}")
    if "written" in document:
        lines.append(f"written: {document['written']}")
    return "\n".join(lines)
