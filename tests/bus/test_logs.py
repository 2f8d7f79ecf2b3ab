"""Every log format written by python-can and read back, every candump dialect, and every kind of damage."""

from __future__ import annotations

import contextlib
import gzip
import itertools
import shutil
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.machinery import PathFinder
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.bus.log_files import read, write
from tests.extras import MF4
from tests.file_limit import files_end_at
from tests.whole_logs import load_frames
from yieldmon.bus.log_files.candump import parse_line
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.log_writing import writing
from yieldmon.bus.log_files.logs import read_log
from yieldmon.cli import main as cli
from yieldmon.errors import InputError

FORMATS = [
    *(".log", ".asc", ".csv", ".trc", ".blf", ".db"),
    pytest.param(".mf4", marks=MF4),
]
TEXT_FORMATS = [".log", ".csv", ".trc", ".asc"]
START_S = 1_700_000_000.0


def sample_log() -> list[can.Message]:
    """Frames that every format can hold, 4 ms apart, channels left out."""
    return [
        can.Message(
            timestamp=START_S + 0.004 * k,
            arbitration_id=0x08FF1081 if k % 3 else 0x123,
            is_extended_id=bool(k % 3),
            data=bytes((k + j) % 256 for j in range(8 if k % 3 else k % 9)),
        )
        for k in range(60)
    ]


def essence(messages) -> list[tuple]:
    return [(m.arbitration_id, m.is_extended_id, m.is_remote_frame, m.is_error_frame, bytes(m.data)) for m in messages]


def refusal(path: Path, messages: list[can.Message], notes: LogNotes) -> str:
    """Reads into `messages`; the text of the InputError, empty when there was none."""
    try:
        messages.extend(read_log(path, notes))
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "gzipped"])
@pytest.mark.parametrize("suffix", FORMATS)
def test_round_trip(tmp_path: Path, suffix: str, packed: bool) -> None:
    path = write(tmp_path / f"drive{suffix}", sample_log())
    if packed:
        with path.open("rb") as plain, gzip.open(tmp_path / f"drive{suffix}.gz", "wb") as out:
            shutil.copyfileobj(plain, out)
        path = tmp_path / f"drive{suffix}.gz"
    messages, notes = read(path)
    assert essence(messages) == essence(sample_log())
    assert (notes.frames, notes.damaged_places) == (60, 0)
    steps = [later.timestamp - first.timestamp for first, later in itertools.pairwise(messages)]
    assert steps == pytest.approx([0.004] * 59, abs=2e-6)


@pytest.fixture
def zone_of_the_computer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    def put(zone: str) -> None:
        monkeypatch.setenv("TZ", zone)
        time.tzset()

    yield put
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize("written", ["America/New_York", "Asia/Kolkata"])
@pytest.mark.parametrize("suffix", [*FORMATS, ".asc.gz"])
def test_times_do_not_depend_on_the_time_zone_of_a_computer(
    tmp_path: Path, suffix: str, written: str, zone_of_the_computer: Callable[[str], None]
) -> None:
    zone_of_the_computer(written)
    path = write(tmp_path / f"drive{suffix}", sample_log())
    for elsewhere in (written, "UTC"):
        zone_of_the_computer(elsewhere)
        assert [m.timestamp for m in read(path)[0]] == pytest.approx([m.timestamp for m in sample_log()], abs=2e-3)


@MF4[0]
@MF4[1]
def test_a_gzipped_mf4_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a log \.mf4 cannot be gzipped while it is written"):
        write(tmp_path / "drive.mf4.gz", sample_log())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".log", ".asc", ".csv", ".trc"])
@pytest.mark.parametrize("stem", ["drive", "north.2026.10.06"])
def test_a_log_that_is_gzipped_while_it_is_written(tmp_path: Path, stem: str, suffix: str) -> None:
    assert essence(read(write(tmp_path / f"{stem}{suffix}.gz", sample_log()))[0]) == essence(sample_log())


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_long_log_is_written_to_its_last_frame(tmp_path: Path, suffix: str) -> None:
    messages = sample_log() * 100
    assert essence(read(write(tmp_path / f"drive{suffix}", messages))[0]) == essence(messages)


