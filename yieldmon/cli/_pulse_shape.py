"""`calibrate --pulse-shape`: how a machine's pulses arrive, from logs of weighed loads, for `pulse_shape_file`."""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from yieldmon.cli import _by_loads, _calibrate_options
from yieldmon.documents.calibrate import PulseShapeDocument
from yieldmon.errors import InputError
from yieldmon.estimation.waveform.machine_shape import MachineShape, calibrate_machine_shape
from yieldmon.estimation.weighing.load_outcome import is_a_lot, scale_sentence
from yieldmon.files import pulse_shape_file, ticket_file, whole_file
from yieldmon.physics.machine import RPM

_DOUBTFUL = 0.15
"""Difference of ln(weighed / measured) of a load from that of the others beyond which its ticket is doubted; curves of the mean
force over the flow are off by less."""


def run(args: argparse.Namespace) -> PulseShapeDocument:
    """Fit and write; the report as plain data. Raises InputError."""
    _calibrate_options.refuse_table_options(args, "--pulse-shape")
    _calibrate_options.refuse_table(args, "--pulse-shape")
    if args.estimator is not None:
        raise InputError("--estimator", "fits a curve", "either --estimator or --pulse-shape")
    if args.loads is None or args.tickets is None:
        raise InputError("--pulse-shape", "has no loads", "--loads LOG... and --tickets FILE")
    if args.out is not None:
        whole_file.check_place(args.out)
    from yieldmon.service.logs import weighed_waves  # The daemon's own modules, which a table of a test facility does not need.

    configured = weighed_waves.looking(_by_loads.configuration_of(args))
    tickets = ticket_file.load(args.tickets)
    weighed = weighed_waves.match(weighed_waves.read(args.loads, configured), tickets, configured)
    try:
        found = calibrate_machine_shape(weighed_waves.pulses(configured), weighed.waves)
    except ValueError as error:
        raise InputError(", ".join(args.loads), str(error), "loads at flows that differ, sampled at 300 Hz or more") from error
    document = report(found, weighed.biases, args)
    document["notes"] = notes(weighed.scales)
    if args.out is not None and not found.refused:
        source = f"{len(found.loads)} weighed loads, {', '.join(Path(log).name for log in args.loads)}"
        pulse_shape_file.save(found.law, args.out, source=source)
        document["written"] = args.out
    return document


def report(found: MachineShape, biases: dict[str, float], args: argparse.Namespace) -> PulseShapeDocument:
    """The result as plain data."""
    law, values = found.law, np.array(list(biases.values()))
    return {
        "file": ", ".join(args.loads),
        "loads": [
            {"load": item.load, "waves": item.waves, "before_error_pct": 100.0 * item.before,
             "left_out_error_pct": 100.0 * item.left_out}
            for item in found.loads
        ],
        "kinds": found.kinds,
        "terms": list(found.terms),
        "log_stretch": list(law.stretch[: len(found.terms)]),
        "log_tail": list((law.tail or ())[: len(found.terms)]),
        "std_dev": [law.covariance[0] ** 0.5, law.covariance[1] ** 0.5],
        "load_share": list(law.fills),
        "plate_angle_deg": np.degrees(law.plate_angles_rad).tolist(),
        "elevator_speed_rpm": [speed / RPM for speed in law.elevator_speeds_rad_s],
        "kernel_bias": float(values.mean()) if values.size else None,
        "kernel_bias_std_dev": float(values.std(ddof=1)) if values.size > 1 else None,
        "notes": [],
        "refused": found.refused,
    }  # fmt: skip


def notes(scales: Mapping[str, float]) -> list[str]:
    """Sentences on tickets that the mean force doubts. scales: weighed over measured by it, by load.

    The mean force's curve over the flow may be off, so a ticket is doubted by it, not left out.
    """
    usual = statistics.median(scales.values())
    apart = {load: scale / usual for load, scale in scales.items() if abs(math.log(scale / usual)) > _DOUBTFUL}
    said = [
        f"load {load} weighs {ratio:.2f} times what the mean force makes of it beside the others: check its ticket"
        for load, ratio in apart.items()
    ]
    return said + ([scale_sentence(usual)] if is_a_lot(usual) else [])


def text(document: PulseShapeDocument) -> str:
    """The report for people."""
    lines = [f"{'load':<12}{'waves':>8}{'before':>11}{'left out':>11}"]
    for load in document["loads"]:
        before, after = (_percent(load[key]) for key in ("before_error_pct", "left_out_error_pct"))
        lines.append(f"{load['load'][:12]:<12}{load['waves']:>8}{before:>11}{after:>11}")
    (least, most), (low, high) = document["load_share"], document["plate_angle_deg"]
    slow, fast = document["elevator_speed_rpm"]
    lines.append(
        f"calibrated: load {least:.2f} to {most:.2f} of a full paddle, plate {low:.0f} to {high:.0f} deg, "
        f"{slow:.0f} to {fast:.0f} rpm"
    )
    lines.append(f"standard deviation of stretch {100.0 * document['std_dev'][0]:.1f} %, by {', '.join(document['terms'])}")
    if document["kernel_bias"] is not None:
        spread = document["kernel_bias_std_dev"]
        around = "" if spread is None else f" ± {spread:.3f}"
        lines.append(f"kernel noise agrees with the weighed loads at waveform.kernel_bias {document['kernel_bias']:.3f}{around}")
    lines += [f"- {note}" for note in document["notes"]]
    if document["refused"]:
        lines.append(f"refused: {document['refused']}")
    if "written" in document:
        lines.append(f"written: {document['written']}; set pulse_shape_file to it, and waveform.shape_terms: true")
    return "\n".join(lines)


def _percent(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:+.1f} %"
