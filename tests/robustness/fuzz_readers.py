"""Mutated files through every reader: logs, YAML, tables, stores, control requests. No traceback, no hang, bounded memory.

    python -m tests.robustness fuzz-readers --count 2000 --reader candump

Mutations of good files (bits, slices doubled, cut, swapped, long runs), without guidance by coverage. An escape is an exception
that is no InputError, a file that takes more than --seconds of processor time, or a process above --memory-mb. Ends with 1 when
there is one.
"""

from __future__ import annotations

import argparse
import gzip
import json
import logging
import random
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import can

from yieldmon.bus.logs import LogNotes, read_log
from yieldmon.errors import InputError
from yieldmon.files import machine_file, parameter_file, table
from yieldmon.resources import shipped
from yieldmon.service import recorded
from yieldmon.service.store import Store

Seed = Callable[[Path], None]
_FRAMES = 200


def _log(path: Path) -> None:
    with can.Logger(path) as logger:
        for number in range(_FRAMES):
            data = bytes([number % 256] * 8)
            logger.on_message_received(
                can.Message(timestamp=1.7e9 + 0.01 * number, arbitration_id=0x18FF0000 + number % 7, data=data)
            )
        if isinstance(logger, can.SqliteWriter):
            while not logger.buffer.empty():
                time.sleep(0.01)


def _copy(name: str) -> Seed:
    return lambda path: path.write_bytes(shipped(name).read_bytes()) and None


def _store(path: Path) -> None:
    from tests.service.test_store import batch

    with Store(path) as store:
        store.commit([batch(number) for number in range(1, 60)])


def _table(path: Path) -> None:
    path.write_text("plate_angle_deg,mass_flow_kg_s,force_n,trial\n" + "60,5,12.5,a\n70,9,-,b\n" * 20)


def _read(path: Path) -> object:
    return sum(1 for _ in read_log(path, LogNotes(on_damage=lambda damage: None)))


READERS: dict[str, tuple[str, Seed, Callable[[Path], object]]] = {
    "candump": ("x.log", _log, _read),
    "asc": ("x.asc", _log, _read),
    "blf": ("x.blf", _log, _read),
    "trc": ("x.trc", _log, _read),
    "csv": ("x.csv", _log, _read),
    "db": ("x.db", _log, _read),
    "candump-gz": ("x.log.gz", lambda path: path.write_bytes(gzip.compress(b"(1.000000) can0 123#01\n" * 400)) and None, _read),
    "parameters": ("x.yaml", _copy("config/parameters/corn.yaml"), parameter_file.load),
    "machine": ("x.yaml", _copy("config/machines/sprocket-8.yaml"), machine_file.load),
    "table": ("x.csv", _table, table.load),
    "store": ("x.sqlite", _store, recorded.read_seconds),
}


def mutated(content: bytes, rng: random.Random) -> bytes:
    """One to eight changes."""
    out = bytearray(content)
    for _ in range(rng.randint(1, 8)):
        at, size = rng.randrange(len(out) + 1), rng.choice((1, 2, 4, 16, 512))
        kind = rng.randrange(6)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at : at + size] = rng.randbytes(size)
        elif kind == 2:
            out[at:at] = out[at : at + size] * rng.choice((1, 2, 64))
        elif kind == 3:
            del out[at : at + size]
        elif kind == 4:
            out[at:at] = rng.choice((b"9" * 400, b" " * 4000, b"\x00", b"'", b"-", b"1e999", b"\xff\xfe", b"{" * 50, b"\n"))
        else:
            del out[at:]
        if not out:
            out = bytearray(content)
    return bytes(out)


def fuzz(name: str, count: int, seed: int, seconds: float) -> Counter[str]:
    """Outcomes of one reader; an escape's key begins with `escape`."""
    file, make, read = READERS[name]
    rng, outcomes = random.Random(f"{seed}/{name}"), Counter[str]()
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / file
        make(path)
        good = path.read_bytes()
        read(path)
        for _ in range(count):
            for left in Path(place).iterdir():
                left.unlink()
            path.write_bytes(mutated(good, rng))
            began_s = time.process_time()
            try:
                read(path)
                outcomes["read"] += 1
            except InputError:
                outcomes["refused"] += 1
            except Exception as error:  # noqa: BLE001 - what is looked for
                outcomes[f"escape {type(error).__name__}: {str(error)[:80]}"] += 1
            if time.process_time() - began_s > seconds:
                outcomes["escape: too slow"] += 1
    return outcomes


def main(arguments: list[str]) -> int:
    """Prints the outcomes as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reader", choices=sorted(READERS), help="default: all")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--memory-mb", type=float, default=500.0)
    args = parser.parse_args(arguments)
    logging.disable(logging.CRITICAL)
    found = {name: dict(fuzz(name, args.count, args.seed, args.seconds)) for name in ([args.reader] if args.reader else READERS)}
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    json.dump({"outcomes": found, "peak_memory_mb": round(peak_mb)}, sys.stdout, indent=2)
    print()
    escaped = any(key.startswith("escape") for outcomes in found.values() for key in outcomes)
    return 1 if escaped or peak_mb > args.memory_mb else 0
