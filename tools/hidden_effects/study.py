"""Runs the cases, one JSON line each, and makes the tables of docs/discrepancy-study.md from them."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.discrepancy import diagnosis
from yieldmon.discrepancy.candidates import library
from yieldmon.discrepancy.fit import fit, predictions
from yieldmon.discrepancy.selection import Policy
from yieldmon.files import parameter_file

from . import baselines, cases

POLICY = Policy(refits=14, exchanges=5, beam=2)
SNR_BINS = ((0.0, 4.0), (4.0, 8.0), (8.0, 16.0), (16.0, np.inf))


def run_case(case: cases.Case) -> dict[str, Any]:
    """Make the rows, examine them, and note what was said beside what was hidden."""
    data = cases.make(case)
    seen = diagnosis.examine(data.rows, parameter_file.load(), diagnosis.Options(policy=POLICY, without=case.without))
    choice = seen.choice
    steps = choice.steps
    return {
        "key": case.key,
        "kind": case.kind,
        "hidden": list(case.hidden),
        "noise_pct": case.noise_pct,
        "speeds": case.speeds,
        "sizes": data.sizes,
        "change_pct": 100.0 * data.change,
        "snr": _snr(case, data, seen) if case.kind in ("hidden", "removed") else None,
        "verdict": choice.verdict,
        "named": list(choice.named),
        "partial": [s.added for s in steps],
        "classes": [[s.added, *s.equivalent] for s in steps] if choice.verdict == "effect" else [],
        "confidence": [s.confidence for s in steps],
        "f": [choice.base_gap.f, choice.best_gap.f],
        "p_any": choice.p_any,
        "closed_pct": seen.held_out.closed_pct if seen.held_out is not None and choice.verdict == "effect" else None,
        "parameter_error_pct": _parameter_error(case, data, choice.best),
        "baselines": {
            "aicc": baselines.by_criterion(choice, "aicc"),
            "bic": baselines.by_criterion(choice, "bic"),
            "sparse": baselines.by_sparse_regression(choice.base, library(choice.base.frame, case.without)),
        },
    }


def _snr(case: cases.Case, data: cases.Data, seen: diagnosis.Examination) -> float:
    """Length of the hidden effect's signature beyond recalibration, in standard deviations of the cell means.

    The published model is refitted to the candidate's own prediction at the hidden size; what it cannot follow is the signature.
    """
    effect = case.hidden[0]
    base = seen.choice.base
    truth = {f"{effect}.{p}": v for p, v in _leading_values(effect, data.sizes[effect]).items()}
    moved = np.real(predictions(base.frame, (effect,), base.values | truth))
    if not np.all(np.isfinite(moved)):
        return float("nan")
    cells = base.frame.cells
    from dataclasses import replace

    absorbed = fit(replace(base.frame, cells=replace(cells, mean=moved)), (), base.values, iterations=12)
    return float(np.sqrt(absorbed.chi2)) if absorbed is not None else float("nan")


def _leading_values(effect: str, size: float) -> dict[str, float]:
    if effect == "moisture_dependence":
        return {"friction_per_pct": size, "density_per_pct": -0.2 * size, "restitution_per_pct": -0.5 * size}
    return {cases.LEADING[effect]: size}


def _parameter_error(case: cases.Case, data: cases.Data, best) -> float | None:  # type: ignore[no-untyped-def]
    if case.kind != "hidden" or case.hidden[0] not in best.effects:
        return None
    effect, size = case.hidden[0], data.sizes[case.hidden[0]]
    return 100.0 * (best.values[f"{effect}.{cases.LEADING[effect]}"] - size) / abs(size)


def run(path: Path, todo: Iterable[cases.Case], tell: Callable[[int, int, str], None]) -> None:
    """Append the cases not yet in `path`, one line each; safe to stop and start again."""
    done = {record["key"] for record in read(path)} if path.exists() else set()
    left = [case for case in todo if case.key not in done]
    with open(path, "a", encoding="utf-8") as file:
        for i, case in enumerate(left):
            record = run_case(case)
            file.write(json.dumps(record) + "\n")
            file.flush()
            tell(i + 1, len(left), case.key)


def read(path: Path) -> list[dict[str, Any]]:
    """Records of a results file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]


