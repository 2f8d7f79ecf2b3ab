"""What `--json` prints: the shape of each document, found by running the command."""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from yieldmon.cli.main import main

_TABLE = "plate_angle_deg,force_n\n70,60\n"
#: Verb -> its command line, in a folder with the files that it names.
_RUNS = {
    "predict": "predict --mass-flow 10 --plate-angle 70 --json",
    "estimate": "estimate forces.csv --json",
    "check-config": "check-config c.yaml --json",
    "monitor": "monitor day.log --once --speed 0 --json",
}
#: Of keys that are empty in these runs.
_EMPTY_HERE = {"notes": "string", "signals": "object or null", "factory_mass_flow_kg_s": "number or null"}
#: Of lists of objects that are empty in these runs: one of them.
_OBJECTS = {"problems": {"where": "", "problem": "", "expected": ""}}
#: Keys whose values are shown no deeper: a configuration has a page of its own, others are one for each name.
_CLOSED = {"configuration", "signals"}


def markdown() -> str:
    """A section for each document."""
    parts = []
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            Path("forces.csv").write_text(_TABLE, encoding="utf-8")
            Path("c.yaml").write_text("{}\n", encoding="utf-8")
            _run("simulate --duration 3 --log day.log")
            for verb, line in _RUNS.items():
                shape = _shape(json.loads(_run(line)))
                parts += [f"## {verb}", "", "```text", f"yieldmon {line}", *shape, "```", ""]
        finally:
            os.chdir(here)
    return "\n".join(parts)


def _run(line: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = main(line.split())
    if code != 0:
        raise RuntimeError(f"yieldmon {line}: exit code {code}")
    return out.getvalue()


def _shape(value: Any, indent: str = "  ") -> list[str]:
    lines: list[str] = []
    for key, inner in value.items():
        listed = isinstance(inner, list)
        one = (inner[0] if inner else _OBJECTS.get(key)) if listed else inner
        mark = f"{indent}{key}{'[]' if listed else ''}"
        if isinstance(one, dict) and key not in _CLOSED:
            lines += [mark, *_shape(one, indent + "  ")]
        else:
            lines.append(f"{mark}: {_EMPTY_HERE[key] if one is None else _kind(one)}")
    return lines


def _kind(value: Any) -> str:
    if isinstance(value, dict):
        return "object"
    if isinstance(value, bool):
        return "boolean"
    return {str: "string", int: "number", float: "number", list: "list"}[type(value)]
