"""Packed frames give back what was packed, to the last bit, and say what is wrong with a file that is none."""

from __future__ import annotations

import gzip
import json
import random
from pathlib import Path

import can
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from tests.file_limit import files_end_at
from tests.fleet import logs
from tests.whole_logs import load_frames
from yieldmon.bus.bulk import FrameBlock, block_of
from yieldmon.bus.codec import Codec
from yieldmon.bus.log_files.loading import iter_blocks, logs_in
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.bus.packed.columns import DIFFERENCE, PLAIN, PREDICTION, decode, encode, place_fields
from yieldmon.bus.packed.writing import pack, pack_logs
from yieldmon.cli.main import main
from yieldmon.errors import InputError

#: gzip's own default.
GZIP_LEVEL = 6
LAYOUTS = Codec().layouts
DATA = Path(__file__).resolve().parents[1] / "data"


def content(block: FrameBlock) -> list[tuple[object, ...]]:
    names = [block.channels[index] for index in block.channel]
    times = block.time_s.view(np.uint64)
    columns = (times, block.can_id, block.length, block.payload)
    return list(zip(*(column.tolist() for column in columns), names, strict=True))


@given(
    values=st.lists(st.integers(0, 2**13 - 1), min_size=1, max_size=40),
    repeats=st.sampled_from([1, 7, 900]),
    bits=st.sampled_from([13, 14, 31, 32, 33, 63, 64]),
    sampled=st.booleans(),
)
@settings(max_examples=150)
def test_columns_come_back(values: list[int], repeats: int, bits: int, sampled: bool) -> None:
    column = np.array(values * repeats, np.uint64) << np.uint64(bits - 13)
    coded = encode(column, bits, sampled=sampled)
    for compiled in (False, True):
        found = decode(coded, column.size, bits, compiled=compiled)
        assert found.dtype == np.uint64
        assert (found == column).all()


@pytest.mark.parametrize("bits", [8, 13, 16, 32])
def test_sampled_signals_of_every_kind_come_back(bits: int) -> None:
    noise = np.random.default_rng(3)
    time = np.arange(20001)
    full = 2**bits - 1
    for wave in (
        0.5 + 0.4 * np.sin(time / 20),
        noise.random(time.size),
        (time % 700) / 700,
        np.where(time % 50 < 25, 0.0, 1.0),
        np.clip(np.cumsum(noise.normal(0, 0.01, time.size)), 0, 1),
    ):
        column = np.rint(wave * full).astype(np.uint64)
        coded = encode(column, bits, sampled=True)
        for compiled in (False, True):
            assert (decode(coded, column.size, bits, compiled=compiled) == column).all()


@pytest.mark.parametrize("starts", [(0,), (7,), (0, 13), (3, 16, 29, 42), (51, 38, 25, 12)])
def test_fields_are_put_where_they_belong(starts: tuple[int, ...]) -> None:
    """Against whole numbers of Python, bit by bit."""
    numbers = random.Random(5)
    values = [[numbers.getrandbits(13) for _ in starts] for _ in range(50)]
    column = np.array([value for frame in values for value in frame], np.uint64)
    expected = [sum(value << start for value, start in zip(frame, starts, strict=True)) for frame in values]
    for compiled in (False, True):
        payload = np.zeros(len(values), np.uint64)
        place_fields(payload, column, starts, compiled=compiled)
        assert payload.tolist() == expected


frames = st.builds(
    lambda time_s, extended, identifier, kind, data, channel: can.Message(
        timestamp=time_s,
        arbitration_id=identifier if extended else identifier & 0x7FF,
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        dlc=len(data),
        data=None if kind == "remote" else data,
        channel=channel,
    ),
    st.one_of(st.floats(0, 2e9), st.integers(0, 2 * 10**15).map(lambda micros: micros / 1e6), st.just(1.0)),
    st.booleans(),
    st.one_of(st.integers(0, 0x1FFFFFFF), st.sampled_from([layout.frame_id for layout in LAYOUTS.values()])),
    st.sampled_from(["data", "data", "remote"]),
    st.binary(max_size=8),
    st.sampled_from(["can0", "can1", None]),
)


