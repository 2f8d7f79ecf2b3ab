"""Install yieldmon as a service on this computer, or uninstall it."""

from __future__ import annotations

import argparse
import functools
import os
import sys
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.files.whole_file import real_path
from yieldmon.service.installation import (
    CONFIGURATION,
    Installer,
    check_interface,
    configured_bus,
    install,
    package_source,
    roll_back,
    uninstall,
)

_TEXT = """
The command goes into a new virtual environment below /opt/yieldmon, with the dependencies of the lock file, verified by hash. An
existing configuration is kept. --uninstall keeps /etc/yieldmon and /var/lib/yieldmon.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "install",
        help="install as a service on this computer",
        description=f"{__doc__}\n{_TEXT}",
        epilog="example: yieldmon install --interface can1",
    )
    parser.add_argument("--uninstall", action="store_true", help="remove everything except configuration and records")
    parser.add_argument("--web", action="store_true", help="also install the web page (`yieldmon web`) as a separate unit")
    parser.add_argument("--rollback", action="store_true", help="go back to the previous installation; run again to go forward")
    parser.add_argument(
        "--no-lock", action="store_true", help="install the latest dependencies instead of those in the lock file"
    )
    parser.add_argument("--purge", action="store_true", help="with --uninstall: also remove configuration and records")
    parser.add_argument("--interface", metavar="NAME", help="CAN interface (default: the existing configuration's, else can0)")
    parser.add_argument(
        "--command",
        type=Path,
        metavar="PATH",
        help="use this installed command, outside home folders (default: install to /opt/yieldmon)",
    )
    parser.add_argument("--from", dest="source", metavar="PACKAGE", help="wheel or folder for pip to install")
    parser.add_argument("--python", default=sys.executable, metavar="PATH", help="Python of /opt/yieldmon (default: this one)")
    parser.add_argument(
        "--root", type=Path, default=Path("/"), metavar="DIR", help="install below this folder instead, without systemctl"
    )
    parser.add_argument("--dry-run", action="store_true", help="print the steps without doing them")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when everything is in its place."""
    root = real_path(args.root)
    if args.command is not None:
        _check_command(args.command, there=root == Path("/"))
    installer = Installer(root, args.dry_run, functools.partial(print, flush=True))
    bus = configured_bus(installer)
    kept = bus[1] if bus is not None and bus[0] == "socketcan" else "can0"
    interface = kept if args.interface is None else args.interface
    try:
        check_interface(interface)
    except ValueError as error:
        raise InputError("--interface", str(error), "a name such as can0 or can-rear") from error
    if args.rollback and args.uninstall:
        raise InputError("--rollback", "with --uninstall", "one of the two")
    if args.uninstall and args.web:
        unit = "`systemctl disable --now yieldmon-web` for the page alone"
        raise InputError("--web", "with --uninstall, which removes the page and the service", f"--uninstall alone, or {unit}")
    if args.purge and not args.uninstall:
        raise InputError("--purge", "without --uninstall", "both")
    if root == Path("/") and os.geteuid() != 0 and not args.dry_run:
        raise InputError("install", "a service needs root", "sudo yieldmon install")
    if args.uninstall:
        uninstall(installer, interface, purge=args.purge)
    elif args.rollback:
        roll_back(installer)
    else:
        source = args.source or package_source()
        install(installer, interface, args.command, args.python, source, locked=not args.no_lock, web=args.web)
        _say_other_bus(installer, interface, bus)
    for failure in installer.failures:
        print(f"yieldmon install: {failure}", file=sys.stderr)
    return 1 if installer.failures else 0


def _check_command(command: Path, *, there: bool) -> None:
    """Raises InputError for a command that the service could not run. there: it has to be on this machine already."""
    if not command.is_absolute():
        raise InputError("--command", f"{command} is relative", "an absolute path")
    target = real_path(command)
    for path in (command, target):
        if path.parts[1:2] in (("home",), ("root",)) or path.parts[1:3] == ("run", "user"):
            leads = "" if path == command else f" leads to {target}, which"
            problem = f"{command}{leads} lies in a home folder, which the service cannot read"
            raise InputError("--command", problem, "a command outside home folders (docs/guide/service.md), or no --command")
    if there and not (target.is_file() and os.access(target, os.X_OK)):
        raise InputError("--command", f"{command} is not an executable program", "the path that `command -v yieldmon` prints")


def _say_other_bus(installer: Installer, interface: str, bus: tuple[str, str] | None) -> None:
    """Where the configuration that was kept reads another bus than the unit waits for, the service would wait for ever."""
    if bus is None or bus == ("socketcan", interface):
        return
    kept = installer.at(CONFIGURATION / "yieldmon.yaml")
    if bus[0] == "socketcan":
        installer.report(f"note    {kept} reads {bus[1]}, but the unit waits for {interface}: use the same in both")
    else:
        installer.report(f"note    {kept} reads {bus[0]} {bus[1]}; the unit supports SocketCAN only and waits for {interface}")
