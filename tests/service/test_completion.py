"""Every verb shows an example, and completion works."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from yieldmon.cli.main import build_parser, find_verbs

ROOT = Path(__file__).parents[2]
VERBS = find_verbs()


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_shows_an_example(name, capsys):
    parser, _ = build_parser(VERBS, VERBS[name])
    with pytest.raises(SystemExit):
        parser.parse_args([name, "--help"])
    assert f"\nexample: yieldmon {name}" in capsys.readouterr().out


@pytest.mark.parametrize("line", ["yieldmon ca", "yieldmon plot sens", "yieldmon export --fo"])
def test_completion(line, tmp_path):
    """As bash's completion calls the command."""
    out = tmp_path / "completions"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "COMP_TYPE": "9",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(out),
        "PYTHONPATH": str(ROOT),
    }
    subprocess.run([sys.executable, "-m", "yieldmon"], env=environment, check=False, capture_output=True)
    last = line.split()[-1]
    assert any(found.startswith(last) and len(found) > len(last) for found in out.read_text(encoding="utf-8").split())
