"""The map of the mutation study, moved from the lines of one commit to those of the next."""

from __future__ import annotations

import hashlib
import json
import subprocess
from pathlib import Path

import pytest

coverage = pytest.importorskip("coverage")

from studies.mutation.reach import carry  # noqa: E402 - needs coverage

BEFORE = "def first():\n    return 1\n\n\ndef second():\n    return 2\n"
AFTER = '"""A new docstring."""\n\n\ndef first():\n    return 1\n\n\ndef second():\n    x = 2\n    return x\n'
MODULE = "yieldmon/service/module.py"


def git(root: Path, *words: str) -> None:
    named = ("-c", "user.name=test", "-c", "user.email=test@example.invalid")
    subprocess.run(("git", *named, *words), cwd=root, check=True, capture_output=True)


def checkout(root: Path, text: str) -> Path:
    (root / MODULE).parent.mkdir(parents=True, exist_ok=True)
    (root / MODULE).write_text(text)
    return root


def mapped(map_file: Path, root: Path, by_test: dict[str, list[int]]) -> None:
    data = coverage.CoverageData(basename=str(map_file))
    for test, lines in by_test.items():
        data.set_context(test)
        data.add_lines({str(root / MODULE): lines})
    data.write()
    digest = hashlib.sha256((root / MODULE).read_bytes()).hexdigest()[:16]
    about = {"cpu_s": dict.fromkeys(by_test, 0.1), "modules": {MODULE: digest}}
    map_file.with_name(f"{map_file.name}.json").write_text(json.dumps(about))


def lines_of(map_file: Path, root: Path) -> dict[int, list[str]]:
    data = coverage.CoverageData(basename=str(map_file))
    data.read()
    return {line: sorted(tests) for line, tests in data.contexts_by_lineno(str(root / MODULE)).items()}


def test_lines_that_stayed_keep_their_tests_and_new_ones_have_those_around_them(tmp_path: Path) -> None:
    root, map_file = checkout(tmp_path / "y", BEFORE), tmp_path / "map"
    git(root, "init", "-q")
    git(root, "add", ".")
    git(root, "commit", "-qm", "before")
    mapped(map_file, root, {"first": [1, 2], "second": [5, 6]})
    checkout(root, AFTER)
    assert carry(map_file, root) == []
    found = lines_of(map_file, root)
    assert (found[4], found[5], found[8]) == (["first"], ["first"], ["second"])
    assert found[9] == found[10] == ["second"]


def test_a_module_that_the_history_does_not_have_is_named(tmp_path: Path) -> None:
    root, map_file = checkout(tmp_path / "y", BEFORE), tmp_path / "map"
    mapped(map_file, root, {"first": [1, 2]})
    checkout(root, AFTER)
    git(root, "init", "-q")
    git(root, "add", ".")
    git(root, "commit", "-qm", "after")
    assert carry(map_file, root) == [MODULE]
    assert lines_of(map_file, root) == {}
