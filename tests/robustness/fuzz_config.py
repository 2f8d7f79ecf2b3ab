"""Mutate the shipped configuration, machine and parameter files: each gives an error line or a run, never more.

python -m tests.robustness fuzz-config --count 10000 --seed 1
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

from tests.service.bench import traffic
from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration

SOURCES = {
    "yieldmon.yaml": "config/yieldmon.yaml",
    "machine.yaml": "config/machines/sprocket-8.yaml",
    "parameters.yaml": "config/parameters/corn.yaml",
}
VALUES = (
    "0", "-1", "1e308", "-1e-308", ".nan", ".inf", "9" * 40, "0x1F", "1:30", "true", "null", "''", "[]", "{}",
    "[1, [2, {a: 3}]]", "word", "2001-02-30", "!!python/name:os.system", "&a 1", "*a", "|", "'", '"\\x00"',
    "\u00e9\U0001f33d", "1.5", "40", "0.3", "3",
)  # fmt: skip
CHARACTERS = " \n\t:-[]{},#&*!|>'\"%@`0123456789eE.+abcxyz\x00\x85\ufeff"


def mutated(text: str, rng: random.Random) -> str:
    """The text with one to three faults such as hands, editors and disks make."""
    for _ in range(rng.randint(1, 3)):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        kind = rng.randrange(8)
        if kind <= 2:
            candidates = [i for i, line in enumerate(lines) if ":" in line and not line.lstrip().startswith("#")]
            at = rng.choice(candidates) if candidates else at
            lines[at] = lines[at].partition(":")[0] + ": " + rng.choice(VALUES)
        elif kind == 3:
            del lines[at]
        elif kind == 4:
            lines.insert(rng.randrange(len(lines)), lines[at])
        elif kind == 5:
            lines[at] = " " * rng.randrange(5) + lines[at].lstrip()
        text = "\n".join(lines)
        place = rng.randrange(len(text) + 1)
        if kind == 6:
            text = text[:place] + "".join(rng.choices(CHARACTERS, k=rng.randint(1, 4))) + text[place + rng.randrange(3) :]
        elif kind == 7:
            text = text[:place]
    return text


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when nothing but InputError came out."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness fuzz-config", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    rng = random.Random(args.seed)
    originals = {name: shipped(source).read_text() for name, source in SOURCES.items()}
    head = "machine_file: machine.yaml\nparameter_file: parameters.yaml\n"
    originals["yieldmon.yaml"] = head + originals["yieldmon.yaml"].replace("machine_file: null\n", "").replace(
        "parameter_file: null\n", ""
    )
    harvest = [*traffic(0.0, 5.0, 0.0), *traffic(5.0, 2.0, 60.0)]
    counts = {"accepted": 0, "refused": 0, "escapes": 0}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.count):
            target = rng.choices(list(SOURCES), weights=(2, 1, 1))[0]
            for name, text in originals.items():
                content = mutated(text, rng) if name == target else text
                (Path(folder) / name).write_text(content, encoding="utf-8", errors="surrogatepass", newline="")
            try:
                loaded = configuration.load(Path(folder) / "yieldmon.yaml", {})
                monitor = build_monitor(loaded.engine, loaded.machine, loaded.parameters, loaded.calibrator)
                for frame in harvest:
                    monitor.feed(frame)
                counts["accepted"] += 1
            except InputError as error:
                counts["refused"] += 1
                if "\n" in str(error):
                    counts["escapes"] += 1
                    print(f"mutation {number}: more than one line: {error}", file=sys.stderr)
            except Exception:  # noqa: BLE001 - what is looked for here
                counts["escapes"] += 1
                print(f"mutation {number} of {target}:\n{traceback.format_exc()}", file=sys.stderr)
    print(json.dumps(counts) if args.json else ", ".join(f"{n} {name}" for name, n in counts.items()))
    return 1 if counts["escapes"] else 0
