"""Every pattern and every text reader under text made to keep them busy, in processes of limited processor time."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

#: Processor time, s, for all of a process: the interpreter's and the imports' share is most of it. A pattern that backtracks
#: without bound needs hours, a search of all lines or names before each one minutes.
CPU_S = 30

_LIMITED = f"import resource; resource.setrlimit(resource.RLIMIT_CPU, ({CPU_S}, {CPU_S}))\n"
_LIMITED += "from yieldmon.bus.log_files import mf4; mf4.defer()\n"

_PATTERNS = (
    _LIMITED
    + """
import importlib, itertools, pkgutil, re
import yieldmon
found = {}
for module in pkgutil.walk_packages(yieldmon.__path__, "yieldmon."):
    if ".plots" in module.name or module.name.endswith("__main__"):
        continue
    try:
        loaded = importlib.import_module(module.name)
    except ModuleNotFoundError:
        continue
    for name, value in vars(loaded).items():
        values = value if isinstance(value, (list, tuple)) else [value]
        if isinstance(value, dict):
            values = itertools.chain.from_iterable(v if isinstance(v, list) else [v] for v in value.values())
        for one in values:
            for part in one if isinstance(one, tuple) else (one,):
                if isinstance(part, re.Pattern):
                    found[part.pattern] = part
from yieldmon.files.strict_yaml import StrictLoader
for entries in StrictLoader.yaml_implicit_resolvers.values():
    for _, pattern in entries:
        found[pattern.pattern] = pattern
assert len(found) >= 6, sorted(map(str, found))
starts = [
    "", "(1436509052.249713) can0 123#", "(1436509052.249713)  can0  123   [8]  01 02 03 04 05 06 07 08",
    "DROPCOUNT: dropped ", "-",
]
units = ["1", "0", "a", " ", "  '", " ERRORFRAME", " '' ", "11.", " 11", "'", "\\t", ".", "e1", "\\x1b[0;", "\\\\x00", "(1"]
for pattern in found.values():
    binary = isinstance(pattern.pattern, bytes)
    for start, unit, end in itertools.product(starts, units, ("", "!", "\\n", "x'")):
        text = start + unit * (1500 // len(unit)) + end
        given = text.encode() if binary else text
        pattern.fullmatch(given), pattern.match(given)
print(len(found))
"""
)

_READERS = (
    _LIMITED
    + """
import itertools, logging, pathlib, sys
logging.disable(logging.CRITICAL)
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.errors import InputError
heads = {
    ".log": "(1436509052.249713)  can0  123   [8]  01 02 03 04 05 06 07 08",
    ".asc": "date Mon Jan 1 00:00:00 2024\\nbase hex  timestamps absolute\\n0.1 1  123 Rx d 8 ",
    ".csv": "timestamp,arbitration_id,extended,remote,error,dlc,data\\n1.0,0x1,",
    ".trc": ";$FILEVERSION=2.1\\n;$COLUMNS=N,O,T,I,d,l,D\\n 1 ",
    "-savvycan.csv": "Time Stamp,ID,Extended,Bus,LEN,D1\\n1000,1,false,0,1,",
    "-canedge.csv": "TimestampEpoch;BusChannel;ID;IDE;DataLength;DataBytes\\n1.0;1;1;0;1;",
    "-kvaser.csv": "CSV CAN data\\nFormat of data field,HEX\\nFormat of id field,HEX\\nLogging started at,2023-08-14 ",
    "-busmaster.log": "***BUSMASTER\\n***HEX***\\n***SYSTEM MODE***\\n***START DATE AND TIME 1:1:2024 1:1:1:1***\\n01:00:00:1",
}
folder = pathlib.Path(sys.argv[1])
for suffix, head in heads.items():
    path = folder / f"hostile{suffix}"
    lines = [head + unit * (4000 // len(unit)) + end for unit, end in itertools.product(
        ["  '", " ERRORFRAME", "1", " 1", "a ", "'", " '' ", ",", ";", "="], ["", "!", "'x"])]
    path.write_text("\\n".join(lines * 8))
    try:
        list(read_log(path, LogNotes(on_damage=lambda damage: None)))
    except InputError:
        pass
"""
)

_DBC = (
    _LIMITED
    + """
import pathlib, sys
from yieldmon.bus import dbc_file
from yieldmon.errors import InputError
path = pathlib.Path(sys.argv[1]) / "hostile.dbc"
for line in ("VAL_ 1 a 1", 'VAL_ 1 a --1 "x" 1e "y" ;', "VAL_ " + "1" * 5000 + ' a 1 "x" ;',
             'VAL_ 1 a 1 "x', 'VAL_ 1 a 1 "x" 2', 'CM_ SG_ 5000 a "x', 'BA_ "x" BO_ 5000 "', "BO_ 5000 x: 8 y",
             "SG_ a : 1|2@1+ (1,", 'SG_ a : 1|2@1+ (1,0) [0|1] "x"  ', "SG_MUL_VAL_ 5000 a b "):
    path.write_text("BO_ 5000 x: 8 y\\n" + (line + "\\n") * min(20_000, 2_000_000 // len(line)))
    dbc_file.names_that_differ(path.read_text())
    try:
        dbc_file.read(path, strict=False)
    except InputError:
        pass
"""
)

_YAML = (
    _LIMITED
    + """
from yieldmon.errors import InputError
from yieldmon.files import strict_yaml
size = strict_yaml.MAX_BYTES - 10
for text in ("1" * size + "x", "a: " + "1" * 60000 + "." + "1" * 30000 + "e", "[" * size, "{a: " * (size // 4),
             "- " * (size // 2), "? " * (size // 2),
             '"' + "\\\\\\\\" * (size // 2), "a: >\\n" + " \\n" * (size // 2), "&a " * (size // 3), "x" * (10 * size)):
    try:
        strict_yaml.parse(text, "hostile")
    except InputError:
        pass
"""
)

_HEADERS = (
    _LIMITED
    + """
import pathlib, sys
from yieldmon.errors import InputError
from yieldmon.field.sources import csv_table
from yieldmon.field.sources.options import ReadOptions
from yieldmon.files import table, ticket_file
path = pathlib.Path(sys.argv[1]) / "wide.csv"
names = [f"a{number}" for number in range(40_000)]
refused = 0
for header in (names, [*names, "a7"], ["x"] * 100_000):
    path.write_text(",".join(header) + "\\n" + ",".join(["1"] * len(header)) + "\\n")
    for read in (table.load, ticket_file.load, lambda path: csv_table.read(path, ReadOptions())):
        try:
            read(path)
        except InputError:
            refused += 1
assert refused == 9, refused
"""
)


@pytest.mark.parametrize(
    "script", [_PATTERNS, _READERS, _DBC, _YAML, _HEADERS], ids=["patterns", "readers", "dbc", "yaml", "headers"]
)
def test_no_text_keeps_a_reader_without_end(script, tmp_path):
    ended = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr[-500:]


def test_the_limit_stops_a_pattern_that_does(tmp_path):
    """The old pattern of candump's screen lines: 147 bytes were enough."""
    script = "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 1))\nimport re\n"
    script += "re.fullmatch(r\"(?:\\s+'.*'|\\s+ERRORFRAME)*\", \" ''\" * 45 + 'x')"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert ended.returncode != 0
    assert resource.getrlimit(resource.RLIMIT_CPU)[0] == resource.RLIM_INFINITY
