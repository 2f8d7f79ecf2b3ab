"""Where the frames that are shown come from: a bus, a log at its own speed, or nowhere."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import ExitStack

import can

from yieldmon.bus.log_files.candump import channel_name, flagged_id
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log, require_log
from yieldmon.bus.opening import open_bus_from
from yieldmon.bus.replay import Schedule
from yieldmon.bus.waiting import receive
from yieldmon.cli._channels import SharedIdentifiers
from yieldmon.cli._daemon import ask_daemon, require_daemon
from yieldmon.cli._monitor.daemon_link import SILENT_S

REFRESH_S = 0.25
_FIRST_S = 0.5
"""A daemon may take for its first answer before there is a screen."""
Source = Iterator[can.Message | None]
"""Frames as they come; None where none came within a refresh period. Ends with a log."""


def _no_bus() -> Source:
    while True:
        time.sleep(REFRESH_S)
        yield None


def source_of(args: argparse.Namespace, stack: ExitStack, shared: SharedIdentifiers) -> Source:
    """What the arguments name. stack: closes a bus at the end. shared: gets to know the channels of a log. Raises InputError."""
    if args.log:
        require_log(args.log)
        return _log_source(args.log, 0.0 if args.once else args.speed, getattr(args, "channel", None), shared)
    if args.cab and "interface" not in args:
        if args.once or args.json:
            ask_daemon(args, {"command": "status"}, SILENT_S)
        else:
            require_daemon(args, _FIRST_S)
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
