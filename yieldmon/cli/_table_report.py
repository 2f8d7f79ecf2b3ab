"""The report of a calibration by a table: as plain data, and for people."""

from __future__ import annotations

import numpy as np

from yieldmon.documents.calibrate import CalibrationDocument
from yieldmon.estimation.fitting.calibration_result import CONFIDENCE, Calibration
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.files.table import Table
from yieldmon.units import counted


def report(result: Calibration, data: Table, rows: Measurements) -> CalibrationDocument:
    """The result as plain data."""
    return {
        "file": data.path,
        "rows": result.residuals.rows,
        "response_unit": result.parameter_set.response_unit,
        "parameters": {
            p.name: {
                "value": p.value,
                "standard_error": p.standard_error,
                "std_dev": result.parameter_set.standard_deviation(p.name),
                "interval": list(p.interval),
                "confidence": CONFIDENCE,
                "at_bound": p.at_bound or None,
                "open_below": p.open_below,
                "open_above": p.open_above,
                "determined": p.determined,
            }
            for p in result.parameters
        },
        "fixed": {k: v for k, v in result.parameter_set.values.items() if k not in result.names},
        "correlation": {"names": list(result.names), "matrix": result.correlation.tolist()},
        "residual": {
            "rms": result.residuals.rms,
            "rms_over_max_pct": result.residuals.rms_over_max_pct,
            "pure_error_sd": result.residuals.pure_error_sd,
            "pure_error_dof": result.residuals.pure_error_dof,
            "pure_error_over_max_pct": 100.0 * result.residuals.pure_error_sd / float(np.max(np.abs(rows.momentum))),
            "lack_of_fit_f": result.residuals.lack_of_fit_f,
            "lack_of_fit_p": result.residuals.lack_of_fit_p,
            "outlier_rows": [i + 1 for i in result.residuals.outlier_rows],
        },
        "starts": result.starts,
        "basins": [{"starts": b.starts, "relative_cost": b.relative_cost, "values": list(b.values)} for b in result.basins],
        "notes": list(result.sentences),
    }


def text(document: CalibrationDocument) -> str:
    """The report for people."""
    unit = document["response_unit"]
    lines = [f"{document['file']}: {counted(document['rows'], 'row')}, {counted(document['starts'], 'start')}"]
    lines.append(f"{'parameter':<34}{'value':>13}{'std error':>13}   {100 * CONFIDENCE:.0f} % interval")
    for name, p in document["parameters"].items():
        low, high = p["interval"]
        ends = f"{'<' if p['open_below'] else ''}{low:.6g} .. {high:.6g}{'>' if p['open_above'] else ''}"
        mark = f"  at its {p['at_bound']} bound" if p["at_bound"] else ""
        lines.append(f"{name:<34}{p['value']:>13.6g}{p['standard_error']:>13.3g}   {ends}{mark}")
    lines += [f"{name:<34}{value:>13.6g}        fixed" for name, value in document["fixed"].items()]
    r = document["residual"]
    per = "kg m/s" if unit == "N" else unit
    lines.append(f"residual rms {r['rms']:.4g} {per}, {r['rms_over_max_pct']:.3g} % of the largest reading")
    if r["pure_error_dof"]:
        lines.append(
            f"replicates scatter by {r['pure_error_sd']:.4g} {per} ({r['pure_error_over_max_pct']:.3g} %); lack of fit "
            f"F = {r['lack_of_fit_f']:.3g}, p = {r['lack_of_fit_p']:.2g}"
        )
    lines.append("basins (starts): " + ", ".join(f"{b['starts']} at {b['relative_cost']:.4g} x" for b in document["basins"]))
    lines += [f"- {sentence}" for sentence in document["notes"]]
    if "comparison" in document:
        lines.append(f"{'load from reading, each load left out in turn':<48}{'rms/max %':>11}{'mean %':>9}{'worst %':>9}")
        lines += [
            f"{row['model']:<48}{row['rms_over_max_pct']:>11.3g}{row['mean_abs_pct']:>9.3g}{row['max_abs_pct']:>9.3g}"
            for row in document["comparison"]
        ]
    if "identifiability" in document:
        lines += ["identifiability:", *(f"- {sentence}" for sentence in document["identifiability"]["sentences"])]
    if "written" in document:
        lines.append(f"written: {document['written']}")
    return "\n".join(lines)
