"""Install yieldmon as a service of this machine, or take it away again."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.files.whole_file import real_path
from yieldmon.service.installation import Installer, check_interface, install, package_source, roll_back, uninstall

_TEXT = """
The command goes into a new virtual environment below /opt/yieldmon, with the lock file's dependencies by their hashes. An
existing configuration is kept. --uninstall keeps /etc/yieldmon and /var/lib/yieldmon.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "install",
        help="install as a service of this machine",
        description=f"{__doc__}\n{_TEXT}",
        epilog="example: yieldmon install --interface can1",
    )
    parser.add_argument("--uninstall", action="store_true", help="take everything away, except configuration and records")
    parser.add_argument("--web", action="store_true", help="with the page (`yieldmon web`), as a unit of its own")
    parser.add_argument("--rollback", action="store_true", help="go back to the previous installation; repeated, forward again")
    parser.add_argument("--no-lock", action="store_true", help="dependencies as pip finds them, not those of the lock file")
    parser.add_argument("--purge", action="store_true", help="with --uninstall: configuration and records, too")
    parser.add_argument("--interface", default="can0", metavar="NAME", help="CAN interface of the combine (default: can0)")
    parser.add_argument(
        "--command", type=Path, metavar="PATH", help="an installed command, outside home folders (default: makes /opt/yieldmon)"
    )
    parser.add_argument("--from", dest="source", metavar="PACKAGE", help="a wheel or folder for pip to install there")
    parser.add_argument("--python", default=sys.executable, metavar="PATH", help="Python of /opt/yieldmon (default: this one)")
    parser.add_argument(
        "--root", type=Path, default=Path("/"), metavar="DIR", help="install below this folder instead; runs no systemctl"
    )
    parser.add_argument("--dry-run", action="store_true", help="print what would be done")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when everything is in its place."""
    if args.command is not None and not args.command.is_absolute():
        raise InputError("--command", f"{args.command} is relative", "an absolute path")
    try:
        check_interface(args.interface)
    except ValueError as error:
        raise InputError("--interface", str(error), "a name such as can0 or can-rear") from error
    if args.rollback and args.uninstall:
        raise InputError("--rollback", "with --uninstall", "one of the two")
    if args.purge and not args.uninstall:
        raise InputError("--purge", "without --uninstall", "both")
    root = real_path(args.root)
    if root == Path("/") and os.geteuid() != 0 and not args.dry_run:
        raise InputError("install", "a service needs root", "sudo yieldmon install")
    installer = Installer(root, args.dry_run)
    if args.uninstall:
        uninstall(installer, args.interface, purge=args.purge)
    elif args.rollback:
        roll_back(installer)
    else:
        source = args.source or package_source()
        install(installer, args.interface, args.command, args.python, source, locked=not args.no_lock, web=args.web)
    for failure in installer.failures:
        print(f"yieldmon install: {failure}", file=sys.stderr)
    return 1 if installer.failures else 0
