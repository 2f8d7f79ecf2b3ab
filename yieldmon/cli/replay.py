"""Replay logs on a bus with their own timing."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import chain, count

import can
from rich.console import Console
from rich.live import Live
from rich.text import Text

from yieldmon.bus.codec import Codec
from yieldmon.bus.filtering import FilterTable
from yieldmon.bus.log_files.log_notes import Damage, LogNotes
from yieldmon.bus.log_files.logs import read_log, require_log
from yieldmon.bus.opening import add_bus_arguments, open_bus_from
from yieldmon.bus.replay import ON_TIME_S, Progress, Schedule, Selection, Sender, replay
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import within
from yieldmon.cli.main import EXIT_INTERRUPTED
from yieldmon.documents.replay import ReplayDocument
from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.units import counted

_DAMAGES_SHOWN = 10


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "replay",
        help="replay logs on a bus with their own timing",
        description="Send the frames of one or more logs, one after the other, with the logs' own timing. Error frames are "
        "not sent, CAN FD frames only with --fd. Damaged records are reported and skipped.",
        epilog="example: yieldmon replay drive.log -i socketcan -c vcan0 --inputs-only --skip-gaps 10",
    )
    parser.add_argument("logs", nargs="+", metavar="LOG", help=".log .asc .blf .csv .db .mf4 .trc .txt, each also with .gz")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="X times as fast; 0: as fast as possible (default: 1)"
    )
    parser.add_argument("--loop", action="store_true", help="repeat until interrupted")
    parser.add_argument("--skip-gaps", type=float, metavar="S", help="shorten gaps to S seconds of log time")
    parser.add_argument("--from", type=float, default=0.0, dest="from_s", metavar="S", help="begin S seconds into the log")
    parser.add_argument("--to", type=float, default=math.inf, dest="to_s", metavar="S", help="end S seconds into the log")
    parser.add_argument(
        "--map",
        action="append",
        default=[],
        metavar="FROM=TO",
        help="send frames of the log's channel FROM on channel TO; frames of other channels are not sent",
    )
    parser.add_argument("--inputs-only", action="store_true", help="send only the frames that yieldmon reads")
    parser.add_argument("--config", metavar="FILE", help="configuration for --inputs-only (default: the shipped one)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    add_bus_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 0, 130 when interrupted. Raises InputError, and can.CanError when a bus fails."""
    channels = _channel_map(args.map)
    schedule = Schedule(within("--speed", args.speed, 0.0), _skip_gaps_s(args.skip_gaps))
    selection = Selection(
        from_s=within("--from", args.from_s, 0.0),
        to_s=args.to_s,
        inputs=_inputs(args),
        channels=frozenset(channels) if channels else None,
        fd="fd" in args,
    )
    if not selection.from_s < selection.to_s:
        raise InputError("--to", f"is {args.to_s:g}", f"more than --from, {args.from_s:g}")
    notes = LogNotes(on_damage=_sparing_damage_report())
    progress = Progress()

    def one_pass() -> Iterator[can.Message]:
        logs = (read_log(path, notes) for path in args.logs)
        return selection.of(chain.from_iterable(logs), progress)

    for path in args.logs:
        require_log(path)
    with ExitStack() as stack:
        sender = Sender(_open_buses(args, channels, stack))
        if sys.stderr.isatty():
            stack.enter_context(_live(progress))
        passes = (one_pass() for _ in (count() if args.loop else range(1)))
        try:
            replay(passes, sender.send, schedule, progress)
            code = 0
        except KeyboardInterrupt:
            code = EXIT_INTERRUPTED
    if not progress.sent and code == 0:
        without = f" but {progress.fd_not_sent} of CAN FD" if progress.fd_not_sent else ""
        expected = "--fd and a bus that takes them" if without else "options that select some frames"
        raise InputError(", ".join(args.logs), f"no frame to send{without}", expected)
    _report(progress, notes, args)
    return code


