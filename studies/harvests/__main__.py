"""What `yieldmon map` can be held to on delays and transport.

    python -m studies.harvests --data SOURCE... [--trials 200] [--seed 1] [--out FILE]

Sources are whole harvests, any that the map reads; the synthetic parts need none.
"""

from __future__ import annotations

import argparse
import json
import sys
from math import isfinite
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError

from .study import coverage, real_shifts, refusals, shift_coverage, transport


def known(value: Any) -> Any:
    """As strict JSON takes it: four decimals, null for NaN."""
    if isinstance(value, dict):
        return {key: known(one) for key, one in value.items()}
    if isinstance(value, list):
        return [known(one) for one in value]
    return (round(value, 4) if isfinite(value) else None) if isinstance(value, float) else value


def main() -> int:
    """Print the results as JSON, and write them where asked."""
    parser = argparse.ArgumentParser(prog="python -m studies.harvests", description=__doc__)
    parser.add_argument("--data", nargs="*", type=Path, default=[], metavar="SOURCE", help="whole harvests")
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    results: dict[str, Any] = {"seed": args.seed}

    def told(name: str, value: Any) -> None:
        results[name] = value = known(value)
        print(name, json.dumps(value), file=sys.stderr, flush=True)

    told("synthetic", coverage(args.trials, args.seed))
    told("noise", refusals(args.trials // 2, args.seed + 1))
    for path in args.data:
        try:
            found = real_shifts(path)
            told(f"{path.name}: delay", found)
            told(f"{path.name}: transport", transport(path))
            if found["decision"] == "estimated":
                told(f"{path.name}: parts", shift_coverage(path, args.trials, args.seed + 2))
        except InputError as error:
            told(path.name, str(error))
    text = json.dumps(results, indent=1)
    print(text)
    if args.out:
        args.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
