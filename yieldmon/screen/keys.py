"""Keys: what they do to the view, and reading them from a terminal without waiting."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from .panels import ORDERS, View

_FOR_THE_CALLER = {"q": "quit", "\x03": "quit", "r": "record", "u": "units"}


def press(view: View, key: str) -> str | None:
    """Apply a key. Returns "quit", "record" or "units" where the caller has to act, else None."""
    if view.typing:
        _type(view, key)
        return None
    if key in _FOR_THE_CALLER:
        return _FOR_THE_CALLER[key]
    match key:
        case "c":
            view.cab = not view.cab
        case " ":
            view.paused = not view.paused
        case "s":
            view.order = ORDERS[(ORDERS.index(view.order) + 1) % len(ORDERS)]
        case "/":
            view.typing, view.needle = True, ""
        case "j":
            view.selected += 1
        case "k":
            view.selected = max(0, view.selected - 1)
    return None


def _type(view: View, key: str) -> None:
    """A key of the text that is looked for: return ends it, escape withdraws it."""
    if key in ("\r", "\n", "\x1b"):
        view.typing = False
        if key == "\x1b":
            view.needle = ""
    elif key in ("\x7f", "\b"):
        view.needle = view.needle[:-1]
    elif key.isprintable():
        view.needle += key


@contextmanager
def raw_keys() -> Iterator[None]:
    """Keys come one by one and unseen while inside; nothing is changed where standard input is not a terminal."""
    if not sys.stdin.isatty():
        yield
        return
    before = termios.tcgetattr(sys.stdin)
    try:
        # Keys pressed while the program was starting stay.
        tty.setcbreak(sys.stdin, termios.TCSANOW)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def waiting() -> str:
    """Keys pressed since the last call; empty where there are none or standard input is not a terminal."""
    if not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0.0)[0]:
        return ""
    return os.read(sys.stdin.fileno(), 64).decode("utf-8", "ignore")
