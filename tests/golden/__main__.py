"""Keep outputs anew, with the reason why they differ from version 0.1.0's.

python -m tests.golden                              # which outputs differ, and where first
python -m tests.golden --keep NAME --reason "..."   # the output of this checkout is the right one from now on
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

from tests.golden import cases, kept


def outputs(names: list[str]) -> dict[str, str]:
    """Outputs of this checkout by case, from a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, str(Path(cases.__file__)), folder, *names], check=True, env=kept.environment())
        found = json.loads((Path(folder) / "outputs.json").read_text())
    return {name: kept.normalized(text) for name, text in found.items()}


def main() -> int:
    known = [case.name for case in cases.CASES]
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__.splitlines()[0])
    parser.add_argument("--keep", nargs="+", choices=known, default=[], metavar="NAME", help="cases to keep anew")
    parser.add_argument("--reason", help="why they differ")
    options = parser.parse_args()
    if options.keep and not options.reason:
        parser.error("--keep needs --reason")
    found = outputs(options.keep)
    if options.keep:
        reasons, machines = kept.differences(), kept.machines()
        for name in options.keep:
            kept.save(name, found[name])
            reasons[name], machines[name] = options.reason, kept.machine()
        kept.MACHINES.write_text(yaml.safe_dump(machines, width=120))
        kept.DIFFERENCES.write_text(yaml.safe_dump(reasons, width=120, allow_unicode=True))
        return 0
    for name, text in found.items():
        expected = kept.load(name)
        same = "same bytes" if text == expected else kept.first_difference(text, expected) or "same numbers"
        print(f"{name}: {same}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
