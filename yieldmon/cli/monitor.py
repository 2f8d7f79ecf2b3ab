"""Watch a bus or log: every frame decoded; or the cab view of load, yield, flow and faults."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import can
from rich.console import Console
from rich.live import Live

from yieldmon.bus.codec import Codec
from yieldmon.bus.databases import load_messages
from yieldmon.bus.opening import add_bus_arguments
from yieldmon.cli import _outputs
from yieldmon.cli._channels import SharedIdentifiers
from yieldmon.cli._daemon import add_daemon_arguments, daemon_socket
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import above_0, within
from yieldmon.cli._monitor.cab_view import CabView
from yieldmon.cli._monitor.daemon_link import SILENT_S, DaemonLink
from yieldmon.cli._monitor.frame_sources import REFRESH_S, Source, source_of
from yieldmon.cli._monitor.recorder import Recorder
from yieldmon.cli._monitor.traffic_document import document
from yieldmon.cli._units import add_units
from yieldmon.errors import InputError
from yieldmon.screen import keys
from yieldmon.screen.other_messages import OtherMessages
from yieldmon.screen.panels import ORDERS, View
from yieldmon.screen.traffic import Traffic
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError

_UNBOUND_LINES = 24
"""Beside the rows, where the output is not a terminal."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "monitor",
        help="watch a bus or log, every frame decoded",
        description="Show a bus, or a log at its own speed. Keys: q quit, space pause, s sort, / filter, j and k select a row, "
        "r record to a log, u units, c cab view on and off. In the cab view: l load, x crop, t ticket, z zero, w sweep; each "
        "asks for confirmation.",
        epilog="example: yieldmon monitor -i socketcan -c can0; yieldmon monitor drive.log --once --json",
    )
    parser.add_argument("log", nargs="?", metavar="LOG", help="show this log instead of a bus")
    parser.add_argument("--dbc", action="append", default=[], metavar="FILE", help="DBC that names messages; repeatable")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="for a log: X times as fast; 0: without waiting (default: 1)"
    )
    parser.add_argument(
        "--once", action="store_true", help="print one screen and exit: after --seconds, or at the end of the log"
    )
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="listening time of --once (default: 3)")
    parser.add_argument("--json", action="store_true", help="print one JSON document with --once, else one per second")
    parser.add_argument("--sort", choices=ORDERS, default="id", help="order of the rows (default: id)")
    parser.add_argument("--filter", default="", metavar="TEXT", help="show only rows whose name or identifier contains this")
    parser.add_argument("--record", type=Path, metavar="FILE", help="write every frame to this log (any format of python-can)")
    _outputs.add_force(parser, "record")
    parser.add_argument("--cab", action="store_true", help="start in the cab view; without -i: of the running daemon")
    add_units(parser, "the daemon's, else metric")
    add_daemon_arguments(parser)
    add_bus_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Watch until q, Ctrl-C or the end of the log."""
    within("--speed", args.speed, 0.0)
    above_0("--seconds", args.seconds)
    if not (args.once or args.json or args.record or sys.stdout.isatty()):
        raise InputError("standard output", "is not a terminal", "a terminal, --once, --json or --record F")
    traffic = Traffic(Codec(), OtherMessages([load_messages(path) for path in args.dbc]))
    with ExitStack() as stack:
        shared = SharedIdentifiers()
        source, view = source_of(args, stack, shared), View(args.sort, args.filter, cab=args.cab)
        interface, channel = getattr(args, "interface", None), getattr(args, "channel", None)
        view.source = args.log or f"{interface or ('no bus' if args.cab else 'bus')} {channel or ''}".strip()
        cab = CabView(args, view, None if args.log or args.json or not _may_ask(args) else DaemonLink(daemon_socket(args)))
        record = Recorder(stack)
        if args.record:
            view.recording = record.start(args.record)
        if args.once:
            _listen(source, traffic, record, time.monotonic() + (float("inf") if args.log else args.seconds))
            _refuse_empty(args.log, channel, traffic)
            _print_once(traffic, cab, args.json)
        elif args.json:
            _print_lines(source, traffic, record)
        else:
            _show(source, traffic, cab, record, stack)
        _refuse_empty(args.log, channel, traffic)
    if shared.problem is not None:
        print(f"yieldmon: {args.log}: {shared.problem} and share rows; select one with -c NAME", file=sys.stderr)
    return 0


def _refuse_empty(log: str | None, channel: str | None, traffic: Traffic) -> None:
    if log is not None and traffic.first_s is None:
        raise InputError(log, "no frame at all" if channel is None else f"no frame of channel {channel}", "a log with frames")


def _may_ask(args: argparse.Namespace) -> bool:
    """Whether a screen is shown that a daemon may stand behind."""
    return not args.once or args.cab


def _listen(source: Source, traffic: Traffic, record: Recorder, until: float) -> None:
    """Take frames until a time of the monotonic clock or the end, marking rates on the frames' own time."""
    marked = -float("inf")
    while time.monotonic() < until:
        message = next(source, _END)
        if message is _END:
            break
        if isinstance(message, can.Message):
            traffic.observe(message)
            record.take(message)
            if message.timestamp - marked >= REFRESH_S:
                marked = message.timestamp
                traffic.mark(marked)


