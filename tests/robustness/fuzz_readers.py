"""Mutated files through every reader: logs, YAML, tables, stores, control requests. No traceback, no hang, bounded memory.

    python -m tests.robustness fuzz-readers --count 2000 --reader candump
    python -m tests.robustness fuzz-readers --cpu-minutes 60 --reader candump      # guided by coverage

Mutations of good files (bits, slices doubled, cut, swapped, long runs). With --cpu-minutes those that reach new steps of the
reader's code, or of the package that it stands on, are mutated further, and inputs that escape are kept in out/fuzz. An escape is
an exception that is no InputError, a file that takes more than --seconds of processor time, or a process above --memory-mb. Ends
with 1 when there is one.
"""

from __future__ import annotations

import argparse
import atexit
import gzip
import json
import logging
import random
import resource
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import can

from tests.robustness.guided import Corpus, Coverage, cpu_s, kept, spliced
from yieldmon.bus.databases import load_messages
from yieldmon.bus.logs import LogNotes, read_log
from yieldmon.errors import InputError
from yieldmon.files import machine_file, parameter_file, table
from yieldmon.resources import shipped
from yieldmon.service import configuration, recorded
from yieldmon.service.control import ControlServer
from yieldmon.service.store import Store

Seed = Callable[[Path], None]
_FRAMES = 200
#: Code whose steps guide: the project's, and what reads its files.
TRACED = ("/yieldmon/", "/can/io/", "/yaml/", "/asammdf/", "/cantools/database/can/formats/")
KEPT = Path("out/fuzz")
#: Processor time of one file, traced, beyond which its reader is taken to read for ever.
ENDLESS_S = 60.0


class Endless(BaseException):
    """Raised in a reader that does not end; no reader catches it."""


@contextmanager
def ended() -> Iterator[None]:
    """Within it, reading ends after ENDLESS_S seconds of processor time."""

    def end(*_: object) -> None:
        raise Endless(f"more than {ENDLESS_S:g} s")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, ENDLESS_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


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


def _zipped_log(path: Path) -> None:
    path.write_bytes(gzip.compress(b"(1.000000) can0 123#01\n" * 400))


def _copy(name: str) -> Seed:
    def write(path: Path) -> None:
        path.write_bytes(shipped(name).read_bytes())

    return write


def _store(path: Path) -> None:
    from tests.service.test_store import batch

    with Store(path) as store:
        store.commit([batch(number) for number in range(1, 60)])


def _signals(path: Path) -> None:
    path.write_text(
        "plate: {fixed_angle_deg: 60}\nsignals:\n"
        "  impact_voltage: {message: ImpactSensorSamples, signals: [Sample0, Sample1], spacing_ms: 2, range: [0, 5000],\n"
        "    not_available: [65535]}\n"
        "  elevator_speed: {message: ElevatorSpeed, signal: ElevatorSpeed, ratio: 1.5,\n"
        "    source: {name: {function: 3}}}\n"
        "  moisture: {value: 18.0}\n"
    )


def _table(path: Path) -> None:
    path.write_text("plate_angle_deg,mass_flow_kg_s,force_n,trial\n" + "60,5,12.5,a\n70,9,-,b\n" * 20)


def _request(path: Path) -> None:
    path.write_bytes(b'{"command": "ticket", "mass_kg": 12000.5, "loads": [1, 2], "note": "a"}\n')


def _ask(path: Path) -> object:
    """The file as a request to a control server, whose answer has to be JSON."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(10.0)
        connection.connect(str(_server().path))
        with suppress(ConnectionError):
            connection.sendall(path.read_bytes().split(b"\n")[0] + b"\n")
        answer = connection.makefile("rb").readline()
    return json.loads(answer)


@cache
def _server() -> ControlServer:
    """One for the whole process, answering what the daemon's would look at first."""
    place = Path(tempfile.mkdtemp())
    server = ControlServer(place / "s", None, lambda request: {"ok": True, "seen": request["command"]})
    server.start()
    atexit.register(shutil.rmtree, place)
    atexit.register(server.stop)
    return server


def _read(path: Path) -> object:
    return sum(1 for _ in read_log(path, LogNotes(on_damage=lambda damage: None)))


