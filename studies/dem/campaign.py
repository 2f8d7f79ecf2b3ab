"""Many throws from one YAML file, so that a kill at any moment loses no finished row and repeats none.

The ledger is a folder: ``rows/<key>.json`` is there, whole, once a row is done, and its key is a digest of everything that the
row depends on. Going on means asking which keys of the plan are missing.
"""

from __future__ import annotations

import csv
import fcntl
import hashlib
import json
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from studies.dem import records, runner
from studies.dem.job import Throw, digest, kernel_defaults, merged, paddle_mass_kg, throw_from_dict, to_dict
from yieldmon.errors import InputError
from yieldmon.files import machine_file
from yieldmon.physics.machine import RPM
from yieldmon.resources import shipped

HISTORY_INTERVAL_S = 0.001
KEYS = (
    "name",
    "machine",
    "kernel",
    "throw",
    "elevator_speed_rpm",
    "friction",
    "restitution",
    "paddle_mass_kg",
    "mass_flow_kg_s",
    "plate_angle_deg",
    "seed",
)
Row = dict[str, float | int | str]


@dataclass(frozen=True, slots=True)
class Campaign:
    """A named plan: throws in the order in which they are to be run, each at the same plate angles."""

    name: str
    throws: tuple[Throw, ...]
    plate_angles_rad: tuple[float, ...]
    source_sha256: str

    @property
    def row_count(self) -> int:
        return len(self.throws) * len(self.plate_angles_rad)


def row_key(throw: Throw, plate_angle_rad: float) -> str:
    """Digest of all that a row depends on."""
    return digest([to_dict(throw), round(math.degrees(plate_angle_rad), 6)])


def _machine_path(name: str) -> Path:
    """A file, or the name of a shipped machine such as sprocket-8."""
    path = Path(name)
    return path if path.suffix else shipped(f"config/machines/{name}.yaml")


def _numbers(where: str, content: Mapping[str, Any], key: str, default: Sequence[float] | None = None) -> list[float]:
    values = content.get(key, default)
    if values is None:
        raise InputError(where, f"{key} is missing", "a list of numbers")
    values = values if isinstance(values, list | tuple) else [values]
    if not values or not all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values):
        raise InputError(where, f"{key} is {values}", "a list of numbers")
    return [float(v) for v in values]


def parse(text: str, where: str) -> Campaign:
    """A campaign from YAML text. Seeds vary slowest, then load, kernel, speed, friction, restitution.

    Keys: name; machine (a file, or a shipped name such as sprocket-8); kernel (sphere, clump or a list of both, each with
    `job.kernel_defaults`); throw (any field of `job.Throw`, nested, over those); lists
    elevator_speed_rpm, friction, restitution, paddle_mass_kg or mass_flow_kg_s, plate_angle_deg, seed. Raises InputError naming
    the key.
    """
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(where, f"not YAML ({error})") from error
    if not isinstance(content, dict):
        raise InputError(where, "no keys", f"a mapping with {', '.join(KEYS)}")
    for key in content:
        if key not in KEYS:
            raise InputError(where, f"{key} is not a key", f"one of {', '.join(KEYS)}")
    fixed = dict(content.get("throw") or {})
    loads_are_flows = "mass_flow_kg_s" in content
    if loads_are_flows == ("paddle_mass_kg" in content):
        raise InputError(where, "paddle_mass_kg or mass_flow_kg_s", "exactly one of the two")
    loads = _numbers(where, content, "mass_flow_kg_s" if loads_are_flows else "paddle_mass_kg")
    throws = []
    try:
        kernels = content.get("kernel", "sphere")
        bases = [
            throw_from_dict(merged(kernel_defaults(kernel), {"paddle_mass_kg": 1.0} | fixed))
            for kernel in (kernels if isinstance(kernels, list) else [kernels])
        ]
        if "machine" in content:
            machine = machine_file.load(_machine_path(str(content["machine"])))
            bases = [replace(base, machine=machine) for base in bases]
        base = bases[0]
        speeds = _numbers(where, content, "elevator_speed_rpm", [base.elevator_speed_rad_s / RPM])
        frictions = _numbers(where, content, "friction", [base.contact.friction])
        restitutions = _numbers(where, content, "restitution", [base.contact.restitution])
        seeds = _numbers(where, content, "seed", [base.seed])
        for seed, load, base, speed, friction, restitution in product(seeds, loads, bases, speeds, frictions, restitutions):
            spin = speed * RPM
            throws.append(
                replace(
                    base,
                    seed=int(seed),
                    elevator_speed_rad_s=spin,
                    paddle_mass_kg=paddle_mass_kg(base.machine, load, spin) if loads_are_flows else load,
                    contact=replace(base.contact, friction=friction, restitution=restitution),
                )
            )
    except (TypeError, ValueError, FileNotFoundError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"throw: {error}") from error
    angles = _numbers(where, content, "plate_angle_deg", [math.degrees(base.machine.home_plate_angle_rad)])
    for angle in angles:
        if not 0.0 < angle <= 90.0:
            raise InputError(where, f"plate_angle_deg holds {angle}", "angles above 0 and at most 90 deg")
    return Campaign(
        str(content.get("name", "campaign")),
        tuple(throws),
        tuple(math.radians(a) for a in angles),
        hashlib.sha256(text.encode()).hexdigest(),
    )


