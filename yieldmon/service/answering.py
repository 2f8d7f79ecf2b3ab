"""Questions to a disk that may hang, on a thread of their own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

#: How long a start waits for what it can do without.
ANSWERS_WITHIN_S = 2.0

T = TypeVar("T")


def answer_or(question: Callable[[], T], otherwise: Callable[[], T]) -> T:
    """The answer to a question; otherwise's where there is none within ANSWERS_WITHIN_S. Raises what the question raises."""
    asked: Future[T] = Future()

    def ask() -> None:
        try:
            asked.set_result(question())
        except Exception as error:  # noqa: BLE001 - raised on the caller's thread
            asked.set_exception(error)

    threading.Thread(target=ask, name="disk-question", daemon=True).start()
    try:
        return asked.result(ANSWERS_WITHIN_S)
    except TimeoutError:
        # Answered in this very moment, or by a time-out of its own.
        return asked.result() if asked.done() else otherwise()
