"""Files in a hostile world: what is read was made to harm, what is written is for others to read; random by seed, invariants
after each life.

    python -m tests.robustness files-simulation --lives 48 --seed 1
    python -m tests.robustness files-simulation --undo "patterns without backtracking"     # a mend undone: it must be found
    python -m tests.robustness files-simulation --table                                    # every mend undone in turn

Invariants: whatever stands in a log, a record, a store, a configuration or a parameter file is a line or is read, in bounded
processor time and room; what is written or installed under any umask is for everybody to read, under a scratch name that nobody
can foresee; an installation has exactly what the lock names, comes whole or not at all, and can be taken back; names come out
without a formula, a control character or XML that is not well-formed. Ends with 1 when one is broken.
"""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import gzip
import io
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import sqlite3
import stat
import subprocess
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast
from unittest import mock

import can
import numpy as np

from tests.robustness import undoing
from tests.robustness.undoing import Broken, Simulation, Trouble, live, mend, require
from tests.seconds import measured_second
from tests.service.test_installation import FakePip
from yieldmon.bus import bulk
from yieldmon.bus.log_files import binary_logs, candump
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.bus.opening import open_bus
from yieldmon.cli import main as command
from yieldmon.discrepancy import adoption
from yieldmon.errors import InputError
from yieldmon.export import agleader, columns, taskdata
from yieldmon.export.points import PointSettings, yield_points
from yieldmon.files import parameter_file, strict_yaml, whole_file
from yieldmon.service import installation
from yieldmon.service.config import configuration, contradictions
from yieldmon.service.logs import recorded
from yieldmon.service.storage import store_file
from yieldmon.service.storage.batch import Batch, Load, ParameterVersion
from yieldmon.service.storage.store import Store

_CPU_S, _FILE_BYTES = 10, 32 * 1024 * 1024
_umask = os.umask
_EVERYBODY = {True: stat.S_IROTH | stat.S_IXOTH, False: stat.S_IROTH}


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        # As one that the service looks into.
        Path(name).chmod(0o755)
        yield Path(name)


@contextmanager
def _under(umask: int) -> Iterator[None]:
    before = _umask(umask)
    try:
        yield
    finally:
        _umask(before)


def _bounded(work: Callable[[], object], what: str) -> None:
    """In a process of limited processor time and file size: work comes to an end, with an InputError or without."""
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
        resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, _FILE_BYTES))
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        code = 0
        try:
            work()
        except InputError:
            pass
        except BaseException:  # noqa: BLE001 - whatever it is, the parent tells it
            code = 1
        os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    require(code == 0, f"{what}: {f'ended by signal {-code}' if code < 0 else 'neither read nor a line'}")


def _line_or_work(work: Callable[[], object], what: str) -> bool:
    """Whether it worked; an InputError is a line, anything else is broken."""
    try:
        work()
    except InputError:
        return False
    except Exception as error:
        raise Broken(f"{what}: {type(error).__name__}: {str(error)[:80]}") from error
    return True


# What is read


_PIECES = ("1", "0", "a", " ", "  '", " ERRORFRAME", " ''", "11.", " 11", "'", "\t", ".", "(1", "  ''", "##1", "R", "_")
_STARTS = (
    "(1436509052.249713)  can0  123   [8]  01 02 03 04 05 06 07 08", "(1436509052.249713) can0 123#", "(1436509052.249713)",
    "(1436509052.249713)  can0  RX - -  123   [8]  remote request", "DROPCOUNT: dropped ",
)  # fmt: skip


