"""Files that have no end: a device, a pipe, a line of gigabytes. What is read is read up to a limit, and refused in one line."""

from __future__ import annotations

import array
import fcntl
import gzip
import io
import os
import socket
import termios
import threading
import time
import zipfile
from pathlib import Path

import can
import pytest

from tests.whole_logs import load_frames
from yieldmon import bounded
from yieldmon.bounded import read_whole
from yieldmon.bus import databases, dbc_file
from yieldmon.bus.log_files import text_logs
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import SUFFIXES, read_log, require_log
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.files import delimited, table, ticket_file
from yieldmon.service.logs import recorded


@pytest.mark.parametrize(
    ("owner", "read", "line"),
    [
        (dbc_file, databases.load_messages, "is longer than 1 MB; expected a readable DBC file"),
        (delimited, table.load, "is longer than 1 MB; expected a readable CSV file"),
        (delimited, ticket_file.load, "is longer than 1 MB; expected a readable CSV file"),
    ],
    ids=["dbc", "table", "tickets"],
)
def test_what_does_not_end_is_refused(owner, read, line, monkeypatch):
    monkeypatch.setattr(owner, "LARGEST_BYTES", 1_000_000)
    with pytest.raises(InputError, match=f"^/dev/zero: {line}$"):
        read(Path("/dev/zero"))


def test_a_file_of_exactly_the_limit_is_read(tmp_path):
    path = tmp_path / "f"
    path.write_bytes(b"12345")
    assert read_whole(path, "a file", 5) == b"12345"
    with pytest.raises(InputError, match=r"f: is longer than 0 MB; expected a file$"):
        read_whole(path, "a file", 4)


def test_limits_are_far_above_what_files_have():
    assert (dbc_file.LARGEST_BYTES, delimited.LARGEST_BYTES) == (64_000_000, 256_000_000)
    assert (bounded.LONGEST_LINE, text_logs.LONGEST_SKIPPED_BYTES) == (16_777_216, 268_435_456)


def test_a_table_comes_through_a_pipe(tmp_path):
    reads, writes = os.pipe()
    try:
        os.write(writes, b"plate_angle_deg,mass_flow_kg_s,force_n\n60,5,12\n70,5,11\n50,5,13\n")
        os.close(writes)
        assert table.load(f"/dev/fd/{reads}").columns["plate_angle_deg"].tolist() == [60.0, 70.0, 50.0]
    finally:
        os.close(reads)
    os.mkfifo(tmp_path / "p.csv")
    with pytest.raises(InputError, match=r"p\.csv: is empty"):
        table.load(tmp_path / "p.csv")


@pytest.fixture(params=["device", "pipe", "socket"])
def endless(request, tmp_path):
    """Makes something under a name that is no file, and says what it is."""

    def make(name):
        path = tmp_path / name
        if request.param == "device":
            path.symlink_to("/dev/zero")
        elif request.param == "pipe":
            os.mkfifo(path)
        else:
            with socket.socket(socket.AF_UNIX) as listener:
                listener.bind(str(path))
        return path, request.param

    return make


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".log.gz", ".blf.gz"])
def test_a_log_is_a_file_or_a_pipe_that_gives_something(suffix, endless, monkeypatch):
    monkeypatch.setattr(bounded, "TIMEOUT_S", 0.01)
    path, kind = endless(f"x{suffix}")
    text = suffix.removesuffix(".gz") in text_logs.TEXT_SUFFIXES
    said = f"x{suffix}: is a {kind}; expected a CAN log that is a file{' or a pipe' if text else ''}$"
    if text and kind == "pipe":
        said = f"x{suffix}: is a pipe that gives nothing within 0 s; expected a file, or a pipe with a writer$"
        require_log(path)
    else:
        with pytest.raises(InputError, match=said):
            require_log(path)
    for read in (load_frames, lambda log: list(read_log(log))):
        with pytest.raises(InputError, match=said):
            read(path)


