"""Truncate, scramble and mix up harvests of every kind: each gives a map or one line, never a traceback.

python -m tests.robustness fuzz-harvests --count 10000 --seed 1
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import io
import json
import random
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from yieldmon.cli import main as cli

HARVESTS = Path(__file__).parents[1] / "data" / "harvests"
SLOW_S = 20.0
_CELLS = ("", "nan", "-1e308", "inf", "1e400", "x", '"', "0", "-", "99999999999", "12.5.3", "\x00", "é", "1_0", ",,,", "180.1")


def base_files(folder: Path) -> list[Path]:
    """Small whole harvests of every kind, made from the excerpts in tests/data."""
    lines = gzip.decompress((HARVESTS / "agleader_corn.txt.gz").read_bytes()).splitlines(keepends=True)[:400]
    (folder / "basic.txt").write_bytes(b"".join(lines))
    shutil.copy(HARVESTS / "agleader_serial.txt", folder / "serial.txt")
    shutil.copy(HARVESTS / "deere_soybeans.zip", folder / "deere.zip")
    with zipfile.ZipFile(folder / "taskdata.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted((HARVESTS / "isoxml").iterdir()):
            archive.write(path, f"TASKDATA/{path.name}")
    out = folder / "made"
    words = ["map", str(folder / "basic.txt"), "--out", str(out), "--products", "csv,geopackage,taskdata,shapefile"]
    with contextlib.redirect_stderr(io.StringIO()):
        assert cli.main(words) == 0
    for name in ("points.csv", "harvest.gpkg", "points_shp.zip"):
        shutil.move(out / name, folder / name)
    shutil.move(out / "taskdata.zip", folder / "own.zip")
    shutil.rmtree(out)
    _geojson(folder / "points.geojson", lines[:60])
    with zipfile.ZipFile(folder / "several.zip", "w") as archive:
        archive.write(folder / "basic.txt", "a/basic.txt")
        archive.write(folder / "points.csv", "points.csv")
    return sorted(path for path in folder.iterdir() if path.is_file())


def _geojson(path: Path, lines: Sequence[bytes]) -> None:
    features = []
    for number, line in enumerate(lines):
        cells = line.decode().split(",")
        properties = {"yield_t_ha": float(cells[2]), "time": f"2024-09-01T10:00:{number:02d}Z", "width_m": 6.0, "Moisture": 15.0}
        place = {"type": "Point", "coordinates": [float(cells[0]), float(cells[1])]}
        features.append({"type": "Feature", "geometry": place, "properties": properties})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def _truncated(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _flipped(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 3, 30, 300))):
        if out:
            out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def _cut(data: bytes, rng: random.Random) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.randrange(1, 400) :]


def _swapped(data: bytes, rng: random.Random) -> bytes:
    size = max(1, len(data) // 16)
    blocks = [data[k : k + size] for k in range(0, len(data), size)]
    rng.shuffle(blocks)
    return b"".join(blocks)


def _cells(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 5, 50))):
        at = rng.randrange(len(lines))
        cells = lines[at].split(b",")
        cells[rng.randrange(len(cells))] = rng.choice(_CELLS).encode()
        lines[at] = b",".join(cells)
    return b"\n".join(lines)


def _lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    kind = rng.randrange(4)
    if kind == 0:
        rng.shuffle(lines)
    elif kind == 1:
        lines = [line for line in lines for _ in range(2)]
    elif kind == 2:
        lines = lines[:1]
    else:
        lines = [line[: rng.randrange(len(line) + 1)] if rng.random() < 0.2 else line for line in lines]
    return b"\n".join(lines)


def _emptied(data: bytes, rng: random.Random) -> bytes:
    return rng.choice(
        (b"", b"\n", b"\x00" * 4096, data[:16], b"\xff\xfe" + data[:200], b"PK\x03\x04", b"{}", b"<?xml version='1.0'?>")
    )


MUTATIONS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    _truncated, _flipped, _cut, _swapped, _cells, _lines, _emptied,
)  # fmt: skip


def mutated(path: Path, others: Sequence[Path], folder: Path, rng: random.Random) -> Path:
    """A damaged copy; now and then within the zip, or under the name of another kind."""
    name = path.name if rng.random() < 0.85 else f"{path.stem}{rng.choice(others).suffix}"
    target = folder / name
    data = path.read_bytes()
    if path.suffix == ".zip" and rng.random() < 0.7:
        with zipfile.ZipFile(path) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist()}
        chosen = rng.choice(list(members))
        if rng.random() < 0.2:
            del members[chosen]
        elif rng.random() < 0.2:
            members[chosen] = rng.choice(list(members.values()))
        else:
            members[chosen] = rng.choice(MUTATIONS)(members[chosen], rng)
        with zipfile.ZipFile(target, "w") as archive:
            for member, content in members.items():
                archive.writestr(member, content)
        return target
    for _ in range(rng.choice((1, 1, 2))):
        data = rng.choice(MUTATIONS)(data, rng)
    target.write_bytes(data)
    return target


def finding(path: Path, out: Path) -> tuple[int | None, str]:
    """Exit code and what is wrong with it; empty if nothing."""
    reported = io.StringIO()
    started = time.process_time()
    try:
        with contextlib.redirect_stderr(reported), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            code = cli.main(["map", str(path), "--out", str(out), "--products", "report", "--json"])
    except BaseException:  # noqa: BLE001 - whatever it is, it is a finding
        return None, traceback.format_exc()
    lines = [line for line in reported.getvalue().splitlines() if line.startswith("yieldmon: ")]
    if code not in (0, 1, 2):
        return code, f"exit code {code}"
    if code and (not lines or len(lines[-1]) > 2000):
        return code, f"no line: {reported.getvalue()[-300:]}"
    if time.process_time() - started > SLOW_S:
        return code, f"took {time.process_time() - started:.0f} s"
    return code, ""


def fuzz(count: int, seed: int, keep: Path | None = None) -> tuple[Counter[str], list[str]]:
    """Outcomes, and what was wrong with `count` damaged files."""
    rng = random.Random(seed)
    outcomes: Counter[str] = Counter()
    findings = []
    with tempfile.TemporaryDirectory() as place:
        whole, folder = Path(place) / "whole", Path(place) / "damaged"
        whole.mkdir()
        files = base_files(whole)
        for number in range(count):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            source = files[number % len(files)]
            path = mutated(source, files, folder, rng)
            code, wrong = finding(path, folder / "out")
            outcomes[f"{source.name}: {'map' if code == 0 else 'one line'}"] += 1
            if wrong:
                findings.append(f"{number} {source.name} {path.name}: {wrong}")
                if keep is not None:
                    keep.mkdir(exist_ok=True)
                    shutil.copy(path, keep / f"{number}-{path.name}")
    return outcomes, findings


def main(arguments: Sequence[str]) -> int:
    """Exit code 0 when every file gave a map or a line."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness fuzz-harvests", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="copies of the files that something was wrong with")
    args = parser.parse_args(arguments)
    outcomes, findings = fuzz(args.count, args.seed, args.keep)
    for name in sorted(outcomes):
        print(f"{outcomes[name]:6d}  {name}")
    for one in findings[:20]:
        print(one, file=sys.stderr)
    print(f"{args.count} files, {len(findings)} findings")
    return 1 if findings else 0
