"""The summary of a dataset as one HTML page that needs no network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from yieldmon.documents.fleet import DayProblem, DaySummary, FleetReportDocument, MachineSummary, ParameterDrift, TicketRow
from yieldmon.units import counted

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:75rem;padding:0 1rem;color:#1c2420;background:#fff}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .6rem;border-bottom:1px solid #dde3df;text-align:right}
th:first-child,td:first-child{text-align:left}th{background:#f2f5f3;position:sticky;top:0}
.scroll{overflow-x:auto;max-height:32rem;overflow-y:auto}.bad{color:#a02020}
svg{vertical-align:middle}
@media print{.scroll{max-height:none;overflow:visible}th{position:static}}
"""
UNFINISHED = "days may be missing: a `fleet run` is under way, was interrupted or left days out; run it again"
_WIDTH, _HEIGHT = 120, 24


def page(summary: FleetReportDocument) -> str:
    """The page's text."""
    totals = summary["totals"]
    head = (
        f"{counted(totals['machines'], 'machine')}, {counted(totals['machine_days'], 'machine-day')}, {totals['hours']:.1f} h, "
        f"{totals['mass_kg'] / 1000.0:.1f} t; yieldmon {', '.join(totals['software'])}; "
        f"{counted(totals['parameter_hashes'], 'configuration')}"
    )
    parts = [
        f"<h1>Fleet: {escape(summary['dataset'])}</h1><p>{escape(head)}</p>",
        _problems(summary),
        "<h2>Machines</h2>" + _machines(summary["machines"]),
        "<h2>Faults</h2>" + _faults(summary["machines"]),
        "<h2>Drift of parameters</h2>" + _drift(summary["machines"]),
        "<h2>Loads against tickets</h2>" + _tickets(summary["tickets"]),
        "<h2>Days</h2>" + _days(summary["days"]),
    ]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Fleet</title><style>{_STYLE}</style></head>'
        f"<body>{''.join(parts)}</body></html>\n"
    )


def _problems(summary: FleetReportDocument) -> str:
    parts = ("Not measured", summary["failed"]), ("Left out", summary["poisoned"]), ("Doubtful", summary["doubtful"])
    unfinished = f'<p class="bad">{escape(UNFINISHED[0].upper() + UNFINISHED[1:])}.</p>' if summary["unfinished"] else ""
    return unfinished + "".join(_listed(title, items) for title, items in parts if items)


def _listed(title: str, items: Sequence[DayProblem]) -> str:
    lines = [f"{item['machine']} {item['day']}: {item['problem']}" for item in items]
    return f'<h2>{title}</h2><ul class="bad">' + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _machines(machines: Sequence[MachineSummary]) -> str:
    header = (
        "machine",
        "crop",
        "days",
        "from",
        "to",
        "hours",
        "t",
        "faults",
        "ModelDisagrees, days",
        "tickets",
        "mean error %",
        "rms error %",
    )
    rows = [
        (
            m["machine"], ", ".join(m["crops"]), m["days"], m["first_day"], m["last_day"], f"{m['hours']:.1f}",
            f"{m['mass_kg'] / 1000.0:.1f}", sum(int(f["count"]) for f in m["faults"].values()), len(m["model_disagrees"]),
            m["tickets"]["count"], _signed(m["tickets"]["mean_error_pct"]), _number(m["tickets"]["rms_error_pct"]),
        )
        for m in machines
    ]  # fmt: skip
    return _table(header, rows)


def _faults(machines: Sequence[MachineSummary]) -> str:
    codes = sorted({code for machine in machines for code in machine["faults"]})
    if not codes:
        return "<p>None.</p>"
    rows = [
        (m["machine"], *(m["faults"][code]["count"] if code in m["faults"] else "" for code in codes))
        for m in machines
        if m["faults"]
    ]
    return _table(("machine", *codes), rows)


def _drift(machines: Sequence[MachineSummary]) -> str:
    names = list(dict.fromkeys(name for machine in machines for name in machine["parameters"]))
    moved = [name for name in names if any(_moves(m["parameters"].get(name)) for m in machines)]
    if not moved:
        return "<p>No parameter changed.</p>"
    cells = []
    for machine in machines:
        row = [escape(machine["machine"])]
        for name in moved:
            entry = machine["parameters"].get(name)
            row.append("" if entry is None else f"{_line(list(entry['by_day'].values()))} {_change(entry)}")
        cells.append(row)
    return _raw_table(("machine", *moved), cells)


def _change(entry: ParameterDrift) -> str:
    """Relative change of a grain parameter; of others the last value and its standard deviation."""
    if entry["change_pct"] is not None:
        return f"{_signed(entry['change_pct'])} %"
    std_dev = entry["std_dev"]
    return f"{entry['last']:.4g}" + ("" if std_dev is None else f" ± {std_dev:.2g}")


def _moves(entry: ParameterDrift | None) -> bool:
    return entry is not None and len(set(entry["by_day"].values())) > 1


def _tickets(tickets: Sequence[TicketRow]) -> str:
    if not tickets:
        return "<p>No tickets.</p>"
    rows = [
        (t["machine"], t["day"], t["name"], f"{t['measured_kg']:.0f}", f"{t['weighed_kg']:.0f}", _signed(t["error_pct"]))
        for t in tickets
    ]
    return _table(("machine", "day", "load", "measured kg", "weighed kg", "error %"), rows)


def _days(days: Sequence[DaySummary]) -> str:
    rows = [
        (d["machine"], d["day"], d["crop"] or "", f"{d['hours']:.2f}", f"{d['mass_kg'] / 1000.0:.2f}",
         "" if d["zero_known"] else "no zero", " ".join(f"{code} {count}x" for code, count in d["faults"].items()))
        for d in days
    ]  # fmt: skip
    return _table(("machine", "day", "crop", "hours", "t", "", "faults"), rows)


def _line(values: Sequence[float]) -> str:
    """A small curve of values."""
    if len(values) < 2:
        return ""
    low, high = min(values), max(values)
    span = (high - low) or 1.0
    points = " ".join(
        f"{_WIDTH * i / (len(values) - 1):.1f},{_HEIGHT - 2 - (_HEIGHT - 4) * (v - low) / span:.1f}" for i, v in enumerate(values)
    )
    return f'<svg width="{_WIDTH}" height="{_HEIGHT}"><polyline points="{points}" fill="none" stroke="#2f6b4a"/></svg>'


def _table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    return _raw_table(header, [[escape(str(cell)) for cell in row] for row in rows])


def _raw_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _signed(value: float | None) -> str:
    return "" if value is None else f"{value:+.2f}"
