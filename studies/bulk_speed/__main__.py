"""How many frames a second go from a log to rows with flow: our frames with real traffic of a tractor between them.

    python -m studies.bulk_speed RECORDINGS [--frames N] [--keep FOLDER] [--json]
    python -m studies.bulk_speed RECORDINGS --frames 69000000 --json     # all of it: 3.5 GB of text in a temporary folder

RECORDINGS is a folder of candump logs of other nodes' traffic (the excerpts in tests/data/tractor_bus do as well). They are
laid end to end, as often as it takes, beside a simulated harvest, each at its own rate; the same frames are written as candump
text and packed. CPU time of one process, in one run; beside it, on samples of the same frames, python-can with cantools, and
asammdf, which decodes bus logs (MF4) by numpy; neither has an engine behind it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import marshal
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
from cantools.database.can import Database

from yieldmon.bus.bulk import FrameBlock, block_of, concatenate, messages_of
from yieldmon.bus.codec import Codec
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.packed.writing import pack
from yieldmon.identifiers import EXTENDED_FLAG
from yieldmon.plant import scenario as scenarios
from yieldmon.plant.combine import VirtualCombine
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.logs import log_record
from yieldmon.service.storage.rows import SecondRow

WANTED_FRAMES = 69_000_000
TILE_S = 600.0
START_S = 1_760_000_000.0
SEED = 11
SAMPLE_FRAMES = 40_000
MF4_FRAMES = 400_000


def ours() -> FrameBlock:
    """A simulated harvest's frames, from 0 s."""
    loaded = configuration.load(shipped("config/yieldmon.yaml"))
    scenario = scenarios.load(shipped("config/scenarios/harvest-day.yaml")).model_copy(update={"duration_s": TILE_S})
    combine, codec = VirtualCombine(scenario, loaded.machine, SEED), Codec()
    return block_of(codec.encode(frame) for frame in combine.frames_until(TILE_S))


def foreign(folder: Path) -> FrameBlock:
    """The recordings, one after the other from 0 s, as often as it takes; frames of at most 8 bytes."""
    parts, at_s = [], 0.0
    recorded = [concatenate(list(iter_blocks(path))) for path in sorted(folder.glob("*.log"))]
    if not recorded:
        raise SystemExit(f"{folder}: no *.log")
    while at_s < TILE_S:
        for block in recorded:
            times = np.maximum.accumulate(block.time_s - block.time_s[0])
            kept = block.take(np.flatnonzero(block.length <= 8))
            parts.append(FrameBlock(times[block.length <= 8] + at_s, kept.can_id, kept.length, kept.payload, kept.channel, ("",)))
            at_s += float(times[-1]) + 0.01
    whole = concatenate(parts)
    return whole.take(np.flatnonzero(whole.time_s < TILE_S))


def tile(folder: Path) -> tuple[FrameBlock, float]:
    """TILE_S of both, in order of time, and the share of ours."""
    parts = ours(), foreign(folder)
    on_one = [FrameBlock(b.time_s, b.can_id, b.length, b.payload, np.zeros_like(b.channel), ("can0",)) for b in parts]
    both = concatenate(on_one)
    return both.take(np.argsort(both.time_s, kind="stable")), len(parts[0]) / len(both)


def tiled(one: FrameBlock, frames: int) -> Iterator[FrameBlock]:
    """The tile again and again, to `frames` frames."""
    for number in range(-(-frames // len(one))):
        times = np.rint((one.time_s + START_S + number * TILE_S) * 1e6) / 1e6
        block = FrameBlock(times, one.can_id, one.length, one.payload, one.channel, one.channels)
        yield block.take(slice(0, min(len(one), frames - number * len(one))))


def write_text(blocks: Iterator[FrameBlock], path: Path) -> None:
    """As candump -l writes it."""
    with path.open("w") as file:
        for block in blocks:
            columns = (block.time_s, block.can_id, block.length, block.payload)
            for time_s, can_id, length, payload in zip(*(column.tolist() for column in columns), strict=True):
                name = f"{can_id & 0x1FFFFFFF:08X}" if can_id & EXTENDED_FLAG else f"{can_id:03X}"
                file.write(f"({time_s:.6f}) can0 {name}#{payload.to_bytes(8, 'little')[:length].hex().upper()}\n")


class Digest:
    """Takes rows: their number and a hash of all their bits. Its own CPU time is kept apart, and no more than some rows."""

    _TOGETHER = 2000
    _values = attrgetter("number", *SecondRow.__dataclass_fields__)

    def __init__(self) -> None:
        self._hash, self._waiting = hashlib.blake2b(), list[SecondRow]()
        self.rows, self.spent_s = 0, 0.0

    def take(self, row: SecondRow) -> None:
        """The next row."""
        self._waiting.append(row)
        if len(self._waiting) >= self._TOGETHER:
            self.finish()

    def finish(self) -> str:
        """The hash of all rows so far."""
        began = time.process_time()
        for row in self._waiting:
            self._hash.update(marshal.dumps(self._values(row)))
        self.rows += len(self._waiting)
        self._waiting.clear()
        self.spent_s += time.process_time() - began
        return self._hash.hexdigest()


def to_rows(path: Path) -> tuple[float, int, str]:
    """CPU seconds, number of rows and their hash, as `process --jobs 1` makes them."""
    loaded = configuration.load(shipped("config/yieldmon.yaml"))
    digest = Digest()
    began = time.process_time()
    log_record.measure([str(path)], loaded, digest.take)
    taken_s = time.process_time() - began - digest.spent_s
    found = digest.finish()
    return taken_s, digest.rows, found


def reading_alone(path: Path) -> float:
    """CPU seconds to frames as arrays."""
    began = time.process_time()
    for _ in iter_blocks(path):
        pass
    return time.process_time() - began


def obvious_loop(path: Path) -> tuple[float, int]:
    """CPU seconds and frames: python-can reads, cantools decodes what is ours; no engine."""
    database = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))
    assert isinstance(database, Database)
    names = {message.frame_id for message in database.messages}
    began, count = time.process_time(), 0
    with can.LogReader(path) as reader:
        for message in reader:
            count += 1
            if message.arbitration_id in names:
                database.decode_message(message.arbitration_id, bytes(message.data), decode_choices=False)
            if count >= SAMPLE_FRAMES:
                break
    return time.process_time() - began, count


