"""Every study has its record and answers; the quick ones run whole, in small."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.in_process import program
from tests.robustness.__main__ import RUNS

ROOT = Path(__file__).parents[2]
STUDIES = ROOT / "studies"
NAMES = sorted(path.parent.name for path in STUDIES.glob("*/__main__.py"))


@pytest.mark.parametrize("name", NAMES)
def test_it_has_a_record_that_names_its_command(name: str) -> None:
    text = (STUDIES / name / "README.md").read_text(encoding="utf-8")
    assert f"python -m studies.{name}" in text


@pytest.mark.parametrize("name", NAMES)
def test_it_answers(name: str) -> None:
    done = program(f"studies.{name}.__main__", "--help")
    assert done.returncode == 0
    assert "usage:" in done.stdout


def test_aliasing_in_small() -> None:
    done = program("studies.aliasing.__main__", "--step", "100", "--json")
    worst = json.loads(done.stdout)["worst"]
    assert worst["windows_pct"] < 0.5


def test_published_in_small() -> None:
    done = program("studies.published.__main__", "--only", "table", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["failed"] == 0


@pytest.mark.parametrize("name", RUNS)
def test_robustness_runs_answer(name: str) -> None:
    done = program("tests.robustness.__main__", name, "--help")
    assert done.returncode == 0
    assert f"python -m tests.robustness {name}" in done.stdout
