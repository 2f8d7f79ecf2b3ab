"""Objects of a .blf log that lie across containers, at every place where one may end; built here by the format's description."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import can
import pytest

from yieldmon.bus.log_files.blf_check import first_flaw
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log

HEADER_BYTES = 144
SMALLEST_BYTES = 32


def thing(size: int, kind: int = 86, body: bytes = b"") -> bytes:
    """An object: signature, its header's size and version, its own size and kind."""
    return (struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, kind) + body).ljust(size, b"\x07")


def container(content: bytes, *, packed: bool) -> bytes:
    data = zlib.compress(content) if packed else content
    body = struct.pack("<HHLLL", 2 if packed else 0, 0, 0, len(content), 0) + data
    whole = thing(16 + len(body), 10, body)
    return whole + bytes(len(whole) % 4)


def log(path: Path, *containers: bytes) -> Path:
    path.write_bytes(struct.pack("<4sL", b"LOGG", HEADER_BYTES).ljust(HEADER_BYTES, b"\0") + b"".join(containers))
    return path


@pytest.mark.parametrize("packed", [True, False])
def test_sound_objects_are_sound_wherever_a_container_ends(tmp_path: Path, *, packed: bool) -> None:
    content = b"".join(thing(size) + bytes(size % 4) for size in (SMALLEST_BYTES, 48, 45, 90, SMALLEST_BYTES, 64))
    for at in range(len(content) + 1):
        parts = [container(part, packed=packed) for part in (content[:at], content[at:])]
        assert first_flaw(log(tmp_path / "a.blf", *parts)) is None


def test_an_object_that_is_too_small_is_found_in_the_container_in_which_its_size_is_known(tmp_path: Path) -> None:
    before = thing(48)
    content = before + thing(SMALLEST_BYTES - 1) + thing(64)
    for at in range(len(content) + 1):
        first, second = (container(part, packed=True) for part in (content[:at], content[at:]))
        begins = HEADER_BYTES if at >= len(before) + 16 else HEADER_BYTES + len(first)
        assert first_flaw(log(tmp_path / "a.blf", first, second)) == (begins, f"an object of {SMALLEST_BYTES - 1} bytes")


def test_what_is_damaged_is_named_by_its_place(tmp_path: Path) -> None:
    sound, other = container(thing(64), packed=True), container(thing(48), packed=True)
    second = HEADER_BYTES + len(sound)
    for cut in range(1, 16):
        assert first_flaw(log(tmp_path / "a.blf", sound, other[:cut])) == (second, "the file ends within an object")
    unpadded = struct.unpack_from("<L", other, 8)[0]
    for cut in (16, 30, unpadded - 1):
        assert first_flaw(log(tmp_path / "a.blf", sound, other[:cut])) == (
            second, f"the file ends within an object of {unpadded} bytes"
        )  # fmt: skip
    assert first_flaw(log(tmp_path / "a.blf", sound, other[:unpadded])) is None
    assert first_flaw(log(tmp_path / "a.blf", sound, b"LOBX" + other[4:])) == (second, "no object begins here")
    assert first_flaw(log(tmp_path / "a.blf", sound, struct.pack("<4sHHLL", b"LOBJ", 16, 1, 15, 10))) == (
        second, "no object begins here"
    )  # fmt: skip
    for more, problem in ((0, None), (1, "an object of 33554433 bytes")):
        large = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 * 1024 * 1024 + more, 86)
        found = first_flaw(log(tmp_path / "a.blf", sound, large))
        assert found == (second, problem or "the file ends within an object of 33554432 bytes")


@pytest.mark.parametrize("method", [1, 3])
def test_a_container_packed_in_a_way_that_is_not_known_is_passed_over(method: int, tmp_path: Path) -> None:
    strange = bytearray(container(thing(8), packed=False))
    strange[16:18] = method.to_bytes(2, "little")
    assert first_flaw(log(tmp_path / "a.blf", bytes(strange), container(thing(64), packed=True))) is None


def test_a_container_whose_packed_part_ends_early_or_is_none(tmp_path: Path) -> None:
    for data, problem in (
        (zlib.compress(thing(64))[:-5], "compressed container damaged: it ends early"),
        (b"no zlib", "compressed"),
    ):
        body = struct.pack("<HHLLL", 2, 0, 0, 64, 0) + data
        found = first_flaw(log(tmp_path / "a.blf", thing(16 + len(body), 10, body)))
        assert found is not None
        assert found[0] == HEADER_BYTES
        assert found[1].startswith(problem)


def test_frames_behind_a_marker_are_read_wherever_a_container_ends(tmp_path: Path) -> None:
    """Vector's programs write a marker of 24 bytes more than they state; everything behind it was lost."""
    with can.BLFWriter(tmp_path / "a.blf") as writer:
        for number in range(4):
            writer.on_message_received(can.Message(timestamp=number + 1.0, arbitration_id=0x123, data=bytes([number] * 8)))
    whole = (tmp_path / "a.blf").read_bytes()
    frames = zlib.decompress(whole[HEADER_BYTES + 32 :])
    frame = len(frames) // 4
    texts = struct.pack("<3L", 7, 4, 12) + bytes(12) + b"harvest" + b"rain" + b"it is raining"[:12]
    marker = (struct.pack("<4sHHLL", b"LOBJ", 32, 1, 72 + 23 - 24, 96) + bytes(16 + 16) + texts) + bytes(1)
    content = frames[:frame] + marker + frames[frame:]
    for at in range(len(content) + 1):
        path = log(tmp_path / "b.blf", *(container(part, packed=True) for part in (content[:at], content[at:])))
        path.write_bytes(whole[:HEADER_BYTES] + path.read_bytes()[HEADER_BYTES:])
        notes = LogNotes()
        assert [message.data[0] for message in read_log(path, notes)] == [0, 1, 2, 3], at
        assert notes.damages == []
