"""A process per item, forked from this one; one that dies is found out."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_ENDS_WITHIN_S = 5.0


def in_processes(work: Callable[[Item], Result], items: Sequence[Item], *, processes: int) -> Generator[Result, None, None]:
    """Results of `work` in the order of the items.

    Unlike `multiprocessing.Pool.imap`, which waits for ever for the result of a process that was killed.

    Parameters
    ----------
    work : callable
        Runs in a process of its own per item. What it returns and raises has to be such that pickle takes it.
    items : sequence
    processes : int
        At most so many run at a time.

    Raises
    ------
    OSError
        A process ended without a result, killed for want of memory for instance; names the item.
    Exception
        What `work` raised, in the item's turn.

    Notes
    -----
    The processes take no SIGINT, which a terminal sends to all: this one ends them, by SIGTERM, when the iterator is closed.
    """
    running: dict[Connection, tuple[int, BaseProcess]] = {}
    found: dict[int, tuple[Result, Exception | None]] = {}
    waiting = iter(enumerate(items))
    try:
        for number in range(len(items)):
            while number not in found:
                while len(running) < processes and (following := next(waiting, None)) is not None:
                    receiving, process = _begun(work, following[1])
                    running[receiving] = following[0], process
                ready = wait(list(running))
                for receiving in [each for each in running if each in ready]:
                    done, process = running.pop(receiving)
                    found[done] = _answer(receiving, items[done])
                    process.join()
            result, error = found.pop(number)
            if error is not None:
                raise error
            yield result
    finally:
        for _, process in running.values():
            process.terminate()
        for receiving, (_, process) in running.items():
            process.join(_ENDS_WITHIN_S)
            process.kill()
            process.join()
            receiving.close()


def _begun(work: Callable[[Item], Result], item: Item) -> tuple[Connection, BaseProcess]:
    context = multiprocessing.get_context("fork")
    receiving, sending = context.Pipe(duplex=False)
    with sending:
        process = context.Process(target=_work, args=(work, item, sending), daemon=True)
        process.start()
    return receiving, process


def _work(work: Callable[[Item], Result], item: Item, sending: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Files under way are put away.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        answer: tuple[Result | None, Exception | None] = work(item), None
    except Exception as error:  # noqa: BLE001 - raised in the item's turn
        answer = None, error
    with suppress(BrokenPipeError):
        sending.send(answer)


def _answer(receiving: Connection, item: object) -> tuple[Any, Exception | None]:
    with receiving:
        try:
            answer: tuple[Any, Exception | None] = receiving.recv()
        except (EOFError, ConnectionResetError):
            return None, OSError(f"{item}: its process was killed, perhaps because memory ran out")
    return answer
