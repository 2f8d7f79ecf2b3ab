"""Captures of SocketCAN interfaces as Wireshark and tcpdump write them, packed here by the formats' own descriptions."""

from __future__ import annotations

import contextlib
import gzip
import struct
from pathlib import Path

import can
import pytest

from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.cli import main as cli
from yieldmon.errors import InputError

SOCKETCAN, SLL, SLL2, ETHERNET = 227, 113, 276, 1
NS = 1_790_000_000_123_456_789
#: Identifier with its flags, length, flags of CAN FD, data; and what is read.
FRAMES = [
    (0x88FF1081, 8, 0, bytes(range(8))),
    (0x123, 2, 0, b"\x07\xff"),
    (0x40000123, 4, 0, b""),
    (0x20000004, 8, 0, b"\0\1\0\0\0\0\0\0"),
    (0x80000123, 12, 0x05, bytes(range(12))),
    (0x321, 1, 0x06, b"\x09"),
]
READ = [
    (0x8FF1081, True, bytes(range(8)), ""),
    (0x123, False, b"\x07\xff", ""),
    (0x123, False, b"", "remote"),
    (0x4, False, b"\0\1\0\0\0\0\0\0", "error"),
    (0x123, True, bytes(range(12)), "fd brs"),
    (0x321, False, b"\x09", "fd esi"),
]


def packet(frame: tuple[int, int, int, bytes], link: int = SOCKETCAN) -> bytes:
    identifier, length, flags, data = frame
    protocol = 0x000D if flags else 0x000C
    head = {
        SOCKETCAN: b"",
        SLL: struct.pack(">HHH8xH", 4, 280, 0, protocol),
        SLL2: struct.pack(">HHIHBB8x", protocol, 0, 2, 280, 4, 0),
    }[link]
    return head + struct.pack(">IBBxx", identifier, length, flags) + data


def pcap(packets: list[bytes], link: int = SOCKETCAN, order: str = "<", nanoseconds: bool = False) -> bytes:
    ticks = 10**9 if nanoseconds else 10**6
    found = struct.pack(order + "IHHiIII", 0xA1B23C4D if nanoseconds else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for number, content in enumerate(packets):
        at = (NS + number * 10**9) * ticks // 10**9
        found += struct.pack(order + "IIII", at // ticks, at % ticks, len(content), len(content)) + content
    return found


def block(kind: int, body: bytes, order: str) -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack(order + "II", kind, len(body) + 12) + body + struct.pack(order + "I", len(body) + 12)


def option(code: int, value: bytes, order: str) -> bytes:
    return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)


def pcapng(
    packets: list[tuple[int, bytes]], links: list[int], order: str = "<", resolution: bytes = b"", offset_s: int = 0
) -> bytes:
    """packets: number of the interface, content. resolution: of if_tsresol, empty for microseconds."""
    found = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1) + option(4, b"Dumpcap", order), order)
    for number, link in enumerate(links):
        options = option(2, f"can{number}".encode(), order) + (option(9, resolution, order) if resolution else b"")
        options += option(14, struct.pack(order + "q", offset_s), order) + option(0, b"", order)
        found += block(1, struct.pack(order + "HHI", link, 0, 65535) + options, order)
    ticks = {b"": 10**6, b"\x09": 10**9, b"\x94": 2**20}[resolution]
    for number, (interface, content) in enumerate(packets):
        at = (NS + number * 10**9 - offset_s * 10**9) * ticks // 10**9
        head = struct.pack(order + "5I", interface, at >> 32, at & 0xFFFFFFFF, len(content), len(content))
        found += block(6, head + content + bytes(-len(content) % 4) + option(2, bytes(4), order), order)
        found += block(5, struct.pack(order + "III", interface, 0, 0), order)
    return found


def kinds(message: can.Message) -> str:
    names = {"is_remote_frame": "remote", "is_error_frame": "error", "is_fd": "fd", "bitrate_switch": "brs"}
    names["error_state_indicator"] = "esi"
    return " ".join(short for name, short in names.items() if getattr(message, name))


def check(path: Path, within_s: float = 1e-6) -> list[can.Message]:
    found = list(read_log(path))
    assert [(m.arbitration_id, m.is_extended_id, bytes(m.data), kinds(m)) for m in found] == READ
    assert [m.dlc for m in found] == [length for _, length, _, _ in FRAMES]
    assert [m.timestamp for m in found] == pytest.approx([NS / 1e9 + k for k in range(len(found))], abs=within_s)
    return found


