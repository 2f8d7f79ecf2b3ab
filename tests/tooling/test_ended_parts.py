"""What tools/test says of a part that ran out of time."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "test"


@pytest.mark.parametrize(
    ("output", "passed", "under_way"),
    [
        ("", [], ""),
        ("tests/vcan/test_a.py::test_one PASSED [ 50%]\ntests/vcan/test_a.py::test_two ", ["tests/vcan/test_a.py::test_one"],
         "tests/vcan/test_a.py::test_two"),
        ("tests/vcan/test_a.py::test_one[a b] FAILED\ntests/vcan/test_b.py::test_two PASSED\n",
         ["tests/vcan/test_b.py::test_two"], ""),
        ("tests/vcan/test_a.py::test_one \nvcan-vm: out of time after 900 s of CPU time\n", [], "tests/vcan/test_a.py::test_one"),
    ],
)  # fmt: skip
def test_passed_tests_and_the_one_under_way(output: str, passed: list[str], under_way: str) -> None:
    progress = runpy.run_path(str(TOOL))["progress"]
    assert progress(output) == (passed, under_way)
