"""Logs through the engine in bulk: read and decoded as arrays, fed a run at a time.

The result is that of one engine over all frames in the order of the logs, to the last bit: what a window is worth depends on the
zero, the gate, the totals and the paddles before it, so the engine itself is never split. What needs no state, reading and
decoding, is done ahead of it by a process of its own; logs that are records of their own can be worked off side by side.
"""

from __future__ import annotations

import gc
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import USABLE, FrameBlock, SignalColumn, concatenate, decode_block
from yieldmon.bus.codec import Codec
from yieldmon.bus.interrupts import interrupts_held
from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.bus.log_files.doubled_frames import DoubledFrames
from yieldmon.bus.log_files.loading import iter_blocks, logs_in
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.packed.reading import Wanted
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result
from yieldmon.engine.runs import FrameRun, SampleRun, SignalRun, in_millivolts, sample_columns
from yieldmon.engine.sources import SampleSource, Sources
from yieldmon.errors import InputError
from yieldmon.identifiers import EXTENDED_FLAG
from yieldmon.service.logs.channels import OneChannel
from yieldmon.service.logs.processing import Summary, hand_over, refuse_nothing
from yieldmon.service.logs.recorded_before import RecordedBefore, SameTimes
from yieldmon.service.logs.stopped_clock import StoppedClock
from yieldmon.service.logs.time_units import TimeUnitCheck
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.traffic.side_inputs import SideInputs
from yieldmon.signals.decoding import MapDecoder
from yieldmon.signals.mapping import SignalMap, default_map

#: Frames of a log fed at a time: windows enough to be closed in groups. Where the recorder's clock steps, the frames of one run
#: are fed one by one.
_RUN_FRAMES = 131_072
#: A run must not bring windows without bound.
_RUN_S = 3600.0
#: Objects more than before at which Python looks for cycles.
_COLLECTED_TOGETHER = 50_000


@dataclass(frozen=True)
class Stretch:
    """Some frames of a log, ready for the engine. frames: all of the log in this stretch, ours: those among them that
    the engine takes, malformed: those of ours with a wrong length, incomplete: messages given up that lack a frame. runs: for
    Monitor.feed_run(). ends_log: another log of a file of packed logs follows."""

    frames: int
    ours: int
    malformed: int
    runs: list[FrameRun] = field(default_factory=list)
    incomplete: int = 0
    ends_log: bool = False


@dataclass(frozen=True)
class EndOfLog:
    """A log is read to its end. channels: those with a frame that was looked at, chosen or not. repeats: whether it begins with
    frames of a log before it, which are left out. doubled: what is to be said of frames that stand there several times; "" where
    none do. same_times: logs before it with other frames of the impact sensor at times of this one."""

    path: str
    damages: list[str]
    channels: frozenset[str] = field(default=frozenset(), compare=False)
    repeats: bool = False
    doubled: str = ""
    same_times: tuple[SameTimes, ...] = ()


def process_in_bulk(
    paths: Sequence[Path | str],
    monitor: Monitor,
    codec: Codec,
    take_row: Callable[[SecondRow], None],
    *,
    signals: SignalMap | None = None,
    channels: Sequence[str] = (),
    reads_ahead: bool = False,
    progress: Callable[[Stretch | EndOfLog], None] | None = None,
    take_results: Callable[[Sequence[Result]], None] | None = None,
) -> Summary:
    """What processing.process_logs() does, and the same rows and summary. Raises InputError as that does.

    signals: where the engine's quantities come from, None: the shipped DBC. channels: whose frames are taken; empty: all.
    reads_ahead: read and decode in a second process. progress: called with each stretch that is done. take_results: called with
    what the monitor handed back, events included, before its rows.
    """
    names = [str(path) for path in paths]
    summary, mapping = Summary(), default_map() if signals is None else signals
    unit = TimeUnitCheck(mapping.sources)
    read = _stretches_ahead if reads_ahead else _stretches_here
    with (
        _seldom_collecting(),
        read(names, Taking(codec, mapping, tuple(channels))) as stretches,
    ):
        for stretch in stretches:
            if isinstance(stretch, EndOfLog):
                summary.damages += stretch.damages
                summary.channels |= stretch.channels
                monitor.begin_log()
            else:
                summary.frames += stretch.frames
                summary.ours += stretch.ours
                summary.malformed += stretch.malformed
                summary.incomplete += stretch.incomplete
                for run in stretch.runs:
                    if unit.wants:
                        unit.take(", ".join(names), run.times_s[run.samples[0].places].tolist())
                    summary.samples += sum(part.places.size for part in run.samples)
                    hand_over(monitor.feed_run(run, reports=False), take_row, summary, take_results)
                if stretch.ends_log:
                    monitor.begin_log()
            if progress is not None:
                progress(stretch)
    refuse_nothing(names, summary, channels)
    return summary


