"""Record a set-up through a terminal of 80 columns and 24 lines as an asciicast: python -m studies.setup.session [OUT.cast]

The answers come from ANSWERS, one of them wrong first. Times in the file are not those of a person: each answer comes STEP_S
after the one before, so that the same program records the same file. `asciinema play docs/img/setup.cast` shows it.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import pexpect

COLUMNS, LINES, STEP_S = 80, 24, 1.5
TARGET = Path(__file__).resolve().parents[2] / "docs" / "img" / "setup.cast"
ANSWERS = (
    "old-green", "", "", "54", "0.0541", "0.1656 0.2071", "0.16", "0.21", "0.4", "0.16", "0.1887", "70", "40", "90", "400", "250",
    "599", "25", "4000", "0 5 10", "500 597.6 695.1", "46.5 86.4", "45 85", "wheat",
)  # fmt: skip
_PROMPT = r"\d+/\d+ [^\n]*: $"


def record() -> str:
    """The asciicast (version 2): a header, then [time s, "o", text] a line."""
    events: list[tuple[float, str, str]] = [(0.0, "o", "$ yieldmon setup --out new\r\n")]
    with tempfile.TemporaryDirectory() as folder:
        terminal = pexpect.spawn(
            sys.executable, ["-m", "yieldmon.cli.main", "setup", "--out", "new"], cwd=folder, dimensions=(LINES, COLUMNS),
            encoding="utf-8", timeout=60, env={**os.environ, "TERM": "xterm"},
        )  # fmt: skip
        for number, answer in enumerate(ANSWERS, 1):
            terminal.expect(_PROMPT)
            events.append((number * STEP_S, "o", terminal.before + terminal.after))
            terminal.sendline(answer)
        terminal.expect(pexpect.EOF)
        events.append(((len(ANSWERS) + 1) * STEP_S, "o", terminal.before))
        terminal.close()
        if terminal.exitstatus != 0:
            raise RuntimeError(f"setup ended with {terminal.exitstatus}: {events[-1][2]}")
    header = {"version": 2, "width": COLUMNS, "height": LINES, "title": "yieldmon setup"}
    return "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in (header, *events))


def main() -> None:
    """Command line."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET
    target.write_text(record(), encoding="utf-8")
    print(f"written: {target}")


if __name__ == "__main__":
    main()