@given(st.lists(frames, min_size=1, max_size=60))
@settings(max_examples=60)
def test_any_frames_come_back(tmp_path_factory: pytest.TempPathFactory, messages: list[can.Message]) -> None:
    path = tmp_path_factory.getbasetemp() / "any.parquet"
    block = block_of(messages)
    pack([block], path, LAYOUTS)
    assert content(load_frames(path)) == content(block)
    assert content(block_of(read_log(path))) == content(block)


def test_a_harvest_is_a_quarter_of_its_gzip_and_gives_the_same_rows(tmp_path: Path) -> None:
    log, packed = tmp_path / "day.log", tmp_path / "day.parquet"
    scenario = ["simulate", "--scenario", "demo", "--duration", "120", "--seed", "9", "--start-time", "1790000000"]
    assert main([*scenario, "--log", str(log)]) == 0
    assert main(["pack", str(log), "--out", str(packed)]) == 0
    assert packed.stat().st_size <= 0.25 * len(gzip.compress(log.read_bytes(), GZIP_LEVEL))
    for source in (log, packed):
        assert main(["process", str(source), "--out", str(tmp_path / f"{source.name}.csv")]) == 0
    assert (tmp_path / "day.log.csv").read_bytes() == (tmp_path / "day.parquet.csv").read_bytes()


_STEPS_S = (1e-6, 1e-9, 0.1 / 3.0)
"""Between the frames of a block: times in whole microseconds, in nanoseconds, and such as only a double holds."""


def _frames_of(step_s: float) -> list[can.Message]:
    """Frames of a DBC's message and of another, and a remote one."""
    known = next(layout.frame_id for layout in LAYOUTS.values() if layout.name == "ElevatorSpeed")
    first = 1_790_000_000.0 if step_s == 1e-6 else 0.0
    return [
        can.Message(
            timestamp=round(first * 1e6 + number) / 1e6 if step_s == 1e-6 else number * step_s,
            arbitration_id=known if number % 2 else 0x123,
            is_extended_id=bool(number % 2),
            is_remote_frame=number % 8 == 2,
            dlc=8,
            data=None if number % 8 == 2 else bytes((number * place) % 256 for place in range(1, 9)),
            channel=f"can{number % 3}",
        )
        for number in range(12)
    ]


def test_a_file_that_was_packed_before_is_read_as_it_was() -> None:
    """Kept on 2026-11-24 (format 2): what packs and what reads share constants, of which a round trip says nothing."""
    kept = Path(__file__).resolve().parent / "data" / "packed-2.parquet"
    assert content(load_frames(kept)) == [one for step_s in _STEPS_S for one in content(block_of(_frames_of(step_s)))]


def test_frames_out_of_time_order_keep_their_places(tmp_path: Path) -> None:
    shuffled = random.Random(5)
    messages = [can.Message(timestamp=float(shuffled.randrange(50)), arbitration_id=n % 5, data=[n % 256]) for n in range(500)]
    pack([block_of(messages)], tmp_path / "f.parquet", LAYOUTS)
    assert content(load_frames(tmp_path / "f.parquet")) == content(block_of(messages))