_END = object()


def _refreshes(source: Source, traffic: Traffic, record: Recorder, act: Callable[[], bool]) -> None:
    """Take frames; every refresh period mark the rates and call `act`, until it says False or the source ends."""
    due = time.monotonic() + REFRESH_S
    for message in source:
        if message is not None:
            traffic.observe(message)
            record.take(message)
            offset = message.timestamp - time.monotonic()
        now = time.monotonic()
        if now >= due:
            due = now + REFRESH_S
            if traffic.frames:
                traffic.mark(now + offset)
            if not act():
                return


def _show(source: Source, traffic: Traffic, cab: CabView, record: Recorder, stack: ExitStack) -> None:
    console = Console()
    if console.is_dumb_terminal:
        raise InputError(
            "TERM", f"is {os.environ.get('TERM', '')!r}, a terminal without screen control", "`--once`, or another terminal"
        )
    if cab.daemon is not None:
        stack.enter_context(cab.daemon)
    with keys.raw_keys(), Live(cab.screen(traffic), console=console, screen=True, auto_refresh=False) as live:

        def act() -> bool:
            cab.look()
            for key in keys.waiting():
                match cab.press(key):
                    case "quit":
                        return False
                    case "record":
                        cab.view.recording = record.toggle()
            if not cab.view.paused or cab.dialog.open:
                live.update(cab.screen(traffic), refresh=True)
            return True

        _refreshes(source, traffic, record, act)


def _print_lines(source: Source, traffic: Traffic, record: Recorder) -> None:
    reported_s, reported_frames = -float("inf"), 0

    def report() -> None:
        nonlocal reported_s, reported_frames
        reported_s, reported_frames = traffic.now_s, traffic.frames
        print_json(document(traffic, View()), indent=None)
        sys.stdout.flush()

    def act() -> bool:
        if traffic.now_s - reported_s >= 1.0 - 0.5 * REFRESH_S:
            report()
        return True

    _refreshes(source, traffic, record, act)
    if traffic.frames > reported_frames:
        traffic.mark(traffic.now_s)
        report()


def _print_once(traffic: Traffic, cab: CabView, as_json: bool) -> None:
    if as_json:
        print_json(document(traffic, cab.view))
        return
    if cab.daemon is not None:
        try:
            cab.know(ask(cab.daemon.path, {"command": "status"}, SILENT_S))
        except ControlError as error:
            cab.know(error)
    console = Console()
    height = max(console.height, _UNBOUND_LINES + len(traffic.rows)) if not sys.stdout.isatty() else console.height
    console.print(cab.screen(traffic), height=height)