def hostile_lines(rng: random.Random) -> None:
    """Lines of a log that make an expression go back and forth."""
    lines = []
    for _ in range(60):
        start = rng.choice(_STARTS)
        pieces = rng.choices(_PIECES, k=rng.choice((1, 1, 2)))
        lines.append(start + "".join(pieces) * rng.randint(20, 1200 // len("".join(pieces))) + rng.choice(("", "!", "x'", "x")))
    lines.append(_STARTS[0] + rng.choice((" ''", " 'a'", " ERRORFRAME", "  ''")) * rng.randint(40, 60) + rng.choice("x!"))
    with _folder() as folder:
        path = folder / "hostile.log"
        path.write_text("\n".join(lines) + "\n", encoding="ascii")
        _bounded(lambda: list(read_log(path, LogNotes(on_damage=lambda damage: None))), "a log of hostile lines")


def much_in_little(rng: random.Random) -> None:
    """A packed database that unpacks to more than there is room for."""
    with _folder() as folder, mock.patch.object(binary_logs, "LARGEST_UNPACKED_BYTES", _FILE_BYTES // 4):
        path = folder / "bomb.db.gz"
        path.write_bytes(gzip.compress(bytes([rng.randrange(256)]) * (3 * _FILE_BYTES), 1))
        notes = LogNotes(on_damage=lambda damage: None)
        _bounded(lambda: list(read_log(path, notes)), "a database of 1/1000 of its size")


_ENDLESS = "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT"


def crafted_store(rng: random.Random) -> None:
    """A store with a view in the place of a table, whose rows never end."""
    with _folder() as folder, mock.patch.object(store_file, "_READING_S", 1.0):
        path = folder / "crafted.sqlite"
        with Store(path) as store:
            store.commit(
                [Batch(1, 1.0, {}, seconds=(measured_second(1, 1.0, 5.0),), loads=(Load(1, "", "", 1.0, None, 5.0, None),))]
            )
        table = rng.choice(("second", "load"))
        with sqlite3.connect(path) as database:
            names = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            values = ", ".join("n" if name == "number" else "0" for name in names)
            database.execute(f"DROP TABLE {table}")
            database.execute(f"CREATE VIEW {table} ({', '.join(names)}) AS {_ENDLESS} {values} FROM c")
        database.close()
        words = ["export", str(path), "--out", str(folder / "out.csv"), *(["--what", "loads"] if table == "load" else [])]
        _bounded(lambda: _quietly(words), f"a store with an endless {table}")


def _quietly(words: list[str]) -> int:
    """A command's exit code; what it says is left aside, unless it is a traceback."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = command.main(words)
    require("Traceback" not in said.getvalue(), f"a traceback of {words[0]}")
    return code


_NUMBERS = (
    "time_s", "duration_s", "mass_kg", "latitude_deg", "longitude_deg", "total_kg", "load_number", "quality", "mass_flow_kg_s",
    "ground_speed_m_s", "course_deg", "moisture_pct",
)  # fmt: skip
_ODD = (float("inf"), float("-inf"), float("nan"), 0.0, -1.0, 1e300, 1000.0, 10**30)
_OUT = ("x.zip", "x.geojson", "x.txt", "x.csv")


def _cannot_be(name: str, value: float) -> bool:
    """Whether no second can have that value, by what the column means."""
    ends = {"latitude_deg": 90.0, "longitude_deg": 180.0, "quality": 255.0}
    least = {"duration_s": 1e-9, "mass_kg": 0.0, "moisture_pct": 0.0, "quality": 0.0}
    return not math.isfinite(value) or not least.get(name, -1e30) <= value <= ends.get(name, 1e29)


def odd_numbers(rng: random.Random) -> None:
    """Tables of one second with a number that no second has."""
    for _ in range(4):
        name, value = rng.choice(_NUMBERS), rng.choice(_ODD)
        record = dataclasses.asdict(measured_second(1, 1.7e9, 9.0)) | {name: value}
        _exported(json.dumps(record), f"{name} {value}", refused=_cannot_be(name, value))


def odd_lines(rng: random.Random) -> None:
    """Tables of seconds whose line is no record."""
    for line in rng.sample(("[" * 100_000, '{"a":' * 100_000, "1e999", "null", '"x"', "{}"), 3):
        _exported(line, line[:10], refused=True)


def _exported(line: str, what: str, *, refused: bool) -> None:
    with _folder() as folder:
        path = folder / "r.jsonl"
        path.write_text(f"{line}\n", encoding="utf-8")
        for out in _OUT:
            more = [] if out == "x.csv" else ["--swath", "6", "--flow-delay", "0", "--start-delay", "0", "--end-delay", "0"]
            words = ["export", str(path), "--out", str(folder / out), *more]
            codes = list[int]()
            _line_or_work(lambda words=words, codes=codes: codes.append(_quietly(words)), f"{what} to {out}")  # type: ignore[misc]
            require(codes != [0] or not refused, f"{what} to {out}: taken for a second")


def many_channels(rng: random.Random) -> None:
    """A log of more channels than a small number counts."""
    count = rng.randint(32_768, 40_000)
    messages = [can.Message(timestamp=float(k), arbitration_id=1, channel=f"c{k}") for k in range(count)]
    made = list[bulk.FrameBlock]()
    _line_or_work(lambda: made.append(bulk.block_of(messages)), f"{count} channels")
    last = made[0].channels[made[0].channel[-1]]
    require(last == f"c{count - 1}", f"the last of {count} channels is {last}")


_KEYS = ("channel", "interface", "can_filters", "receive_own_messages", "bitrate", "receive_buffer_bytes")


def odd_options(rng: random.Random) -> None:
    """Options of a bus that say again what has a key of its own."""
    for option in rng.sample(_KEYS, 4):
        document = {"bus": {"interface": "virtual", "channel": "odd", "options": {option: rng.choice((1, "x"))}}}

        def open_it(document: dict[str, Any] = document) -> None:
            bus = configuration.build(document, Path("odd.yaml"), {}).document.bus
            try:
                open_bus(bus.interface, bus.channel, bus.bitrate_bit_s, **cast("dict[str, Any]", bus.options)).shutdown()
            except InputError as error:
                # What check-config takes and a start refuses would be started again for ever.
                raise ValueError("found at the start only") from error

        _line_or_work(open_it, f"bus.options.{option}")


def odd_versions(rng: random.Random) -> None:
    """Parameter files with a version beyond what a store counts."""
    known = parameter_file.to_document(parameter_file.load())
    for version in rng.sample((10**20, 2**63, 2**63 - 1, 10**30, 10**9, 2**31), 3):
        with _folder() as folder:
            path = folder / "corn.yaml"
            path.write_text(json.dumps({**known, "version": version}), encoding="utf-8")

            def store_it(path: Path = path) -> None:
                document = parameter_file.to_document(parameter_file.load(path))
                # The one it came with, and the one that a ticket makes of it.
                versions = tuple(ParameterVersion(document["version"] + more, 1.0, "file", document) for more in (0, 1))
                with Store(path.with_name("s")) as store:
                    store.commit([Batch(1, 1.0, {}, parameter_versions=versions)])

            _line_or_work(store_it, f"version {version}")


def odd_parents(rng: random.Random) -> None:
    """Parameter files that name as their parent what is no file beside them."""
    for name in rng.sample(("", ".", "..", "a/b", "/", "/etc/passwd", "../x", "a\0b", "x" * 300, "gone.yaml"), 4):
        with _folder() as folder:
            known = dataclasses.replace(parameter_file.load(), provenance={"parent_copy": name, "parent_sha256": "0" * 64})
            parameter_file.save(known, folder / "corn.yaml")
            _line_or_work(lambda path=folder / "corn.yaml": adoption.rollback(path), f"parent_copy {name[:20]!r}")  # type: ignore[misc]


# What is written


def saves(rng: random.Random) -> None:
    """A parameter file under some umask, where somebody else may write as well."""
    with _folder() as folder:
        path = folder / "corn.yaml"
        if rng.random() < 0.5:
            path.write_text("before", encoding="utf-8")
            path.chmod(rng.choice((0o600, 0o640)))
        with _under(rng.choice((0o022, 0o027, 0o077))):
            parameter_file.save(parameter_file.load(), path)
            scratch = []
            for _ in range(2):
                with whole_file.scratch_for(path) as name:
                    scratch.append(name)
                    mode = name.parent.stat().st_mode & 0o777
                    require(mode == 0o700 or name.parent == folder, f"a scratch folder of mode {mode:o}")
                    name.write_text("x", encoding="utf-8")
        require(scratch[0] != scratch[1], "a scratch name that can be predicted")
        require(bool(path.stat().st_mode & stat.S_IROTH), f"a parameter file of mode {path.stat().st_mode & 0o777:o}")


def installs(rng: random.Random) -> None:
    """Installed, upgraded, upgraded in vain and rolled back under some umask, for an interface of some name."""
    interface = rng.choice(("can-rear", "a--b", "can-0"))
    with _folder() as folder, contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        fake, root = FakePip(folder), folder / "root"
        root.mkdir(mode=0o755)
        victim, unit = folder / "victim", root / "etc/systemd/system/yieldmon.service"
        victim.write_text("somebody else's", encoding="utf-8")
        unit.parent.mkdir(parents=True)
        unit.with_name(f".{unit.name}.new").symlink_to(victim)
        words = ["install", "--root", str(root), "--python", str(fake.python), "--from", "x.whl", "--interface", interface]

        def says() -> str:
            done = subprocess.run([root / "opt/yieldmon/bin/yieldmon"], capture_output=True, text=True, check=True)
            return Path(done.stdout.strip()).parent.name

        with _under(rng.choice((0o027, 0o077))):
            require(command.main(words) == 0, "does not install")
            first = says()
            require(command.main(words) == 0, "does not upgrade")
            second = says()
            fake.fails.touch()
            require(command.main(words) != 0, "an upgrade without its packages is none")
            fake.fails.unlink()
            require(says() == second, "an upgrade that failed has changed what is in use")
            require(command.main([*words, "--rollback"]) == 0, "an upgrade cannot be taken back")
            require(says() == first, "a rollback leads elsewhere")
        require(victim.read_text(encoding="utf-8") == "somebody else's", "a planted link was written through")
        for path in root.rglob("*"):
            # What was there before keeps its mode.
            if not path.is_symlink():
                need = _EVERYBODY[path.is_dir()]
                require(path.stat().st_mode & need == need, f"{path.relative_to(root)} has mode {path.stat().st_mode & 0o777:o}")
        steps = fake.log.read_text(encoding="utf-8")
        require("--require-hashes" in steps and "requirements.lock" in steps, "packages that no lock names")
        escaped = re.findall(r"devices-(\S+)\.device", unit.read_text(encoding="utf-8"))
        require(
            bool(escaped) and {_read_back(name) for name in escaped} == {interface}, f"bound to {escaped[:1]}, not {interface}"
        )


def _read_back(name: str) -> str:
    """A part of a unit's name as systemd reads it: a dash is a slash, unless it is written as a number."""
    plain = name.replace("-", "/")
    return re.sub(r"\\x([0-9a-f]{2})", lambda found: chr(int(found[1], 16)), plain)


_LETTERS = "ab =+-@|'\"<>&\t\r\n\0\x07\x1b\x7f\x9b\u2028\u202e\ufffe\ud800é中;,"


def odd_names(rng: random.Random) -> None:
    """Fields and crops of any characters, in every format that carries them."""
    name = rng.choice(("=cmd|' /C calc'!A0", "@x", "-1", "")) + "".join(rng.choices(_LETTERS, k=rng.randint(1, 12)))
    rows = [measured_second(n, 1.7e9 + n, 9.0, latitude_deg=40.0 + n * 1e-5) for n in range(1, 40)]
    points = yield_points(rows, PointSettings(6.0, 0.0, 0.0, 0.0))
    with _folder() as folder:
        names = (name, name)
        _line_or_work(lambda: taskdata.write(folder / "t.zip", points, lambda _: names, lambda _: 15.5), f"{name!r} in task data")
        with zipfile.ZipFile(folder / "t.zip") as packed:
            documents = [packed.read(one) for one in packed.namelist() if one.upper().endswith(".XML")]
        try:
            for document in documents:
                ET.fromstring(document)
        except ET.ParseError as error:
            raise Broken(f"{name!r} in task data: {error}") from error
        _line_or_work(
            lambda: agleader.write(folder / "a.txt", points, lambda load: (name, "Corn")), f"{name!r} in Ag Leader's text"
        )
        text = (folder / "a.txt").read_bytes().decode("utf-8", "surrogatepass")
        require(not re.search("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202e]", text), f"{name!r} as it is in Ag Leader's text")
        load = Load(1, name, "corn", 1.0, None, 10.0, None)
        _line_or_work(lambda: columns.write_csv(folder / "l.csv", Load, [load]), f"{name!r} in a table")
        with (folder / "l.csv").open(encoding="utf-8", newline="") as stream:
            cells = list(csv.reader(stream))[1]
        require(not any(one.startswith(("=", "@", "\t", "\r")) for one in cells), f"a formula in a table, of {name!r}")


TROUBLES: tuple[Trouble, ...] = (
    *(hostile_lines, much_in_little, crafted_store, odd_numbers, odd_lines, many_channels, odd_options, odd_versions),
    *(odd_parents, saves, installs, odd_names),
)


def simulate(lives: int, seed: int) -> tuple[list[str], Any]:
    """What so many lives broke, and how often each trouble came."""
    return live(lives, seed, TROUBLES)


# Each mend undone

_BACKTRACKING = re.compile(candump._SCREEN_LINE.pattern.replace(r"(?:\s+'.*')?(?:\s+ERRORFRAME)?", r"(?:\s+'.*'|\s+ERRORFRAME)*"))


class _Never(Exception):
    """Raised by nothing."""


def _in_place(installer: installation.Installer, python: str, source: str, **_: object) -> bool:
    """As it was: into the one environment there is, what pip finds."""
    home = installer.at(installation.HOME)
    installer.run(python, "-m", "venv", str(home), live_only=False)
    installer.run(str(home / "bin/python"), "-m", "pip", "install", "--upgrade", source, live_only=False)
    return not installer.failures


def _without_lock() -> Any:
    before = installation._new_release

    def new_release(*given: Any, **named: Any) -> bool:
        return before(*given, **{**named, "locked": False})

    return mock.patch.object(installation, "_new_release", new_release)


def _writes_through(self: installation.Installer, path: Path, text: str, *, keep: bool = False) -> None:
    target = self.at(path)
    if keep and target.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    fresh = target.with_name(f".{target.name}.new")
    fresh.write_text(text, encoding="utf-8")
    fresh.chmod(0o644)
    fresh.replace(target)


def _foreseeable(target: Path, path: object) -> Path:
    folder = target.parent / f".{target.stem}.{os.getpid()}"
    folder.mkdir(exist_ok=True)
    return folder


def _unpacks_all(packed: Any, out: Any, free_bytes: int) -> None:
    shutil.copyfileobj(packed, out)


@contextmanager
def _trusting() -> Iterator[None]:
    """A store is read as our own: nothing is looked for in it, and reading takes its time."""
    nothing = "SELECT type, name FROM sqlite_schema WHERE 0"
    with (
        mock.patch.object(store_file, "_distrust"),
        mock.patch.object(store_file, "_STRANGE", nothing),
    ):
        yield


@contextmanager
def _any_version() -> Iterator[None]:
    with mock.patch.object(parameter_file, "_LARGEST_VERSION", 10**40), mock.patch.object(strict_yaml, "_WHOLE", 10**40):
        yield


class _AnyName:
    """As it was: the last part of a name, whatever it is."""

    def __init__(self, name: str) -> None:
        self.name = name


MENDS = {
    "modes of what is saved": mend((5,), saves, lambda: mock.patch.object(whole_file, "READABLE", None)),
    "modes of what is installed": mend((5,), installs, lambda: mock.patch.object(os, "umask", lambda mask: mask)),
    "patterns without backtracking": mend((7,), hostile_lines, lambda: mock.patch.object(candump, "_SCREEN_LINE", _BACKTRACKING)),
    "packages of the lock": mend((11,), installs, _without_lock),
    "releases beside each other": mend((11,), installs, lambda: mock.patch.object(installation, "_new_release", _in_place)),
    "names of interfaces in units": mend((11,), installs, lambda: mock.patch.object(installation, "unit_name", str)),
    "numbers that no second has": mend((13,), odd_numbers, lambda: mock.patch.object(recorded, "_check")),
    "records that are too deep": mend(
        (13,), odd_lines, lambda: mock.patch.object(recorded, "RecursionError", _Never, create=True),
    ),
    "room for channels": mend((13,), many_channels, lambda: mock.patch.object(np, "int32", np.int16)),
    "options that have a key": mend(
        (13,), odd_options, lambda: mock.patch.object(contradictions, "_NAMED_BUS_OPTIONS", frozenset()),
    ),
    "names of parents": mend((13,), odd_parents, lambda: mock.patch.object(adoption, "Path", _AnyName)),
    "bounds of versions": mend((14,), odd_versions, _any_version),
    "scratch names": mend((16,), saves, lambda: mock.patch.object(whole_file, "_private_folder", _foreseeable)),
    "planted links": mend((16,), installs, lambda: mock.patch.object(installation.Installer, "write", _writes_through)),
    "names in XML": mend((17,), odd_names, lambda: mock.patch.object(taskdata, "plain", str)),
    "names in text": mend((17,), odd_names, lambda: mock.patch.object(agleader, "quotable", str)),
    "no formulas": mend((17,), odd_names, lambda: mock.patch.object(columns, "cell", str)),
    "bounded unpacking": mend((18,), much_in_little, lambda: mock.patch.object(binary_logs, "_unpacked", _unpacks_all)),
    "stores of anybody": mend((18,), crafted_store, _trusting),
}  # fmt: skip

SIMULATION = Simulation(__doc__, "lives", 48, simulate, MENDS)


def main(arguments: list[str]) -> int:
    """See `undoing.main`."""
    return undoing.main(SIMULATION, arguments)