@dataclass(frozen=True)
class Taking:
    """What is taken from a log: of the shipped DBC by the codec, of the mapping's groups by its decoder. channels: whose frames;
    empty: all, where no impact samples come on two at the same times."""

    codec: Codec
    signals: SignalMap
    channels: tuple[str, ...] = ()


def stretches_of(paths: Iterable[str], taking: Taking) -> Iterator[Stretch | EndOfLog]:
    """The logs, one after the other, decoded. Raises InputError for a log that cannot be read."""
    reading = _Reading(taking)
    for path in paths:
        file = _File(path, StoppedClock(taking.signals.sources))
        for part in range(logs_in(path)):
            if part:
                yield Stretch(0, 0, 0, ends_log=True)
            yield from reading.log(file, part)
        yield reading.end_of(file)
    if under_way := reading.under_way:
        yield Stretch(0, 0, 0, incomplete=under_way)


@dataclass
class _File:
    """What is found in a file of one log, or of several packed ones. twice: of frames that stand there several times. again: of
    frames that a log before it holds, repeats: whether it begins with them."""

    path: str
    clock: StoppedClock
    notes: LogNotes = field(default_factory=LogNotes)
    channels: frozenset[str] = frozenset()
    twice: str = ""
    again: list[str] = field(default_factory=list)
    repeats: bool = False
    same_times: list[SameTimes] = field(default_factory=list)


class _Reading:
    """Decodes logs, one after the other."""

    def __init__(self, taking: Taking) -> None:
        self._taking = taking
        self._sources = taking.signals.sources
        self._decoder, self._side = MapDecoder(taking.signals), SideInputs()
        self._wanted = _wanted(taking, self._decoder, self._side)
        self._one_channel = None if taking.channels else OneChannel(self._sources)
        self._recorded = RecordedBefore(taking.channels)
        self._sensors = {source.message for source in self._sources.impact}

    @property
    def under_way(self) -> int:
        """Messages that lack a frame still."""
        return self._decoder.under_way

    def log(self, file: _File, part: int) -> Iterator[Stretch]:
        """A log of a file, by its number from 0."""
        doubled, notes = DoubledFrames(), file.notes
        line = self._recorded.begin(file.path, part)
        before = notes.frames
        for block in doubled.blocks(_joined(iter_blocks(file.path, notes, wanted=self._wanted, part=part))):
            file.channels |= block.channels_in_use()
            yield self._stretch(file, block, notes.frames - before)
            before = notes.frames
        file.twice = file.twice or doubled.said
        file.again += [*([line] if line else []), *self._recorded.at_other_times()]
        file.repeats = file.repeats or bool(line)
        file.same_times += self._recorded.same_times()

    def _stretch(self, file: _File, read: FrameBlock, frames: int) -> Stretch:
        """frames: in the log, of which `read` holds those that somebody may want."""
        block = read.of_channels(self._taking.channels) if self._taking.channels else read
        block = block.after(self._recorded.again_until_s)
        before = self._decoder.incomplete
        columns, refused = _decoded(self._taking, self._decoder, self._side, block)
        for name in self._sensors & columns.keys():
            self._recorded.take(block, columns[name].rows)
            file.clock.take(name, columns[name].time_s)
        if self._one_channel is not None:
            self._one_channel.take(file.path, block, {name: (each.rows, each.time_s) for name, each in columns.items()})
        found = _stretch(columns, refused, block, frames, self._sources)
        return replace(found, incomplete=self._decoder.incomplete - before)

    def end_of(self, file: _File) -> EndOfLog:
        """What is to be said of a file that was read to its end."""
        path = file.path
        twice = [f"{path}: {file.twice}"] if file.twice else []
        shared = self._one_channel.end_of_log(path) if self._one_channel is not None else []
        damages = [*file.notes.lacks(path), *twice, *shared, *file.clock.end_of_log(path), *file.again]
        return EndOfLog(path, damages, file.channels, file.repeats, file.twice, tuple(file.same_times))