def test_what_the_recorder_lost_is_reported_of_the_packed_log_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, packed = tmp_path / "day.log", tmp_path / "day.parquet"
    lines = logs.text().splitlines(keepends=True)
    lost = "DROPCOUNT: dropped {} CAN frames on 'can0' socket (total drops {})\n"
    text.write_text("".join([*lines[:50], lost.format(37, 37), *lines[50:], lost.format(3, 40)]))
    assert main(["pack", str(text), "--out", str(packed)]) == 0
    for log in (text, packed):
        capsys.readouterr()
        assert main(["process", str(log), "--out", str(log.with_suffix(".csv")), "--force", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["damages"] == [f"{log}: the recorder lost 40 frames"]
        by_frame, by_block = LogNotes(), LogNotes()
        assert sum(1 for _ in read_log(log, by_frame)) == sum(len(block) for block in iter_blocks(log, by_block)) == len(lines)
        assert by_frame.dropped_by_recorder == by_block.dropped_by_recorder == 40


@pytest.mark.parametrize("begins", ["0", "2", "1,1", "x", "-1"])
def test_a_file_whose_logs_begin_nowhere_is_damaged(tmp_path: Path, begins: str) -> None:
    """Of two blocks, the second one of which may begin a log."""
    whole, odd = tmp_path / "whole.parquet", tmp_path / "odd.parquet"
    block = block_of([can.Message(timestamp=1.0, arbitration_id=1)])
    pack_logs([[block], [block]], whole, LAYOUTS)
    assert logs_in(whole) == 2
    with parquet.ParquetFile(whole) as source, parquet.ParquetWriter(odd, source.schema_arrow) as writer:
        for group in range(source.num_row_groups):
            writer.write_table(source.read_row_group(group))
        writer.add_key_value_metadata({"yieldmon.logs_begin": begins})
    with pytest.raises(InputError, match=r"odd\.parquet: damaged: logs that begin with the blocks"):
        logs_in(odd)


def test_damaged_places_beyond_those_named_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "day.log"
    log.write_text(logs.text() + "garbage\n" * 25)
    assert main(["process", str(log), "--out", str(tmp_path / "day.csv"), "--json"]) == 0
    damages = json.loads(capsys.readouterr().out)["damages"]
    assert (len(damages), damages[-1]) == (21, f"{log}: 5 more damaged places")


def test_a_full_disk_is_told_in_the_systems_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """pyarrow puts its own around them."""
    log = logs.write(tmp_path / "day.log")
    with files_end_at(2_000):
        assert main(["pack", str(log), "--out", str(tmp_path / "day.parquet")]) == 1
    assert capsys.readouterr().err.startswith(f"yieldmon: {tmp_path / 'day.parquet'}: File too large; expected a medium")
    assert [*tmp_path.iterdir()] == [log]


def test_a_log_with_longer_frames_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "fd.log").write_text("(1.000000) can0 123##1" + "AA" * 12 + "\n")
    assert main(["pack", str(tmp_path / "fd.log"), "--out", str(tmp_path / "fd.parquet")]) == 2
    assert f"{tmp_path / 'fd.log'}: holds CAN FD frames with more than 8 bytes" in capsys.readouterr().err
    assert not (tmp_path / "fd.parquet").exists()


def test_longer_frames_are_refused(tmp_path: Path) -> None:
    block = block_of([can.Message(arbitration_id=1, is_fd=True, data=bytes(12))])
    with pytest.raises(InputError, match="CAN FD"):
        pack([block], tmp_path / "f.parquet", LAYOUTS)


def _packed(path: Path) -> Path:
    pack([block_of([can.Message(timestamp=n / 10, arbitration_id=5, data=[n, 7]) for n in range(200)])], path, LAYOUTS)
    return path


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda data: b"", "damaged"),
        (lambda data: data[: len(data) // 2], "damaged"),
        (lambda data: b"(1.000000) can0 123#01\n", "damaged"),
    ],
)
def test_spoilt_files_are_refused(tmp_path: Path, spoil, says: str) -> None:
    path = _packed(tmp_path / "f.parquet")
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(InputError, match=says):
        load_frames(path)


