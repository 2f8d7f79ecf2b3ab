"""`fleet diagnose`: effects that the machines of a dataset share, and those that one has for itself."""

from __future__ import annotations

import argparse
from functools import partial
from math import isfinite

from yieldmon.cli._fleet.arguments import MOST_WORKERS
from yieldmon.cli._forks import in_processes
from yieldmon.cli._json import print_document
from yieldmon.cli._limits import whole_number
from yieldmon.documents.fleet import FleetDiagnosisDocument, FleetEffect, MachineEffects, VisibleEffect
from yieldmon.fleet.diagnosis import POLICY, FleetDiagnosis, MachineVerdict, Named, diagnose, sweeps_of

_JUDGED = ("none", "effect", "unknown")
"""Verdicts on machines that could be compared; any other says why one could not."""


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when all machines were diagnosed, 1 when one could not be."""
    whole_number("--workers", args.workers, 1, MOST_WORKERS)
    found = diagnose(sweeps_of(args.dataset), each=partial(in_processes, processes=args.workers))
    document = _document(found)
    print_document(document, _text, as_json=args.json)
    return 0 if all(verdict.judged for verdict in found.machines) else 1


def _document(found: FleetDiagnosis) -> FleetDiagnosisDocument:
    return {
        "shared": found.shared,
        "model": [_named(item) for item in found.model],
        "candidates": [_named(item) for item in found.candidates],
        "machines": [_verdict(item) for item in found.machines],
        "visible_from": [
            {"name": v.effect, "parameter": v.parameter, "size": v.size if isfinite(v.size) else None, "unit": v.unit}
            for v in found.visible_from
        ],
    }


def _verdict(item: MachineVerdict) -> MachineEffects:
    return {"machine": item.name, "verdict": item.verdict, "effects": [_named(named) for named in item.named]}


def _named(item: Named) -> FleetEffect:
    return {
        "name": item.effect,
        "confidence": item.confidence,
        "equivalent": list(item.equivalent),
        "parameters": dict(item.values),
    }


def _text(document: FleetDiagnosisDocument) -> str:
    lines = _shared_lines(document)
    for item in document["machines"]:
        if item["verdict"] == "none":
            continue
        names = ", ".join(_words(named) for named in item["effects"])
        lines.append(f"{item['machine']}: " + (names if item["verdict"] == "effect" else f"{item['verdict']} {names}".rstrip()))
    verdicts = [item["verdict"] for item in document["machines"]]
    compared = sum(verdict in _JUDGED for verdict in verdicts)
    if compared:
        which = "machines" if compared == len(verdicts) else "compared machines"
        lines.append(f"{verdicts.count('none')} of {compared} {which} show no effect of their own")
    return "\n".join([*lines, *_visible_lines(document["visible_from"])])


def _shared_lines(document: FleetDiagnosisDocument) -> list[str]:
    """What the model lacks for all machines."""
    if document["shared"] == "effect":
        return [f"the model lacks {_words(item)}" for item in document["model"]]
    if document["shared"] == "unknown":
        nearest = ", with ".join(_words(item) for item in document["candidates"])
        least = f"the nearest: {nearest}" if nearest else "no known effect explains it"
        return [f"the model lacks an effect in all machines, too uncertain to name; {least}"]
    none = {"none": "no effect is shared by all machines"}
    return [none.get(document["shared"], "not known whether machines share an effect: too few of one geometry")]


def _visible_lines(visible_from: list[VisibleEffect]) -> list[str]:
    """What sweeps like these would show of one machine, and what they cannot."""
    seen = [v for v in visible_from if v["size"] is not None]
    lines = ["smallest effect of a single machine that 80 of 100 such fleets show:"] if seen else []
    lines += [f"  {v['name']:28}{v['parameter']} {v['size']:.3g} {v['unit']}".rstrip() for v in seen]
    unseen = [v["name"] for v in visible_from if v["size"] is None]
    return [*lines, f"not visible in these sweeps at any physical size: {', '.join(unseen)}"] if unseen else lines


def _words(named: FleetEffect) -> str:
    count = 1 + len(named["equivalent"])
    if count > POLICY.largest_class:
        return f"one of {count} effects that fit equally well, such as {named['name']}"
    return " or ".join([named["name"], *named["equivalent"]])