def _joined(blocks: Iterator[FrameBlock]) -> Iterator[FrameBlock]:
    """The same frames in fewer blocks, of not much more than _RUN_FRAMES: what a run costs, whatever is in it, is shared."""
    waiting: list[FrameBlock] = []
    for block in blocks:
        if waiting and sum(map(len, waiting)) + len(block) > _RUN_FRAMES:
            yield _whole(waiting)
            waiting = []
        waiting.append(block)
    if waiting:
        yield _whole(waiting)


def _whole(blocks: list[FrameBlock]) -> FrameBlock:
    return blocks[0] if len(blocks) == 1 else concatenate(blocks)


def _wanted(taking: Taking, decoder: MapDecoder, side: SideInputs) -> Wanted:
    """Identifiers of frames that codec, decoder or side inputs look at."""
    own = taking.signals.own_messages if taking.signals.groups else None
    layouts = [layout for layout in taking.codec.layouts.values() if own is None or layout.name in own]
    ranges = [(layout.identity | EXTENDED_FLAG, layout.identity_mask | EXTENDED_FLAG) for layout in layouts]
    ranges += [(match.identity, match.mask) for match in decoder.matches]

    def wanted(identifiers: NDArray[np.uint32]) -> NDArray[np.bool_]:
        taken = side.concerns(identifiers)
        for identity, mask in ranges:
            taken |= (identifiers & np.uint32(mask)) == np.uint32(identity)
        return taken

    return wanted


@dataclass(frozen=True)
class _Columns:
    """One message's frames in a block: rows, times and values by signal, nan for what is not available."""

    rows: NDArray[np.intp]
    time_s: NDArray[np.float64]
    values: Callable[[str, slice], NDArray[np.float64]]
    names: tuple[str, ...]


def _decoded(taking: Taking, decoder: MapDecoder, side: SideInputs, block: FrameBlock) -> tuple[dict[str, _Columns], int]:
    """The columns of each message that the engine takes, and how many frames were of a wrong length."""
    own = decode_block(taking.codec, block, taking.signals.own_messages if taking.signals.groups else None)
    own = side.extend(own, block)
    found = {
        name: _Columns(columns.rows, columns.time_s, partial(_known, columns.signals), tuple(columns.signals))
        for name, columns in own.messages.items()
    }
    refused = len(own.wrong_length)
    if taking.signals.groups:
        data = np.flatnonzero((block.can_id & np.uint32(REMOTE_FLAG | ERROR_FLAG)) == 0)
        columns = (block.time_s[data], block.can_id[data], block.length[data], block.payload[data])
        groups, wrong = decoder.decode_block(*columns, block.long_of(data))
        refused += len(wrong)
        for group in groups:
            found[group.name] = _Columns(data[group.rows], group.time_s, partial(_part, group.signals), tuple(group.signals))
    return found, refused


def _stretch(found: dict[str, _Columns], refused: int, block: FrameBlock, frames: int, sources: Sources) -> Stretch:
    """frames: in the log, of which the block holds those that somebody may want."""
    inputs = {name: found[name] for name in sources.messages if name in found}
    taken = np.zeros(len(block), bool)
    for columns in inputs.values():
        taken[columns.rows] = True
    rows = np.flatnonzero(taken)
    times, places = block.time_s[rows], np.cumsum(taken) - 1
    runs = [_run(inputs, rows[part], times[part], places, sources) for part in _parts(times)]
    return Stretch(frames, len(rows), refused, runs)


