"""How often names are right beside parameters of the grain that end at a bound, and what limiting their confidence changes.

    python -m studies.hidden_effects.bounds studies/hidden_effects/laws-905177.jsonl [MORE.jsonl ...]

Names are those of the records' verdict `effect`, with the confidence of the shipped map. Records hold the grain's parameters
where the gain is 1 + restitution, and with k1 and k2 friction and density; those of the discrete-element engine hold none.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from studies.hidden_effects import study
from studies.hidden_effects.confidence_map import expected_calibration_error
from yieldmon.discrepancy import confidence
from yieldmon.discrepancy.policy import Policy
from yieldmon.physics.grain import GRAIN

_NEAR = 1e-3
"""Share of the range within which a parameter counts as at its bound, as in a fit."""
_HIGH = 0.6
"""Stated confidence from which names are counted on their own."""


def at_bounds(record: dict[str, Any]) -> int:
    """Number of the grain's parameters at a bound beside the effects."""
    fitted = {k: v for k, v in record.get("grain", {}).get("fitted", {}).items() if v is not None}
    count = 0
    for name, value in fitted.items():
        low, high = GRAIN[name].search
        count += not low + _NEAR * (high - low) < value < high - _NEAR * (high - low)
    return count


def names(path: Path) -> list[tuple[int, float, bool]]:
    """(parameters at a bound, stated confidence, right) of every name in a file of records."""
    out = []
    for record in study.read(path):
        if record["verdict"] != "effect":
            continue
        stated = confidence.shipped().within(confidence.as_rows(record["features"]))
        if stated[0] < Policy().least_confidence:
            continue
        hidden = set() if record["generator"].endswith("removed") else set(record["hidden"])
        count = at_bounds(record)
        out += [(count, float(s), bool(hidden & set(of))) for s, of in zip(stated, record["classes"], strict=True)]
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", nargs="+", type=Path)
    found = [name for path in parser.parse_args().records for name in names(path)]
    count, stated, right = (np.array(column, dtype=float) for column in zip(*found, strict=True))
    most = np.array([1.0, confidence.MOST_BESIDE_BOUND, confidence.MOST_AT_BOUND])[np.minimum(count.astype(int), 2)]
    print(f"{len(found)} names")
    for number in (0, 1, 2):
        for what, chosen in (("all", count == number), (f"stated {_HIGH:g} or more", (count == number) & (stated >= _HIGH))):
            if chosen.any():
                figures = f"{chosen.sum()} names, stated {stated[chosen].mean():.2f}, right {int(right[chosen].sum())}"
                print(f"  parameters at a bound {number}, {what}: {figures}")
    for what, p in (("by the map", stated), ("limited", np.minimum(stated, most))):
        loss = -float(np.mean(right * np.log(p) + (1.0 - right) * np.log(1.0 - p)))
        print(f"  {what}: expected calibration error {expected_calibration_error(p, right):.3f}, log loss {loss:.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
