"""A map in numbers, as one JSON document."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from yieldmon.documents.harvest_map import Delays, MapCrop, MapDocument, TransportDocument
from yieldmon.units import M2_PER_HA, T_HA_PER_KG_M2

from .cleaning import KEPT
from .delay import Decision, Delay
from .harvest import HarvestMap
from .transport import Transport


def document(result: HarvestMap, files: Sequence[str]) -> MapDocument:
    """The map's numbers by the names that other programs use; None for what is not known. files: that were written."""
    totals, flow = result.totals, result.flow_delay
    left_out = {name: round(mass, 3) for name, mass in totals.by_reason.items() if name != KEPT}
    weighed = any(load.weighed_kg is not None for load in result.loads)
    bushels = [result.bushels_per_acre(value) for value in (totals.yield_kg_m2, totals.low_kg_m2, totals.high_kg_m2)]
    return {
        "sources": [
            {
                "path": source.path,
                "kind": source.kind,
                "points": source.points,
                "skipped": [{"part": one.part, "why": one.why} for one in source.skipped],
                "notes": list(source.notes),
                "machine_total_kg": source.mass_kg,
                "machine_area_ha": None if source.area_m2 is None else source.area_m2 / M2_PER_HA,
            }
            for source in result.table.sources
        ],
        "delay": _delays(result),
        "agreement": {
            "no_shift": _known(flow.no_shift),
            "shifted": _known(flow.shifted),
            "held_out": _known(flow.held_out),
            "pairs": flow.pairs,
        },
        "mass_kg": {
            "machine_total": totals.machine_kg,
            "integrated": round(totals.measured_kg, 3),
            "corrected": round(totals.corrected_kg, 3),
            "low": totals.low_kg,
            "high": totals.high_kg,
            "kept": round(totals.by_reason.get(KEPT, 0.0), 3),
            "left_out_by_reason": left_out,
        },
        "area_ha": totals.area_m2 / M2_PER_HA,
        "kept_area_ha": totals.kept_area_m2 / M2_PER_HA,
        "yield_t_ha": _scaled(totals.yield_kg_m2),
        "yield_t_ha_low": _scaled(totals.low_kg_m2),
        "yield_t_ha_high": _scaled(totals.high_kg_m2),
        "yield_bu_ac": _known(bushels[0]),
        "crop": result.crop,
        "crops": _crops(result),
        "transport": None if result.transport is None else transport_document(result.transport),
        "points_by_reason": result.cleaned.points_by_reason(),
        "loads": [load.document() for load in result.loads] if weighed or len(result.loads) > 1 else [],
        "notes": list(result.notes),
        "files": list(files),
    }


def _crops(result: HarvestMap) -> list[MapCrop]:
    mass_kg, count = np.nan_to_num(result.placed.mass_kg), len(result.crops.names)
    in_all = np.bincount(result.crops.codes, mass_kg, count)
    kept = np.bincount(result.crops.codes, np.where(result.cleaned.kept, mass_kg, 0.0), count)
    return [
        {"crop": result.crops.names[code], "mass_kg": round(float(in_all[code]), 3), "kept_kg": round(float(kept[code]), 3)}
        for code in np.argsort(-in_all, kind="stable")
        if in_all[code] > 0.0
    ]


def _delays(result: HarvestMap) -> Delays:
    found: Delays = {"flow_s": result.flow_delay.document(), "moisture_s": result.moisture_delay.document()}
    if len(result.machines) > 1:
        found["machines"] = [
            {"name": one.name, "points": len(one.rows), "flow_s": one.flow.document(), "moisture_s": one.moisture.document()}
            for one in result.machines
        ]
    return found


def delay_lines(result: HarvestMap) -> list[str]:
    """Flow and moisture delay of each machine, a line each for people."""
    return [
        f"{one.name + ': ' if one.name else ''}{delay_line(delay, name)}"
        for one in result.machines
        for delay, name in ((one.flow, "flow"), (one.moisture, "moisture"))
    ]


def transport_document(transport: Transport) -> TransportDocument:
    """As JSON takes it."""
    return {
        "decision": "on" if transport.better else "off",
        "time_constant_s": transport.chosen.tau_s,
        "plain": _known(transport.plain),
        "smoothed": _known(transport.smoothed),
        "inverted": _known(transport.inverted),
        "margin": _known(transport.margin),
        "margin_sd": _known(transport.margin_sd),
    }


def transport_line(transport: Transport) -> str:
    """One line for people."""
    verdict = "on" if transport.better else "off, for it does not beat a smoother of the same bandwidth"
    return (
        f"transport inversion is {verdict}: opposing passes held out agree to {transport.inverted:.3f}, "
        f"smoothed to {transport.smoothed:.3f}, with the delay alone to {transport.plain:.3f}"
    )


def delay_line(delay: Delay, name: str) -> str:
    """One line for people."""
    declared = "" if delay.declared_s is None else f"; the machine declares {delay.declared_s:g} s"
    if delay.decision is Decision.ESTIMATED:
        return f"{name} delay {delay.value_s:z.1f} s ({delay.low_s:z.1f} to {delay.high_s:z.1f}){declared}"
    if delay.decision is Decision.DECLARED:
        return f"{name} delay {delay.value_s:z.1f} s, as given{declared}"
    return f"{name} delay: cannot tell ({delay.why}); {delay.value_s:z.1f} s is used{declared}"


def _known(value: float | None) -> float | None:
    return round(value, 6) if value is not None and isfinite(value) else None


def _scaled(value: float) -> float | None:
    return _known(value * T_HA_PER_KG_M2)
