"""Ctrl-C while compiled code is loaded: none is lost in a function that C calls, which Python prints and forgets."""

from __future__ import annotations

import ctypes
import importlib
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from yieldmon.bus.interrupts import interrupts_held

NONE, PLANES = np.empty(0, np.intp), np.zeros((1, 4), np.uint8)


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Shells start background jobs with the signal ignored, and what they start inherits that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@ctypes.CFUNCTYPE(None)
def interrupted_from_c() -> None:
    """As LLVM calls llvmlite back when it has compiled."""
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(
    ("module", "public", "compiled", "arguments"),
    [
        ("log_files.compiled_candump", "parse_common", "_pass", (np.empty(0, np.uint8), NONE, NONE, ["can0"], ())),
        ("packed.compiled_columns", "from_differences", "_differences", (PLANES, 16)),
        ("packed.compiled_columns", "from_predicted", "_predicted", (PLANES, np.zeros(8), 4, 16, 1.0)),
        ("packed.compiled_columns", "place_fields", "_place_fields", (NONE, NONE, NONE)),
    ],
)
def test_none_is_lost_while_compiled_code_is_loaded(
    module: str, public: str, compiled: str, arguments: tuple[object, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numba")
    of_module = importlib.import_module(f"yieldmon.bus.{module}")
    monkeypatch.setattr(of_module, compiled, lambda *_: interrupted_from_c())
    with pytest.raises(KeyboardInterrupt):
        getattr(of_module, public)(*arguments)


def test_it_counts_at_the_end_of_what_is_done_meanwhile() -> None:
    done = []

    @interrupts_held()
    def work() -> None:
        signal.raise_signal(signal.SIGINT)
        done.append("to its end")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["to its end"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupts_held():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        signal.raise_signal(signal.SIGINT)


def test_other_threads_leave_signals_alone() -> None:
    seen: list[object] = []

    def body() -> None:
        with interrupts_held():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=body)
    thread.start()
    thread.join(60.0)
    assert seen == [signal.default_int_handler]
