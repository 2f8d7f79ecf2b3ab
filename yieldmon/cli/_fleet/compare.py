"""`fleet compare`: where and how the results of two datasets differ."""

from __future__ import annotations

import argparse

from yieldmon.cli._json import print_document
from yieldmon.documents.fleet import FleetCompareDocument
from yieldmon.fleet.comparison import compare
from yieldmon.units import counted

_SHOWN = 20
_COLUMNS_SHOWN = 6
_CAUSES = {"inputs_sha256": "logs, tickets or crop", "parameters_sha256": "parameters", "software": "software"}


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when they are equal, 1 when they are not."""
    found = compare(args.first, args.second)
    print_document(found, _text, as_json=args.json)
    return 1 if found["different"] or found["only_in_first"] or found["only_in_second"] else 0


def _text(found: FleetCompareDocument) -> str:
    lines = [f"{found['equal']} of {found['partitions']} partitions are equal"]
    if found["because"]:
        lines.append(
            "what differs: " + ", ".join(f"{_CAUSES[name]} ({counted(days, 'day')})" for name, days in found["because"].items())
        )
    lines += [
        f"columns of records only in {dataset}: {', '.join(names)}"
        for dataset, names in (
            (found["first"], found["columns_only_in_first"]),
            (found["second"], found["columns_only_in_second"]),
        )
        if names
    ]
    lines += [f"only in {found['first']}: {name}" for name in found["only_in_first"]]
    lines += [f"only in {found['second']}: {name}" for name in found["only_in_second"]]
    worst = sorted(found["different"], key=lambda item: -abs(item["mass_change_pct"] or 0.0))
    for item in worst[:_SHOWN]:
        change = f"{item['mass_change_pct']:+.3f} %" if item["mass_change_pct"] is not None else "no mass in A"
        columns = ", ".join(f"{name} {entry['seconds']} s" for name, entry in list(item["columns"].items())[:_COLUMNS_SHOWN])
        if (more := len(item["columns"]) - _COLUMNS_SHOWN) > 0:
            columns += f" and {more} more"
        lines.append(f"{item['machine']} {item['day']}: mass {change}; {columns or ', '.join(item['tables'])}")
    if len(worst) > _SHOWN:
        lines.append(f"and {len(worst) - _SHOWN} more; --json has them all")
    return "\n".join(lines)