@pytest.mark.parametrize("link", [SOCKETCAN, SLL, SLL2])
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_every_kind_of_frame_of_a_pcap(tmp_path: Path, link: int, order: str, nanoseconds: bool) -> None:
    path = tmp_path / "drive.pcap"
    path.write_bytes(pcap([packet(frame, link) for frame in FRAMES], link, order, nanoseconds))
    found = check(path)
    assert all(message.is_rx == (link == SOCKETCAN) for message in found)
    assert {message.channel for message in found} == {"2" if link == SLL2 else None}, "of all interfaces, each by its number"


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("resolution", [b"", b"\x09", b"\x94"])
def test_every_kind_of_frame_of_a_pcapng(tmp_path: Path, order: str, resolution: bytes) -> None:
    path = tmp_path / "drive.pcapng.gz"
    content = pcapng([(0, packet(frame)) for frame in FRAMES], [SOCKETCAN], order, resolution, offset_s=1000)
    path.write_bytes(gzip.compress(content))
    assert {message.channel for message in check(path, 2e-6)} == {"can0"}


def test_of_several_interfaces_those_of_can_are_read(tmp_path: Path) -> None:
    path = tmp_path / "drive.pcapng"
    content = [(interface, content) for frame in FRAMES for interface, content in ((2, packet(frame, SLL)),)]
    path.write_bytes(pcapng([*content, (0, b"\xff" * 60)], [ETHERNET, SOCKETCAN, SLL]))
    assert {message.channel for message in check(path)} == {"can2"}
    path.write_bytes(pcap([b"\0\0\0\1\0\6" + bytes(8) + b"\x08\x00" + bytes(40), packet(FRAMES[0], SLL)], SLL))
    assert [message.arbitration_id for message in read_log(path.rename(tmp_path / "any.pcap"))] == [0x8FF1081]


def test_what_stands_behind_the_length_of_a_classic_frame_is_nothing(tmp_path: Path) -> None:
    """As a plotter records what it sends itself (canboat/canboat at 01d0dc3, Apache-2.0, samples/can0-1.pcap)."""
    packets = [
        "99f0142b080000000f37373138312020", "8dff182b082e92040011419fff080126", "8dff182b082d92044011419fff02017f",
        "8dff1d1208aa2103200e419fffffffff", "98ea2e2b03aa210314f001",
    ]  # fmt: skip
    path = tmp_path / "can0.pcap"
    path.write_bytes(pcap([bytes.fromhex(one) for one in packets]))
    found = list(read_log(path))
    assert [f"{m.arbitration_id:08x} {m.data.hex()} {kinds(m)}" for m in found] == [
        "19f0142b 0f37373138312020 ", "0dff182b 0011419fff080126 ", "0dff182b 4011419fff02017f ", "0dff1d12 200e419fffffffff ",
        "18ea2e2b 14f001 ",
    ]  # fmt: skip


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng"])
def test_a_capture_that_is_cut_off_is_read_up_to_there(tmp_path: Path, suffix: str) -> None:
    whole = pcap([packet(FRAMES[0])] * 9) if suffix == ".pcap" else pcapng([(0, packet(FRAMES[0]))] * 9, [SOCKETCAN])
    heads = [pcap([])] if suffix == ".pcap" else [pcapng([], []), pcapng([], [SOCKETCAN])]
    for cut in range(len(whole)):
        path, notes = tmp_path / f"cut{suffix}", LogNotes()
        path.write_bytes(whole[:cut])
        frames: list[can.Message] = []
        with contextlib.suppress(InputError):
            # What is raised for a file without any frame.
            frames = list(read_log(path, notes))
        assert notes.frames == len(frames) <= 9
        assert notes.damaged_places <= 1
        assert frames or notes.damaged_places or cut in map(len, heads)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (pcap([bytes(60)], ETHERNET), "a capture of link type 1; expected one of a SocketCAN interface"),
        (pcapng([(0, bytes(60))], [ETHERNET]), "a capture of link type 1; expected one of a SocketCAN interface"),
        (b"not a capture at all", "neither a pcap nor a pcapng"),
        (pcap([packet(FRAMES[0])[:12]]), "a frame that is cut off; capture whole packets"),
        (pcap([struct.pack(">IBB", 1, 0x80, 0x80) + bytes(20)]), "a CAN XL frame, which is not read"),
        # 0x123 as CSS Electronics' converter writes it.
        (
            pcap([packet((0x23010000, 2, 0, b"\1\2"), SLL)], SLL),
            "identifiers with their bytes in reverse, as `mdf2pcap` writes them",
        ),
    ],
)
def test_what_is_no_capture_of_a_can_bus_is_refused_in_a_line(tmp_path: Path, content: bytes, problem: str, capsys) -> None:
    path = tmp_path / "drive.pcapng"
    path.write_bytes(content)
    assert cli.main(["process", str(path), "--out", str(tmp_path / "o.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert problem in line
