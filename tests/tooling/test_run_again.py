"""What fails in a virtual machine on the host's clock runs again on a counted one, whose outcome counts."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "test"

#: Stands in for tools/vcan-vm: machines that are there, and for each what it reports of its tests.
MACHINE = """
import sys
from pathlib import Path
words = sys.argv[1:]
machine = words[words.index("--machine") + 1] if "--machine" in words else sorted({reports})[-1]
if machine not in {reports}:
    sys.exit(125)
if "--check" in words:
    print(machine)
    sys.exit(0)
command = words[words.index("--") + 1:]
(Path({folder!r}) / machine).write_text(" ".join(command[command.index("pytest") + 1:]))
failed = {reports}[machine]
if failed is None:
    sys.exit(124)
tests = [word for word in command if "::" in word] or ["t.py::test_a", "t.py::test_b[1 2]", "t.py::test_c"]
count = sum(test in failed for test in tests)
report = Path(command[command.index("--junit-xml") + 1])
with report.open("w") as file:
    print(f'<testsuites><testsuite tests="{{len(tests)}}" failures="{{count}}" errors="0" skipped="0">', file=file)
    for test in tests:
        outcome = "<failure/>" if test in failed else ""
        print(f'<testcase classname="t" name="{{test.partition("::")[2]}}" file="t.py">{{outcome}}</testcase>', file=file)
    print("</testsuite></testsuites>", file=file)
sys.exit(1 if count else 0)
"""
B, C = "t.py::test_b[1 2]", "t.py::test_c"


@pytest.mark.parametrize(
    ("reports", "outcome", "again"),
    [
        ({"user-mode": [], "qemu": [C]}, (3, 0, 0), None),
        ({"user-mode": [B], "qemu": []}, (3, 0, 1), [B]),
        ({"user-mode": [B, C], "qemu": [C]}, (2, 1, 2), [B, C]),
        ({"user-mode": None, "qemu": []}, (3, 0, 3), ["t.py"]),
        ({"user-mode": [B]}, (2, 1, 0), None),
        ({"qemu": [B]}, (2, 1, 0), ["t.py"]),
    ],
    ids=["passed", "one failed", "fails on both", "ended before its report", "no counted clock", "counted clock alone"],
)
def test_outcome_and_what_runs_again(
    reports: dict[str, Any],
    outcome: tuple[int, int, int],
    again: list[str] | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tool = runpy.run_path(str(TOOL))
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "vcan-vm").write_text(MACHINE.format(reports=reports, folder=str(tmp_path)))
    monkeypatch.setattr(tool["environment"], "ROOT", tmp_path)
    part = tool["Part"]("vcan", ("pytest",), report=tmp_path / "vcan.xml", machine=(), limit_s=100, tests=("t.py",))
    found = tool["run_in_machine"](part)
    assert (found.passed, found.failed, found.again) == outcome
    counted = tmp_path / "qemu"
    assert counted.exists() == (again is not None)
    if again is not None:
        assert counted.read_text().endswith(" ".join(again))
