"""Power cuts, the quick version of python -m tests.robustness crash-test."""

from __future__ import annotations

import json
import shutil
import subprocess

import pytest

from tests.in_process import program


def run(*options: str) -> subprocess.CompletedProcess[str]:
    """The daemon's lives are processes of their own; what kills and checks them need not be."""
    return program("tests.robustness.__main__", "crash-test", "--seed", "20261121", *options)


def crash_test(*options: str) -> dict:
    done = run(*options)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_kills_lose_at_most_the_second_under_way():
    result = crash_test("--kills", "6")
    assert result["closed_but_not_committed_at_most"] <= 1
    assert result["total_kg"] > 10.0


@pytest.mark.strace
def test_power_cuts_leave_a_store_that_adds_up():
    if shutil.which("strace") is None:
        pytest.skip("needs strace, which sees the store's writes")
    result = crash_test("--power-cuts", "60", "--life", "30")
    assert result["stores_opened"] > 50
    assert result["seconds"] > 20


@pytest.mark.parametrize(
    ("broken", "finding"), [("split", "the last second"), ("twice", "sum of the seconds")], ids=["split", "twice"]
)
def test_a_store_that_is_wrong_is_found_out(broken, finding):
    done = run("--broken", broken, "--kills", "60")
    assert done.returncode == 1
    assert finding in done.stderr


@pytest.mark.strace
def test_a_store_that_does_not_wait_for_the_medium_is_found_out():
    if shutil.which("strace") is None:
        pytest.skip("needs strace, which sees the store's writes")
    done = run("--broken", "unsynced", "--power-cuts", "30", "--life", "20")
    assert done.returncode == 1
    assert "committed before" in done.stderr