def commit() -> str:
    """Commit of this checkout, "unknown" outside one."""
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


def summarise(records: list[dict[str, Any]]) -> dict[str, Any]:
    """The numbers of the tables."""
    kinds = {kind: [r for r in records if r["kind"] == kind] for kind in ("hidden", "clean", "outside", "removed", "pair")}
    out: dict[str, Any] = {"cases": {k: len(v) for k, v in kinds.items()}}
    strong = [r for r in kinds["hidden"] if r["noise_pct"] == 1.0 and r["change_pct"] >= 5.0]
    seen = [r for r in strong if _visible(r)]
    out["hidden_1pct_noise_5pct_change"] = _named(strong)
    out["the_same_and_visible"] = _named(seen)
    out["by_snr"] = {}
    for noise in (1.0, 3.0):
        for low, high in SNR_BINS:
            chosen = [r for r in kinds["hidden"] if r["noise_pct"] == noise and low <= (r["snr"] or 0.0) < high]
            out["by_snr"][f"{noise:g} % noise, snr {low:g} to {high:g}"] = _named(chosen)
    out["by_effect"] = {
        name: _named([r for r in kinds["hidden"] if r["hidden"] == [name] and r["noise_pct"] == 1.0]) for name in cases.SIZES
    }
    out["clean"] = {"false_alarms": sum(r["verdict"] != "none" for r in kinds["clean"]), "of": len(kinds["clean"])}
    out["outside"] = _verdicts(kinds["outside"])
    out["outside_by_kind"] = {
        name: _verdicts([r for r in kinds["outside"] if r["hidden"] == [name]])
        for name in sorted({r["hidden"][0] for r in kinds["outside"]})
    }
    removed = [r for r in kinds["removed"] if _visible(r)]
    out["removed_and_visible"] = _verdicts(removed)
    both = kinds["pair"]
    out["pairs"] = {
        "of": len(both),
        "both": sum(_pair_hits(r) == 2 for r in both),
        "at_least_one": sum(_pair_hits(r) >= 1 for r in both),
    }
    out["baselines"] = {name: _baseline(kinds, name) for name in ("aicc", "bic", "sparse")}
    out["ours"] = {
        "first_place": _share([r["named"][:1] == r["hidden"] for r in seen]),
        "false_alarms": _share([r["verdict"] != "none" for r in kinds["clean"]]),
        "outside_named": _share([r["verdict"] == "effect" for r in kinds["outside"]]),
    }
    return out


def _visible(record: dict[str, Any]) -> bool:
    return (record["snr"] or 0.0) >= 4.0


def _named(records: list[dict[str, Any]]) -> dict[str, Any]:
    first = [r["named"][:1] == r["hidden"] for r in records]
    within = [any(r["hidden"][0] in c and len(c) <= 4 for c in r["classes"][:1]) for r in records]
    closed = [r["closed_pct"] for r in records if r["closed_pct"] is not None]
    errors = [abs(r["parameter_error_pct"]) for r in records if r["parameter_error_pct"] is not None]
    sizes = [len(r["classes"][0]) for r in records if r["classes"]]
    return {
        "of": len(records),
        "first_place_pct": _share(first),
        "within_class_pct": _share(within),
        "wrong_name_pct": _share([r["verdict"] == "effect" and not w for r, w in zip(records, within, strict=True)]),
        "unknown_pct": _share([r["verdict"] == "unknown" for r in records]),
        "none_pct": _share([r["verdict"] == "none" for r in records]),
        "mean_class_size": float(np.mean(sizes)) if sizes else None,
        "median_closed_pct": float(np.median(closed)) if closed else None,
        "median_parameter_error_pct": float(np.median(errors)) if errors else None,
        "median_snr": float(np.nanmedian([r["snr"] or np.nan for r in records])) if records else None,
    }


def _verdicts(records: list[dict[str, Any]]) -> dict[str, Any]:
    return {"of": len(records)} | {
        f"{v}_pct": _share([r["verdict"] == v for r in records]) for v in ("unknown", "effect", "none")
    }


def _pair_hits(record: dict[str, Any]) -> int:
    if record["verdict"] != "effect":
        return 0
    hits = 0
    left = list(record["classes"])
    for name in record["hidden"]:
        place = next((c for c in left if name == c[0]), None) or next((c for c in left if name in c and len(c) <= 4), None)
        if place is not None:
            left.remove(place)
            hits += 1
    return hits


