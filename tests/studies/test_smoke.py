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
    done = program("studies.published.__main__", "--only", "table,facility", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["failed"] == 0
    loops = [line for line in found["lines"] if "11.20" in line["figure"]]
    # Table 11.20's own figures: 14 % corn, 3.69, 7.76 and 14.15 kg/s for 4.44, 8.45 and 15.61.
    assert [line["published"] for line in loops] == ["-11.5", "-13.9", "-18.8"]
    # Grain of 14 % measured with its own calibration is right; of 26 %, whose force is lower, it reads low.
    assert loops[0]["ours"] == 0.0
    assert loops[2]["ours"] < loops[1]["ours"] < -1.0


def test_crop_change_in_small() -> None:
    done = program("studies.crop_change.__main__", "--machines", "1", "--changes", "1")
    assert done.returncode == 0, done.stderr
    rows = [line.split("|")[1:3] for line in done.stdout.splitlines()[2:]]
    stages = ["first load", "after 0", "after 1", "after 2", "after 3"]
    assert [(way.strip(), at.strip()) for way, at in rows] == [(way, at) for way in ("published", "carried") for at in stages]


@pytest.mark.parametrize("name", RUNS)
def test_robustness_runs_answer(name: str) -> None:
    done = program("tests.robustness.__main__", name, "--help")
    assert done.returncode == 0
    assert f"python -m tests.robustness {name}" in done.stdout
