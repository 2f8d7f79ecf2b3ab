"""Run the study and print its table: python -m studies.setup [--seeds N] [--first SEED] [--without-sweeps] [--json F]"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from studies.setup.study import Result, run


def _pair(way: str, without: list[Result], with_sweeps: list[Result]) -> None:
    """Mean absolute error of each machine's further loads, with sweeps less without, of all and of each twenty in a row."""
    if not with_sweeps:
        return
    before, after = (np.mean(np.abs([r.errors_pct for r in rows]), axis=1) for rows in (without, with_sweeps))
    change = after - before
    error = float(np.std(change, ddof=1) / np.sqrt(change.size)) if change.size > 1 else float("nan")
    twenties = ", ".join(f"{part.mean():+.3f}" for part in np.split(change, range(20, change.size, 20)))
    print(
        f"{way}: mean absolute error {before.mean():.3f} % without, {after.mean():.3f} % with sweeps; "
        f"change {change.mean():+.3f} +- {error:.3f} % (by 20: {twenties}); smaller for {int(np.sum(change < 0.0))} of "
        f"{change.size} machines"
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--without-sweeps", action="store_true", help="weighed loads alone, in a tenth of the time")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    results = [r for seed in seeds for r in run(seed, with_sweeps=not options.without_sweeps)]
    if options.json is not None:
        options.json.write_text(json.dumps([dataclasses.asdict(r) for r in results], indent=1), encoding="utf-8")
    print(
        "| way | worst load, % | within 2 / 1.5 / 1 % | mean of ten, worst seed, % | stated sd, % | in 68 / 95 % interval "
        "| by the load's own sd |"
    )
    print("|---|---|---|---|---|---|---|")
    for way in dict.fromkeys(r.way for r in results):
        here = [r for r in results if r.way == way]
        errors = np.array([r.errors_pct for r in here])
        scaled = np.abs(errors) / np.array([r.sd_pct for r in here])[:, None]
        own = np.abs(errors) / np.array([r.own_sd_pct for r in here])
        within = " / ".join(f"{100.0 * np.mean(np.abs(errors) <= limit):.0f}" for limit in (2.0, 1.5, 1.0))
        told = bool(np.isfinite(scaled).all())
        inside, by_own = (
            " / ".join(f"{100.0 * np.mean(z <= limit):.1f}" for limit in (1.0, 1.96)) if told else "-" for z in (scaled, own)
        )
        stated = f"{np.mean([r.sd_pct for r in here]):.2f}" if told else "-"
        worst, mean = np.abs(errors).max(), np.abs(errors.mean(axis=1)).max()
        print(f"| {way} | {worst:.2f} | {within} | {mean:.2f} | {stated} | {inside} | {by_own} |")
    for way in ("three loads", "six loads"):
        _pair(way, [r for r in results if r.way == way], [r for r in results if r.way == f"{way} and sweeps"])


if __name__ == "__main__":
    main()
