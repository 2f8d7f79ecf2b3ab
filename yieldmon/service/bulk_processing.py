"""Logs through the engine in bulk: read and decoded as arrays, the samples fed a run at a time.

The result is that of one engine over all frames in the order of the logs, to the last bit: what a window is worth depends on the
zero, the gate, the totals and the paddles before it, so the engine itself is never split. What needs no state, reading and
decoding, is done ahead of it by a process of its own; logs that are records of their own can be worked off side by side.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import USABLE, DecodedBlock, MessageColumns, decode_block, frames_of
from yieldmon.bus.codec import Codec
from yieldmon.bus.loading import iter_blocks
from yieldmon.bus.logs import LogNotes
from yieldmon.engine.monitor import Monitor, SampleRun
from yieldmon.errors import InputError
from yieldmon.frames import IMPACT_SENSOR_SAMPLES, INPUTS, SAMPLES_PER_FRAME, Frame
from yieldmon.service.processing import Summary
from yieldmon.service.rows import SecondRow, second_row

#: Frames fed at a time. Where the recorder's clock steps, the frames of one piece are fed one by one; and a piece must not
#: bring more windows than a monitor keeps.
_PIECE_FRAMES = 1024
_SAMPLES = tuple(f"Sample{k}" for k in range(SAMPLES_PER_FRAME))


@dataclass(frozen=True)
class Stretch:
    """Some frames of a log, ready for the engine. frames: all of the log in this stretch, ours: those among them that
    the engine takes, malformed: those of ours with a wrong length. runs: pieces for Monitor.feed_run()."""

    frames: int
    ours: int
    malformed: int
    runs: list[tuple[SampleRun, list[Frame]]] = field(default_factory=list)


@dataclass(frozen=True)
class EndOfLog:
    """A log is read to its end."""

    path: str
    damages: list[str]


def process_in_bulk(
    paths: Iterable[Path | str],
    monitor: Monitor,
    codec: Codec,
    take_row: Callable[[SecondRow], None],
    *,
    reads_ahead: bool = False,
    progress: Callable[[Stretch | EndOfLog], None] | None = None,
) -> Summary:
    """What processing.process_logs() does, and the same rows and summary. Raises InputError for a log that cannot be read.

    reads_ahead: read and decode in a second process. progress: called with each stretch that is done.
    """
    names = [str(path) for path in paths]
    summary = Summary()
    with _stretches_ahead(names, codec) if reads_ahead else _stretches_here(names, codec) as stretches:
        for stretch in stretches:
            if isinstance(stretch, EndOfLog):
                summary.damages += stretch.damages
            else:
                summary.frames += stretch.frames
                summary.ours += stretch.ours
                summary.malformed += stretch.malformed
                for run, others in stretch.runs:
                    monitor.feed_run(run, others)
                    for record in monitor.take_records():
                        summary.windows += 1
                        take_row(second_row(summary.windows, record))
            if progress is not None:
                progress(stretch)
    return summary


def stretches_of(paths: Iterable[str], codec: Codec) -> Iterator[Stretch | EndOfLog]:
    """The logs, one after the other, decoded. Raises InputError for a log that cannot be read."""
    for path in paths:
        notes = LogNotes()
        for block in iter_blocks(path, notes):
            yield _stretch(decode_block(codec, block), len(block))
        yield EndOfLog(path, [str(damage) for damage in notes.damages])


def _stretch(decoded: DecodedBlock, frames: int) -> Stretch:
    inputs = [decoded.messages[name] for name in INPUTS if name in decoded.messages]
    runs = [_run(inputs, first, first + _PIECE_FRAMES) for first in range(0, frames, _PIECE_FRAMES)]
    ours = sum(len(columns.rows) for columns in inputs)
    return Stretch(frames, ours, len(decoded.wrong_length), [run for run in runs if run[0].times_s.size or run[1]])


def _run(inputs: list[MessageColumns], first: int, end: int) -> tuple[SampleRun, list[Frame]]:
    """The frames in rows first to end of the block."""
    none = np.empty(0)
    samples = SampleRun(none, np.empty((0, SAMPLES_PER_FRAME)), none, none)
    sample_rows: NDArray[np.intp] = np.empty(0, np.intp)
    others: list[tuple[int, Frame]] = []
    for columns in inputs:
        part = slice(*np.searchsorted(columns.rows, (first, end)))
        rows = columns.rows[part]
        if not len(rows):
            continue
        if columns.name == IMPACT_SENSOR_SAMPLES:
            samples, sample_rows = _sample_run(columns, part), rows
        else:
            others += zip(rows.tolist(), frames_of(_part(columns, part)), strict=True)
    others.sort(key=lambda other: other[0])
    places = np.searchsorted(sample_rows, [row for row, _ in others]).astype(np.intp)
    return replace(samples, places=places), [frame for _, frame in others]


def _sample_run(columns: MessageColumns, part: slice) -> SampleRun:
    """nan for what is not available."""

    def known(name: str) -> NDArray[np.float64]:
        column = columns.signals[name]
        return np.where(column.status[part] == USABLE, column.values[part], np.nan)

    millivolts = np.column_stack([known(name) for name in _SAMPLES])
    return SampleRun(columns.time_s[part], millivolts, known("SampleCounter"), known("SensorStatus"))


def _part(columns: MessageColumns, part: slice) -> MessageColumns:
    signals = {
        name: type(column)(column.values[part], column.status[part]) for name, column in columns.signals.items()
    }
    return MessageColumns(columns.name, columns.rows[part], columns.time_s[part], signals)


@contextmanager
def _stretches_here(paths: list[str], codec: Codec) -> Iterator[Iterator[Stretch | EndOfLog]]:
    yield stretches_of(paths, codec)


@contextmanager
def _stretches_ahead(paths: list[str], codec: Codec) -> Iterator[Iterator[Stretch | EndOfLog]]:
    """The same from a process that reads ahead as far as the pipe between them holds."""
    context = multiprocessing.get_context("fork")
    receiving, sending = context.Pipe(duplex=False)
    reader = context.Process(target=_read, args=(paths, codec, sending), daemon=True)
    reader.start()
    sending.close()
    try:
        yield _received(receiving)
    finally:
        reader.terminate()
        reader.join()
        receiving.close()


def _read(paths: list[str], codec: Codec, sending: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for stretch in stretches_of(paths, codec):
            sending.send(stretch)
        sending.send(None)
    except InputError as error:
        sending.send((error.where, error.problem, error.expected))


def _received(receiving: Connection) -> Iterator[Stretch | EndOfLog]:
    while True:
        try:
            item = receiving.recv()
        except EOFError:
            raise OSError("the process that reads the logs has ended early") from None
        if item is None:
            return
        if isinstance(item, tuple):
            raise InputError(*item)
        yield item
