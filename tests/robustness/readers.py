"""Every reader of files from outside, with a good file for each and the damage that gets furthest in it."""

from __future__ import annotations

import atexit
import gzip
import json
import shutil
import socket
import struct
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import can

from tests.robustness import forked, fuzz_harvests
from tests.robustness.damage import Damage, mutated, within_parquet, within_zip
from tests.service.bench import CODEC, traffic
from tests.service.test_store import batch, second
from yieldmon.bus.codec import Codec
from yieldmon.bus.databases import load_messages
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.bus.packed.writing import pack
from yieldmon.engine.monitor import Monitor
from yieldmon.errors import InputError
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.files import flow_curve_file, machine_file, moisture_file, parameter_file, table, ticket_file
from yieldmon.resources import shipped
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory
from yieldmon.service.logs import recorded
from yieldmon.service.logs.tables import open_table
from yieldmon.service.operator import commands
from yieldmon.service.operator.control import ControlServer
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.store import Store

Seed = Callable[[Path], None]
_FRAMES = 200


class Reader(NamedTuple):
    """file: name of the file. make: writes a good one. read: raises InputError or nothing. start_s: processor time of starting
    the process that reads, where it is one of its own."""

    file: str
    make: Seed
    read: Callable[[Path], object]
    damage: Damage = mutated
    start_s: float = 0.0


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


def _pcap(path: Path) -> None:
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227)
    frame = struct.pack(">IBBxx", 0x98FF0000, 8, 0) + bytes(range(8))
    path.write_bytes(head + b"".join(struct.pack("<IIII", 1700000000 + k, 0, 16, 16) + frame for k in range(_FRAMES)))


def _pcapng(path: Path) -> None:
    def block(kind: int, body: bytes) -> bytes:
        return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)

    name = struct.pack("<HH", 2, 4) + b"can0" + bytes(4)
    frame = struct.pack(">IBBxx", 0x98FF0000, 8, 0) + bytes(range(8))
    packet = [struct.pack("<5I", 0, k, 0, 16, 16) + frame for k in range(_FRAMES)]
    blocks = [block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)), block(1, struct.pack("<HHI", 227, 0, 65535) + name)]
    path.write_bytes(b"".join([*blocks, *(block(6, content) for content in packet)]))


def _zipped_log(path: Path) -> None:
    path.write_bytes(gzip.compress(b"(1.000000) can0 123#01\n" * 400))


def _excerpt(name: str) -> Seed:
    """A log of another maker's logger."""

    def write(path: Path) -> None:
        path.write_bytes((Path(__file__).parents[1] / "data" / "loggers" / name).read_bytes())

    return write


def _copy(name: str) -> Seed:
    def write(path: Path) -> None:
        path.write_bytes(shipped(name).read_bytes())

    return write


def _store(path: Path) -> None:
    with Store(path) as store:
        store.commit([batch(number) for number in range(1, 60)])


def _signals(path: Path) -> None:
    path.write_text(
        "plate: {fixed_angle_deg: 60}\nsignals:\n"
        "  impact_voltage: {message: ImpactSensorSamples, signals: [Sample0, Sample1], spacing_ms: 2, range: [0, 5000],\n"
        "    not_available: [8191]}\n"
        "  elevator_speed: {message: ElevatorSpeed, signal: ElevatorSpeed, ratio: 1.5,\n"
        "    source: {name: {function: 3}}}\n"
        "  moisture: {value: 18.0}\n"
    )


def _table(path: Path) -> None:
    path.write_text("plate_angle_deg,mass_flow_kg_s,force_n,trial\n" + "60,5,12.5,a\n70,9,-,b\n" * 20)


def _request(path: Path) -> None:
    path.write_bytes(b'{"command": "ticket", "mass_kg": 12000.5, "loads": [1, 2], "note": "a"}\n')


