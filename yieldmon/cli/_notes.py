"""Notes about what a command reads: on standard error when it has ended, not where it was refused, as a refusal is one line."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from yieldmon.errors import InputError
from yieldmon.files.plain_text import plain

_READERS = tuple(map(logging.getLogger, ("yieldmon.files", "yieldmon.bus.log_files")))
_held: ContextVar[list[str] | None] = ContextVar("held", default=None)


class _Handler(logging.Handler):
    """Makes notes of what the readers of files warn of."""

    def emit(self, record: logging.LogRecord) -> None:
        note(record.getMessage())


def note(text: str, before: str = "yieldmon") -> None:
    """One note; at once outside `held`. before: what its line begins with."""
    line, lines = f"{before}: {plain(text)}", _held.get()
    if lines is None:
        print(line, file=sys.stderr)
    elif line not in lines:
        lines.append(line)


def not_calibrated(scale_error: float, carried_from: str = "") -> str:
    """Of parameters that are not this machine's, or not this crop's. scale_error, carried_from: see `ParameterSet`."""
    what, of_it = "not calibrated on this machine", ""
    if carried_from:
        what, of_it = f"those of a crop that was not weighed, with the scale of {carried_from}", " of it"
    return (
        f"the parameters are {what}: its force is known to {100.0 * scale_error:g} % "
        f"(standard deviation) until a load{of_it} is weighed (`yieldmon ticket`, `yieldmon calibrate --loads`)"
    )


@contextmanager
def held() -> Iterator[list[str]]:
    """Around a command's work: notes wait for its end, and go where it raises InputError. Gives their lines."""
    lines: list[str] = []
    handler, token = _Handler(), _held.set(lines)
    for reader in _READERS:
        reader.addHandler(handler)
    try:
        yield lines
    except InputError:
        lines.clear()
        raise
    finally:
        _held.reset(token)
        for reader in _READERS:
            reader.removeHandler(handler)
        for line in lines:
            print(line, file=sys.stderr)
