"""Random network traffic through node, transport, task controller client, side inputs and a mapping of long messages.

python -m tests.robustness fuzz-network --count 1000000 --seed 1

Frames of the groups that the network layers take, of random and of half-sensible content, from all addresses, in bursts and with
pauses. An escape is an exception; a frame of ours that is no claim while we have no address, or from another address than ours;
more sessions held than the bounds allow; memory that grows; a mapped value that differs between frames one by one and blocks.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import tracemalloc
from collections.abc import Iterator, Sequence
from pathlib import Path

import can

from yieldmon.bus.bulk import block_of
from yieldmon.bus.databases import load_messages
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.settings import TotalsSettings
from yieldmon.identifiers import NULL_ADDRESS
from yieldmon.network.identifier import ADDRESS_CLAIMED, REQUEST, Identifier
from yieldmon.physics.machine import Implement, Machine
from yieldmon.service.config.service_sections import Network
from yieldmon.service.traffic.network_link import NetworkLink
from yieldmon.service.traffic.side_inputs import SideInputs
from yieldmon.signals.binding import Binding
from yieldmon.signals.decoding import MapDecoder
from yieldmon.signals.mapping import build

FORMATS = (0xEE, 0xEA, 0xEC, 0xEB, 0xE8, 0xCB, 0xFE, 0xFF, 0xEF)
GROUPS = (0x1F801, 0x1F802, 0x1F805, 0x1F010, 0xFEF3, 0xFEE8, 0xFEF1, 0xFE48, 0xFE49, 0xFECA, 0xFF69)
ADDRESSES = (0x83, 0xF7, 0x17, 0xFF, 0xFE, 0x26)
#: Kinds of transport frames, part numbers, and commands of process data.
FIRST_BYTES = (16, 17, 19, 32, 255, 0, 1, 2, 0x10, 0x11, 0x31, 0x51, 0x71, 0x91, 0xFE, 0x84, 0x23, 0x2A, 0x40, 0x60)
MEMORY_GROWTH_BYTES = 3_000_000
BLOCK_FRAMES = 997
MOST_UNDER_WAY = 128
#: Groups of the openings above as messages of 20 bytes, and a fast packet.
LONG = """VERSION ""
NS_ :
BS_:
BU_: N
""" + "".join(
    f'BO_ {group << 8 | 0x980000FE} M{number}: 20 N\n SG_ S : 64|16@1+ (0.125,0) [0|0] "rpm" N\n'
    for number, group in enumerate((0xFECA, 0xFEDA, 0xCB00, 0xFED8, 0x1F805))
)


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


def traffic(draw: random.Random, link: NetworkLink) -> Iterator[tuple[int, bytes]]:
    """Frames without end, whole long messages now and then between them, of which one in twenty loses a frame."""
    under_way: list[tuple[int, bytes]] = []
    while True:
        if not under_way and draw.random() < 0.02:
            under_way = long_message(draw)
            if draw.random() < 0.05:
                del under_way[draw.randrange(len(under_way))]
        if under_way and draw.random() < 0.5:
            yield under_way.pop(0)
        else:
            yield identifier(draw, link.address), content(draw)


def long_message(draw: random.Random) -> list[tuple[int, bytes]]:
    """20 bytes: a broadcast, or a fast packet."""
    source, data = draw.choice(ADDRESSES[1:3]), draw.randbytes(20)
    if draw.random() < 0.5:
        lead = draw.randrange(8) << 5
        parts = [bytes([lead, 20]) + data[:6], bytes([lead | 1]) + data[6:13], bytes([lead | 2]) + data[13:]]
        return [(0x19F80500 | source, part) for part in parts]
    opening = bytes([32, 20, 0, 3, 255]) + draw.choice((0xFECA, 0xFEDA, 0xCB00, 0xFED8)).to_bytes(3, "little")
    parts = [bytes([k + 1]) + data[7 * k : 7 * k + 7].ljust(7, b"\xff") for k in range(3)]
    return [(0x1CECFF00 | source, opening), *((0x1CEBFF00 | source, part) for part in parts)]


def strangers(frames: Sequence[can.Message], address: int | None) -> list[str]:
    """Of frames that we send: those that are no claim and not from our address."""
    found = []
    for frame in frames:
        parts = Identifier.of(frame.arbitration_id)
        claim = parts.group == ADDRESS_CLAIMED or (parts.group == REQUEST and parts.source == NULL_ADDRESS)
        if not claim and parts.source != address:
            found.append(f"sent {frame} with address {address}")
    return found


def mapped(number: int) -> MapDecoder:
    """A decoder of one of the long messages, from any source."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.dbc"
        path.write_text(LONG)
        messages = load_messages(path)
    binding = Binding("fuzz", "elevator_speed", "long.dbc", f"M{number}", ("S",))
    return MapDecoder(build([binding], lambda _name: messages, Machine()))


def held_against(decoders: Sequence[tuple[MapDecoder, MapDecoder]], messages: list[can.Message]) -> tuple[int, list[str]]:
    """How many values the frames brought, and where one by one and as a block they brought others."""
    values, wrong = 0, []
    for single, blocks in decoders:
        found = [
            (frame.time_s, frame.signals["elevator_speed"])
            for m in messages
            for frame in single.decode(m.timestamp, m.arbitration_id, True, bytes(m.data))
        ]
        block = block_of(messages)
        columns, _ = blocks.decode_block(block.time_s, block.can_id, block.length, block.payload, block.long)
        pairs = [zip(one.time_s.tolist(), one.signals["elevator_speed"].tolist(), strict=True) for one in columns]
        times = [pair for one in pairs for pair in one]
        values += len(found)
        if times != found or single.incomplete != blocks.incomplete:
            wrong.append(f"until {messages[-1].timestamp}: {found} one by one, {times} as a block")
        if single.under_way > MOST_UNDER_WAY:
            wrong.append(f"{single.under_way} sessions")
    return values, wrong


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
    decoders = [(mapped(number), mapped(number)) for number in range(5)]
    recent: list[can.Message] = []
    frames = traffic(draw, link)
    long_values = 0
    now_s, sent, silent, side_frames = 0.0, 0, 0, 0
    escapes: list[str] = []
    out = link.start(now_s)
    tracemalloc.start()
    begun = 0
    for number in range(options.count):
        now_s += draw.choice((0.0, 0.0001, 0.001, 0.01, 0.01, 0.3 if draw.random() < 0.05 else 0.0))
        at, data = next(frames)
        message = can.Message(timestamp=now_s, arbitration_id=at, data=data, is_extended_id=True)
        recent.append(message)
        try:
            if len(recent) == BLOCK_FRAMES:
                values, wrong = held_against(decoders, recent)
                long_values, recent = long_values + values, []
                escapes += wrong
            out += link.poll(now_s)
            if link.concerns(message):
                out += link.receive(message, now_s)
            side_frames += len(side.frames(message, None))
            if number % 500 == 0:
                out += link.report_trouble(draw.sample(list(FaultCode), draw.randrange(6)), now_s)
                link.troubles(now_s)
                json.dumps(link.status())
        except Exception as error:  # noqa: BLE001 - whatever it is, it escaped
            escapes.append(f"frame {number}: {message}: {type(error).__name__}: {error}")
            break
        silent += link.address is None
        escapes += [f"frame {number}: {said}" for said in strangers(out, link.address)]
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
        "long_values": long_values,
        "long_incomplete": sum(single.incomplete for single, _ in decoders),
        "memory_growth_bytes": grown,
        "escapes": escapes[:20],
    }
    print(json.dumps(result, indent=2))
    return 1 if escapes else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
