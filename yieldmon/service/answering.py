"""Work on a thread of its own, such as questions to a disk that may hang."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

#: How long a start waits for what it can do without.
ANSWERS_WITHIN_S = 2.0

T = TypeVar("T")


def on_a_thread(work: Callable[[], T], name: str) -> Future[T]:
    """Begin work on a thread of this name; what it returns or raises is the result. Raises RuntimeError where the system gives no
    thread."""
    found: Future[T] = Future()

    def run() -> None:
        try:
            found.set_result(work())
        except BaseException as error:  # noqa: BLE001 - raised where the result is asked for
            found.set_exception(error)

    threading.Thread(target=run, name=name, daemon=True).start()
    return found


def answer_or(question: Callable[[], T], otherwise: Callable[[], T]) -> T:
    """The answer to a question; otherwise's where there is none within ANSWERS_WITHIN_S. Raises what the question raises."""
    asked = on_a_thread(question, "disk-question")
    try:
        return asked.result(ANSWERS_WITHIN_S)
    except TimeoutError:
        # Answered in this very moment, or by a time-out of its own.
        return asked.result() if asked.done() else otherwise()
