"""Runs the cases, one JSON line each, and makes the tables of README.md from them."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from yieldmon.discrepancy import diagnosis
from yieldmon.discrepancy.candidates import library
from yieldmon.discrepancy.fit import Fit, fit
from yieldmon.discrepancy.frame import predictions
from yieldmon.files import parameter_file

from . import baselines, cases

VISIBLE = 4.0
"""Standard deviations that a signature must be long to be called visible."""
SNR_BINS = ((0.0, 4.0), (4.0, 8.0), (8.0, 16.0), (16.0, np.inf))


def run_case(case: cases.Case) -> dict[str, Any]:
    """Make the rows, examine them, and note what was said beside what was hidden."""
    data = cases.make(case)
    seen = diagnosis.examine(data.rows, parameter_file.load(), diagnosis.Options(without=case.without))
    choice = seen.choice
    steps = choice.steps
    snr, projected = _signature(case, data, choice.base) if case.kind in ("hidden", "removed") else (None, None)
    return {
        "key": case.key,
        "kind": case.kind,
        "hidden": list(case.hidden),
        "noise_pct": case.noise_pct,
        "speeds": case.speeds,
        "sizes": data.sizes,
        "change_pct": 100.0 * data.change,
        "snr": snr,
        "projected_pct": projected,
        "snr_beside": _snr_beside(data, choice.base) if case.kind == "pair" else None,
        "verdict": choice.verdict,
        "named": list(choice.named),
        "partial": [s.added for s in steps],
        "classes": [[s.added, *s.equivalent] for s in steps] if choice.verdict == "effect" else [],
        "confidence": [s.confidence for s in steps],
        "f": [choice.lack_of_fit_before.f, choice.lack_of_fit_after.f],
        "p_any": choice.p_any,
        "closed_pct": seen.held_out.closed_pct if seen.held_out is not None and choice.verdict == "effect" else None,
        "parameter_error_pct": _parameter_error(case, data, choice.best),
        "baselines": {
            "aicc": baselines.by_criterion(choice, "aicc"),
            "bic": baselines.by_criterion(choice, "bic"),
            "sparse": baselines.by_sparse_regression(choice.base, library(choice.base.frame, case.without)),
        },
    }


def _signature(case: cases.Case, data: cases.Data, base: Fit) -> tuple[float, float]:
    """The hidden effect's signature beyond recalibration: its length in standard deviations of the cell means, and its largest
    value in percent of the largest reading.

    The published model is refitted to the candidate's own prediction at the hidden size; what it cannot follow is the signature.
    """
    effect = case.hidden[0]
    absorbed = _absorbed(base, (effect,), (), base.values | _truth(data))
    if absorbed is None:
        return float("nan"), float("nan")
    left = float(np.max(np.abs(absorbed.residual * base.frame.sd)))
    return float(np.sqrt(absorbed.chi2)), 100.0 * left / float(np.max(np.abs(base.frame.cells.mean)))


def _snr_beside(data: cases.Data, base: Fit) -> list[float]:
    """For each effect of a pair, the length of what recalibration and the other effect, refitted, cannot follow of the two."""
    grain = data.grain
    gain = {"restitution": grain.restitution} if "restitution" in base.values else {"k1": 0.0, "k2": 1.0 + grain.restitution}
    true = base.values | {"friction": grain.friction, "density": grain.density} | gain | _truth(data)
    pair = tuple(data.sizes)
    left = [_absorbed(base, pair, tuple(e for e in pair if e != name), true) for name in pair]
    return [float("nan") if a is None else float(np.sqrt(a.chi2)) for a in left]


def _truth(data: cases.Data) -> dict[str, float]:
    return {f"{e}.{p}": v for e, size in data.sizes.items() for p, v in _leading_values(e, size).items()}


def _absorbed(base: Fit, hidden: tuple[str, ...], known: tuple[str, ...], values: dict[str, float]) -> Fit | None:
    """The model with the `known` effects fitted to the noise-free prediction with the `hidden` ones."""
    moved = np.real(predictions(base.frame, hidden, values))
    if not np.all(np.isfinite(moved)):
        return None
    cells = base.frame.cells
    return fit(replace(base.frame, cells=replace(cells, mean=moved)), known, values, iterations=20)


def _leading_values(effect: str, size: float) -> dict[str, float]:
    if effect == "moisture_dependence":
        return {"friction_per_pct": size, "density_per_pct": -0.2 * size, "restitution_per_pct": -0.5 * size}
    return {cases.LEADING[effect]: size}


def _parameter_error(case: cases.Case, data: cases.Data, best: Fit) -> float | None:
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
    out["left_of_full_scale_5pct"] = _named([r for r in strong if (r["projected_pct"] or 0.0) >= 5.0])
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
    out["pairs"] = _pairs(kinds["pair"])
    out["pairs_both_visible"] = _pairs([r for r in kinds["pair"] if min(r["snr_beside"]) >= VISIBLE])
    out["baselines"] = {name: _baseline(kinds, name) for name in ("aicc", "bic", "sparse")}
    out["ours"] = {
        "first_place": _share([r["named"][:1] == r["hidden"] for r in seen]),
        "false_alarms": _share([r["verdict"] != "none" for r in kinds["clean"]]),
        "outside_named": _share([r["verdict"] == "effect" for r in kinds["outside"]]),
    }
    return out


def _visible(record: dict[str, Any]) -> bool:
    return (record["snr"] or 0.0) >= VISIBLE


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
        "right_pct": _share([w or (r["verdict"] == "none" and not _visible(r)) for r, w in zip(records, within, strict=True)]),
        "wrong_name_pct": _share([r["verdict"] == "effect" and not w for r, w in zip(records, within, strict=True)]),
        "further_name_pct": _share([len(r["named"]) > 1 for r in records]),
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


def _pairs(records: list[dict[str, Any]]) -> dict[str, int]:
    hits = [_pair_hits(r) for r in records]
    return {
        "of": len(records),
        "both": sum(n == 2 for n in hits),
        "at_least_one": sum(n >= 1 for n in hits),
        "unknown": sum(r["verdict"] == "unknown" for r in records),
        "wrong": sum(r["verdict"] == "effect" and n == 0 for r, n in zip(records, hits, strict=True)),
    }


def _pair_hits(record: dict[str, Any]) -> int:
    """How many of the two are named, each in a place of its own: as its first name, or within a class of at most four."""
    if record["verdict"] != "effect":
        return 0
    one, other = (
        {i for i, c in enumerate(record["classes"]) if name == c[0] or (name in c and len(c) <= 4)} for name in record["hidden"]
    )
    return min(bool(one) + bool(other), len(one | other))


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
        f"Made by `python -m studies.hidden_effects report` from results of commit {made_at}; cases in `cases.py` (a",
        "case's seed is a checksum of its key). Numbers are percent of cases unless said otherwise. Visible: the hidden effect's",
        "signature beyond recalibration is at least 4 standard deviations long (snr). Right: within the class, or `none` where",
        "the effect is not visible. Further: more than the one effect was named.",
        "",
        "## Named",
        "",
        _table_head("hidden effects", _NAMED),
    ]
    rows = {
        "1 % noise, change of 5 % or more": s["hidden_1pct_noise_5pct_change"],
        "the same, visible ones": s["the_same_and_visible"],
        "the same, 5 % or more beyond recalibration": s["left_of_full_scale_5pct"],
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
        _pair_line("Two effects at once", s["pairs"]),
        _pair_line("Those of which each is visible beside the other", s["pairs_both_visible"]),
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


def _pair_line(name: str, pairs: dict[str, int]) -> str:
    return (
        f"{name}: both named in {pairs['both']} of {pairs['of']}, at least one in {pairs['at_least_one']}, "
        f"`unknown` in {pairs['unknown']}, a wrong name first in {pairs['wrong']}."
    )


_NAMED = {
    "of": "cases", "median_snr": "median snr", "first_place_pct": "first", "within_class_pct": "within class",
    "right_pct": "right", "wrong_name_pct": "wrong", "further_name_pct": "further",
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
