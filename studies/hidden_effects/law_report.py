"""Tables from the cases of `law_cases`, and the map of confidence that ships.

    python -m studies.hidden_effects.law_report RESULTS.jsonl... [--shipped] [--page STUDY.md] [--ship] [--judge OTHERS.jsonl...]

A confidence is only judged on causes that it was not learnt on: names in a case get theirs from the cases, of all
generators, that hide none of its effects (leave-law-out); beside it, from the cases of the other generators alone. A map is
learnt on candidates that were not named too, so that it speaks of them as well.
--shipped: confidences by the map that ships, for cases that it was not learnt on.
--judge: what a limit on confidence alone would name on other cases, in place of the rules, by the map learnt on RESULTS, and the
log loss of that map and of the one that ships on their names.
--page rewrites the part of a page between `<!-- laws -->` and `<!-- /laws -->`. --ship writes the map learnt on all generators.
"""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from studies.hidden_effects import law_cases, study
from studies.hidden_effects.confidence_map import expected_calibration_error, learnt, to_document
from yieldmon.discrepancy import confidence
from yieldmon.discrepancy.confidence import Calibration
from yieldmon.discrepancy.policy import Policy

SHIPPED = Path(confidence.__file__).with_name("confidence.json")
LARGEST_CLASS = 4
LEAST_NAMES = 5
SURE = 0.7
"""Confidence that might outweigh what speaks against a name."""
Record = dict[str, Any]


def read(path: Path) -> list[Record]:
    """Records of a results file, each case by its salt too; of older ones, what speaks against a name by today's rules, as far as
    they kept it."""
    return [_judged({**r, "case": f"{r['salt']}/{r['case']}"}) for r in study.read(path)]


def _judged(record: Record) -> Record:
    if "against" in record or not record["classes"]:
        return record
    policy = Policy()
    left = record["features"][0]["left_share"] ** 2
    against = (
        record["p"][1] < policy.lack_of_fit_p
        or left > policy.unexplained_share
        or record.get("undone", 0.0) > policy.most_cancelled
        or len(record["classes"][0]) > policy.largest_class
    )
    found = [{**f, "against": float(against)} for f in record["features"]]
    verdict = "unknown" if against and record["verdict"] == "effect" else record["verdict"]
    return {**record, "features": found, "verdict": verdict}


def family(kind: str) -> str:
    """The generator behind a kind of case."""
    return "combine" if kind == "clean" else kind.partition("-")[0]


def law(record: Record) -> frozenset[str]:
    """The causes whose laws a case has; of one that hides nothing, its kind."""
    return frozenset(record["hidden"] or [record["generator"]])


def generator(record: Record) -> frozenset[str]:
    """The generator behind a case."""
    return frozenset([family(record["generator"])])


def steps_of(records: Sequence[Record]) -> list[tuple[Record, int]]:
    """Every step, named or a leading candidate, whatever the confidence in it."""
    return [(r, i) for r in records for i in range(len(r["classes"]))]