READERS: dict[str, tuple[str, Seed, Callable[[Path], object]]] = {
    "candump": ("x.log", _log, _read),
    "asc": ("x.asc", _log, _read),
    "blf": ("x.blf", _log, _read),
    "trc": ("x.trc", _log, _read),
    "csv": ("x.csv", _log, _read),
    "db": ("x.db", _log, _read),
    "candump-gz": ("x.log.gz", _zipped_log, _read),
    "parameters": ("x.yaml", _copy("config/parameters/corn.yaml"), parameter_file.load),
    "machine": ("x.yaml", _copy("config/machines/sprocket-8.yaml"), machine_file.load),
    "configuration": ("x.yaml", _copy("config/yieldmon.yaml"), lambda path: configuration.load(path, {})),
    "signals": ("x.yaml", _signals, lambda path: configuration.load(path, {})),
    "dbc": ("x.dbc", _copy("dbc/yieldmon.dbc"), load_messages),
    "mf4": ("x.mf4", _log, _read),
    "control": ("x.json", _request, _ask),
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
                _to_an_end(path, read)
                outcomes["read"] += 1
            except InputError:
                outcomes["refused"] += 1
            except Exception as error:  # noqa: BLE001 - what is looked for
                outcomes[f"escape {type(error).__name__}: {str(error)[:80]}"] += 1
            if time.process_time() - began_s > seconds:
                outcomes["escape: too slow"] += 1
    return outcomes


def guided(name: str, cpu_minutes: float, seed: int, seconds: float) -> Counter[str]:
    """The same for so much processor time, guided by coverage."""
    file, make, read = READERS[name]
    rng, outcomes, coverage = random.Random(f"{seed}/{name}"), Counter[str](), Coverage(TRACED)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / file
        make(path)
        good = path.read_bytes()
        corpus = Corpus(good)
        content, until_s = good, cpu_s() + 60.0 * cpu_minutes
        while cpu_s() < until_s:
            for left in Path(place).iterdir():
                left.unlink()
            path.write_bytes(content)
            steps, raised = coverage.of(lambda: _to_an_end(path, read))
            outcomes["new"] += corpus.take(content, steps)
            outcomes["refused" if isinstance(raised, InputError) else "read" if raised is None else "raised"] += 1
            escape = "" if raised is None or isinstance(raised, InputError) else f"{type(raised).__name__}: {str(raised)[:80]}"
            escape = escape or _slow(path, read, seconds)
            if escape:
                outcomes[f"escape {escape}"] += 1
                if outcomes[f"escape {escape}"] == 1:
                    print(f"{name}: {escape}: {kept(KEPT, name, content)}", file=sys.stderr)
            base = corpus.chosen(rng)
            content = spliced(base, corpus.chosen(rng), rng)[: 4 * len(good)] if rng.random() < 0.1 else base
            content = mutated(content or good, rng)
    outcomes["steps"] = len(corpus.reached)
    return outcomes


def _to_an_end(path: Path, read: Callable[[Path], object]) -> None:
    try:
        with ended():
            read(path)
    except Endless as error:
        raise RuntimeError(f"reads for ever: {error}") from error


def _slow(path: Path, read: Callable[[Path], object], seconds: float) -> str:
    """Whether reading takes too long, without the tracing that makes everything slow; only files of some size are asked."""
    if path.stat().st_size < 4096:
        return ""
    began_s = cpu_s()
    with suppress(Exception):
        _to_an_end(path, read)
    return "too slow" if cpu_s() - began_s > seconds else ""


def main(arguments: list[str]) -> int:
    """Prints the outcomes as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reader", choices=sorted(READERS), help="default: all")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--cpu-minutes", type=float, help="guided by coverage, for so much processor time a reader")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--memory-mb", type=float, default=500.0)
    args = parser.parse_args(arguments)
    logging.disable(logging.CRITICAL)
    names = [args.reader] if args.reader else list(READERS)
    if args.cpu_minutes is not None:
        found = {name: dict(guided(name, args.cpu_minutes, args.seed, args.seconds)) for name in names}
    else:
        found = {name: dict(fuzz(name, args.count, args.seed, args.seconds)) for name in names}
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    json.dump({"outcomes": found, "peak_memory_mb": round(peak_mb)}, sys.stdout, indent=2)
    print()
    escaped = any(key.startswith("escape") for outcomes in found.values() for key in outcomes)
    return 1 if escaped or peak_mb > args.memory_mb else 0
