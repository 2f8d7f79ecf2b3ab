"""Logs through the engine: what live gave, a file gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import can

from yieldmon.arguments import of_other_type, require_type
from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.log_files.candump import channel_name
from yieldmon.bus.log_files.doubled_frames import DoubledFrames
from yieldmon.bus.log_files.loading import logs_in
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_part
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result, records_in
from yieldmon.errors import InputError
from yieldmon.service.logs.channels import OneChannel
from yieldmon.service.logs.recorded_before import RecordedBefore
from yieldmon.service.logs.stopped_clock import StoppedClock
from yieldmon.service.logs.time_units import TimeUnitCheck
from yieldmon.service.storage.rows import SecondRow, second_row
from yieldmon.service.traffic.input_frames import InputFrames
from yieldmon.signals.mapping import SignalMap, default_map


@dataclass
class Summary:
    """Counts of a run of `process_logs`.

    Parameters
    ----------
    frames : int
        Frames in the logs.
    ours : int
        Frames fed to the engine.
    samples : int
        Of these, frames with samples of an impact sensor.
    malformed : int
        Frames of a wrong length.
    incomplete : int
        Messages of several frames of which one is missing.
    windows : int
        One-second windows.
    damages : list of str
        Damaged places of the logs.
    channels : set of str
        Channels in the logs, chosen or not.

    Examples
    --------
    See `process_logs`.
    """

    frames: int = 0
    ours: int = 0
    samples: int = 0
    malformed: int = 0
    incomplete: int = 0
    windows: int = 0
    damages: list[str] = field(default_factory=list)
    channels: set[str] = field(default_factory=set, compare=False)


def process_logs(
    paths: Sequence[Path | str],
    monitor: Monitor,
    codec: Codec,
    take_row: Callable[[SecondRow], None],
    signals: SignalMap | None = None,
    channels: Sequence[str] = (),
) -> Summary:
    r"""Feed logs, one after the other, to a monitor.

    Parameters
    ----------
    paths : sequence of path
    monitor : Monitor
    codec : Codec
    take_row : callable
        Called with each second's `SecondRow`.
    signals : SignalMap, optional
        Where the engine's quantities come from; None: the shipped DBC. Frames that the monitor sends are not needed here: those
        in a log were sent by the monitor of that time.
    channels : sequence of str, optional
        Whose frames are taken; empty: all, where no impact samples come on two channels at the same times.

    Returns
    -------
    Summary
        Counts of frames and windows, and what was damaged.

    Raises
    ------
    InputError
        For an argument of another type, such as a single path instead of a sequence, for a log that cannot be read, and where
        all logs hold nothing that the engine could take, or nothing to weigh.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> loaded, codec, rows = api.load_configuration(api.shipped("config/yieldmon.yaml")), api.Codec(), []
    >>> monitor = api.build_monitor(loaded.engine, loaded.machine, loaded.parameters)
    >>> combine = api.VirtualCombine(api.Scenario(duration_s=4), loaded.machine)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = pathlib.Path(folder, "drive.log")
    ...     lines = [codec.encode(frame) for frame in combine.frames_until(4.0)]
    ...     _ = log.write_text("".join(f"({m.timestamp:.6f}) can0 {m.arbitration_id:08X}#{m.data.hex()}\n" for m in lines))
    ...     summary = api.process_logs([log], monitor, codec, rows.append)
    >>> summary.windows == len(rows)
    True
    """
    _require_arguments(paths, monitor, codec, take_row, channels)
    summary = Summary()
    mapping = default_map() if signals is None else signals
    bus = InputFrames(codec, mapping)
    sensors = {source.message for source in mapping.sources.impact}
    unit, first = TimeUnitCheck(mapping.sources), mapping.sources.impact[0].message
    one_channel = None if channels else OneChannel(mapping.sources)
    recorded = RecordedBefore(tuple(channels))
    for path in paths:
        notes, twice, again, clock = LogNotes(), list[str](), list[str](), StoppedClock(mapping.sources)
        for message in _each_once(str(path), recorded, monitor, notes, twice, again):
            channel = channel_name(message)
            summary.channels.add(channel)
            if (channels and channel not in channels) or message.timestamp <= recorded.again_until_s:
                continue
            try:
                frames = bus.frames(message)
            except FrameError:
                summary.malformed += 1
                continue
            summary.ours += bool(frames)
            if any(frame.message in sensors for frame in frames):
                summary.samples += 1
                recorded.take_message(message)
            for frame in frames:
                clock.take_frame(frame.message, frame.time_s)
                if frame.message == first:
                    unit.take(", ".join(map(str, paths)), [frame.time_s])
                if one_channel is not None:
                    one_channel.take_frame(str(path), frame.message, channel, frame.time_s)
                hand_over(monitor.feed(frame), take_row, summary)
        shared = one_channel.end_of_log(str(path)) if one_channel is not None else []
        summary.frames += notes.frames
        summary.damages += [*notes.lacks(path), *twice[:1], *shared, *clock.end_of_log(str(path)), *again]
    summary.incomplete = bus.incomplete + bus.under_way
    refuse_nothing(paths, summary, channels)
    return summary


def _each_once(
    path: str, recorded: RecordedBefore, monitor: Monitor, notes: LogNotes, twice: list[str], again: list[str]
) -> Iterator[can.Message]:
    """The frames of a file's logs without copies; the monitor and `recorded` are told of each log. Added to twice and again is
    what is to be said of frames that stand in a log several times, and of those that one before it holds."""
    for part in range(logs_in(path)):
        doubled = DoubledFrames()
        if line := recorded.begin(path, part):
            again.append(line)
        monitor.begin_log()
        yield from doubled.messages(read_part(path, notes, part))
        if doubled.said:
            twice.append(f"{path}: {doubled.said}")
        again += recorded.at_other_times()


def _require_arguments(paths: object, monitor: object, codec: object, take_row: object, channels: object) -> None:
    """Those of `process_logs`. Raises InputError."""
    if isinstance(paths, str | Path):
        raise InputError("paths", f"is {str(paths)!r}", f"a list of paths, such as [{str(paths)!r}]")
    if isinstance(channels, str):
        raise InputError("channels", f"is {channels!r}", f"a list of names, such as [{channels!r}]")
    require_type("monitor", monitor, Monitor, "a Monitor")
    require_type("codec", codec, Codec, "a Codec")
    if not callable(take_row):
        raise of_other_type("take_row", take_row, "a function that takes a SecondRow")


def refuse_nothing(paths: Sequence[Path | str], summary: Summary, channels: Sequence[str] = ()) -> None:
    """Raises InputError when there was nothing in all the logs that the engine could take, or nothing to weigh; channels: whose
    frames were taken."""
    wrong = f", {summary.malformed} of wrong length" if summary.malformed else ""
    wrong += f", {summary.incomplete} messages lack a frame" if summary.incomplete else ""
    if channels:
        wrong += f" on channel {' and '.join(channels)}; the frames are of {_listed(summary.channels)}"
    if not summary.ours:
        found = f"none of {summary.frames} frames is one that yieldmon takes in" if summary.frames else "no frame at all"
        raise InputError(", ".join(map(str, paths)), found + wrong, "a log with sensor, speed and plate frames")
    if not summary.samples:
        where = ", ".join(map(str, paths))
        problem = f"no impact sensor: none of {summary.frames} frames brings its samples{wrong}"
        raise InputError(where, problem, "`signals` in the configuration; `yieldmon signals LOG` lists what there is")


def _listed(channels: set[str]) -> str:
    return ", ".join(sorted(channels - {""})) or "no named channel"


def hand_over(
    results: Sequence[Result],
    take_row: Callable[[SecondRow], None],
    summary: Summary,
    take_results: Callable[[Sequence[Result]], None] | None = None,
) -> None:
    """The rows of the windows that closed; take_results: asked with all that the monitor handed back."""
    if take_results is not None:
        take_results(results)
    for record in records_in(results):
        summary.windows += 1
        take_row(second_row(summary.windows, record))
