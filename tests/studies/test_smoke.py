"""Every study has its record and answers; the quick ones run whole, in small."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from tests.robustness.__main__ import RUNS
from tests.robustness.__main__ import main as robustness

ROOT = Path(__file__).parents[2]
STUDIES = ROOT / "studies"
NAMES = sorted(path.parent.name for path in STUDIES.glob("*/__main__.py"))


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", NAMES)
def test_it_has_a_record_that_names_its_command(name: str) -> None:
    text = (STUDIES / name / "README.md").read_text(encoding="utf-8")
    assert f"python -m studies.{name}" in text


@pytest.mark.parametrize("name", NAMES)
def test_it_answers(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"studies.{name}", run_name="__main__")
    assert ended.value.code == 0
    assert "usage:" in capsys.readouterr().out


def test_aliasing_in_small() -> None:
    done = run("studies.aliasing", "--step", "100", "--json")
    worst = json.loads(done.stdout)["worst"]
    assert worst["windows_pct"] < 0.5


def test_published_in_small() -> None:
    done = run("studies.published", "--only", "table", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["failed"] == 0


@pytest.mark.parametrize("name", RUNS)
def test_robustness_runs_answer(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["robustness", name, "--help"])
    with pytest.raises(SystemExit) as ended:
        robustness()
    assert ended.value.code == 0
    assert f"python -m tests.robustness {name}" in capsys.readouterr().out
