"""What the verbs that talk to a running daemon share."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from yieldmon.service.folders import runtime_folder
from yieldmon.service.operator.control_client import ANSWER_S, SilentDaemonError, ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.units import Units, UnitSystem

SYSTEM_SOCKET = Path("/run/yieldmon/yieldmon.sock")


def add_daemon_arguments(parser: argparse.ArgumentParser) -> None:
    """--socket and --config: which daemon."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--socket", metavar="PATH", help="the daemon's socket (default: the system's, else the user's)")
    which.add_argument("--config", metavar="FILE", help="the daemon's configuration, to find its socket")


def ask_daemon(args: argparse.Namespace, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> dict[str, Any]:
    """The daemon's answer; ends the program with one line and exit code 1 when there is none within timeout_s seconds."""
    socket = daemon_socket(args)
    try:
        return ask(socket, request, timeout_s)
    except ControlError as error:
        raise _ended(error, args, socket) from error


def require_daemon(args: argparse.Namespace, timeout_s: float) -> None:
    """Ends the program as `ask_daemon` does where no daemon listens; one that is silent for timeout_s seconds may yet answer."""
    socket = daemon_socket(args)
    try:
        ask(socket, {"command": "status"}, timeout_s)
    except SilentDaemonError:
        return
    except ControlError as error:
        raise _ended(error, args, socket) from error


def _ended(error: ControlError, args: argparse.Namespace, socket: Path) -> SystemExit:
    print(f"yieldmon: {_in_units(str(error), args, socket)}", file=sys.stderr)
    return SystemExit(1)


def _in_units(text: str, args: argparse.Namespace, socket: Path) -> str:
    """A refusal with its masses in the units that are shown."""
    if " kg" not in text:
        return text
    system = getattr(args, "units", None)
    if system is None:
        with suppress(ControlError):
            system = ask(socket, {"command": "loads"}).get("units")
    return Units(UnitSystem(system or UnitSystem.METRIC)).in_text(text)


def daemon_socket(args: argparse.Namespace) -> Path:
    """Where the daemon that the arguments name answers."""
    if args.socket is not None:
        return Path(args.socket)
    if args.config is not None:
        # A third of a second, which the other ways do without.
        from yieldmon.service.config import configuration

        return configuration.load(args.config).socket_path
    user = runtime_folder(os.environ) / SYSTEM_SOCKET.name
    return SYSTEM_SOCKET if SYSTEM_SOCKET.exists() or not user.exists() else user
