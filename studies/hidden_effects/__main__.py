"""The hidden-effect study of `yieldmon diagnose`.

python -m studies.hidden_effects run --out results.jsonl            # resumable; one line a case
python -m studies.hidden_effects run --out results.jsonl --cases 3  # a short one: three cases of each kind and effect
python -m studies.hidden_effects run --out part1.jsonl --part 1/3   # one of three processes
python -m studies.hidden_effects report *.jsonl                     # README.md, results.json
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from studies.hidden_effects import cases, study


def tell(done: int, of: int, key: str) -> None:
    """One line of progress, over the last one."""
    print(f"\r{done}/{of} {key:60.60s}", end="", file=sys.stderr, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    run = verbs.add_parser("run", help="run the cases that are not in the results yet")
    run.add_argument("--out", type=Path, required=True, help="results, JSON Lines")
    run.add_argument("--cases", type=int, help="of each effect and kind, in place of the full study")
    run.add_argument("--part", default="1/1", help="which share of the cases, such as 2/3")
    report = verbs.add_parser("report", help="tables from results")
    report.add_argument("results", type=Path, nargs="+")
    report.add_argument("--commit", help="commit that made the results (default: this checkout's)")
    report.add_argument("--to", type=Path, default=Path(__file__).resolve().parent, help="folder for README.md and results.json")
    args = parser.parse_args()
    if args.verb == "run":
        n = args.cases
        todo = cases.all_cases(10, 2, 100, 8, 2, 100) if n is None else cases.all_cases(n, 0, 4 * n, n, n, 4 * n)
        part, parts = (int(v) for v in args.part.split("/"))
        study.run(args.out, todo[part - 1 :: parts], tell)
        print(file=sys.stderr)
        return 0
    records = {r["key"]: r for path in args.results for r in study.read(path)}
    summary = study.summarise(list(records.values()))
    made_at = args.commit or study.commit()
    (args.to / "results.json").write_text(json.dumps({"commit": made_at} | summary, indent=1) + "\n", encoding="utf-8")
    (args.to / "README.md").write_text(study.markdown(summary, made_at), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
