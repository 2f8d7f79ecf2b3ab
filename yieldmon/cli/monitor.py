"""Live monitor: every frame decoded, with rate, age, bytes and range; or the cab's view of load, yield, flow and faults."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import can
from rich.console import Console, RenderableType
from rich.live import Live

from yieldmon.bus.candump import channel_name, flagged_id
from yieldmon.bus.codec import Codec
from yieldmon.bus.databases import load_messages
from yieldmon.bus.log_notes import LogNotes
from yieldmon.bus.log_writing import writing
from yieldmon.bus.logs import read_log, require_log
from yieldmon.bus.opening import add_bus_arguments, open_bus_from
from yieldmon.bus.replay import Schedule
from yieldmon.bus.waiting import receive
from yieldmon.cli import _outputs
from yieldmon.cli._cab import DaemonLink, Status, aged
from yieldmon.cli._channels import SharedIdentifiers
from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon, daemon_socket, mass
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import above_0, within
from yieldmon.cli._units import add_units
from yieldmon.documents.monitor import MonitorDocument, MonitorRow
from yieldmon.errors import InputError
from yieldmon.files.units import units_of
from yieldmon.frames import Unusable
from yieldmon.screen import keys
from yieldmon.screen.cab import Cab, from_frames
from yieldmon.screen.dialog import KEYS, Dialog
from yieldmon.screen.other_messages import OtherMessages
from yieldmon.screen.panels import ORDERS, Screen, View
from yieldmon.screen.traffic import Row, Traffic
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.units import UnitSystem

REFRESH_S = 0.25
_UNBOUND_LINES = 24
"""Beside the rows, where the output is not a terminal."""
Source = Iterator[can.Message | None]
"""Frames as they come; None where none came within a refresh period. Ends with a log."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "monitor",
        help="watch the bus: every frame decoded, mass flow large",
        description="Show a bus, or a log at its own speed. Keys: q quit, space pause, s sort, / filter, j and k choose a row, "
        "r record to a log, u units, c the cab's view and back. There l, x, t, z and w ask the daemon for a load, crop, ticket, "
        "zero or sweep, each after a question.",
        epilog="example: yieldmon monitor -i socketcan -c can0; yieldmon monitor drive.log --once --json",
    )
    parser.add_argument("log", nargs="?", metavar="LOG", help="show this log instead of a bus")
    parser.add_argument("--dbc", action="append", default=[], metavar="FILE", help="DBC that names messages; repeatable")
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="of a log: times as fast; 0: at once (default: 1)")
    parser.add_argument("--once", action="store_true", help="print one screen and end: after --seconds, or at a log's end")
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="how long --once listens (default: 3)")
    parser.add_argument("--json", action="store_true", help="one JSON document with --once, else a line a second")
    parser.add_argument("--sort", choices=ORDERS, default="id", help="order of the rows (default: id)")
    parser.add_argument("--filter", default="", metavar="TEXT", help="only rows whose name or identifier holds this")
    parser.add_argument("--record", type=Path, metavar="FILE", help="write every frame to this log (any format of python-can)")
    _outputs.add_force(parser, "record")
    parser.add_argument("--cab", action="store_true", help="begin with the cab's view; without -i, of a running daemon")
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
        source, view = _source(args, stack, shared), View(args.sort, args.filter, cab=args.cab)
        interface, channel = getattr(args, "interface", None), getattr(args, "channel", None)
        view.source = args.log or f"{interface or ('no bus' if args.cab else 'bus')} {channel or ''}".strip()
        cab = _Cab(args, view, None if args.log or args.json or not _may_ask(args) else DaemonLink(daemon_socket(args)))
        record = _Recorder(stack)
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
        print(f"yieldmon: {args.log}: {shared.problem} and share their rows; -c NAME shows one", file=sys.stderr)
    return 0


def _refuse_empty(log: str | None, channel: str | None, traffic: Traffic) -> None:
    if log is not None and traffic.first_s is None:
        raise InputError(log, "no frame at all" if channel is None else f"no frame of channel {channel}", "a log with frames")


