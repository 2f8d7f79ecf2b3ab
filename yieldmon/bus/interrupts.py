"""Ctrl-C while compiled code is loaded: Python prints and forgets an exception that is raised in a function called from C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C counts at the end of what is done meanwhile, which is to be short; also as a decorator. Only on the main thread, the
    one that a signal interrupts.

    Raises
    ------
    KeyboardInterrupt
        At the end, or whatever else the handler of SIGINT does.
    """
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[FrameType | None] = []
    signal.signal(signal.SIGINT, lambda _, frame: held.append(frame))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if held:
            handler(signal.SIGINT, held[0])
