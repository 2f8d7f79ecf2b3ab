"""`fleet report`: what a dataset says of its machines."""

from __future__ import annotations

import argparse
import sys

from yieldmon.cli._json import print_document
from yieldmon.documents.fleet import FleetReportDocument, MachineSummary
from yieldmon.files import whole_file
from yieldmon.files.plain_text import plain
from yieldmon.fleet.html import UNFINISHED, page
from yieldmon.fleet.summary import summarise
from yieldmon.units import counted


def run(args: argparse.Namespace) -> int:
    """Exit code 0."""
    summary = summarise(args.dataset)
    if args.html is not None:
        whole_file.write(args.html, page(summary))
    print_document(summary, _text, as_json=args.json)
    if summary["unfinished"]:
        print(plain(f"yieldmon: {args.dataset}: {UNFINISHED}"), file=sys.stderr)
    for what, items in ("not measured", summary["failed"]), ("left out", summary["poisoned"]), ("doubtful", summary["doubtful"]):
        for item in items:
            print(plain(f"{what}: {item['machine']} {item['day']}: {item['problem']}"), file=sys.stderr)
    return 0


def _drift(machine: MachineSummary) -> float | None:
    """The largest change of a parameter, %; None where one of them was changed by somebody."""
    parameters = machine["parameters"].values()
    if any(p["change_pct"] is None and len({*p["by_day"].values()}) > 1 for p in parameters):
        return None
    return max((p["change_pct"] or 0.0 for p in parameters), key=abs, default=0.0)


def _text(summary: FleetReportDocument) -> str:
    names = [plain(m["machine"]) for m in summary["machines"]]
    wide = max([15, *map(len, names)]) + 1
    lines = [f"{'machine':<{wide}} days    hours         t  faults disagrees tickets  error %  drift %"]
    for name, m in zip(names, summary["machines"], strict=True):
        faults = sum(int(f["count"]) for f in m["faults"].values())
        error = m["tickets"]["mean_error_pct"]
        drift = _drift(m)
        lines.append(
            f"{name:<{wide}}{m['days']:>5}{m['hours']:>9.1f}{m['mass_kg'] / 1000.0:>10.1f}{faults:>8}"
            f"{len(m['model_disagrees']):>10}{m['tickets']['count']:>8}"
            + (f" {error:>+8.2f}" if error is not None else f"{'-':>9}")
            + (f" {drift:>+8.2f}" if drift is not None else f"{'-':>9}")
        )
    totals = summary["totals"]
    sums = f"{totals['hours']:.1f} h, {totals['mass_kg'] / 1000.0:.1f} t"
    machines, days = counted(totals["machines"], "machine"), counted(totals["machine_days"], "day")
    lines.append(f"{machines}, {days}, {sums}")
    return "\n".join(lines)