class _Recorder:
    """Writes frames to a log while recording is on."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._logger: can.Listener | None = None

    def start(self, path: Path) -> str:
        try:
            self._logger = self._stack.enter_context(writing(path))
        except (ValueError, OSError) as error:
            raise InputError(str(path), str(error), "a log file name that python-can can write, such as drive.log") from error
        return path.name

    def toggle(self) -> str:
        if self._logger is not None:
            self._logger = None
            return ""
        return self.start(_not_taken(time.strftime("yieldmon-%Y%m%d-%H%M%S")))

    def take(self, message: can.Message) -> None:
        if self._logger is not None:
            self._logger.on_message_received(message)


def _not_taken(name: str) -> Path:
    """A log of this name, with a number behind where there is one: a clock that is set back says the same time twice."""
    path, count = Path(f"{name}.log"), 1
    while path.exists():
        count += 1
        path = Path(f"{name}-{count}.log")
    return path


def _may_ask(args: argparse.Namespace) -> bool:
    """Whether a screen is shown that a daemon may stand behind."""
    return not args.once or args.cab


def _shipped_crop(name: str) -> str | None:
    # The crops' file needs numpy and yaml, the screen neither until a crop is asked for.
    from yieldmon.files.crops import shipped_name

    return shipped_name(name)


def _shipped_crops() -> tuple[str, ...]:
    from yieldmon.files.crops import crops

    return tuple(crops())


class _Cab:
    """The cab's view: the daemon's status, or what the frames report, with the dialog of its keys."""

    def __init__(self, args: argparse.Namespace, view: View, daemon: DaemonLink | None) -> None:
        self.view = view
        self.daemon = daemon
        self.dialog = Dialog(mass, _shipped_crop, _shipped_crops)
        self._system: str | None = args.units
        self._status: Status | None = None
        self._heard_s = time.monotonic()

    def look(self) -> None:
        """Take what the daemon has said since."""
        for news in self.daemon.news() if self.daemon is not None else ():
            if isinstance(news, str):
                self.dialog.report(self.view.units.in_text(news))
            else:
                self._status, self._heard_s = news, time.monotonic()

    def know(self, status: Status) -> None:
        """A status that was asked for."""
        self._status, self._heard_s = status, time.monotonic()

    def screen(self, traffic: Traffic) -> RenderableType:
        """What to draw now."""
        status = self._status
        crop = status["crop"]["name"] if status is not None else ""
        self.view.units = units_of(self._system, status["units"] if status is not None else "metric", crop)
        if not self.view.cab:
            return Screen(traffic, self.view)
        shown = from_frames(traffic) if status is None else aged(status, time.monotonic() - self._heard_s)
        return Cab(shown, self.view.units, self.dialog.prompt, self.view)

    def press(self, key: str) -> str | None:
        """Apply a key; what the caller has to do."""
        if self.view.cab:
            if key in ("q", "\x03") and not self.dialog.open:
                return "quit"
            asked = key in KEYS or self.dialog.open
            requests = self.dialog.press(key, self._status, self.view.units) if asked else ()
            if self.daemon is not None:
                self.daemon.request(*requests)
            if asked or key not in "cu ":
                return None
        what = keys.press(self.view, key)
        if what == "units":
            self._system = str(UnitSystem.METRIC if self.view.units.system is UnitSystem.US else UnitSystem.US)
            return None
        return what


def _no_bus() -> Source:
    while True:
        time.sleep(REFRESH_S)
        yield None


def _source(args: argparse.Namespace, stack: ExitStack, shared: SharedIdentifiers) -> Source:
    if args.log:
        require_log(args.log)
        return _log_source(args.log, 0.0 if args.once else args.speed, getattr(args, "channel", None), shared)
    if args.cab and "interface" not in args:
        ask_daemon(args, {"command": "status"})
        return _no_bus()
    return _bus_source(stack.enter_context(open_bus_from(args)))


def _bus_source(bus: can.BusABC) -> Source:
    while True:
        yield receive(bus, REFRESH_S)


def _log_source(path: str, speed: float, channel: str | None, shared: SharedIdentifiers) -> Source:
    schedule = Schedule(speed)
    begun = None
    for message in read_log(path, LogNotes()):
        name = channel_name(message)
        if channel is not None and name != channel:
            continue
        shared.take(name, (flagged_id(message),))
        due = schedule.due_s(message.timestamp)
        begun = time.monotonic() - due if begun is None else begun
        while schedule.is_paced and (wait := begun + due - time.monotonic()) > 0.0:
            time.sleep(min(wait, REFRESH_S))
            if wait > REFRESH_S:
                yield None
        yield message


def _listen(source: Source, traffic: Traffic, record: _Recorder, until: float) -> None:
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


def _refreshes(source: Source, traffic: Traffic, record: _Recorder, act: Callable[[], bool]) -> None:
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


def _show(source: Source, traffic: Traffic, cab: _Cab, record: _Recorder, stack: ExitStack) -> None:
    console = Console()
    if console.is_dumb_terminal:
        raise InputError("TERM", f"is {os.environ.get('TERM', '')!r}, which draws no screen", "`--once`, or another terminal")
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


def _print_lines(source: Source, traffic: Traffic, record: _Recorder) -> None:
    reported_s, reported_frames = -float("inf"), 0

    def report() -> None:
        nonlocal reported_s, reported_frames
        reported_s, reported_frames = traffic.now_s, traffic.frames
        print_json(_document(traffic, View()), indent=None)
        sys.stdout.flush()

    def act() -> bool:
        if traffic.now_s - reported_s >= 1.0 - 0.5 * REFRESH_S:
            report()
        return True

    _refreshes(source, traffic, record, act)
    if traffic.frames > reported_frames:
        traffic.mark(traffic.now_s)
        report()


def _print_once(traffic: Traffic, cab: _Cab, as_json: bool) -> None:
    if as_json:
        print_json(_document(traffic, cab.view))
        return
    if cab.daemon is not None:
        with suppress(ControlError):
            cab.know(ask(cab.daemon.path, {"command": "status"}))
    console = Console()
    height = max(console.height, _UNBOUND_LINES + len(traffic.rows)) if not sys.stdout.isatty() else console.height
    console.print(cab.screen(traffic), height=height)


def _document(traffic: Traffic, view: View) -> MonitorDocument:
    now = traffic.now_s
    return {
        "time_s": now if traffic.frames else None,
        "frames": traffic.frames,
        "error_frames": traffic.error_frames,
        "factory_mass_flow_kg_s": traffic.factory_kg_s,
        "rows": [_row_document(traffic, row, now) for row in traffic.sorted_rows(view.order, view.needle)],
    }


def _row_document(traffic: Traffic, row: Row, now_s: float) -> MonitorRow:
    frame = traffic.decoded(row)
    signals = None
    if frame is not None:
        signals = {name: None if isinstance(value, Unusable) else value for name, value in frame.signals.items()}
    return {
        "id": f"{row.key[0]:X}",
        "message": row.name or None,
        "count": row.count,
        "rate_hz": round(row.rate_hz(now_s), 2),
        "age_s": round(row.age_s(now_s), 3),
        "stale": row.is_stale(now_s),
        "data": bytes(row.last.data).hex() if row.last is not None else "",
        "signals": signals,
    }
