"""Every command's output is the kept one, and the kept one is version 0.1.0's or has a reason not to be."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.golden import kept
from tests.golden.cases import CASES, PARAMETERS, STORE, Case, Runner
from yieldmon.cli.main import main
from yieldmon.files import parameter_file


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Runner:
    return Runner(tmp_path_factory.mktemp("golden"), main)


@pytest.fixture(scope="module")
def apart(tmp_path_factory: pytest.TempPathFactory) -> Runner:
    return Runner(tmp_path_factory.mktemp("apart"), as_a_process)


def as_a_process(arguments: list[str]) -> int:
    command = [sys.executable, "-m", "yieldmon", *arguments]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=kept.environment())
    sys.stdout.write(done.stdout)
    sys.stderr.write(done.stderr)
    return done.returncode


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_output_is_the_kept_one(runner: Runner, apart: Runner, case: Case) -> None:
    """Bit for bit on a machine like that of the kept one; where OPENBLAS_ variables choose other code, by a process without."""
    text, expected = kept.normalized(runner.output(case)), kept.load(case.name)
    assert kept.first_difference(text, expected) == ""
    if kept.machine() == kept.machine_of(case.name) and text != expected:
        assert kept.sha256(kept.normalized(apart.output(case))) == kept.sha256(expected), "last digits"


@pytest.mark.parametrize("name", [case.name for case in CASES])
def test_kept_output_is_that_of_0_1_0_or_has_a_reason(name: str) -> None:
    if kept.sha256(kept.load(name)) != kept.hashes()[name]:
        assert kept.differences().get(name), f"{name} differs from version 0.1.0 without a reason"
    else:
        assert name not in kept.differences()


def test_a_difference_in_the_seventh_digit_is_seen() -> None:
    assert kept.first_difference("a,1.00001\n", "a,1.00002\n") != ""
    assert kept.first_difference("a,1.0000000001\n", "a,1.0\n") == ""
    assert kept.first_difference("b,1\n", "a,1\n") != ""
    assert kept.first_difference("a,1\nb,2\n", "a,1\n") != ""


@pytest.mark.parametrize(("other", "same"), [(-0.0741, True), (-0.0743, False), (0.0740, False)])
def test_an_error_in_percent_is_a_difference_of_what_agrees_to_six_digits(other: float, same: bool) -> None:
    shown = [json.dumps({"error_pct": value}, indent=2) for value in (-0.07405, other)]
    assert (kept.first_difference(*shown) == "") == same


def test_store_of_0_1_0_opens_with_its_totals(tmp_path: Path) -> None:
    from yieldmon.service.storage.store import Store

    copy = tmp_path / "yieldmon.sqlite"
    copy.write_bytes(STORE.read_bytes())
    with Store(copy) as store:
        loads = [(load.number, load.field, load.mass_kg) for load in store.loads()]
        seconds = store.seconds()
        tickets = store.tickets()
    assert loads == [(1, "", 1209.9549439610464), (2, "south", 1089.7455306614156)]
    assert len(seconds) == 179
    assert [ticket.weighed_mass_kg for ticket in tickets] == [1200.0]


def test_parameter_file_of_0_1_0_loads() -> None:
    parameters = parameter_file.load(PARAMETERS)
    assert parameters.values["friction"] == pytest.approx(0.196, abs=0.02)
