"""The fast loader against the slow reader: the same frames, the same counts, the same damage."""

from __future__ import annotations

import gzip
from contextlib import nullcontext
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.whole_logs import load_frames
from yieldmon.bus.bulk import FrameBlock, block_of, concatenate
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.errors import InputError

START_S = 1_700_000_000


def quiet() -> LogNotes:
    return LogNotes(on_damage=lambda damage: None)


def content(block: FrameBlock) -> list[tuple]:
    names = [block.channels[index] for index in block.channel]
    columns = (block.time_s, block.can_id, block.length, block.payload)
    whole = [block.long.get(row) for row in range(len(names))]
    return list(zip(*(column.tolist() for column in columns), names, whole, strict=True))


def assert_same(path: Path, chunk_bytes: int, compiled: bool | None = None) -> None:
    """Frame by frame to the last bit, or the same refusal."""
    slow, fast = quiet(), quiet()
    outcomes = []
    for load in (
        lambda: block_of(read_log(path, slow)),
        lambda: concatenate(list(iter_blocks(path, fast, chunk_bytes=chunk_bytes, compiled=compiled))),
    ):
        try:
            outcomes.append(content(load()))
        except InputError as error:
            outcomes.append(str(error))
    assert outcomes[0] == outcomes[1]
    fast.on_damage = slow.on_damage
    assert fast == slow


hexadecimal = st.text("0123456789ABCDEFabcdef", max_size=18)
fractions = st.one_of(st.integers(0, 999_999).map("{:06d}".format), st.integers(0, 999_999_999).map("{:09d}".format))
common_lines = st.builds(
    "({}.{}) {} {}#{}{}".format,
    st.one_of(st.integers(0, 2_000_000_000), st.sampled_from([0, 9_007_199_254, 9_007_199_255, 9_999_999_999])),
    fractions,
    st.sampled_from(["can0", "vcan0", "can1"]),
    st.one_of(
        st.integers(0, 0x1FFFFFFF).map("{:08X}".format),
        st.integers(0, 0xFFFFFFFF).map("{:08x}".format),
        st.integers(0, 0xFFF).map("{:03X}".format),
    ),
    st.binary(max_size=8).map(lambda data: data.hex().upper()),
    st.sampled_from(["", " R", " T", "\r"]),
)
odd_lines = st.one_of(
    st.builds("({}.{}) can0 {}#{}".format, st.integers(0, 10), st.text("0123456789x", max_size=9), hexadecimal, hexadecimal),
    st.sampled_from(
        [
            "",
            "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)",
            "(1.000000) can0 123#R4",
            "(1.000000) can0 20000080#0000000000000000",
            "(1.000000) can0 123##1" + "AB" * 12,
            "(1.000000)  can0  123   [2]  01 02",
            "(1.000000) can0 12345678#11223344556677\x0188",
            "(1.000000) can0 12345678#112233445566" + "7" * 9000,
            "(1.000000) can\u00e4 12345678#11",
        ]
    ),
    st.text(max_size=30).filter(lambda text: "\n" not in text and not text.startswith("\ufeff")),
)


@given(
    lines=st.lists(st.one_of(common_lines, common_lines, odd_lines), max_size=60),
    repeats=st.integers(1, 3),
    ended=st.booleans(),
    chunk_bytes=st.sampled_from([50, 300, 100_000]),
    packed=st.booleans(),
    compiled=st.booleans(),
)
@settings(max_examples=200)
def test_fast_is_slow(tmp_path_factory, lines, repeats: int, ended: bool, chunk_bytes: int, packed: bool, compiled: bool) -> None:
    text = ("\n".join(lines * repeats) + "\n" * ended).encode()
    path = tmp_path_factory.getbasetemp() / ("any.log.gz" if packed else "any.log")
    path.write_bytes(gzip.compress(text) if packed else text)
    assert_same(path, chunk_bytes, compiled)


def drive(frames: int) -> bytes:
    """A log as candump writes it, frames 1 ms apart."""
    random = np.random.default_rng(20_26)
    data = random.integers(0, 2**63, frames)
    return b"".join(
        b"(%d.%06d) can0 0%07X#%016X\n" % (START_S + k // 1000, k % 1000 * 1000 + k % 7, 0x8FF1081 + k % 5, data[k])
        for k in range(frames)
    )


@pytest.mark.parametrize("chunk_bytes", [1000, 4 * 1024 * 1024])
def test_a_usual_log(tmp_path: Path, chunk_bytes: int) -> None:
    path = tmp_path / "drive.log"
    path.write_bytes(drive(20_000))
    assert_same(path, chunk_bytes)
    assert len(load_frames(path)) == 20_000


@pytest.mark.parametrize("cut", [0.3, 0.7, 0.999])
def test_cut_off_gzip(tmp_path: Path, cut: float) -> None:
    path = tmp_path / "drive.log.gz"
    packed = gzip.compress(drive(20_000))
    path.write_bytes(packed[: int(cut * len(packed))])
    assert_same(path, 10_000)
    notes = quiet()
    assert 0 < len(load_frames(path, notes)) < 20_000
    assert notes.damaged_places == 1


@pytest.mark.parametrize(("mark", "refused"), [(b"\xef\xbb\xbf", False), (b"\xff\xfe", True)], ids=["UTF-8", "UTF-16"])
def test_byte_order_marks(tmp_path: Path, mark: bytes, refused: bool) -> None:
    path = tmp_path / "drive.log"
    path.write_bytes(mark + drive(10))
    assert_same(path, 100)
    with pytest.raises(InputError, match="UTF-16") if refused else nullcontext():
        assert len(load_frames(path)) == 10


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc", ".blf", ".db"])
def test_other_formats(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"drive{suffix}"
    with can.Logger(path) as writer:
        for k in range(50):
            writer.on_message_received(can.Message(timestamp=START_S + k / 1000, arbitration_id=k, data=bytes(k % 9)))
    assert_same(path, 1000)
    assert len(load_frames(path)) == 50


def test_missing_log(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_frames(tmp_path / "absent.log")
