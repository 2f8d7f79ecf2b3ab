"""Small logs for fleets: nominal traffic with and without grain."""

from __future__ import annotations

import gzip
from functools import cache
from pathlib import Path

import can

from tests.service.bench import CODEC, traffic

START_S = 1_790_841_600.0
"""2026-10-01, 08:00 UTC."""
EMPTY_S, GRAIN_S = 10.0, 8.0


def text(force_mv: float = 60.0, start_s: float = START_S, grain_s: float = GRAIN_S) -> str:
    """A candump log: the elevator runs empty, then grain."""
    return _stretch(start_s, EMPTY_S, 0.0) + _stretch(start_s + EMPTY_S, grain_s, force_mv)


@cache
def _stretch(start_s: float, duration_s: float, force_mv: float) -> str:
    """Lines of one force; most logs begin with the same ones."""
    lines = []
    for frame in traffic(start_s, duration_s, force_mv):
        message: can.Message = CODEC.encode(frame)
        lines.append(f"({message.timestamp:.6f}) can0 {message.arbitration_id:08X}#{message.data.hex().upper()}\n")
    return "".join(lines)


def write(path: Path, force_mv: float = 60.0, start_s: float = START_S) -> Path:
    """The log as a file, gzipped where its name says so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = text(force_mv, start_s).encode()
    path.write_bytes(gzip.compress(content, 1, mtime=0) if path.suffix == ".gz" else content)
    return path


def tree(folder: Path, machines: int = 2, days: int = 2) -> Path:
    """A folder MACHINE/DAY/LOGS in which each day is another."""
    for machine in range(machines):
        for day in range(days):
            write(folder / f"m{machine}" / f"2026-10-{day + 1:02d}" / "a.log", 50.0 + 5.0 * day + 20.0 * machine)
    return folder


def dataset_files(out: Path) -> dict[str, bytes]:
    """All files of a dataset."""
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}