def fast_decoder(blocks: Iterator[FrameBlock], folder: Path) -> tuple[float, int, int]:
    """CPU seconds, frames and decoded channels of asammdf, from the same frames as MF4; no engine."""
    import asammdf

    path, count = folder / "bulk.mf4", 0
    with can.MF4Writer(path) as writer:
        for block in blocks:
            for message in messages_of(block):
                writer.on_message_received(message)
            count += len(block)
    began = time.process_time()
    with asammdf.MDF(path) as log, log.extract_bus_logging({"CAN": [(str(shipped("dbc/yieldmon.dbc")), 0)]}) as decoded:
        channels = sum(len(signal) > 0 for signal in decoded.iter_channels(skip_master=True))
    return time.process_time() - began, count, channels


def main() -> int:
    """Exit code 0 when rows from text and packed frames are the same."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.bulk_speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--frames", type=int, default=2_000_000)
    parser.add_argument("--keep", type=Path, help="folder that keeps the files made; default: none")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        one, share = tile(args.recordings)
        text, packed = folder / "bulk.log", folder / "bulk.parquet"
        write_text(tiled(one, args.frames), text)
        size = pack(tiled(one, args.frames), packed, Codec().layouts).size_bytes
        to_rows(packed)  # compiled code is made once
        found = {name: (to_rows(path), reading_alone(path)) for name, path in (("packed", packed), ("text", text))}
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        same = found["packed"][0][1:] == found["text"][0][1:]
        mf4_s, mf4_frames, mf4_channels = fast_decoder(tiled(one, min(args.frames, MF4_FRAMES)), folder)
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
        loop_s, loop_frames = obvious_loop(text)
        document = {
            "frames": args.frames, "share_of_ours": share, "tile_frames": len(one), "seconds_of_log": found["text"][0][1],
            "seed": SEED, "commit": commit.stdout.strip(), "load_average": os.getloadavg()[0],
            "text_bytes": text.stat().st_size, "packed_bytes": size, "rows_equal": same,
            "rows_hash": found["text"][0][2], "peak_memory_mb": peak_mb,
            **{name: _figures(rows_s, read_s, args.frames) for name, ((rows_s, _, _), read_s) in found.items()},
            "python_can_cantools": {"frames": loop_frames, "mframes_s": loop_frames / loop_s / 1e6,
                                    "cpu_s_scaled": WANTED_FRAMES * loop_s / loop_frames},
            "asammdf": {"frames": mf4_frames, "mframes_s": mf4_frames / mf4_s / 1e6, "channels": mf4_channels,
                        "cpu_s_scaled": WANTED_FRAMES * mf4_s / mf4_frames},
        }  # fmt: skip
    print(json.dumps(document, indent=2) if args.json else _text(document))
    return 0 if same else 1


def _figures(rows_s: float, read_s: float, frames: int) -> dict[str, float]:
    return {
        "cpu_s": rows_s,
        "mframes_s": frames / rows_s / 1e6,
        "reading_mframes_s": frames / read_s / 1e6,
        "cpu_s_scaled": WANTED_FRAMES * rows_s / frames,
    }


def _text(document: dict[str, Any]) -> str:
    lines = [
        f"{document['frames']} frames, {100 * document['share_of_ours']:.0f} % ours, {document['seconds_of_log']} s of log; "
        f"rows from text and packed frames equal: {document['rows_equal']}; peak memory {document['peak_memory_mb']:.0f} MB",
    ]
    for name in ("packed", "text"):
        f = document[name]
        lines.append(
            f"{name:8} {f['cpu_s']:7.2f} CPU-s, {f['mframes_s']:.2f} M frames/s (reading alone {f['reading_mframes_s']:.2f}); "
            f"{WANTED_FRAMES / 1e6:.0f} M frames scaled: {f['cpu_s_scaled']:.0f} CPU-s"
        )
    loop = document["python_can_cantools"]
    lines.append(
        f"python-can and cantools, no engine, on {loop['frames']} frames: {loop['mframes_s']:.4f} M frames/s; "
        f"scaled: {loop['cpu_s_scaled']:.0f} CPU-s"
    )
    other = document["asammdf"]
    lines.append(
        f"asammdf, no engine, on {other['frames']} frames (MF4): {other['mframes_s']:.2f} M frames/s, "
        f"{other['channels']} channels; scaled: {other['cpu_s_scaled']:.0f} CPU-s"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
