"""The daemon's address, answers and trouble codes as the kernel's own j1939 and can-utils see them."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from tests.network.peer import read
from tests.vcan.nodes import candump, daemon, eventually
from yieldmon.bus.log_files.logs import read_log
from yieldmon.network.diagnostics import DM1, DM2
from yieldmon.network.identifier import ADDRESS_CLAIMED, REQUEST, Identifier

pytestmark = pytest.mark.vcan

US, PEER = 0x83, 0x20
SOFTWARE = 65242
RECORDINGS = sorted((Path(__file__).parent.parent / "data" / "tractor_bus").glob("*.log"))


@contextmanager
def kernel_socket(channel: str, group: int = socket.J1939_NO_PGN) -> Iterator[socket.socket]:
    """A j1939 socket of the kernel at PEER; its transport protocol is the kernel's."""
    try:
        opened = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_J1939)
    except OSError:
        pytest.skip("this kernel has no j1939")
    with opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        opened.bind((channel, socket.J1939_NO_NAME, group, PEER))
        opened.settimeout(60.0)
        yield opened


def ask(peer: socket.socket, channel: str, group: int, destination: int) -> None:
    peer.sendto(group.to_bytes(3, "little"), (channel, socket.J1939_NO_NAME, REQUEST, destination))


def received(peer: socket.socket, group: int) -> bytes:
    """The next message of a group from the daemon."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        data, (_, _, pgn, address) = peer.recvfrom(2000)
        if (pgn, address) == (group, US):
            return data
    raise AssertionError(f"no group {group} from the daemon")


def claimed(node: object) -> bool:
    return bool(node.status["network"]["address"])  # type: ignore[attr-defined]


def test_nothing_of_ours_leaves_before_the_claim(vcan0: str, tmp_path: Path) -> None:
    log = tmp_path / "candump.log"
    with candump(vcan0, log), daemon(vcan0, tmp_path) as node:
        eventually(lambda: node.windows > 2, "windows on a silent bus")
    seen = [(m.timestamp, Identifier.of(m.arbitration_id)) for m in read_log(log) if m.is_extended_id]
    assert [parts.group for _, parts in seen[:2]] == [REQUEST, ADDRESS_CLAIMED]
    claim_s = seen[1][0]
    assert all(at_s - claim_s >= 0.249 for at_s, parts in seen[2:] if parts.group != ADDRESS_CLAIMED)
    assert {parts.source for _, parts in seen[1:]} == {US}


def test_the_kernels_j1939_takes_our_answers(vcan0: str, tmp_path: Path) -> None:
    with daemon(vcan0, tmp_path) as node, kernel_socket(vcan0) as peer:
        eventually(lambda: claimed(node), "the claim")
        ask(peer, vcan0, SOFTWARE, US)
        assert received(peer, SOFTWARE).startswith(b"\x01yieldmon ")


def test_the_kernels_j1939_sees_several_codes_steadily_and_dm2_afterwards(vcan0: str, tmp_path: Path) -> None:
    """On a silent bus sensor, speed and feedback are missing."""
    with daemon(vcan0, tmp_path) as node, kernel_socket(vcan0) as peer:
        eventually(lambda: len(node.faults) >= 3, "the faults")
        seen = []
        while len([codes for codes in seen if len(codes) >= 3]) < 3:
            seen.append({(code.spn, code.fmi) for code in read(received(peer, DM1))})
        assert {(520192, 9), (520194, 9), (520195, 9)} <= seen[-1]
        ask(peer, vcan0, DM2, US)
        assert read(received(peer, DM2)) == ()


@pytest.mark.skipif(shutil.which("j1939acd") is None, reason="no j1939acd of can-utils")
@pytest.mark.parametrize(("name", "ours"), [("0000000000000001", False), ("F000000000000001", True)], ids=["lower", "higher"])
def test_j1939acd_contests_our_address(vcan0: str, tmp_path: Path, name: str, ours: bool) -> None:
    with daemon(vcan0, tmp_path) as node:
        eventually(lambda: claimed(node), "the claim")
        words = ["j1939acd", "-r", f"{US}-{US + 5}", "-c", str(tmp_path / "cache"), "-a", str(US), name, vcan0]
        rival = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            holds = lambda: next((p["address"] for p in node.status["network"]["partners"] if p["name"] == name), None)  # noqa: E731
            eventually(lambda: holds() is not None and claimed(node), "both have an address")
            eventually(lambda: (node.status["network"]["address"] == US) == ours, "who has ours")
            assert holds() != node.status["network"]["address"]
        finally:
            rival.terminate()
            rival.wait(5.0)


def test_a_tractors_network_traffic_changes_nothing(vcan0: str, tmp_path: Path) -> None:
    with daemon(vcan0, tmp_path) as node, can.Bus(vcan0, interface="socketcan") as peer:
        eventually(lambda: claimed(node), "the claim")
        for path in RECORDINGS:
            for message in read_log(path):
                peer.send(can.Message(arbitration_id=message.arbitration_id, data=message.data, is_extended_id=True))
                time.sleep(0.001)
        eventually(lambda: len(node.status["network"]["partners"]) >= 5, "the tractor's nodes")
        assert "NetworkFault" not in node.faults
        assert node.status["network"]["address"] == US


@pytest.mark.skipif(None in map(shutil.which, ("j1939cat", "testj1939")), reason="no j1939cat and testj1939 of can-utils")
def test_testj1939_prints_what_j1939cat_asks_us_for(vcan0: str, tmp_path: Path) -> None:
    request = tmp_path / "request"
    request.write_bytes(SOFTWARE.to_bytes(3, "little"))
    with daemon(vcan0, tmp_path) as node, (tmp_path / "printed").open("w") as printed:
        eventually(lambda: claimed(node), "the claim")
        # Without -oL what is printed stays in testj1939's buffer, which its end by a signal throws away.
        words = ["stdbuf", "-oL", "testj1939", "-r", f"{vcan0}:{PEER:#x}"]
        with subprocess.Popen(words, stdout=printed, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL) as receiver:
            try:

                def answered() -> bool:
                    asking = ["j1939cat", "-i", str(request), f"{vcan0}:{PEER:#x}", f":{US:#x},{REQUEST:#x}"]
                    # Its exit status tells of the kernel's notes on what it sent, which not every release can read.
                    subprocess.run(asking, check=False, timeout=20, stderr=subprocess.DEVNULL)
                    time.sleep(0.5)
                    return b"\x01yieldmon " in _payload((tmp_path / "printed").read_text())

                eventually(answered, "the answer in what testj1939 prints")
            finally:
                receiver.kill()
    first = (tmp_path / "printed").read_text().split(":", 1)[0]
    assert [int(word, 16) for word in first.split()] == [US, SOFTWARE]


def _payload(printed: str) -> bytes:
    """The bytes in testj1939's lines: address and group before the first eight, the offset before the others."""
    return bytes(int(word, 16) for line in printed.splitlines() for word in line.split()[1:] if len(word) == 2)
