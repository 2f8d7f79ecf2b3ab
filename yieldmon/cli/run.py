"""Run the yield monitor as a daemon."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
from pathlib import Path

from yieldmon.cli import _notes
from yieldmon.errors import system_text
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.journal_lines import JournalLines
from yieldmon.service.rate_limited_log import RateLimitedLog
from yieldmon.service.storage.ownership import OccupiedError
from yieldmon.service.storage.store_errors import StoreError

#: Signals that would end the process, and that other programs send to one that they take for another (`logrotate`'s USR1).
_IGNORED = (signal.SIGUSR1, signal.SIGUSR2, signal.SIGIO, signal.SIGPWR)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "run",
        help="run the yield monitor as a daemon",
        description=f"{__doc__} SIGTERM and SIGINT end it; SIGHUP reloads the configuration.",
        epilog="example: yieldmon run --config /etc/yieldmon/yieldmon.yaml",
    )
    parser.add_argument("--config", metavar="FILE", help="YAML configuration (default: the shipped one)")


def run(args: argparse.Namespace) -> int:
    """Run until a signal ends it. Exit code 2, on which the unit is not started again, is for what only a person can correct."""
    early: list[int] = []
    for ignored in _IGNORED:
        signal.signal(ignored, signal.SIG_IGN)
    # Until the daemon is there a hangup would end the process.
    signal.signal(signal.SIGHUP, lambda number, _: early.append(number))
    path = Path(args.config) if args.config is not None else shipped("config/yieldmon.yaml")
    with _notes.held():
        loaded = configuration.load(path)
    # Under a service manager the journal has the time and takes the level from the prefix.
    lines = JournalLines()
    lines.addFilter(RateLimitedLog())
    logging.basicConfig(handlers=[lines], format="%(levelname)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("yieldmon").setLevel(loaded.document.logging.level.upper())
    daemon = Daemon(loaded, reload=lambda: configuration.load(path))
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: daemon.request_stop())
    signal.signal(signal.SIGHUP, lambda *_: daemon.request_reload())
    if early:
        daemon.request_reload()
    try:
        return daemon.run()
    except (StoreError, OccupiedError, OSError) as error:
        lines.finish()
        print(f"yieldmon: {system_text(error)}", file=sys.stderr)
        return 1
    finally:
        lines.finish()