class Ledger:
    """The folder of a campaign: which rows are done, and where the grains' records are."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.rows = folder / "rows"
        self.cache = folder / "heaps"
        self.rows.mkdir(parents=True, exist_ok=True)
        self.cache.mkdir(exist_ok=True)

    def throw_folder(self, throw: Throw) -> Path:
        return self.folder / "throws" / throw.throw_key()

    def row_file(self, throw: Throw, plate_angle_rad: float) -> Path:
        return self.rows / f"{row_key(throw, plate_angle_rad)}.json"

    def missing_angles(self, campaign: Campaign, throw: Throw) -> list[float]:
        return [a for a in campaign.plate_angles_rad if not self.row_file(throw, a).exists()]

    def missing(self, campaign: Campaign) -> list[tuple[Throw, list[float]]]:
        """Throws with rows still to do, in the plan's order."""
        wanted = ((throw, self.missing_angles(campaign, throw)) for throw in campaign.throws)
        return [(throw, angles) for throw, angles in wanted if angles]

    def add(self, throw: Throw, plate_angle_rad: float, row: Row) -> None:
        """Puts a row down, whole or not at all."""
        path = self.row_file(throw, plate_angle_rad)
        part = path.with_suffix(f".part{os.getpid()}")
        with part.open("w", encoding="utf-8") as stream:
            json.dump(row, stream)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)

    def read(self, campaign: Campaign) -> list[Row]:
        """Rows done so far, in the plan's order."""
        files = (self.row_file(t, a) for t in campaign.throws for a in campaign.plate_angles_rad)
        rows = [json.loads(f.read_text(encoding="utf-8")) for f in files if f.exists()]
        for row in rows:
            # A row that names no kernel is of spheres.
            row.setdefault("kernel", "sphere")
        return rows

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Holds the folder for this process; the lock dies with it. Raises InputError when another campaign has it."""
        with (self.folder / "lock").open("w") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(str(self.folder), "another campaign is at work here", "a folder of its own") from None
            yield


def work(throw: Throw, angle_count: int) -> float:
    """Rough effort of a throw in grain-steps, for the time left: settling, the throw, and half of a turn per plate angle."""
    turn_steps = 2.0 * math.pi / (throw.elevator_speed_rad_s * throw.time_step_s)
    return throw.grain_count * turn_steps * (throw.settle_revolutions + 0.4 + 0.6 * angle_count)


def run(
    campaign: Campaign, ledger: Ledger, jobs: int, tell: Callable[[str], None], clock: Callable[[], float] = time.monotonic
) -> None:
    """Does what is missing, `jobs` engine processes at a time. Raises runner.EngineError after the running throws have ended."""
    with ledger.alone():
        todo = ledger.missing(campaign)
        (ledger.folder / "provenance.json").write_text(json.dumps(provenance(campaign), indent=1), encoding="utf-8")
        total = sum(work(t, len(a)) for t, a in todo)
        rows_left = sum(len(a) for _, a in todo)
        tell(f"{campaign.name}: {campaign.row_count - rows_left} of {campaign.row_count} rows are done")
        started, done = clock(), 0.0
        with ThreadPoolExecutor(max_workers=jobs) as pool:
            queue = iter(todo)
            running: dict[Future[None], tuple[Throw, list[float]]] = {}
            failure: BaseException | None = None
            while True:
                while failure is None and len(running) < jobs and (item := next(queue, None)) is not None:
                    running[pool.submit(_one, ledger, *item)] = item
                if not running:
                    break
                ended, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in ended:
                    throw, angles = running.pop(future)
                    failure = future.exception() or failure
                    if future.exception() is None:
                        done += work(throw, len(angles))
                        rows_left -= len(angles)
                        left = (clock() - started) * (total - done) / done
                        tell(f"{campaign.row_count - rows_left}/{campaign.row_count} rows, {left / 60.0:.0f} min left")
        if failure is not None:
            raise failure


def _one(ledger: Ledger, throw: Throw, angles: list[float]) -> None:
    """One throw at the angles that are missing; each row is put down as soon as its plate phase has ended."""
    out = ledger.throw_folder(throw)

    def on_report(report: dict[str, Any]) -> None:
        if report["stage"] == "plate":
            angle = report["plate_angle_rad"]
            plate = runner.load(runner.plate_file(out, angle))
            ledger.add(throw, angle, records.row(throw, runner.load(out / "release.npz"), plate))

    runner.run_throw(throw, angles, out, ledger.cache, on_report=on_report)


def provenance(campaign: Campaign) -> dict[str, Any]:
    """What is needed to repeat the campaign."""
    return {
        "campaign": campaign.name,
        "source_sha256": campaign.source_sha256,
        "engine": "LAMMPS",
        "engine_version": runner.engine_version(),
        "code_sha256": _code_digest(Path(__file__).parent),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": platform.platform(),
        "command": sys.argv,
    }


def _code_digest(folder: Path) -> str:
    names = ("clump.py", "job.py", "packing.py", "script.py", "worker.py")
    parts = [hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names]
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def write_csv(path: Path, rows: Iterable[Mapping[str, float | int | str]]) -> None:
    """Rows with equal columns as CSV, numbers to seven digits."""
    rows = list(rows)
    if not rows:
        raise InputError(str(path), "no rows to write", "a campaign with at least one finished row")
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.7g}" if isinstance(v, float) else v for k, v in row.items()})


def layer_rows(campaign: Campaign, ledger: Ledger) -> list[Row]:
    """Release by radial layer for each throw that has its records."""
    rows: list[Row] = []
    for throw in campaign.throws:
        release, plates = ledger.throw_folder(throw) / "release.npz", sorted(ledger.throw_folder(throw).glob("plate-*.npz"))
        if not (release.exists() and plates):
            continue
        for layer in records.layers(throw, runner.load(release) | runner.load(plates[0])):
            rows.append({**_head(throw), **layer})
    return rows


def arrival_rows(campaign: Campaign, ledger: Ledger) -> list[Row]:
    """How the stream meets the plate, for each row whose records are kept (`records.arrival`)."""
    rows: list[Row] = []
    for throw in campaign.throws:
        for angle in campaign.plate_angles_rad:
            path = runner.plate_file(ledger.throw_folder(throw), angle)
            if path.exists():
                head = {"plate_angle_deg": round(math.degrees(angle), 6), **_head(throw)}
                rows.append({**head, **records.arrival(throw, runner.load(path))})
    return rows


def heap_rows(campaign: Campaign, ledger: Ledger) -> list[Row]:
    """Shape of the settled heap for each throw that has its records and is large enough to have a surface."""
    rows: list[Row] = []
    for throw in campaign.throws:
        path = ledger.throw_folder(throw) / "release.npz"
        if not path.exists():
            continue
        try:
            shape = settled_shape(throw, runner.load(path))
        except ValueError:
            continue
        rows.append(
            {
                **_head(throw),
                "inner_radius_m": shape.inner_radius_m,
                "reach_deg": math.degrees(shape.reach_rad),
                "shape_ratio": shape.shape_ratio,
                "straightness_mm": 1e3 * shape.straightness_m,
                "bulk_density_kg_m3": shape.bulk_density_kg_m3,
            }
        )
    return rows


def settled_shape(throw: Throw, release: records.Arrays) -> records.HeapShape:
    """Shape of the heap that a release file holds."""
    from studies.dem import script

    along, ahead = records.paddle_frame(release["heap_position_m"], script.start_angle_rad(throw))
    return records.heap_shape(throw, along, ahead, release["radius_m"])


def grain_arrays(campaign: Campaign, ledger: Ledger) -> dict[str, NDArray[Any]]:
    """Per-grain records of the throws at the plan's first speed, friction and seed, small enough to ship.

    For each load: settled place along and ahead of the paddle (mm), radius when let go (mm), travel to the tip (ms), speed (m/s)
    and direction (deg below the horizontal) once free. Names end in the load in kg.
    """
    from studies.dem import script

    first = campaign.throws[0]
    arrays: dict[str, NDArray[Any]] = {}
    loads = []
    for throw in campaign.throws:
        if replace(throw, paddle_mass_kg=first.paddle_mass_kg) != first:
            continue
        folder = ledger.throw_folder(throw)
        plates = sorted(folder.glob("plate-*.npz"))
        if not plates:
            continue
        release, plate = runner.load(folder / "release.npz"), runner.load(plates[0])
        along, ahead = records.paddle_frame(release["heap_position_m"], script.start_angle_rad(throw))
        values = {
            "along_mm": 1e3 * along,
            "ahead_mm": 1e3 * ahead,
            "let_go_radius_mm": 1e3 * plate["let_go_radius_m"],
            "travel_ms": 1e3 * (plate["tip_s"] - plate["let_go_s"]),
            "speed_m_s": np.hypot(plate["free_velocity_m_s"][:, 0], plate["free_velocity_m_s"][:, 1]),
            "below_horizontal_deg": np.degrees(records.direction_below_horizontal_rad(plate["free_velocity_m_s"])),
        }
        loads.append(throw.paddle_mass_kg)
        for name, value in values.items():
            arrays[f"{name}_{throw.paddle_mass_kg:g}"] = value.astype(np.float16)
    return {"paddle_mass_kg": np.array(loads), **arrays} if loads else {}


def _head(throw: Throw) -> Row:
    return {
        "paddle_mass_kg": throw.paddle_mass_kg,
        "elevator_speed_rpm": round(throw.elevator_speed_rad_s / RPM, 6),
        "friction": throw.contact.friction,
        "trial": throw.seed,
        "kernel": throw.grain.kernel,
    }


def history_rows(campaign: Campaign, ledger: Ledger, interval_s: float = HISTORY_INTERVAL_S) -> list[Row]:
    """Horizontal force on the plate in each interval since the settled load was handed over, normal only and total, N."""
    rows: list[Row] = []
    for throw in campaign.throws:
        for angle in campaign.plate_angles_rad:
            path = runner.plate_file(ledger.throw_folder(throw), angle)
            if not path.exists():
                continue
            plate = runner.load(path)
            dt = float(plate["time_step_s"])
            lead_in = np.zeros(round(float(plate["start_s"]) / dt))
            normal, total = (
                records.resample_force_n(np.concatenate([lead_in, plate[name][:, 0]]), dt, interval_s)
                for name in ("normal_force_n", "total_force_n")
            )
            first = int(np.argmax(total != 0.0))
            for i in range(first, len(normal)):
                rows.append(
                    {
                        "plate_angle_deg": round(math.degrees(angle), 6),
                        **_head(throw),
                        "time_s": round(i * interval_s, 9),
                        "force_normal_n": float(normal[i]),
                        "force_total_n": float(total[i]),
                    }
                )
    return rows
