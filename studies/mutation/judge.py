"""A mutant against its tests, in a fork of a process that has the third-party packages loaded."""

from __future__ import annotations

import contextlib
import importlib
import importlib.machinery
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.mutation.reach import MARKS

#: What tests import from outside; loaded once, before the forks.
LOADED = (
    "numpy", "scipy.optimize", "scipy.interpolate", "scipy.stats", "scipy.linalg", "scipy.special", "can", "cantools", "yaml",
    "pydantic", "rich.live", "hypothesis", "pytest", "_pytest.assertion.rewrite",
)  # fmt: skip
#: Tests are given to pytest in batches, the first one small: most mutants fall early, and few files are read for them.
FIRST_BATCH, GROWTH = 12, 4
#: A single test that takes more CPU time than this has been stopped from ending: s.
CPU_LIMIT_S = 300
#: The same by the clock, and for a test whose CPU time is known, so many times that.
STALL_S, STALL_TIMES = 120.0, 40.0


@dataclass(frozen=True)
class Verdict:
    """How a mutant ended: "killed", "endless" (killed as well), "survived"; by which test; how many tests were run and not."""

    outcome: str
    test: str = ""
    run: int = 0
    not_run: int = 0


@dataclass(frozen=True)
class Trial:
    """What a mutant is tried with.

    Parameters: path, the module in the checkout; text, in its place; tests, node ids in order, or files; budget_s, CPU time
    after which no further test begins; cpu_s, CPU time by test.
    """

    path: Path
    text: str
    tests: Sequence[str]
    budget_s: float
    cpu_s: dict[str, float]


class _Watcher:
    """A plugin of pytest: only certain tests, in their order; each one told before it runs, and the first that fails."""

    def __init__(self, tests: Sequence[str], out: int, until_s: float) -> None:
        self._tests, self._out, self._until_s = tests, out, until_s

    def tell(self, what: str, test: str = "") -> None:
        os.write(self._out, (json.dumps([what, test]) + "\n").encode())

    def pytest_collection_modifyitems(self, config: object, items: list) -> None:  # type: ignore[type-arg]
        place = {test: number for number, test in enumerate(self._tests)}
        # A parameter's name may come from what was changed: then the tests of that function.
        missing = {test.split("[", 1)[0]: number for test, number in place.items()}
        present = {item.nodeid for item in items}
        missing = {base: number for base, number in missing.items() if not any(t in present for t in _family(base, place))}
        found = []
        for item in items:
            base = item.nodeid.split("[", 1)[0]
            number = place.get(item.nodeid, place.get(base.split("::", 1)[0], missing.get(base)))
            if number is not None:
                found.append((number, item))
        items[:] = [item for _, item in sorted(found, key=lambda one: one[0])]

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.tell("begins", nodeid)

    def pytest_runtest_logreport(self, report: object) -> None:
        if getattr(report, "failed", False):
            self.tell("fails", str(getattr(report, "nodeid", "")))

    def pytest_collectreport(self, report: object) -> None:
        if getattr(report, "failed", False):
            self.tell("fails", str(getattr(report, "nodeid", "")).split("::", 1)[0])

    def pytest_runtest_protocol(self, item: object) -> bool | None:
        if time.process_time() < self._until_s:
            return None
        self.tell("left")
        return True  # not run


def _family(base: str, tests: dict[str, int]) -> Iterator[str]:
    return (test for test in tests if test.split("[", 1)[0] == base)


def judged(trial: Trial) -> Verdict:
    """How the tests end with a text in the place of a module."""
    reading, writing = os.pipe()
    # What numba compiles of a change is not kept where others would find it.
    compiled = tempfile.mkdtemp(prefix="mutation-")
    child = os.fork()
    if child == 0:
        os.close(reading)
        if trial.path.stem.startswith("compiled_"):
            os.environ["NUMBA_CACHE_DIR"] = compiled
        os.setpgid(0, 0)
        code = 70
        try:
            with open(os.devnull, "r+") as nothing:
                for stream in (0, 1, 2):
                    os.dup2(nothing.fileno(), stream)
            code = _run(trial, writing)
        finally:
            os._exit(code)
    os.close(writing)
    try:
        return _followed(child, reading, trial)
    finally:
        os.close(reading)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        shutil.rmtree(compiled, ignore_errors=True)


def _followed(child: int, reading: int, trial: Trial) -> Verdict:
    begun: list[str] = []
    text = b""
    while True:
        current = begun[-1] if begun else ""
        timeout_s = max(STALL_S, STALL_TIMES * trial.cpu_s.get(current, 0.0))
        if not select.select([reading], [], [], timeout_s)[0]:
            return Verdict("endless", current, len(begun))
        data = os.read(reading, 65536)
        if not data:
            # It ended without a last word: a process that the change brought down, or one out of CPU time.
            return Verdict("endless", current, len(begun))
        *lines, text = (text + data).split(b"\n")
        for line in lines:
            what, test = json.loads(line)
            if what == "begins":
                begun.append(test)
            elif what == "fails":
                return Verdict("killed", test, len(begun))
            elif what == "done":
                return Verdict("survived", "", len(begun), max(0, len(trial.tests) - len(begun)))


def _run(trial: Trial, out: int) -> int:
    original = importlib.machinery.SourceFileLoader.get_code

    def get_code(loader: importlib.machinery.SourceFileLoader, name: str) -> object:
        changed = loader.path == str(trial.path)
        return compile(trial.text, str(trial.path), "exec") if changed else original(loader, name)

    setattr(importlib.machinery.SourceFileLoader, "get_code", get_code)  # noqa: B010 - a method of a standard class
    resource.setrlimit(resource.RLIMIT_CPU, (int(trial.budget_s) + CPU_LIMIT_S, int(trial.budget_s) + CPU_LIMIT_S))
    pytest = importlib.import_module("pytest")
    until_s = time.process_time() + trial.budget_s
    options = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:benchmark", "-o", "addopts=", "-m", MARKS)
    first, size = 0, FIRST_BATCH
    watcher = _Watcher((), out, until_s)
    while first < len(trial.tests) and time.process_time() < until_s:
        batch = trial.tests[first : first + size]
        watcher = _Watcher(batch, out, until_s)
        files = dict.fromkeys(test.split("::", 1)[0] for test in batch)
        code = int(pytest.main([*options, *files], plugins=[watcher]))
        if code not in {0, 5}:
            # Anything that is not told as a test: a conftest.py that cannot be imported, say.
            watcher.tell("fails", "")
        first, size = first + size, size * GROWTH
    watcher.tell("done")
    return 0


class Confirming:
    """Judges, and runs a test that kills against the module as it is; one that fails there too kills nothing."""

    def __init__(self) -> None:
        self._sound: dict[str, bool] = {}

    def judged(self, trial: Trial) -> Verdict:
        """As `judged`, without tests that fail by themselves."""
        while True:
            tests = [test for test in trial.tests if self._sound.get(test, True)]
            verdict = judged(Trial(trial.path, trial.text, tests, trial.budget_s, trial.cpu_s))
            if verdict.outcome == "survived" or not verdict.test or self._is_sound(verdict.test, trial):
                return verdict

    def _is_sound(self, test: str, trial: Trial) -> bool:
        if test not in self._sound:
            same = Trial(trial.path, trial.path.read_text(encoding="utf-8"), [test], CPU_LIMIT_S, trial.cpu_s)
            self._sound[test] = judged(same).outcome == "survived"
            if not self._sound[test]:
                print(f"fails by itself: {test}", file=sys.stderr, flush=True)
        return self._sound[test]
