"""The document of a diagnosis: what `yieldmon diagnose --json` prints."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, isnan

import numpy as np

from yieldmon.documents.diagnose import DiagnosisDocument, Gap, MeasureDocument, NamedEffect, RegionDocument
from yieldmon.physics.effects import family_of, get_effect, registry
from yieldmon.physics.machine import RPM

from .choice import Step
from .diagnosis import Diagnosis, Measure
from .fit import Fit
from .lack_of_fit import Region, fills
from .stopgap import Correction


def to_document(diagnosis: Diagnosis) -> DiagnosisDocument:
    """The JSON document of ``yieldmon diagnose --json``: angles in degrees, speeds in rpm."""
    choice = diagnosis.choice
    document: DiagnosisDocument = {
        "verdict": diagnosis.verdict,
        "effects": _effects(diagnosis.best, choice.steps) if choice.named else [],
        "where": [_region(r) for r in diagnosis.regions],
        "gap": _gap(diagnosis),
        "next_experiment": {
            "rows": [
                {
                    "plate_angle_deg": round(degrees(r.plate_angle_rad), 3),
                    "mass_flow_kg_s": round(r.mass_flow_kg_s, 4),
                    "elevator_speed_rpm": round(r.elevator_speed_rad_s / RPM, 3),
                }
                for r in diagnosis.plan.rows
            ],
            "separates": [list(pair) for pair in diagnosis.plan.separates],
            "power": diagnosis.plan.power,
            "powers": list(diagnosis.plan.powers),
        },
        "minimum_detectable": diagnosis.minimum_detectable,
        "undetectable": list(diagnosis.undetectable),
        "base": {"form": diagnosis.form, "parameters": diagnosis.base.values, "p_any_effect": choice.p_any},
        "candidates": [
            {
                "name": family_of(c.effect),
                "law": get_effect(c.effect).law,
                "lack_of_fit_f": c.fit.chi2 / max(c.fit.dof, 1),
                "cross_validated": c.cross_validated,
                "p_value": c.p_value,
                "refused": c.refused,
            }
            for c in choice.looked_at
        ],
        "notes": list(diagnosis.notes),
    }
    if diagnosis.verdict == "unknown":
        document["partial"] = [s.added for s in choice.steps]
        if diagnosis.leading is not None and diagnosis.with_leading is not None:
            document["leading"] = _effects(diagnosis.leading, choice.steps)
            document["gap"]["with_leading"] = _measure_document(diagnosis.with_leading)
        document["remaining"] = [_region(r) for r in diagnosis.remaining]
        assert diagnosis.correction is not None
        document["stop_gap"] = {
            "kind": "Gaussian process over plate angle and load; holds only where these rows lie; names no cause",
            "axes": list(diagnosis.correction.axes),
            "closed_pct": diagnosis.correction.closed_pct,
            "cells": _correction_cells(diagnosis.correction, diagnosis.base),
        }
    return document


def _effects(fitted: Fit, steps: Sequence[Step]) -> list[NamedEffect]:
    """Effects with their sizes in a fit to every row."""
    sds = dict(zip((p.name for p in fitted.parameters), np.sqrt(np.diag(fitted.covariance())), strict=True))
    return [
        {
            "name": step.added,
            "law": get_effect(step.law).law,
            "stage": registry()[step.added].stage,
            "parameters": {
                p.name.partition(".")[2]: {"value": fitted.values[p.name], "sd": float(sds[p.name]), "unit": p.unit}
                for p in fitted.parameters
                if p.name.startswith(f"{step.law}.")
            },
            "confidence": step.confidence,
            "name_confidence": step.name_confidence,
            "equivalent": list(step.equivalent),
        }
        for step in steps
    ]


def _gap(diagnosis: Diagnosis) -> Gap:
    held = diagnosis.held_out
    return {
        "before": _measure_document(diagnosis.before),
        "after": _measure_document(diagnosis.after),
        "held_out": None
        if held is None
        else {
            "rows": held.rows,
            "before": _measure_document(held.before),
            "after": _measure_document(held.after),
            "lack_of_fit_f_interval": None if held.f_interval is None else [list(ends) for ends in held.f_interval],
            "closed_interval_pct": None if held.closed_interval_pct is None else list(held.closed_interval_pct),
        },
        "noise_floor_rms": held.noise_floor_rms if held is not None else diagnosis.noise_floor_rms,
        "closed_pct": diagnosis.closed_pct,
    }


def _correction_cells(found: Correction, base: Fit) -> list[dict[str, float]]:
    """Correction of the published model's prediction at each cell, %."""
    cells, fill = base.frame.cells, fills(base)
    correction_pct = 100.0 * found.at(cells.plate_angle_rad, fill, cells.elevator_speed_rad_s)
    return [
        {
            "plate_angle_deg": round(degrees(angle), 3),
            "fill": round(float(share), 4),
            "elevator_speed_rpm": round(float(speed) / RPM, 3),
            "correction_pct": round(float(percent), 3),
        }
        for angle, share, speed, percent in zip(
            cells.plate_angle_rad, fill, cells.elevator_speed_rad_s, correction_pct, strict=True
        )
    ]


def _measure_document(measure: Measure) -> MeasureDocument:
    return {
        "rms": measure.rms,
        "rms_over_max_pct": measure.rms_over_max_pct,
        "lack_of_fit_f": None if measure.lack_of_fit_f is None or isnan(measure.lack_of_fit_f) else measure.lack_of_fit_f,
        "p_value": measure.p_value,
    }


def _region(region: Region) -> RegionDocument:
    return {
        "plate_angle_deg": [round(degrees(v), 3) for v in region.plate_angle_rad],
        "fill": [round(v, 4) for v in region.fill],
        "elevator_speed_rpm": [round(v / RPM, 3) for v in region.elevator_speed_rad_s],
        "mean_error_pct": region.mean_error_pct,
        "p_value": region.p_value,
    }
