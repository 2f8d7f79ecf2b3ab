"""A tree of logs and its dataset, once for each module."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fleet import logs
from tests.fleet.runs import tasks
from yieldmon.fleet.worker import DONE, work


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return logs.tree(tmp_path_factory.mktemp("fleet") / "tree")


@pytest.fixture(scope="module")
def measured(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fleet") / "dataset"
    assert [work(task).status for task in tasks(tree, out)] == [DONE] * 4
    return out
