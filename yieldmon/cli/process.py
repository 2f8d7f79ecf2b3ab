"""Put CAN logs through the engine: a row for each second, as the daemon would have measured it."""

from __future__ import annotations

import argparse
import json
import sys

from yieldmon.bus.codec import Codec
from yieldmon.engine.faults import FaultCode
from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.service import configuration
from yieldmon.service.assembly import build_monitor
from yieldmon.service.processing import process_logs
from yieldmon.service.tables import FORMATS, open_table


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser("process", help="put CAN logs through the engine", description=__doc__)
    parser.add_argument("logs", nargs="+", metavar="LOG", help="candump or any log of python-can; several are one record")
    parser.add_argument("--config", metavar="F", help="configuration (YAML); default: the shipped one")
    parser.add_argument("--out", metavar="F", required=True, help=f"table to write, *{', *'.join(FORMATS)}; - is standard output")
    parser.add_argument("--format", choices=[kind[1:] for kind in FORMATS], help="kind of table; default: by the name's ending")
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when every log was read to its end, damaged places aside."""
    if args.json and args.out == "-":
        raise InputError("--json", "standard output is taken by --out -", "a file for --out")
    path = args.config if args.config is not None else shipped("config/yieldmon.yaml")
    loaded = configuration.load(path)
    monitor = build_monitor(loaded.engine, loaded.machine, loaded.parameters, loaded.calibrator)
    with open_table(args.out, f".{args.format}" if args.format else None) as table:
        summary = process_logs(args.logs, monitor, Codec(), table.write)
    totals = monitor.totals
    if args.json:
        document = {
            "frames": summary.frames,
            "frames_of_ours": summary.ours,
            "frames_malformed": summary.malformed,
            "windows": summary.windows,
            "total_mass_kg": totals.total_kg,
            "dry_mass_kg": totals.total_dry_kg if totals.total_unknown_moisture_kg == 0.0 else None,
            "faults": {code.value: count for code in FaultCode if (count := monitor.faults.occurrences(code))},
            "damages": summary.damages,
        }
        print(json.dumps(document, indent=2))
    else:
        line = f"{summary.frames} frames, {summary.windows} s, {totals.total_kg:.1f} kg"
        print(line + (f", {summary.malformed} malformed frames" if summary.malformed else ""), file=sys.stderr)
    return 0
