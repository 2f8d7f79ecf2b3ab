"""`fleet prior`: parameters of a crop for the next machine, from the tickets of the others."""

from __future__ import annotations

import argparse

import numpy as np

from yieldmon.cli._json import print_document
from yieldmon.documents.fleet import DensityAndGain, FleetPriorDocument
from yieldmon.files import parameter_file
from yieldmon.fleet.prior import CropPrior, crop_prior
from yieldmon.physics.numerics import Array
from yieldmon.units import counted


def run(args: argparse.Namespace) -> int:
    """Exit code 0."""
    found = crop_prior(args.dataset, args.crop)
    if args.out is not None:
        parameter_file.save(found.prior.parameter_set, args.out)
    document = _document(found)
    print_document(document, _text, as_json=args.json)
    return 0


def _document(found: CropPrior) -> FleetPriorDocument:
    prior = found.prior
    known = prior.parameter_set
    return {
        "parameters": {
            name: {"value": value, "standard_deviation": known.standard_deviation(name)} for name, value in known.values.items()
        },
        "crop_shift_pct": _scale(100.0 * prior.crop_shift),
        "between_machines_sd_pct": _scale(100.0 * np.sqrt(np.diag(prior.between))),
        "machines": {
            machine.name: {"loads": len(machine.loads), "density_pct": 100.0 * own[0], "gain_pct": 100.0 * own[1]}
            for machine, own in zip(found.machines, prior.machines.tolist(), strict=True)
        },
        "left_out": list(found.left_out),
    }


def _scale(pair: Array) -> DensityAndGain:
    density, gain = pair.tolist()
    return {"density": density, "gain": gain}


def _text(document: FleetPriorDocument) -> str:
    lines = [f"{name:<34}{p['value']:>13.6g}{p['standard_deviation']:>13.3g}" for name, p in document["parameters"].items()]
    shift, between = document["crop_shift_pct"], document["between_machines_sd_pct"]
    lines += [
        f"{name}: {moved:+.1f} % from the shipped crop; machines differ by {apart:.1f} % (1 sd)"
        for name, moved, apart in (
            ("density", shift["density"], between["density"]),
            ("gain", shift["gain"], between["gain"]),
        )
    ]
    lines += [f"{name}: {counted(m['loads'], 'load')}" for name, m in document["machines"].items()]
    lines += [f"left out: {reason}" for reason in document["left_out"]]
    return "\n".join(lines)
