"""`fleet diagnose`: effects that the machines of a dataset share, and those that one has for itself."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.fleet.diagnosis import FleetDiagnosis, MachineSweeps, MachineVerdict, Named, diagnose, sweeps_of, verdict_of


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when all machines were diagnosed, 1 when one could not be."""
    if not 1 <= args.workers <= 1024:
        raise InputError("--workers", f"is {args.workers}", "a whole number from 1 to 1024")
    found = diagnose(sweeps_of(args.dataset), partial(_ask, args.workers))
    document = _document(found)
    print(json.dumps(document, indent=2) if args.json else _text(document))
    return 0 if all(item["verdict"] in ("effect", "none", "unknown") for item in document["before"]) else 1


def _ask(workers: int, machines: Sequence[tuple[MachineSweeps, ParameterSet]]) -> list[MachineVerdict]:
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(verdict_of, *zip(*machines, strict=True)))


def _document(found: FleetDiagnosis) -> dict[str, Any]:
    return {
        "model": [_named(item) for item in found.model],
        "machines": [_verdict(item) for item in found.of_machines],
        "before": [_verdict(item) for item in found.before],
    }


def _verdict(item: MachineVerdict) -> dict[str, Any]:
    return {"machine": item.name, "verdict": item.verdict, "effects": [_named(named) for named in item.named]}


def _named(item: Named) -> dict[str, Any]:
    return {
        "name": item.effect,
        "confidence": item.confidence,
        "equivalent": list(item.equivalent),
        "parameters": dict(item.values),
    }


def _text(document: dict[str, Any]) -> str:
    lines = [f"the model lacks {item['name']} ({100 * item['confidence']:.0f} % of the machines)" for item in document["model"]]
    lines = lines or ["no effect is shared by most machines"]
    for item in document["machines"]:
        names = ", ".join(named["name"] for named in item["effects"]) or item["verdict"]
        lines.append(f"{item['machine']}: {names}")
    return "\n".join(lines)
