"""Three to six weighed loads on machines whose force follows another law than the model's.

    python -m studies.load_laws                                   # two machines of each law, after 2, 3 and 6 loads
    python -m studies.load_laws --first 2001 --machines 3 --out results.json

Each machine is calibrated by its first loads, as by `yieldmon calibrate --loads`, from the shipped corn, and judged on ten
further loads of 3 t at 3.5 to 20 kg/s.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from studies.load_laws.machines import LAWS, MACHINE, MODELS, SHIPPED, draw, judged
from yieldmon import api
from yieldmon.estimation.weighing.loads import calibrate_loads
from yieldmon.physics.numerics import Array

COUNTS = (2, 3, 6)


def machine(name: str, seed: int, counts: tuple[int, ...] = COUNTS) -> list[dict[str, Any]]:
    """Errors of the ten further loads of one machine after each number of weighed ones."""
    drawn, model = draw(name, seed), api.ForwardModel(MACHINE, SHIPPED.effects)
    rows = []
    for count in counts:
        row: dict[str, Any] = {"law": name, "seed": seed, "loads": count}
        try:
            found = calibrate_loads(model, SHIPPED, drawn.weighed[:count])
        except ValueError as error:
            rows.append(row | {"refused": str(error)})
            continue
        errors = judged(found.parameter_set, drawn)
        row |= {"refused": "worse on loads left out" if found.refused else "", "dropped": len(found.outliers)}
        rows.append(row | {"error_pct": errors[:, 0].round(3).tolist(), "std_dev_pct": errors[:, 1].round(3).tolist()})
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """What the page has."""
    out = [
        "| machines | loads | mean error, % | largest | within 1 % | within 1 / 2 sd | z, rms | refused | loads dropped |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for title, names in (("other laws", LAWS), ("the model's law", MODELS)):
        for count in sorted({row["loads"] for row in rows}):
            own = [row for row in rows if row["law"] in names and row["loads"] == count]
            with_errors = [row for row in own if "error_pct" in row]
            if not with_errors:
                continue
            error: Array = np.array([row["error_pct"] for row in with_errors])
            z = error / np.array([row["std_dev_pct"] for row in with_errors])
            cells = (
                f"{title} ({len(own)})", count, f"{np.abs(error).mean():.2f}", f"{np.abs(error).max():.1f}",
                f"{100 * np.mean(np.abs(error) <= 1):.0f} %",
                f"{100 * np.mean(np.abs(z) <= 1):.0f} / {100 * np.mean(np.abs(z) <= 2):.0f} %", f"{np.sqrt(np.mean(z**2)):.2f}",
                sum(bool(row["refused"]) for row in own), sum(row["dropped"] for row in with_errors),
            )  # fmt: skip
            out.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(out)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1, help="first seed (default: %(default)s)")
    parser.add_argument("--machines", type=int, default=2, help="of each law (default: %(default)s)")
    parser.add_argument("--only", nargs="*", help="these laws (default: all)", choices=(*LAWS, *MODELS))
    parser.add_argument("--out", type=Path, help="write every load here as JSON")
    args = parser.parse_args()
    rows = []
    for name in args.only or (*LAWS, *MODELS):
        for seed in range(args.first, args.first + args.machines):
            rows += machine(name, seed)
        errors = [np.mean(np.abs(row["error_pct"])) for row in rows if row["law"] == name and "error_pct" in row]
        print(f"{name}: mean error {np.mean(errors):.2f} %" if errors else f"{name}: refused", flush=True)
    print(table(rows))
    if args.out is not None:
        git = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
        document = {"commit": git.stdout.strip(), "first": args.first, "rows": rows}
        args.out.write_text(json.dumps(document) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
