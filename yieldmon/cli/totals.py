"""Set a running daemon's totals to 0, or copy its store."""

from __future__ import annotations

import argparse
import errno
import os
from pathlib import Path

from yieldmon.cli._daemon import add_daemon_arguments, ask_daemon
from yieldmon.errors import InputError, database_errno
from yieldmon.files.units import units_of
from yieldmon.units import Units, UnitSystem


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "totals",
        help="set the totals to 0, or copy the store",
        description=f"{__doc__} archive copies all records, loads and parameters to a new file, with or without a running "
        "daemon. reset sets total and load to 0, begins the next load and keeps the records.",
        epilog="example: yieldmon totals archive /mnt/usb/2026.sqlite && yieldmon totals reset 41250",
    )
    actions = parser.add_subparsers(dest="action", metavar="archive|reset", required=True)
    archive = actions.add_parser(
        "archive", help="copy the store to a new file", epilog="example: yieldmon totals archive /mnt/usb/2026.sqlite"
    )
    archive.add_argument("out", metavar="OUT", help="file to write; must not exist")
    archive.add_argument("--store", metavar="FILE", help="store to copy (default: the running daemon's)")
    add_daemon_arguments(archive)
    reset = actions.add_parser("reset", help="set all masses to 0", epilog="example: yieldmon totals reset 41250")
    reset.add_argument("total", metavar="TOTAL", nargs="+", help="present total, as `status` shows it or in whole kg")
    add_daemon_arguments(reset)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when it is done."""
    if args.action == "reset":
        answer = ask_daemon(args, {"command": "totals-reset", "total_kg": _named(args)})
        total = units_of(None, answer.get("units", "metric")).mass(answer["total_kg"])
        print(f"totals: {total} set to 0; load {answer['load']} begins")
        return 0
    from yieldmon.files.whole_file import scratch_for
    from yieldmon.service.logs.recorded import opened
    from yieldmon.service.storage.store_errors import StoreDamagedError, StoreError

    out = Path(args.out)
    if out.exists():
        raise InputError(args.out, "exists already", "a new file")
    store = args.store if args.store is not None else ask_daemon(args, {"command": "status"})["store"]["file"]
    with scratch_for(out, durable=True) as scratch, opened(Path(store)) as source:
        try:
            source.copy_to(scratch)
        except StoreDamagedError:
            raise
        except StoreError as error:
            # Of the new file; the store itself was read when it was opened.
            number = database_errno(error.__cause__ or error)
            what = os.strerror(number) if number != errno.EIO else str(error)
            raise OSError(number, what, args.out) from error
    print(f"{out}: copy of {store}")
    return 0


def _named(args: argparse.Namespace) -> int:
    """The total in whole kg where what was typed names it. Raises InputError."""
    typed = _plain(" ".join(args.total).lower().split("±")[0])
    if not typed[:1].isdecimal():
        raise InputError("TOTAL", repr(" ".join(args.total)), "the total as `yieldmon status` shows it, such as 18.82 t")
    status = ask_daemon(args, {"command": "status"})
    total_kg = float(status["total"]["mass_kg"])
    shown = [Units(system).mass(total_kg) for system in UnitSystem]
    if typed.removesuffix("kg") == f"{total_kg:.0f}" or typed in map(_plain, shown):
        return round(total_kg)
    total = units_of(None, status["units"]).mass(total_kg)
    if typed == _plain(total).removesuffix("lb"):
        return round(total_kg)
    raise InputError("totals reset", f"the total is {total}", "this figure, to confirm the reset")


def _plain(mass: str) -> str:
    return mass.replace(",", "").replace(" ", "")