def _inputs(args: argparse.Namespace) -> FilterTable | None:
    """What --inputs-only lets through; None without it."""
    if not args.inputs_only:
        if args.config is not None:
            raise InputError("--config", "needs --inputs-only", "both, or neither")
        return None
    from yieldmon.service.config import configuration
    from yieldmon.service.traffic.input_frames import InputFrames

    loaded = configuration.load(args.config if args.config is not None else shipped("config/yieldmon.yaml"))
    return FilterTable(InputFrames(Codec(), loaded.signals).input_filters())


def _channel_map(pairs: list[str]) -> dict[str, str]:
    channels = {}
    for pair in pairs:
        source, equals, target = pair.partition("=")
        if not (source and equals and target):
            raise InputError("--map", repr(pair), "FROM=TO, for example can0=vcan0")
        channels[source] = target
    return channels


def _skip_gaps_s(value: float | None) -> float:
    return math.inf if value is None else within("--skip-gaps", value, 0.0)


def _open_buses(args: argparse.Namespace, channels: dict[str, str], stack: ExitStack) -> dict[str | None, can.BusABC]:
    """Channel in the log -> bus; one bus for all without --map."""
    if not channels:
        return {None: stack.enter_context(open_bus_from(args))}
    opened: dict[str, can.BusABC] = {}
    for target in dict.fromkeys(channels.values()):
        opened[target] = stack.enter_context(open_bus_from(argparse.Namespace(**{**vars(args), "channel": target})))
    return {source: opened[target] for source, target in channels.items()}


def _sparing_damage_report() -> Callable[[Damage], None]:
    reported = count(1)

    def report(damage: Damage) -> None:
        number = next(reported)
        if number <= _DAMAGES_SHOWN:
            print(f"yieldmon: {damage}", file=sys.stderr)
        elif number == _DAMAGES_SHOWN + 1:
            print("yieldmon: further damaged records are only counted", file=sys.stderr)

    return report


class _Line:
    """What the terminal shows while a replay runs."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def __rich__(self) -> Text:
        progress = self._progress
        passes = f", pass {progress.passes + 1}" if progress.passes else ""
        return Text(
            f"{progress.sent} frames in {progress.elapsed_s:.0f} s, {progress.frames_per_s:.0f} frames/s, "
            f"{progress.late} late{passes}"
        )


def _live(progress: Progress) -> Live:
    return Live(_Line(progress), console=Console(stderr=True), transient=True)


def _report(progress: Progress, notes: LogNotes, args: argparse.Namespace) -> None:
    if args.json:
        summary: ReplayDocument = {
            "frames": progress.sent,
            "elapsed_s": progress.elapsed_s,
            "frames_per_s": progress.frames_per_s,
            "passes": progress.passes,
            "damaged_places": notes.damaged_places,
            "dropped_by_recorder": notes.dropped_by_recorder,
        }
        if progress.fd_not_sent:
            summary["fd_not_sent"] = progress.fd_not_sent
        if args.speed:
            summary |= {"late": progress.late, "worst_lateness_s": progress.worst_lateness_s}
        print_json(summary, indent=None)
        return
    line = f"{counted(progress.sent, 'frame')} in {progress.elapsed_s:.3f} s, {progress.frames_per_s:.0f} frames/s"
    if args.speed and progress.sent:
        on_time_pct = 100 * (1 - progress.late / progress.sent)
        line += f"; {on_time_pct:.2f} % within {1000 * ON_TIME_S:g} ms, at worst {1000 * progress.worst_lateness_s:.1f} ms late"
    if progress.fd_not_sent:
        line += f"; {counted(progress.fd_not_sent, 'CAN FD frame')} not sent (needs --fd)"
    if notes.damaged_places:
        line += f"; {counted(notes.damaged_places, 'damaged record')}"
    if notes.dropped_by_recorder:
        line += f"; the recorder lost {counted(notes.dropped_by_recorder, 'frame')}"
    print(line)