def _baseline(kinds: dict[str, list[dict[str, Any]]], name: str) -> dict[str, Any]:
    seen = [r for r in kinds["hidden"] if r["noise_pct"] == 1.0 and r["change_pct"] >= 5.0 and _visible(r)]
    return {
        "first_place": _share([r["baselines"][name] == r["hidden"][0] for r in seen]),
        "false_alarms": _share([r["baselines"][name] != "" for r in kinds["clean"]]),
        "outside_named": _share([r["baselines"][name] != "" for r in kinds["outside"]]),
    }


def _share(flags: list[bool]) -> float | None:
    return round(100.0 * sum(flags) / len(flags), 1) if flags else None


def markdown(summary: dict[str, Any], made_at: str) -> str:
    """The tables as a page."""
    s = summary
    lines = [
        "# Hidden-effect study: results",
        "",
        f"Made by `tools/hidden-effects report` from results of commit {made_at}; cases in `tools/hidden_effects/cases.py` (a",
        "case's seed is a checksum of its key). Numbers are percent of cases unless said otherwise. Visible: the hidden effect's",
        "signature beyond recalibration is at least 4 standard deviations long (snr).",
        "",
        "## Named",
        "",
        _table_head("hidden effects", _NAMED),
    ]
    rows = {
        "1 % noise, change of 5 % or more": s["hidden_1pct_noise_5pct_change"],
        "the same, visible ones": s["the_same_and_visible"],
    }
    rows |= s["by_snr"]
    lines += [_table_row(name, _NAMED, values) for name, values in rows.items() if values["of"]]
    lines += ["", "## By effect, 1 % noise", "", _table_head("effect", _NAMED)]
    lines += [_table_row(name, _NAMED, values) for name, values in s["by_effect"].items() if values["of"]]
    lines += ["", "## Holding its tongue", "", _table_head("cases", _VERDICTS)]
    lines += [_table_row(f"outside the library: {k}", _VERDICTS, v) for k, v in s["outside_by_kind"].items()]
    lines += [
        _table_row("outside the library: all", _VERDICTS, s["outside"]),
        _table_row("effect removed from the library, visible", _VERDICTS, s["removed_and_visible"]),
        "",
        f"Clean data: {s['clean']['false_alarms']} false alarms in {s['clean']['of']} cases.",
        f"Two effects at once: both named in {s['pairs']['both']} of {s['pairs']['of']}, "
        f"at least one in {s['pairs']['at_least_one']}.",
        "",
        "## Against simpler choices",
        "",
        _table_head("choice", _RIVALS),
        _table_row("yieldmon diagnose", _RIVALS, s["ours"]),
        *(
            _table_row({"aicc": "AICc alone", "bic": "BIC alone", "sparse": "lasso on residuals, BIC"}[k], _RIVALS, v)
            for k, v in s["baselines"].items()
        ),
        "",
    ]
    return "\n".join(lines)


_NAMED = {
    "of": "cases", "median_snr": "median snr", "first_place_pct": "first", "within_class_pct": "within class",
    "wrong_name_pct": "wrong",
    "unknown_pct": "unknown", "none_pct": "none", "mean_class_size": "class size", "median_closed_pct": "gap closed, held out",
    "median_parameter_error_pct": "parameter error",
}  # fmt: skip
_VERDICTS = {"of": "cases", "unknown_pct": "unknown", "effect_pct": "an effect named", "none_pct": "none"}
_RIVALS = {
    "first_place": "first place (visible, 1 % noise)",
    "false_alarms": "false alarms on clean data",
    "outside_named": "a name given outside the library",
}


def _table_head(first: str, columns: dict[str, str]) -> str:
    return f"| {first} | " + " | ".join(columns.values()) + " |\n|---|" + "---|" * len(columns)


def _table_row(name: str, columns: dict[str, str], values: dict[str, Any]) -> str:
    cells = [
        "" if values.get(c) is None else f"{values[c]:.3g}" if isinstance(values[c], float) else str(values[c]) for c in columns
    ]
    return f"| {name} | " + " | ".join(cells) + " |"