def test_a_full_medium_is_reported_with_the_logs_name(tmp_path: Path) -> None:
    path = tmp_path / "full.log"
    path.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        write(path, sample_log() * 100)
    assert caught.value.filename == str(path)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_database_that_cannot_be_written_ends_with_an_error(tmp_path: Path) -> None:
    """Its writer is a thread of its own, which dies by itself."""
    path = tmp_path / "folder.db"
    path.mkdir()
    with pytest.raises(OSError, match="not all frames could be written") as caught, writing(path) as logger:
        logger.on_message_received(sample_log()[0])
    assert caught.value.filename == str(path)


def test_mf4_without_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    monkeypatch.setattr(PathFinder, "find_spec", lambda name, path=None, target=None: None)
    (tmp_path / "drive.mf4").write_bytes(b"MDF     4.10    ")
    with pytest.raises(ModuleNotFoundError) as caught:
        list(read_log(tmp_path / "drive.mf4"))
    assert caught.value.name == "asammdf"


@MF4[0]
@MF4[1]
@pytest.mark.parametrize("frames_taken", [None, 3], ids=["read to its end", "left early"])
def test_an_mf4_that_its_recorder_has_not_finalised_leaves_no_copy_behind(
    frames_taken: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, copies = tmp_path / "drive.mf4", tmp_path / "temporary"
    write(log, sample_log())
    content = bytearray(log.read_bytes())
    content[:8], content[60:62] = b"UnFinMF ", (1).to_bytes(2, "little")  # cycle counters are to be updated
    log.write_bytes(content)
    copies.mkdir()
    monkeypatch.setenv("TMPDIR", str(copies))
    monkeypatch.setattr(tempfile, "tempdir", None)
    frames = read_log(log)
    assert len(list(itertools.islice(frames, frames_taken))) == (frames_taken or len(sample_log()))
    frames.close()
    assert list(copies.iterdir()) == []


@MF4[0]
@MF4[1]
def test_a_damaged_mf4_on_which_its_reader_goes_in_circles_comes_to_an_end_within_a_second() -> None:
    with pytest.raises(InputError, match="its reader makes no progress"):
        read(Path(__file__).with_name("data") / "endless.mf4")


@MF4[0]
@MF4[1]
def test_a_bus_that_repeats_itself_makes_a_small_mf4_of_many_frames_all_of_which_are_read() -> None:
    """By python-can: 60,000 frames of eight zero bytes, a millisecond apart."""
    path = Path(__file__).with_name("data") / "idle.mf4"
    assert path.stat().st_size < 25_000
    assert len(read(path)[0]) == 60_000


CANDUMP = [
    ("(1436509052.249713) can0 123#2A366C2BBA", 0x123, "2A366C2BBA", {}),
    ("(1436509052.249713) can0 18FF1380#0102030405060708", 0x18FF1380, "0102030405060708", {"is_extended_id": True}),
    ("(1436509052.249713) can0 18ff1380#ab", 0x18FF1380, "AB", {"is_extended_id": True}),
    ("(1436509052.249713) can0 123#11.22.33", 0x123, "112233", {}),
    ("(1436509052.249713) can0 123#", 0x123, "", {"dlc": 0}),
    ("(1436509052.249713) can0 123#AA R", 0x123, "AA", {"is_rx": True}),
    ("(1436509052.249713) can0 123#AA T", 0x123, "AA", {"is_rx": False}),
    ("(1436509052.249713) can0 123#1122334455667788_E", 0x123, "1122334455667788", {"dlc": 8}),
    ("(1436509052.249713) can0 123#R", 0x123, "", {"is_remote_frame": True, "dlc": 0}),
    ("(1436509052.249713) can0 123#R5", 0x123, "", {"is_remote_frame": True, "dlc": 5}),
    ("(1436509052.249713) can0 123##1" + "0A" * 12, 0x123, "0A" * 12, {"is_fd": True, "bitrate_switch": True}),
    ("(1436509052.249713) can0 123##2AA", 0x123, "AA", {"is_fd": True, "error_state_indicator": True}),
    ("(1436509052.249713) can0 20000004#0001000000000000", 4, "0001000000000000", {"is_error_frame": True}),
    ("(1436509052.249713) can0 20000088#0000000000000000 R", 0x88, "00" * 8, {"is_error_frame": True}),
    ("(1436509052.249713)  can0  123   [2]  2A 36", 0x123, "2A36", {}),
    ("(1436509052.249713)  can0  18FF1380   [0]", 0x18FF1380, "", {"is_extended_id": True}),
    ("(1436509052.249713)  can0  123   [1]  41   'A'", 0x123, "41", {}),
    ("(2015-07-10 06:17:32.249713)  can0  123   [1]  41", 0x123, "41", {}),
    ("(1436509052.249713)  can0  123   [4]  remote request", 0x123, "", {"is_remote_frame": True, "dlc": 4}),
    ("(1436509052.249713)  can0  TX - -  123   [1]  2A", 0x123, "2A", {"is_rx": False}),
    ("(1436509052.249713)  can0  123  [12]  " + "0A " * 11 + "0A", 0x123, "0A" * 12, {"is_fd": True}),
    (
        "(1436509052.249713)  can0  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME",
        4,
        "0001" + "00" * 6,
        {"is_error_frame": True},
    ),
]


@pytest.mark.parametrize(("line", "arbitration_id", "data", "more"), CANDUMP, ids=[entry[0][20:] for entry in CANDUMP])
def test_candump_dialects(line: str, arbitration_id: int, data: str, more: dict) -> None:
    message = parse_line(line)
    assert (message.arbitration_id, bytes(message.data).hex().upper()) == (arbitration_id, data)
    assert (message.timestamp, message.channel) == (1436509052.249713, "can0")
    expected = {"is_extended_id": False, "is_remote_frame": False, "is_error_frame": False, "is_fd": False} | more
    assert {name: getattr(message, name) for name in expected} == expected


@pytest.mark.parametrize("digits", ["5", "249713", "249713456"])
def test_candump_fraction_digits(digits: str) -> None:
    assert parse_line(f"(1436509052.{digits}) can0 123#").timestamp == float(f"1436509052.{digits}")


@pytest.mark.parametrize(
    "line",
    [
        "(1436509052.249713) can0 123",
        "(1436509052.249713) can0 123#1",
        "(1436509052.249713) can0 123#112233445566778899",
        "(1436509052.249713) can0 1234#11",
        "(1436509052.249713) can0 800#11",
        "(1436509052.249713) can0 40000123#11",
        "(1436509052.249713) can0 123##1" + "00" * 65,
        "(1436509052.249713) can0 123##1" + "00" * 9,
        "(1436509052.249713) can0 123#XY",
        "(14365x9052.249713) can0 123#11",
        "1436509052.249713 can0 123#11",
        "(1436509052.249713)  can0  123   [3]  2A 36",
        "(1436509052.249713) can0 123#11 R extra",
    ],
)
def test_candump_damage(line: str) -> None:
    assert parse_line(line) is None


@given(st.text(max_size=80))
@settings(max_examples=300)
def test_candump_parser_takes_any_text(line: str) -> None:
    parse_line(line)


def test_damaged_candump_lines_are_reported_and_the_rest_is_read(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    good = b"(1.000000) can0 123#01\n"
    path.write_bytes(
        good
        + b"(1.000000) can0 12\n"
        + b"DROPCOUNT: dropped 37 CAN frames on 'can0' socket (total drops 37)\n"
        + b"\n"
        + b"\x00\x01\xff\xfe binary\n"
        + b"(2.000000) can0 20000080#0000000000000000 R\r\n"
        + b"(3.0) can0 "
        + b"A" * 300_000
        + b"\n"
        + b"(3.0) can0 123#\xe4\n"
        + good
        + b"(4.000000) can0 123#0"
    )
    messages, notes = read(path)
    assert [(m.timestamp, m.is_error_frame) for m in messages] == [(1.0, False), (2.0, True), (1.0, False)]
    assert (notes.frames, notes.error_frames, notes.dropped_by_recorder, notes.damaged_places) == (3, 1, 37, 5)
    assert [damage.where for damage in notes.damages] == [f"{path}:{line}" for line in (2, 5, 7, 8, 10)]
    assert "longer than 4096 bytes" in notes.damages[2].problem
    assert "0x00" in notes.damages[1].problem


def test_error_frames_of_a_blf_are_no_damage_whatever_their_length_says(tmp_path: Path) -> None:
    """Vector's converter writes a length code of 15 where there are no data; each error frame was a damaged place."""
    path = tmp_path / "errors.blf"
    with can.BLFWriter(path) as writer:
        writer.on_message_received(can.Message(timestamp=1.0, arbitration_id=0x123, is_extended_id=False, data=b"\x07"))
        writer.on_message_received(can.Message(timestamp=2.0, is_error_frame=True, dlc=15, data=bytes(8)))
    notes = LogNotes()
    assert [message.is_error_frame for message in read_log(path, notes)] == [False, True]
    assert (notes.error_frames, notes.damages) == (1, [])


def test_what_candump_says_of_error_frames_is_no_damage(tmp_path: Path) -> None:
    """Three damaged places for each error frame of a recording with -e."""
    path = tmp_path / "e.log"
    path.write_text(
        " (1700000000.000100)  can0  200001AC   [8]  00 10 80 19 00 00 80 00   ERRORFRAME\n"
        "\tcontroller-problem{rx-error-passive,tx-error-passive}\n\tprotocol-violation{{error-on-tx}{acknowledge-slot}}\n"
        "\tno-acknowledgement-on-tx\n\tbus-error\n\terror-counter-tx-rx{{128}{0}}\n"
        " (1700000000.000200)  can0  RX - -  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME\n\tbus-off\n"
        "\tbus-on\n"
    )
    found, notes = read(path)
    assert [message.is_error_frame for message in found] == [True, True]
    assert [str(damage) for damage in notes.damages] == [f"{path}:9: 'bus-on' is not a candump line"]


def test_comments_in_candumps_logs_are_no_damage(tmp_path: Path) -> None:
    """As people keep a recording's notes with it; what is left of a cut line is none."""
    path = tmp_path / "a.txt"
    path.write_text("# NMEA 2000 bus, tractor 3\n#\n(1.000000) can0 123#01\n# stop\n#0102\n(2.000000) can0 123#01\n")
    found, notes = read(path)
    assert len(found) == len(load_frames(path).time_s) == 2
    assert [str(damage) for damage in notes.damages] == [f"{path}:5: '#0102' is not a candump line"]
    path.write_text("# screen\n  can0  09F8027F   [2]  00 FC\n")
    with pytest.raises(InputError, match=r"a.txt:2: 'can0 09F8027F .2. 00 FC' has no time; record with `candump -L`"):
        read(path)


DELTAS = (0.0, 0.004, 0.0001, 0.004, 0.0, 0.0032, 0.004, 0.1)


@pytest.mark.parametrize(
    ("times", "refused"),
    [
        (DELTAS * 20, True),
        (DELTAS, False),
        ([166.0] * 100 + [167.0] * 100, False),
        # Two channels, a batch of each in turn.
        ([0.01 * (place // 20) + 0.001 * (place % 10) for place in range(200)], False),
        ([1.79e9 + time_s for time_s in DELTAS * 20], False),
    ],
)
@pytest.mark.parametrize("line", ["({:010.6f}) can0 123#01\n", " ({:010.6f})  can0  123   [1]  01\n"])
def test_times_since_the_frame_before_are_refused(times: list[float], refused: bool, line: str, tmp_path: Path) -> None:
    """Of `candump -t d`; its log gave no second and no mass, and no word of it."""
    path = tmp_path / "a.log"
    path.write_text("".join(line.format(time_s) for time_s in times))
    for reader in (read, load_frames):
        with (
            pytest.raises(InputError, match="its times are each since the frame before") if refused else contextlib.nullcontext()
        ):
            reader(path)


@pytest.mark.parametrize("line", ["  can0  18FF1380   [3]  01 02 03", "  can0  TX - -  123   [0]  remote request"])
def test_candump_without_times_is_refused_with_how_to_record(line: str, tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(f"{line}\n{line}\n")
    with pytest.raises(InputError, match=r"has no time; record with `candump -L`; no frame in the whole file"):
        read(path)


@pytest.mark.parametrize("suffix", TEXT_FORMATS)
@pytest.mark.parametrize("junk", [b"\x00\xff\x01\n", b"x" * 9000 + b"\n"], ids=["binary", "huge"])
def test_a_damaged_line_in_any_text_format_costs_that_line(tmp_path: Path, suffix: str, junk: bytes) -> None:
    path = write(tmp_path / f"drive{suffix}", sample_log())
    lines = path.read_bytes().splitlines(keepends=True)
    place = len(lines) // 2
    lines.insert(place, junk)
    path.write_bytes(b"".join(lines))
    messages, notes = read(path)
    assert essence(messages) == essence(sample_log())
    assert [damage.where for damage in notes.damages] == [f"{path}:{place + 1}"]


@pytest.mark.parametrize(
    ("suffix", "old", "new"),
    [
        (".csv", b",0x8ff1081,1,0,0,8,", b",0xnonsense,1,0,0,8,"),
        (".csv", b",0x8ff1081,1,0,0,8,", b",0x8ff1081,1,0,0,80,"),
        (".csv", b",0x8ff1081,1,0,0,8,", b",0xFFFFFFFFFF,1,0,0,8,"),
        (".csv", b",0x8ff1081,1,0,0,8,", b","),
        (".trc", b" 8FF1081 ", b" 8XX1081 "),
        (".trc", b"Rx -  8 ", b"Rx -  9 "),
        (".asc", b"8FF1081x", b"8XX1081x"),
        (".log", b"08FF1081#", b"08XX1081#"),
    ],
)
def test_a_wrong_field_costs_its_line(tmp_path: Path, suffix: str, old: bytes, new: bytes) -> None:
    path = write(tmp_path / f"drive{suffix}", sample_log())
    lines = path.read_bytes().splitlines(keepends=True)
    victim = [number for number, line in enumerate(lines) if old in line][20]
    lines[victim] = lines[victim].replace(old, new)
    path.write_bytes(b"".join(lines))
    messages, notes = read(path)
    assert len(messages) == 59
    assert [damage.where for damage in notes.damages] == [f"{path}:{victim + 1}"]


@pytest.mark.parametrize("suffix", [f"{name}.gz" for name in TEXT_FORMATS])
def test_cut_off_gzip_gives_what_is_there(tmp_path: Path, suffix: str) -> None:
    long_log = sample_log() * 200
    plain = write(tmp_path / f"drive{suffix.removesuffix('.gz')}", long_log)
    packed = gzip.compress(plain.read_bytes())
    path = tmp_path / f"drive{suffix}"
    path.write_bytes(packed[: len(packed) // 2])
    messages, notes = read(path)
    assert 100 < len(messages) < len(long_log)
    assert essence(messages) == essence(long_log)[: len(messages)]
    assert "the compressed data end early" in notes.damages[-1].problem


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (gzip.compress(b"(1.0) can0 123#11\n")[:-8] + bytes(8), "incorrect data check"),
        (gzip.compress(b"(1.0) can0 123#11\n") + b"junk", "no compressed data follow"),
        (gzip.compress(b"(1.0) can0 123#11\n") + bytes(100), None),
        (gzip.compress(b"(1.0) can0 123#11\n") + gzip.compress(b"(1.0) can0 123#11\n"), None),
    ],
    ids=["checksum", "junk behind", "zeros behind", "two members"],
)
def test_ends_of_gzip(tmp_path: Path, content: bytes, problem: str | None) -> None:
    path = tmp_path / "drive.log.gz"
    path.write_bytes(content)
    notes = LogNotes(on_damage=lambda damage: None)
    refusal(path, [], notes)
    assert notes.damaged_places == (problem is not None)
    assert problem is None or problem in notes.damages[0].problem


@pytest.mark.parametrize(
    ("lines", "reported"), [("rain\nhail\n", 0), ("rain\nhail\n(1.0) can0 123#11\n", 2), ("(1.0) can0 123#11\nrain\n", 1)]
)
def test_damage_of_a_file_that_is_no_log_is_reported_in_its_error_alone(tmp_path: Path, lines: str, reported: int) -> None:
    path, seen = tmp_path / "drive.log", []
    path.write_text(lines)
    for read_frames in (read_log, iter_blocks):
        seen.clear()
        notes = LogNotes(on_damage=seen.append)
        with contextlib.suppress(InputError):
            list(read_frames(path, notes))
        assert [len(seen), notes.damaged_places] == [reported, lines.count("\n") - notes.frames]


def damaged(content: bytes, how: str) -> bytes:
    half = len(content) // 2
    return {
        "cut off": content[:half],
        "junk in the middle": content[:half] + b"\xa5" * 2000 + content[half + 2000 :],
        "junk at the end": content[:-3000] + b"\xa5" * 3000,
    }[how]


@pytest.fixture(scope="module")
def long_log() -> list[can.Message]:
    return [
        can.Message(
            timestamp=START_S + 0.001 * k,
            arbitration_id=k * 7919 % 0x1FFFFFFF,
            data=(k * 2654435761 % 2**64).to_bytes(8),
        )
        for k in range(40_000)
    ]


@pytest.fixture(scope="module")
def whole(long_log: list[can.Message], tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The same log in each binary format."""
    folder = tmp_path_factory.mktemp("whole")
    return {suffix: write(folder / f"whole{suffix}", long_log).read_bytes() for suffix in (".blf", ".db")}


@pytest.mark.parametrize("how", ["cut off", "junk in the middle", "junk at the end"])
@pytest.mark.parametrize("suffix", [".blf", ".db", ".blf.gz", ".db.gz"])
def test_damaged_binary_format_is_reported_with_its_place(
    tmp_path: Path, long_log: list[can.Message], whole: dict[str, bytes], suffix: str, how: str
) -> None:
    content = damaged(whole[suffix.removesuffix(".gz")], how)
    path = tmp_path / f"drive{suffix}"
    path.write_bytes(gzip.compress(content, 1) if suffix.endswith(".gz") else content)
    messages: list[can.Message] = []
    notes = LogNotes(on_damage=lambda damage: None)
    refused = refusal(path, messages, notes)
    assert ("no frame in the whole file" in refused) is (not messages)
    assert notes.damaged_places == 1
    assert notes.damages[0].where.startswith(f"{path}: ")
    assert len(messages) < len(long_log)
    assert essence(messages) == essence(long_log)[: len(messages)]


@pytest.mark.parametrize("lines", [1, 2, 3, 5])
def test_a_trc_that_ends_in_its_header_is_one_damage(tmp_path: Path, lines: int) -> None:
    """As a power cut leaves it; python-can's reader wants the columns, again and again."""
    whole = write(tmp_path / "whole.trc", [can.Message(timestamp=START_S, arbitration_id=1, data=b"1")]).read_bytes()
    path = tmp_path / "drive.trc"
    path.write_bytes(b";$FILEVERSION=2.1\n" + b"".join(whole.splitlines(keepends=True)[1:lines]).replace(b"COLUMNS", b"COLUMN"))
    messages: list[can.Message] = []
    notes = LogNotes(on_damage=lambda damage: None)
    assert "no frame in the whole file" in refusal(path, messages, notes)
    assert notes.damaged_places == 1


@pytest.mark.parametrize("size", [0, 1, 31])
def test_an_object_of_a_blf_that_has_no_length_ends_the_reading(tmp_path: Path, long_log: list[can.Message], size: int) -> None:
    """python-can would read it again and again."""
    path = tmp_path / "drive.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for message in long_log[:6000]:
            writer.on_message_received(message)
    content = bytearray(path.read_bytes())
    at = content.rindex(b"LOBJ") + 8
    content[at : at + 4] = size.to_bytes(4, "little")
    path.write_bytes(content)
    messages: list[can.Message] = []
    notes = LogNotes(on_damage=lambda damage: None)
    assert refusal(path, messages, notes) == ""
    assert [damage.problem for damage in notes.damages] == [f"an object of {size} bytes; reading stopped"]
    assert 0 < len(messages) < 6000
    assert essence(messages) == essence(long_log)[: len(messages)]


@pytest.mark.parametrize("content", [b"\xa5" * 5000, b"no log at all\n" * 50], ids=["binary", "text"])
@pytest.mark.parametrize("suffix", [".log", ".csv", ".blf", ".db", ".log.gz", ".blf.gz", ".db.gz"])
def test_nothing_readable_is_an_input_error(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"drive{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no frame in the whole file") as caught:
        read(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("absent.log", None, "No such file"),
        ("absent.db", None, "No such file"),
        ("drive.erf", b"", r"unknown log format; expected one of \.log"),
        ("drive", b"", "unknown log format"),
        ("drive.gz", b"", "unknown log format"),
        ("drive.log", "(1.0) can0 123#\n".encode("utf-16"), "UTF-16 text; expected UTF-8"),
    ],
)
def test_unusable_files(tmp_path: Path, name: str, content: bytes | None, problem: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=problem):
        read(tmp_path / name)
    assert content is not None or not (tmp_path / name).exists()


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "drive.log").mkdir()
    with pytest.raises(InputError, match="Is a directory"):
        read(tmp_path / "drive.log")


def test_empty_log_has_no_frames(tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_bytes(b"")
    assert read(tmp_path / "drive.log")[0] == []


def test_utf8_mark_is_no_damage(tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_bytes(b"\xef\xbb\xbf(1.0) can0 123#11\n")
    messages, notes = read(tmp_path / "drive.log")
    assert (len(messages), notes.damaged_places) == (1, 0)


@given(st.binary(max_size=400))
@settings(max_examples=150)
@pytest.mark.parametrize("suffix", [".log", ".csv", ".trc", ".asc", ".blf", ".pcap", ".pcapng"])
def test_any_bytes_give_frames_or_an_input_error(tmp_path_factory, suffix: str, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    path.write_bytes(content)
    refused = refusal(path, [], LogNotes(on_damage=lambda damage: None))
    assert not refused or refused.startswith(str(path))


@pytest.mark.parametrize("frames", [60, 6000])
def test_a_database_that_outgrows_its_medium_is_reported_with_the_logs_name(tmp_path: Path, frames: int, capfd) -> None:
    """Also where only the last frames fail, which its writer writes when it is closed."""
    path = tmp_path / "drive.db"
    with pytest.raises(OSError, match="not all frames could be written") as caught, files_end_at(8192):
        write(path, sample_log() * (frames // 60))
    assert caught.value.filename == str(path)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("data", ["434041037028460038", "8", "'text'", "NULL", "1.5"])
def test_a_database_whose_data_are_no_bytes_is_read_as_far_as_they_are(tmp_path: Path, data: str) -> None:
    """A bytearray of a number is as many zeros, or more than there is memory."""
    path, frames, damage = tmp_path / "drive.db", sample_log(), []
    write(path, frames)
    with sqlite3.connect(path) as database:
        database.execute(f"UPDATE messages SET data = {data} WHERE rowid = 7")
    database.close()
    read = list(read_log(path, LogNotes(on_damage=damage.append)))
    assert len(read) == 6
    [told] = [str(note) for note in damage]
    assert told.startswith(f"{path}: frame 7")
    assert "its data are not bytes" in told


@pytest.mark.parametrize(
    ("name", "mend"),
    [
        ("drive.log.xz", "`unxz drive.log.xz` first"),
        ("drive.zip", "`unzip drive.zip` first"),
        ("drive.dump", "give it the ending of its format, .log for candump's lines"),
        ("00000005.MFC", "convert 00000005.MFC to .mf4 with CSS Electronics' MDF4 converters first"),
        ("LOG00000.KMF", "export LOG00000.KMF as .mf4, .asc or .csv with Kvaser's converter first"),
        ("drive.vsb", "export drive.vsb as .csv or .asc with Vehicle Spy first"),
        ("drive.mdf", "give it the ending .mf4 if it is MDF 4"),
        ("drive.log.2", "give drive.log.2 the ending of its format last, as in drive.1.log"),
    ],
)
def test_a_file_of_another_ending_is_told_what_to_do(tmp_path: Path, name: str, mend: str, capsys) -> None:
    (tmp_path / name).write_bytes(b"any")
    assert cli.main(["process", str(tmp_path / name), "--out", str(tmp_path / "o.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "unknown log format; expected one of .log" in line
    assert f"; {mend}" in line


def test_an_mdf_of_version_3_is_named(tmp_path: Path, capsys) -> None:
    path = tmp_path / "signals.mf4"
    path.write_bytes(b"MDF     3.30    amdf    ".ljust(200, b"\0"))
    assert cli.main(["process", str(path), "--out", str(tmp_path / "o.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "MDF of version 3.30, which holds signals and no frames" in line


@pytest.mark.parametrize("suffix", [".csv", ".db"])
def test_long_frames_of_a_format_without_a_mark_for_them_are_can_fd(tmp_path: Path, suffix: str) -> None:
    """python-can's writers of these formats do not say which frames are CAN FD's."""
    path = tmp_path / f"fd{suffix}"
    frames = [
        can.Message(timestamp=1e9 + k, arbitration_id=0x123, data=bytes(range(length)), is_fd=length > 8)
        for k, length in enumerate((8, 12, 24, 64, 2))
    ]
    write(path, frames)
    notes = LogNotes()
    assert [(bytes(m.data), m.is_fd) for m in read_log(path, notes)] == [(bytes(m.data), m.is_fd) for m in frames]
    assert notes.damaged_places == 0


def test_an_asc_without_a_header_keeps_its_first_frame(tmp_path: Path) -> None:
    path = tmp_path / "bare.asc"
    path.write_text("   0.500000 1  8FF1081x  Rx   d 2 0A FF\n   0.504000 1  123  Rx   d 1 07\n")
    assert [(m.arbitration_id, bytes(m.data)) for m in read_log(path)] == [(0x8FF1081, b"\x0a\xff"), (0x123, b"\x07")]


def test_a_part_of_a_csv_without_its_heading_keeps_its_first_frame(tmp_path: Path) -> None:
    """As `split` makes them: python-can's reader passes over the first line, whatever it is."""
    path, frames = tmp_path / "whole.csv", [can.Message(timestamp=0.5 * k, arbitration_id=0x123, data=[k]) for k in range(3)]
    with can.CSVWriter(path) as writer:
        for frame in frames:
            writer.on_message_received(frame)
    heading, *rows = path.read_text().splitlines(keepends=True)
    (tmp_path / "part.csv").write_text("".join(rows))
    (tmp_path / "damaged.csv").write_text("".join([heading[3:], *rows]))
    for name in ("whole.csv", "part.csv", "damaged.csv"):
        assert [bytes(message.data) for message in read_log(tmp_path / name)] == [bytes(frame.data) for frame in frames]
