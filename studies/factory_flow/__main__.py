"""Random frames of factory yield monitors, read by yieldmon and by PySOBUS.

    pip install --no-deps --target FOLDER pysobus==0.0.3
    python -m studies.factory_flow --pysobus FOLDER

Deere 61184, Case IH 65385, 65475 and 65488: all eight bytes at random, of Deere every second frame with the opcode of the yield
monitor. A value that SAE J1939-71 keeps for "error" or "not available" (from 0xFB00 on) is one for PySOBUS and none for yieldmon.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import json
import random
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from yieldmon.bus.factory_monitor import MASS_FLOW, MOISTURE, FactoryMonitor

FOLDER = Path(__file__).resolve().parent
FRAMES = {"Deere 61184": "18EFFFD3", "Case 65385": "18FF6990", "Case 65475": "18FFC3A4", "Case 65488": "18FFD0F0"}
NAMES = {"Grain Flow": MASS_FLOW, "Flow Rate": MASS_FLOW, "Grain Moisture": MOISTURE, "Moisture Content": MOISTURE}
STEPS = {MASS_FLOW: {"Deere 61184": 0.01}, MOISTURE: {}}
CASE_STEP = {MASS_FLOW: 0.001, MOISTURE: 0.01}
FIRST_RESERVED = 0xFB00
DEERE_OPCODE = "4F09"


def number(text: str) -> Any:
    """A cell of the definitions as Python has it."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def load_dict(path: str, keys: list[str], values: list[str], delimiter: str) -> dict[tuple[Any, ...], list[dict[str, Any]]]:
    """Rows of a table by some of its columns: what PySOBUS asks of a library whose release on PyPI has no tables."""
    found: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    with Path(path).open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file, delimiter=delimiter):
            found.setdefault(tuple(number(row[key]) for key in keys), []).append({name: number(row[name]) for name in values})
    return found


def pysobus_parser(folder: str) -> Callable[[str], dict[str, float]]:
    """PySOBUS's parser as a function of a frame in hexadecimal: name of a value -> value."""
    tables, spanner = ModuleType("spanner.tables"), ModuleType("spanner")
    tables.__dict__["load_dict"] = load_dict
    spanner.__dict__["tables"] = tables
    sys.modules["spanner"] = spanner
    sys.path.insert(0, folder)
    parser = importlib.import_module("pysobus.parser").Parser()

    def read(frame: str) -> dict[str, float]:
        found = parser.parse_message(frame)
        return dict(found["spn_vals"]) if found else {}

    return read


def main(arguments: list[str] | None = None) -> int:
    """Exit code 1 where a value differs."""
    options = argparse.ArgumentParser(prog="python -m studies.factory_flow", description=__doc__)
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.add_argument("--pysobus", required=True, metavar="FOLDER", help="where PySOBUS is installed")
    options.add_argument("--count", type=int, default=10_000, help="frames of each kind (default: 10000)")
    options.add_argument("--seed", type=int, default=20260)
    options.add_argument("--out", metavar="F", default=str(FOLDER / "results.json"))
    chosen = options.parse_args(arguments)
    theirs, monitor, draw = pysobus_parser(chosen.pysobus), FactoryMonitor(), random.Random(chosen.seed)
    table: dict[str, dict[str, int]] = {}
    differing: list[str] = []
    for kind, head in FRAMES.items():
        counts = table[kind] = {"frames": chosen.count, "values": 0, "reserved": 0}
        for index in range(chosen.count):
            data = draw.randbytes(8).hex().upper()
            if kind.startswith("Deere") and index % 2 == 0:
                data = DEERE_OPCODE + data[4:]
            found = {NAMES[name]: value for name, value in theirs(head + data).items() if name in NAMES}
            step = {quantity: STEPS[quantity].get(kind, CASE_STEP[quantity]) for quantity in found}
            known = {name: value for name, value in found.items() if round(value / step[name]) < FIRST_RESERVED}
            ours = monitor.decode(int(head, 16), bytes.fromhex(data))
            counts["values"] += len(known)
            counts["reserved"] += len(found) - len(known)
            if ours.keys() != known.keys() or any(abs(ours[name] - known[name]) > 1e-9 for name in known):
                differing.append(f"{head}#{data}: {ours} here, {known} there")
    result = {
        "seed": chosen.seed,
        "by_kind": table,
        "values": sum(c["values"] for c in table.values()),
        "differing": differing[:20],
    }
    Path(chosen.out).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=2))
    return 1 if differing or not result["values"] else 0


if __name__ == "__main__":
    sys.exit(main())
