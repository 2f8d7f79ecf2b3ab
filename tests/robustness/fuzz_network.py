"""Random network traffic through node, transport, task controller client and side inputs: nothing may escape.

python -m tests.robustness fuzz-network --count 1000000 --seed 1

Frames of the groups that the network layers take, of random and of half-sensible content, from all addresses, in bursts and with
pauses. An escape is an exception; a frame of ours that is no claim while we have no address, or from another address than ours;
more sessions held than the bounds allow; memory that grows.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tracemalloc
from collections.abc import Sequence

import can

from yieldmon.engine.faults import FaultCode
from yieldmon.engine.settings import TotalsSettings
from yieldmon.network.identifier import ADDRESS_CLAIMED, NULL_ADDRESS, REQUEST, Identifier
from yieldmon.physics.machine import Implement, Machine
from yieldmon.service.document import Network
from yieldmon.service.link import NetworkLink
from yieldmon.service.side_inputs import SideInputs

FORMATS = (0xEE, 0xEA, 0xEC, 0xEB, 0xE8, 0xCB, 0xFE, 0xFF, 0xEF)
GROUPS = (0x1F801, 0x1F802, 0x1F805, 0x1F010, 0xFEF3, 0xFEE8, 0xFEF1, 0xFE48, 0xFE49, 0xFECA, 0xFF69)
ADDRESSES = (0x83, 0xF7, 0x17, 0xFF, 0xFE, 0x26)
#: Kinds of transport frames, part numbers, and commands of process data.
FIRST_BYTES = (16, 17, 19, 32, 255, 0, 1, 2, 0x10, 0x11, 0x31, 0x51, 0x71, 0x91, 0xFE, 0x84, 0x23, 0x2A, 0x40, 0x60)
MEMORY_GROWTH_BYTES = 3_000_000


def identifier(draw: random.Random, ours: int | None) -> int:
    """A 29-bit identifier that the layers are likely to take."""
    source = draw.choice((*ADDRESSES, draw.randrange(256)))
    if draw.random() < 0.3:
        return draw.randrange(8) << 26 | draw.choice(GROUPS) << 8 | source
    destination = draw.choice((ours if ours is not None else 0x83, 0xFF, draw.randrange(256)))
    return draw.randrange(8) << 26 | draw.choice(FORMATS) << 16 | destination << 8 | source


def content(draw: random.Random) -> bytes:
    """Eight bytes or fewer, the first often one that means something."""
    data = bytearray(draw.randbytes(draw.choice((8, 8, 8, 8, draw.randrange(9)))))
    if data and draw.random() < 0.6:
        data[0] = draw.choice(FIRST_BYTES)
    if len(data) == 8 and draw.random() < 0.3:
        data[5:8] = draw.choice((b"\xca\xfe\x00", b"\xda\xfe\x00", b"\x00\xcb\x00", b"\xd8\xfe\x00"))
    return bytes(data)


def main(arguments: Sequence[str]) -> int:
    """Exit code 1 when something escaped."""
    about = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(prog="python -m tests.robustness fuzz-network", description=about)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    draw = random.Random(options.seed)
    machine = Machine(implement=Implement(working_width_m=9.1))
    link = NetworkLink(Network(task_controller=True, obey_commanded_address=True, identity_number=77), machine, TotalsSettings())
    side = SideInputs()
    now_s, sent, silent, side_frames = 0.0, 0, 0, 0
    escapes: list[str] = []
    out = link.start(now_s)
    tracemalloc.start()
    begun = 0
    for number in range(options.count):
        now_s += draw.choice((0.0, 0.0001, 0.001, 0.01, 0.01, 0.3 if draw.random() < 0.05 else 0.0))
        message = can.Message(
            timestamp=now_s, arbitration_id=identifier(draw, link.address), data=content(draw), is_extended_id=True
        )
        try:
            out += link.poll(now_s)
            if link.concerns(message):
                out += link.hear(message, now_s)
            side_frames += len(side.frames(message, None))
            if number % 500 == 0:
                out += link.tell_trouble(draw.sample(list(FaultCode), draw.randrange(6)), now_s)
                link.troubles(now_s)
                json.dumps(link.status())
        except Exception as error:  # noqa: BLE001 - whatever it is, it escaped
            escapes.append(f"frame {number}: {message}: {type(error).__name__}: {error}")
            break
        silent += link.address is None
        for frame in out:
            parts = Identifier.of(frame.arbitration_id)
            claim = parts.group == ADDRESS_CLAIMED or (parts.group == REQUEST and parts.source == NULL_ADDRESS)
            if not claim and parts.source != link.address:
                escapes.append(f"frame {number}: sent {frame} with address {link.address}")
        sent += len(out)
        out = []
        if number == options.count // 5:
            begun = tracemalloc.get_traced_memory()[0]
    grown = tracemalloc.get_traced_memory()[0] - begun
    if grown > MEMORY_GROWTH_BYTES:
        escapes.append(f"memory grew by {grown} bytes")
    result = {
        "frames": options.count,
        "seed": options.seed,
        "seconds": round(now_s),
        "sent": sent,
        "without_address": silent,
        "side_frames": side_frames,
        "memory_growth_bytes": grown,
        "escapes": escapes[:20],
    }
    print(json.dumps(result, indent=2))
    return 1 if escapes else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
