"""Processes of which some die: what comes back, and what is left."""

from __future__ import annotations

import os
import pickle
import signal
import time
from pathlib import Path

import pytest

from yieldmon.cli._forks import in_processes
from yieldmon.errors import InputError
from yieldmon.service.config.configuration import ConfigurationError


def doubled(number: int) -> int:
    if number < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 0:
        raise InputError("zero", "is no number", "one")
    # The first ones take longest.
    time.sleep(0.02 * (5 - number))
    return 2 * number


@pytest.mark.parametrize("processes", [1, 2, 9])
def test_results_come_in_the_order_of_the_items(processes: int) -> None:
    assert list(in_processes(doubled, [1, 2, 3, 4], processes=processes)) == [2, 4, 6, 8]


@pytest.mark.parametrize(
    ("number", "kind", "said"),
    [
        (-1, OSError, "-1: its process was killed, perhaps because memory ran out"),
        (0, InputError, "zero: is no number; expected one"),
    ],
)
@pytest.mark.parametrize("processes", [1, 3])
def test_what_goes_wrong_is_raised_in_its_turn(number: int, kind: type[Exception], said: str, processes: int) -> None:
    results = in_processes(doubled, [1, number, 3], processes=processes)
    assert next(results) == 2
    with pytest.raises(kind, match=f"^{said}$"):
        next(results)


def test_those_that_work_on_are_ended_and_put_their_files_away(tmp_path: Path) -> None:
    def written(name: str) -> str:
        if name == "first":
            while not (tmp_path / "second").exists():
                time.sleep(0.001)
            return name
        (tmp_path / name).touch()
        try:
            time.sleep(60.0)
        finally:
            (tmp_path / name).unlink()
        return name

    results = in_processes(written, ["first", "second"], processes=2)
    assert next(results) == "first"
    results.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "error",
    [InputError("a", "b", "c"), ConfigurationError([InputError("x", "y", "z"), InputError("u", "v")])],
    ids=["one", "several"],
)
def test_errors_come_through_a_pipe(error: InputError) -> None:
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 - its own
    assert (type(again), str(again), again.where) == (type(error), str(error), error.where)
    if isinstance(error, ConfigurationError):
        assert list(map(str, again.problems)) == list(map(str, error.problems))


def test_no_more_run_at_a_time_than_asked_for(tmp_path: Path) -> None:
    def others(name: str) -> int:
        (tmp_path / name).touch()
        time.sleep(0.05)
        running = len(list(tmp_path.iterdir()))
        (tmp_path / name).unlink()
        return running

    assert max(in_processes(others, list("abcdef"), processes=2)) <= 2


def test_ctrl_c_of_a_terminal_is_for_the_one_that_waits() -> None:
    """A terminal sends it to all of a program's processes."""

    def interrupted(name: str) -> str:
        os.kill(os.getpid(), signal.SIGINT)
        return name

    assert list(in_processes(interrupted, ["a", "b"], processes=2)) == ["a", "b"]