@pytest.mark.parametrize("suffix", [".log", ".log.gz"])
def test_a_text_log_comes_through_a_pipe(suffix, tmp_path):
    path = tmp_path / f"x{suffix}"
    os.mkfifo(path)
    content = b"(1.0) can0 123#0102\n" * 3
    for read in (load_frames, lambda log: list(read_log(log))):
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with path.open("wb") as pipe:
            require_log(path)
            pipe.write(gzip.compress(content) if suffix.endswith(".gz") else content)
            pipe.flush()
            found = []
            thread = threading.Thread(target=lambda: found.append(read(path)))  # noqa: B023 - ends within the turn
            thread.start()
            while thread.is_alive() and not _taken(reader):
                time.sleep(0.001)
        thread.join()
        os.close(reader)
        assert len(found[0]) == 3


def _taken(reader: int) -> bool:
    """Whether a pipe is empty."""
    waiting = array.array("i", [0])
    fcntl.ioctl(reader, termios.FIONREAD, waiting)
    return waiting[0] == 0


_FRAMES = {
    ".log": ("", "(1.0) can0 123#0102"),
    ".csv": (
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n",
        "1.0,0x123,0,0,0,2,AQI=",
    ),
    ".asc": (
        "date Tue Nov 24 12:00:00.000 am 2026\nbase hex  timestamps absolute\ninternal events logged\n",
        "   1.000000 1  123             Rx   d 2 01 02",
    ),
    ".trc": (";$FILEVERSION=1.1\n;$STARTTIME=43008.92\n", "     1)      1000.0  Rx         0123  2  01 02"),
}


def _log_with(tmp_path: Path, suffix: str, long: int, packed: bool) -> tuple[Path, int]:
    """A frame, a line of so many bytes and another frame; the number of the long line."""
    header, frame = _FRAMES[suffix]
    content = f"{header}{frame}\n{'7' * long}\n{frame}\n".encode()
    path = tmp_path / (f"x{suffix}.gz" if packed else f"x{suffix}")
    path.write_bytes(gzip.compress(content) if packed else content)
    return path, header.count("\n") + 2


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "gz"])
@pytest.mark.parametrize("suffix", _FRAMES)
def test_a_line_without_an_end_ends_the_reading(suffix, packed, tmp_path, monkeypatch):
    monkeypatch.setattr(text_logs, "LONGEST_SKIPPED_BYTES", 40_000)
    path, line = _log_with(tmp_path, suffix, 200_000, packed)
    notes = LogNotes()
    frames = list(read_log(path, notes))
    assert [bytes(frame.data) for frame in frames] == [b"\x01\x02"]
    assert [str(damage) for damage in notes.damages] == [f"{path}:{line}: a line longer than 0 MB; reading stopped"]
    in_blocks = LogNotes()
    blocks = list(iter_blocks(path, in_blocks, chunk_bytes=5_000))
    assert sum(len(block) for block in blocks) == 1
    assert in_blocks.damages == notes.damages