def right(steps: Sequence[tuple[Record, int]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Whether what is hidden is the name or tied with it, and whether it is the name; 0 or 1."""
    removed = [r["generator"].endswith("removed") for r, _ in steps]
    truth = [set() if gone else set(r["hidden"]) for gone, (r, _) in zip(removed, steps, strict=True)]
    within = [float(bool(t & set(r["classes"][i]))) for t, (r, i) in zip(truth, steps, strict=True)]
    name = [float(r["classes"][i][0] in t) for t, (r, i) in zip(truth, steps, strict=True)]
    return np.array(within), np.array(name)


def learn(records: Sequence[Record], provenance: dict[str, Any]) -> Calibration:
    """The map from cases with known answers. Raises ValueError where too few names were given."""
    steps = steps_of(records)
    if len(steps) < LEAST_NAMES:
        raise ValueError(f"{len(steps)} names: at least {LEAST_NAMES} are needed")
    rows = confidence.as_rows([r["features"][i] for r, i in steps])
    within, name = right(steps)
    tied = np.array([len(r["classes"][i]) > 1 for r, i in steps]) & (within > 0.5)
    if np.count_nonzero(tied) < 5:
        tied = within > 0.5
    return Calibration(learnt(rows, within), learnt(rows[tied], name[tied]), provenance)


def crossed(records: Sequence[Record], of: Callable[[Record], frozenset[str]] = law) -> dict[str, list[tuple[float, float]]]:
    """For each case its steps' confidences (within, name) by the map of the cases that share nothing with it."""
    out: dict[str, list[tuple[float, float]]] = {}
    for left_out in {of(r) for r in records if r["classes"]}:
        by = learn([r for r in records if not of(r) & left_out], {})
        for r in records:
            if of(r) == left_out and r["classes"]:
                rows = confidence.as_rows(r["features"])
                within = by.within(rows)
                tied = np.array([len(c) > 1 for c in r["classes"]])
                names = within * np.where(tied, by.name(rows), 1.0)
                out[r["case"]] = [(float(w), float(n)) for w, n in zip(within, names, strict=True)]
    return out


def by_shipped(records: Sequence[Record]) -> dict[str, list[tuple[float, float]]]:
    """For each case its steps' confidences (within, name) by the map that ships."""
    by, out = confidence.shipped(), {}
    for r in records:
        if r["classes"]:
            rows = confidence.as_rows(r["features"])
            within = by.within(rows)
            names = within * np.where([len(c) > 1 for c in r["classes"]], by.name(rows), 1.0)
            out[r["case"]] = [(float(w), float(n)) for w, n in zip(within, names, strict=True)]
    return out


def named(record: Record, stated: dict[str, list[tuple[float, float]]]) -> bool:
    """Whether a case's verdict names an effect, doubtful ones left out."""
    return record["verdict"] == "effect" and stated[record["case"]][0][0] >= Policy().least_confidence


def table(records: Sequence[Record], *, by_map_that_ships: bool = False) -> list[str]:
    """The page's part, as Markdown."""
    stated = by_shipped(records) if by_map_that_ships else crossed(records)
    how = "by the map that ships" if by_map_that_ships else "from the cases of other causes"
    commits = ", ".join(sorted({r["commit"] for r in records}))
    salts = ", ".join(sorted({str(r["salt"]) for r in records}))
    lines = [
        *textwrap.wrap(
            f"{len(records)} cases, salt {salts}, commit {commits}; each name's confidence {how}. Visible: the published model "
            f"leaves {law_cases.VISIBLE:g} sd or more. Within: in the first class, of at most {LARGEST_CLASS}.",
            width=128,
        ),
        "",
        "| cases | number | within class | first | a wrong name | unknown | none |",
        "|---|---|---|---|---|---|---|",
    ]
    singles = [r for r in records if r["generator"] in ("third", "combine", "engine") and r["visible_sd"] >= law_cases.VISIBLE]
    for kind in ("third", "combine", "engine", "all"):
        lines.append(_single_line(kind, [r for r in singles if kind in ("all", r["generator"])], stated))
    lines += ["", "| cases | number | an effect named | unknown | none |", "|---|---|---|---|---|"]
    for kind, what in (
        ("clean", "virtual combine, nothing hidden"),
        ("third-clean", "study's generator, nothing hidden"),
        ("engine-clean", "discrete elements, nothing put in (its own differences remain)"),
        ("third-removed", "visible, the effect taken from the library"),
    ):
        least = law_cases.VISIBLE if kind == "third-removed" else 0.0
        chosen = [r for r in records if r["generator"] == kind and r["visible_sd"] >= least]
        lines.append(_verdict_line(what, chosen, stated))
    pairs = [r for r in records if r["generator"] == "third-pair"]
    hits = [_pair_hits(r) if named(r, stated) else 0 for r in pairs]
    both, one = sum(h == 2 for h in hits), sum(h >= 1 for h in hits)
    lines += ["", f"Pairs: both named in {both} of {len(pairs)}, at least one in {one}."]
    return [*lines, "", *reliability(records, stated)]


def _single_line(kind: str, chosen: Sequence[Record], stated: dict[str, list[tuple[float, float]]]) -> str:
    given = [r for r in chosen if named(r, stated)]
    within = sum(r["hidden"][0] in r["classes"][0] and len(r["classes"][0]) <= LARGEST_CLASS for r in given)
    first = sum(r["classes"][0][0] == r["hidden"][0] for r in given)
    wrong = sum(all(r["hidden"][0] not in c for c in r["classes"]) for r in given)
    verdicts = Counter("effect" if r in given else "none" if r["verdict"] == "none" else "unknown" for r in chosen)
    cells = (within, first, wrong, verdicts["unknown"], verdicts["none"])
    return f"| {kind} | {len(chosen)} | " + " | ".join(_share(n, len(chosen)) for n in cells) + " |"


def _verdict_line(what: str, chosen: Sequence[Record], stated: dict[str, list[tuple[float, float]]]) -> str:
    given = sum(named(r, stated) for r in chosen)
    none = sum(r["verdict"] == "none" for r in chosen)
    return f"| {what} | {len(chosen)} | {given} | {len(chosen) - given - none} | {none} |"


def _share(count: int, of: int) -> str:
    return f"{count} ({100.0 * count / of:.0f} %)" if of else "-"


def _pair_hits(record: Record) -> int:
    found = [
        {i for i, c in enumerate(record["classes"]) if name == c[0] or (name in c and len(c) <= LARGEST_CLASS)}
        for name in record["hidden"]
    ]
    return min(sum(map(bool, found)), len(set().union(*found)))


def reliability(records: Sequence[Record], stated: dict[str, list[tuple[float, float]]]) -> list[str]:
    """Reliability diagram as a table, and expected calibration errors, over every name given."""
    steps = [(r, i) for r, i in steps_of(records) if named(r, stated)]
    within, name = right(steps)
    others = crossed(records, generator)
    elsewhere = np.array([others[r["case"]][i][0] for r, i in steps])
    ours = np.array([stated[r["case"]][i][0] for r, i in steps])
    names = np.array([stated[r["case"]][i][1] for r, i in steps])
    raw = np.array([r["features"][i]["stability"] for r, i in steps])
    lines = ["| stated | names | mean stated | right |", "|---|---|---|---|"]
    for low in np.arange(0.0, 1.0, 0.1):
        inside = (ours >= low) & (ours < low + 0.1 + 1e-9 * (low > 0.85))
        if inside.any():
            means = f"{ours[inside].mean():.2f} | {within[inside].mean():.2f}"
            lines.append(f"| {low:.1f} to {low + 0.1:.1f} | {inside.sum()} | {means} |")
    error = expected_calibration_error
    chance = by_chance(ours)
    slope, intercept, p_line = calibration_line(ours, within)
    by_effect, by_name, by_others, by_share = (
        f"{error(p, truth):.3f}" for p, truth in ((ours, within), (names, name), (elsewhere, within), (raw, within))
    )
    return [
        *lines,
        "",
        f"Expected calibration error over {len(steps)} names, 10 bins: {by_effect} (effect or one tied with it), {by_name} (the",
        f"effect itself), {by_others} by the other generators' maps; of the bootstrap's share {by_share}. If each",
        f"name is right with its stated probability, so many show {chance.mean():.3f}, and at most",
        f"{np.quantile(chance, 0.95):.3f} in 95 % of draws: p = {np.mean(chance >= error(ours, within)):.2f}. Log odds of right",
        f"names over those stated: slope {slope:.2f}, intercept {intercept:+.2f}, p = {p_line:.2f} for 1 and 0.",
        f"A name's highest confidence that was wrong: {max(ours[within < 0.5], default=0.0):.2f}.",
    ]


def by_chance(stated: NDArray[np.float64], draws: int = 2000) -> NDArray[np.float64]:
    """Expected calibration errors of names that are right with exactly their stated probabilities, (draws,)."""
    rng = np.random.default_rng(1)
    right = (rng.random((draws, len(stated))) < stated).astype(float)
    return np.array([expected_calibration_error(stated, r) for r in right])


def calibration_line(stated: NDArray[np.float64], right: NDArray[np.float64]) -> tuple[float, float, float]:
    """Slope and intercept of the right names' log odds over the stated ones, and p for 1 and 0 (likelihood ratio; Cox 1958)."""
    odds = np.log(stated) - np.log1p(-stated)
    columns = np.column_stack((odds, np.ones(len(odds))))

    def loss(line: NDArray[np.float64]) -> float:
        at = columns @ line
        return float(np.sum(np.logaddexp(0.0, at) - right * at))

    found = optimize.minimize(loss, np.array([1.0, 0.0]), bounds=((-20.0, 20.0), (-20.0, 20.0)))
    ratio = 2.0 * (loss(np.array([1.0, 0.0])) - float(found.fun))
    return float(found.x[0]), float(found.x[1]), float(stats.chi2.sf(ratio, 2))


def judged(records: Sequence[Record], others: Sequence[Record]) -> list[str]:
    """What a limit on the first class's confidence names on `others`, by the map of `records`, beside the rules; Markdown."""
    by = learn(records, {})
    lines = [
        "| named where | within class, visible | a wrong name | removed effects, visible | nothing hidden | pairs, one or both |",
        "|---|---|---|---|---|---|",
    ]
    shipped = by_shipped(others)
    lines.append("| the rules say so | " + " | ".join(_named_so(others, [r for r in others if named(r, shipped)])) + " |")
    first = {r["case"]: float(by.within(confidence.as_rows(r["features"][:1]))[0]) for r in others if r["classes"]}
    for limit in (0.4, 0.5, 0.6, 0.7):
        given = [r for r in others if r["verdict"] != "none" and first.get(r["case"], 0.0) >= limit]
        lines.append(f"| confidence is {limit} or more | " + " | ".join(_named_so(others, given)) + " |")
    sure = [r for r in others if r["verdict"] != "none" and first.get(r["case"], 0.0) >= SURE]
    either = [r for r in others if r in sure or named(r, shipped)]
    lines.append(f"| the rules say so, or confidence is {SURE} or more | " + " | ".join(_named_so(others, either)) + " |")
    steps = [(r, i) for r, i in steps_of(others) if r["verdict"] == "effect"]
    rows, (within, _) = confidence.as_rows([r["features"][i] for r, i in steps]), right(steps)
    ours, theirs = (np.log(np.where(within > 0.5, p, 1.0 - p)) for p in (by.within(rows), confidence.shipped().within(rows)))
    gain, sd = float(np.mean(ours - theirs)), float(np.std(ours - theirs)) / len(steps) ** 0.5
    return [
        *lines,
        "",
        f"Log loss over {len(steps)} names: {-theirs.mean():.3f} by the map that ships, {-ours.mean():.3f} by this one (better",
        f"by {gain:+.3f} +- {sd:.3f} a name).",
    ]


def _named_so(records: Sequence[Record], given: Sequence[Record]) -> list[str]:
    """Counts of `given`, which are named, among the kinds of `records`."""

    def part(chosen: Sequence[Record], good: Callable[[Record], bool]) -> str:
        return f"{sum(r in given and good(r) for r in chosen)} of {len(chosen)}"

    seen = [r for r in records if r["visible_sd"] >= law_cases.VISIBLE]
    singles = [r for r in seen if r["generator"] in ("third", "combine", "engine")]
    return [
        part(singles, lambda r: r["hidden"][0] in r["classes"][0] and len(r["classes"][0]) <= LARGEST_CLASS),
        part(singles, lambda r: all(r["hidden"][0] not in c for c in r["classes"])),
        part([r for r in seen if r["generator"] == "third-removed"], lambda r: True),
        part([r for r in records if "clean" in r["generator"]], lambda r: True),
        part([r for r in records if r["generator"] == "third-pair"], lambda r: _pair_hits(r) >= 1),
    ]


def provenance(records: Sequence[Record]) -> dict[str, Any]:
    """Of the map that ships."""
    return {
        "method": "python -m studies.hidden_effects.law_report RESULTS.jsonl --ship",
        "generators": dict(sorted(Counter(r["generator"] for r in records).items())),
        "cases": len(records),
        "names": len(steps_of(records)),
        "salt": sorted({r["salt"] for r in records}),
        "commit": sorted({r["commit"] for r in records}),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("--shipped", action="store_true", help="confidences by the map that ships")
    parser.add_argument("--page", type=Path, help="page to rewrite")
    parser.add_argument("--judge", type=Path, nargs="+", default=[], help="other cases, named by confidence alone")
    parser.add_argument("--ship", action="store_true", help="write the map that yieldmon uses")
    args = parser.parse_args()
    records = [r for path in args.results for r in read(path)]
    if args.judge:
        print("\n".join(judged(records, [r for path in args.judge for r in read(path)])))
        return 0
    text = "\n".join(table(records, by_map_that_ships=args.shipped))
    print(text)
    if args.page is not None:
        before, _, rest = args.page.read_text(encoding="utf-8").partition("<!-- laws -->")
        _, _, after = rest.partition("<!-- /laws -->")
        args.page.write_text(f"{before}<!-- laws -->\n{text}\n<!-- /laws -->{after}", encoding="utf-8")
    if args.ship:
        document = to_document(learn(records, provenance(records)))
        SHIPPED.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
