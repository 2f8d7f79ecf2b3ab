"""Mutation guided by coverage: inputs that reach new steps of the program are kept and mutated further.

A step is a line of the project's (or a named package's) code after another one of the same function, with the count of its
occurrences in powers of two, as in AFL. Standard library only (`sys.settrace`), so it runs wherever the project does.
"""

from __future__ import annotations

import hashlib
import random
import resource
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

Step = tuple[object, int, int, int]
Counted = dict[tuple[tuple[str, str, int], int, int], int]
"""Of a process of its own: file, name and first line of the code in the place of the code."""

current: Coverage | None = None
"""The one that follows the present call."""


class Coverage:
    """Steps that one call takes in files whose path has one of these parts."""

    def __init__(self, parts: Sequence[str]) -> None:
        self._parts = tuple(parts)
        self._wanted: dict[CodeType, bool] = {}
        self._counts: dict[tuple[CodeType, int, int], int] = {}
        self._counted: Counted = {}
        self._last: dict[int, int] = {}

    def of(self, call: Callable[[], object]) -> tuple[frozenset[Step], BaseException | None]:
        """The steps, and what the call raised."""
        global current  # noqa: PLW0603 - the trace function is the interpreter's, too
        self._counts, self._counted, self._last = {}, {}, {}
        before, current = sys.gettrace(), self
        threading.settrace(self._enter)
        sys.settrace(self._enter)
        try:
            call()
            raised: BaseException | None = None
        except Exception as error:  # noqa: BLE001 - whoever asked judges it
            raised = error
        finally:
            sys.settrace(before)
            threading.settrace(before)
            current = None
        taken = (*list(self._counts.items()), *self._counted.items())
        return frozenset((*step, count.bit_length()) for step, count in taken), raised

    def counted(self) -> Counted:
        """So far, for another process."""
        return {
            ((code.co_filename, code.co_qualname, code.co_firstlineno), last, line): count
            for (code, last, line), count in list(self._counts.items())
        }

    def add(self, counted: Counted) -> None:
        """What another process has counted during this call."""
        for step, count in counted.items():
            self._counted[step] = self._counted.get(step, 0) + count

    def _enter(self, frame: FrameType, event: str, arg: Any) -> Any:
        wanted = self._wanted.get(frame.f_code)
        if wanted is None:
            wanted = self._wanted[frame.f_code] = any(part in frame.f_code.co_filename for part in self._parts)
        if not wanted:
            return None
        self._last[id(frame)] = frame.f_lineno
        return self._line

    def _line(self, frame: FrameType, event: str, arg: Any) -> Any:
        key = frame.f_code, self._last.get(id(frame), 0), frame.f_lineno
        self._counts[key] = self._counts.get(key, 0) + 1
        self._last[id(frame)] = frame.f_lineno
        return self._line


class Corpus:
    """Inputs that each reached a step which none before had, and what they have reached together."""

    def __init__(self, first: bytes) -> None:
        self.inputs = [first]
        self.reached: set[Step] = set()

    def chosen(self, rng: random.Random) -> bytes:
        """One to go on from: the newest more often."""
        newest = self.inputs[-8:]
        return rng.choice(newest if rng.random() < 0.5 else self.inputs)

    def take(self, content: bytes, steps: frozenset[Step]) -> bool:
        """Keep an input if it is new; whether it was."""
        if steps <= self.reached:
            return False
        self.reached |= steps
        if content != self.inputs[0]:
            self.inputs.append(content)
        return True


def spliced(content: bytes, other: bytes, rng: random.Random) -> bytes:
    """The beginning of one input and the end of another."""
    return content[: rng.randrange(len(content) + 1)] + other[rng.randrange(len(other) + 1) :]


def cpu_s() -> float:
    """Processor time of all threads so far, and of the processes that were waited for, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def kept(folder: Path, name: str, content: bytes) -> Path:
    """An input that escaped, for whoever mends what it found."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}-{hashlib.sha256(content).hexdigest()[:12]}"
    path.write_bytes(content)
    return path