@pytest.mark.parametrize("suffix", _FRAMES)
def test_a_long_line_that_ends_costs_itself_alone(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr(text_logs, "LONGEST_SKIPPED_BYTES", 40_000)
    path, line = _log_with(tmp_path, suffix, 30_000, packed=False)
    notes = LogNotes()
    assert len(list(read_log(path, notes))) == 2
    assert [str(damage) for damage in notes.damages] == [f"{path}:{line}: line longer than 4096 bytes"]
    in_blocks = LogNotes()
    assert sum(len(block) for block in iter_blocks(path, in_blocks, chunk_bytes=5_000)) == 2
    assert in_blocks.damages == notes.damages


_TABLES = {
    "table": ("plate_angle_deg,mass_flow_kg_s,force_n\n60,5,12\n", ".csv", table.load, "a plain CSV file"),
    "tickets": ("load,weighed_kg\n1,12000\n", ".csv", ticket_file.load, "a plain CSV file"),
    "harvest": (
        "longitude_deg,latitude_deg,mass_flow_kg_s\n11,48,5\n",
        ".csv",
        lambda path: sources.read(path, ReadOptions()),
        "a delimited text file",
    ),
    "seconds": ("number,time_s\n1,2\n", ".csv", recorded.read_seconds, "a table that `yieldmon process` wrote"),
    "seconds-jsonl": ('{"number": 1}\n{"number": 2}\n', ".jsonl", recorded.read_seconds, "a table that `yieldmon process` wrote"),
}


@pytest.mark.parametrize("name", _TABLES)
def test_a_tables_line_is_read_up_to_a_limit(name, tmp_path, monkeypatch):
    begin, suffix, read, expected = _TABLES[name]
    monkeypatch.setattr(bounded, "LONGEST_LINE", 1000)
    path = tmp_path / f"t{suffix}"
    path.write_text(f"{begin}{'7' * 1001}", encoding="utf-8")
    with pytest.raises(InputError, match=f"{suffix}: line 3: has more than 1000 characters; expected {expected}$"):
        read(path)


def test_a_truth_tables_line_too(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bounded, "LONGEST_LINE", 1000)
    monkeypatch.setattr(recorded, "read_seconds", lambda path: [object()])
    (tmp_path / "truth.csv").write_text(f"time_s\n{'7' * 1001}", encoding="utf-8")
    assert main(["plot", "flow", "r.csv", "--truth", str(tmp_path / "truth.csv"), "--out", str(tmp_path / "o.png")]) == 2
    assert "truth.csv: line 2: has more than 1000 characters" in capsys.readouterr().err


def test_stops_at_the_limit_exactly(monkeypatch):
    monkeypatch.setattr(bounded, "LONGEST_LINE", 10)
    assert bounded.split("1234567890\n12", "f", "text") == ["1234567890", "12"]
    with pytest.raises(InputError, match=r"^f: line 2: has more than 10 characters; expected text$"):
        bounded.split("1\n12345678901\n", "f", "text")


@pytest.mark.parametrize("name", ["x.csv", "x.jsonl", "x.parquet", "x.sqlite", "x.db"])
def test_a_record_that_is_no_file_is_named_as_what_it_is(name, endless):
    path, kind = endless(name)
    with pytest.raises(InputError, match=f"{name}: is a {kind}; expected "):
        recorded.read_seconds(path)


def test_task_data_are_read_up_to_a_limit(tmp_path):
    path = tmp_path / "TASKDATA.XML"
    path.write_bytes(b'<ISO11783_TaskData VersionMajor="4">')
    os.truncate(path, (1 << 30) + 1)
    with pytest.raises(InputError, match="larger than 1073741824 bytes"):
        sources.read(path, ReadOptions())


def test_a_workbook_that_unpacks_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(delimited, "LARGEST_BYTES", 1_000_000)
    book = io.BytesIO()
    with zipfile.ZipFile(book, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("xl/workbook.xml", "xl/worksheets/sheet1.xml"):
            archive.writestr(name, bytes(600_000))
    (tmp_path / "t.xlsx").write_bytes(book.getvalue())
    with pytest.raises(InputError, match=r"t\.xlsx: unpacks to 1 MB; expected at most 1 MB$"):
        table.load(tmp_path / "t.xlsx")


def test_an_object_of_a_blf_that_says_gigabytes_is_not_read(tmp_path):
    path = tmp_path / "x.blf"
    with can.Logger(path) as logger:
        logger.on_message_received(can.Message(timestamp=1.7e9, arbitration_id=0x123, data=b"\x01"))
    whole = path.read_bytes()
    begin = whole.index(b"LOBJ")
    path.write_bytes(whole + whole[begin : begin + 8] + (0xFFFF_0000).to_bytes(4, "little") + whole[begin + 12 :])
    os.truncate(path, 5_000_000_000)
    notes = LogNotes(on_damage=lambda damage: None)
    begun_s = time.process_time()
    assert [frame.arbitration_id for frame in read_log(path, notes)] == [0x123]
    assert time.process_time() - begun_s < 1.0
    assert [damage.problem for damage in notes.damages] == ["an object of 4294901760 bytes; reading stopped"]