def test_a_flipped_bit_is_refused_or_changes_nothing(tmp_path: Path) -> None:
    path = _packed(tmp_path / "f.parquet")
    good, expected, refused = path.read_bytes(), content(load_frames(path)), 0
    chance = random.Random(8)
    for _ in range(200):
        spoilt, bit = bytearray(good), chance.randrange(8 * len(good))
        spoilt[bit // 8] ^= 1 << bit % 8
        path.write_bytes(spoilt)
        try:
            assert content(load_frames(path)) == expected, f"bit {bit}"
        except InputError:
            refused += 1
    assert refused > 50


TIMES, DATA_BITS = 0, 1
"""Rows of the file: the first message's times, and the first stretch of its data."""


@pytest.mark.parametrize(
    ("row", "column", "value"),
    [
        *[(TIMES, "frames", value) for value in (0, -1, 2**31 - 1)],
        *[(TIMES, "length", value) for value in (9, 255)],
        *[(TIMES, "column", value) for value in ("place", "x")],
        *[(TIMES, "start", value) for value in ("", "ms", None)],
        *[(TIMES, "data", value) for value in (b"", b"\xff" * 90, None)],
        *[(TIMES, "size", value) for value in (-1, 0, 2**31 - 1)],
        *[(DATA_BITS, "start", value) for value in ("", "x", "-1", "64", "57", ",".join(["0"] * 99))],
        *[(DATA_BITS, "bits", value) for value in (0, 65, 255)],
        *[(DATA_BITS, "coding", value) for value in ("", "zip", None)],
        *[(DATA_BITS, "width", value) for value in (0, 9, 255)],
    ],
)
def test_a_row_that_makes_no_sense_is_refused(tmp_path: Path, row: int, column: str, value: object) -> None:
    path = _packed(tmp_path / "f.parquet")
    table = parquet.read_table(path)
    cells = table[column].to_pylist()
    cells[row] = value
    place = table.schema.get_field_index(column)
    parquet.write_table(table.set_column(place, table.schema.field(place), pa.array(cells, table.schema.types[place])), path)
    with pytest.raises(InputError, match="damaged"):
        load_frames(path)


@pytest.mark.parametrize("column", ["channel", "frames", "data"])
def test_a_column_that_is_missing_or_of_another_kind_is_refused(tmp_path: Path, column: str) -> None:
    path = _packed(tmp_path / "f.parquet")
    table = parquet.read_table(path)
    place = table.schema.get_field_index(column)
    for spoilt in (table.remove_column(place), table.set_column(place, column, pa.array([[0.5]] * table.num_rows))):
        parquet.write_table(spoilt, path)
        with pytest.raises(InputError, match="damaged"):
            load_frames(path)


def test_a_table_of_seconds_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, table = DATA / "bench_log.log.gz", tmp_path / "seconds.parquet"
    assert main(["process", str(log), "--out", str(table)]) == 0
    assert main(["process", str(table), "--out", str(tmp_path / "again.csv")]) == 2
    assert "seconds.parquet: a Parquet file without packed CAN frames; expected a file" in capsys.readouterr().err


def test_nothing_is_overwritten_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = _packed(tmp_path / "a.parquet"), tmp_path / "b.parquet"
    assert main(["pack", str(source), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 200
    before = source.read_bytes()
    assert main(["pack", str(source), "--out", str(out)]) == 2
    assert main(["pack", str(source), "--out", str(out), "--force"]) == 0
    assert main(["pack", str(source), "--out", str(source), "--force"]) == 2
    assert source.read_bytes() == before


@pytest.mark.parametrize(
    ("coding", "width", "wrong"),
    [
        (PLAIN, 0, "numbers of 0 bytes; expected 1 to 8"),
        (DIFFERENCE, 9, "numbers of 9 bytes; expected 1 to 8"),
        (PREDICTION, 0, "numbers of 0 bytes; expected 1 to 8"),
        ("new", 1, "unknown coding 'new'"),
    ],
)
def test_a_column_that_none_can_be_is_refused(coding: str, width: int, wrong: str) -> None:
    coded = encode(np.arange(40, dtype=np.uint64), 16)._replace(coding=coding, width=width)
    with pytest.raises(ValueError, match=wrong):
        decode(coded, 40, 16)
