"""A plugin of pytest that records which lines of the four packages each test runs, and each test's CPU time.

`python -m studies.mutation record` loads it into each of pytest-xdist's workers, with the file to write in MUTATION_MAP.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path

import coverage
import pytest

from studies.mutation.mutants import PACKAGES


class Recorder:
    """A worker's part of the map: coverage's data with a context a test, and CPU seconds by test."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cpu_s: dict[str, float] = {}
        sources = [f"yieldmon/{package}" for package in PACKAGES]
        self._coverage = coverage.Coverage(data_file=path, config_file=False, source=sources, branch=False)
        self._coverage.start()

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """All of a test, with its fixtures."""
        self._coverage.switch_context(item.nodeid)
        begun_s = time.process_time()
        yield
        self._cpu_s[item.nodeid] = round(time.process_time() - begun_s, 4)
        self._coverage.switch_context("")

    def pytest_sessionfinish(self) -> None:
        """Writes both files."""
        self._coverage.stop()
        self._coverage.save()
        self._path.with_suffix(".json").write_text(json.dumps(self._cpu_s), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Workers record; the process that hands out the tests does not."""
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker:
        config.pluginmanager.register(Recorder(Path(f"{os.environ['MUTATION_MAP']}.{worker}.part")))