def _parts(times: NDArray[np.float64]) -> Iterator[slice]:
    """Stretches of at most _RUN_FRAMES frames and, while the clock runs on, _RUN_S seconds."""
    first = 0
    while first < times.size:
        ahead = times[first : first + _RUN_FRAMES]
        beyond = np.flatnonzero(np.abs(ahead - ahead[0]) > _RUN_S)
        last = first + (int(beyond[0]) if beyond.size else ahead.size)
        yield slice(first, last)
        first = last


def _run(
    inputs: dict[str, _Columns],
    rows: NDArray[np.intp],
    times: NDArray[np.float64],
    place_of: NDArray[np.intp],
    sources: Sources,
) -> FrameRun:
    """The frames in these rows of the block, all of messages that the engine takes. place_of: that of each row of the block among
    those."""
    found = {}
    for name, columns in inputs.items():
        part = slice(*np.searchsorted(columns.rows, (rows[0], rows[-1] + 1)))
        places = place_of[columns.rows[part]] - place_of[rows[0]]
        if places.size:
            found[name] = columns, part, places
    samples = [
        _sample_run(source, *found[source.message]) if source.message in found else _silent(source) for source in sources.impact
    ]
    listened = {source.message for source in sources.inputs}
    others = [
        SignalRun(name, places, columns.time_s[part], {signal: columns.values(signal, part) for signal in columns.names})
        for name, (columns, part, places) in found.items()
        if name in listened
    ]
    return FrameRun(times, samples, others)


def _sample_run(source: SampleSource, columns: _Columns, part: slice, places: NDArray[np.intp]) -> SampleRun:
    unknown = np.full(places.shape, np.nan)
    table = [columns.values(name, part) if name is not None else unknown for name in sample_columns(source)]
    return SampleRun(places, in_millivolts(source, np.stack(table).T))


def _silent(source: SampleSource) -> SampleRun:
    return SampleRun(np.empty(0, np.intp), np.empty((0, len(sample_columns(source)))))


def _known(signals: Mapping[str, SignalColumn], name: str, part: slice) -> NDArray[np.float64]:
    """nan for what is not available."""
    column = signals[name]
    values, usable = column.values[part], column.status[part] == USABLE
    return values.astype(np.float64, copy=False) if usable.all() else np.where(usable, values, np.nan)


def _part(signals: Mapping[str, NDArray[np.float64]], name: str, part: slice) -> NDArray[np.float64]:
    return signals[name][part]


@contextmanager
def _seldom_collecting() -> Iterator[None]:
    """Python's search for cycles put off: what a window is made of holds none, and goes as soon as the window is a row."""
    before = gc.get_threshold()
    if before[0]:
        gc.set_threshold(max(before[0], _COLLECTED_TOGETHER), *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


@contextmanager
def _stretches_here(paths: list[str], taking: Taking) -> Iterator[Iterator[Stretch | EndOfLog]]:
    yield stretches_of(paths, taking)


@contextmanager
def _stretches_ahead(paths: list[str], taking: Taking) -> Iterator[Iterator[Stretch | EndOfLog]]:
    """The same from a process that reads ahead as far as the pipe between them holds."""
    context = multiprocessing.get_context("fork")
    receiving, sending = context.Pipe(duplex=False)
    reader = context.Process(target=_read, args=(paths, taking, sending, receiving), daemon=True)
    try:
        # Else the reader could take a Ctrl-C before it leaves them to this process.
        with interrupts_held():
            reader.start()
        sending.close()
        yield _received(receiving)
    finally:
        if reader.pid is not None:
            reader.terminate()
            reader.join()
        receiving.close()


def _read(paths: list[str], taking: Taking, sending: Connection, receiving: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # With this end open here too, a reader whose parent was killed would wait for ever instead of finding it gone.
    receiving.close()
    try:
        for stretch in stretches_of(paths, taking):
            sending.send(stretch)
        sending.send(None)
    except InputError as error:
        sending.send((error.where, error.problem, error.expected))
    except BrokenPipeError:
        return


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