def _requests(path: Path) -> None:
    """One of each kind."""
    path.write_text(
        '{"command": "load-start", "field": "north", "crop": "wheat", "thousand_kernel_weight_g": 42.5}\n'
        '{"command": "load-stop"}\n{"command": "totals-reset", "total_kg": 0}\n{"command": "loads"}\n'
        '{"command": "ticket", "first_load": 1, "last_load": 2, "mass_kg": 4400, "std_dev_kg": 20.5, "note": "a"}\n'
        '{"command": "tickets"}\n{"command": "ticket-undo", "ticket": 1}\n{"command": "calibrations"}\n'
        '{"command": "calibration-undo", "version": 1}\n{"command": "zero", "force": true}\n{"command": "zero-undo"}\n'
        '{"command": "sweep-start"}\n{"command": "sweep-abort"}\n',
        encoding="ascii",
    )


def _ask(path: Path) -> object:
    """The first line of a file as a request to a control server, whose answer has to be JSON."""
    return _asked(path.read_bytes().split(b"\n")[0])


def _asked(line: bytes) -> object:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(10.0)
        connection.connect(str(_server().path))
        with suppress(ConnectionError):
            connection.sendall(line + b"\n")
        answer = connection.makefile("rb").readline()
    return json.loads(answer, parse_constant=_no_number)


def _no_number(text: str) -> float:
    raise ValueError(f"{text} in an answer, which is no JSON")


def _command(path: Path) -> object:
    """Each line as an operator's request that the engine's thread carries out, where nothing but an InputError may come of it."""
    monitor, journal = _engine()
    for line in path.read_bytes().split(b"\n")[:40]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(request, dict) and isinstance(request.get("command"), str):
            with suppress(InputError):
                answer = commands.execute({**request, "who": "fuzz"}, monitor, journal, 1.7e9)
                json.dumps(dict(answer), allow_nan=False)
    return None


def _engine() -> tuple[Monitor, Journal]:
    """A monitor without frames, and a journal with two loads."""
    loaded = _loaded()
    loads = tuple(Load(number, "north", "corn", None, None, 1000.0 * number, 900.0) for number in (1, 2))
    return monitor_of(loaded), Journal(Memory(loads=loads), loaded.parameters, now_s=0.0)


@cache
def _loaded() -> configuration.Configuration:
    return configuration.build({}, Path("fuzz.yaml"), {})


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


def _read_in_forks(path: Path) -> object:
    with forked.processes():
        return _read(path)


def _in_blocks(path: Path) -> object:
    return sum(len(block) for block in iter_blocks(path, LogNotes(on_damage=lambda damage: None)))


def _packed(path: Path) -> None:
    """Every coding that there is: a combine's messages, in the order of time and not."""
    log = path.with_suffix(".log")
    sent = [(frame.time_s, CODEC.encode(frame)) for frame in traffic(0.0, 5.0, 60.0)]
    lines = [f"({time_s:.6f}) can0 {message.arbitration_id:08X}#{message.data.hex()}\n" for time_s, message in sent]
    log.write_text("".join([*lines, *reversed(lines[:9])]), encoding="ascii")
    pack(iter_blocks(log, LogNotes()), path, Codec().layouts)
    log.unlink()


def _seconds(path: Path) -> None:
    with open_table(str(path)) as writer:
        for number in range(1, 30):
            writer.write(second(number))


def _tickets(path: Path) -> None:
    path.write_text("load;weighed_kg;std_dev_kg;note\n7;9120,5;40;a\n8-9;18.1;-;\nmonday.log;7000;35;b\n")


def _workbook(path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    for row in (("load", "weighed_t", "note"), (7, 9.12, "a"), ("8-9", 18.1, None), (None, None, None), (10, 7.0, "2024")):
        book.worksheets[0].append(row)
    book.save(path)


def _curve(path: Path) -> None:
    path.write_text(
        "estimator: table\nformat: 1\nelevator_speed_rpm: 400\nrelative_std_dev: 0.03\n"
        "calibrated_range: {mass_flow_kg_s: [2, 30], elevator_speed_rpm: [350, 450], plate_angle_deg: [60, 70]}\n"
        "columns:\n  - {plate_angle_deg: 60, force_n: [10, 20], mass_flow_kg_s: [6, 12]}\n"
    )


@cache
def _harvests() -> Path:
    """Good harvests of every kind, made once."""
    place = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, place)
    fuzz_harvests.base_files(place)
    return place


def _harvest(name: str) -> Seed:
    def write(path: Path) -> None:
        path.write_bytes((_harvests() / name).read_bytes())

    return write


def _points(path: Path) -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", category=RuntimeWarning, module="yieldmon")
        return len(sources.read(path, ReadOptions()))


READERS: dict[str, Reader] = {
    "candump": Reader("x.log", _log, _read),
    "candump-blocks": Reader("x.log", _log, _in_blocks),
    "asc": Reader("x.asc", _log, _read),
    "blf": Reader("x.blf", _log, _read),
    "trc": Reader("x.trc", _log, _read),
    "csv": Reader("x.csv", _log, _read),
    "savvycan": Reader("x.csv", _excerpt("savvycan_gvret.csv"), _read),
    "canedge": Reader("x.csv", _excerpt("canedge.csv"), _read),
    "busmaster": Reader("x.log", _excerpt("busmaster.log"), _in_blocks),
    "peak": Reader("x.trc", _excerpt("peak_2_0.trc"), _read),
    "pcap": Reader("x.pcap", _pcap, _read),
    "pcapng": Reader("x.pcapng", _pcapng, _read),
    "db": Reader("x.db", _log, _read),
    "candump-gz": Reader("x.log.gz", _zipped_log, _read),
    "packed": Reader("x.parquet", _packed, _read, within_parquet),
    "parameters": Reader("x.yaml", _copy("config/parameters/corn.yaml"), parameter_file.load),
    "machine": Reader("x.yaml", _copy("config/machines/sprocket-8.yaml"), machine_file.load),
    "moisture": Reader("x.yaml", _copy("config/moisture/corn-published.yaml"), moisture_file.load),
    "flow-curve": Reader("x.yaml", _curve, flow_curve_file.load),
    "configuration": Reader("x.yaml", _copy("config/yieldmon.yaml"), lambda path: configuration.load(path, {})),
    "signals": Reader("x.yaml", _signals, lambda path: configuration.load(path, {})),
    "dbc": Reader("x.dbc", _copy("dbc/yieldmon.dbc"), load_messages),
    "mf4": Reader("x.mf4", _log, _read_in_forks),
    "control": Reader("x.json", _request, _ask),
    "commands": Reader("x.jsonl", _requests, _command),
    "table": Reader("x.csv", _table, table.load),
    "tickets": Reader("x.csv", _tickets, ticket_file.load),
    "workbook": Reader("x.xlsx", _workbook, ticket_file.load, within_zip),
    "store": Reader("x.sqlite", _store, recorded.read_seconds),
    "seconds-csv": Reader("x.csv", _seconds, recorded.read_seconds),
    "seconds-jsonl": Reader("x.jsonl", _seconds, recorded.read_seconds),
    "seconds-parquet": Reader("x.parquet", _seconds, recorded.read_seconds, within_parquet),
    "agleader": Reader("x.txt", _harvest("basic.txt"), _points),
    "harvest-csv": Reader("x.csv", _harvest("points.csv"), _points),
    "geojson": Reader("x.geojson", _harvest("points.geojson"), _points),
    "geopackage": Reader("x.gpkg", _harvest("harvest.gpkg"), _points),
    "shapefile": Reader("x.zip", _harvest("points_shp.zip"), _points, within_zip),
    "deere": Reader("x.zip", _harvest("deere.zip"), _points, within_zip),
    "task-data": Reader("x.zip", _harvest("taskdata.zip"), _points, within_zip),
}
