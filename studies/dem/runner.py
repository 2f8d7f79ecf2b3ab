"""Starts the engine's process, hands it a job and reads what it reports. This side never imports LAMMPS."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.dem.job import Throw, to_dict

Arrays = dict[str, NDArray[Any]]
#: numpy reads an array's header with ast, which CPython 3.11 does not build in two threads at once (its issue 106905).
_LOADING = threading.Lock()


class EngineError(RuntimeError):
    """The engine is missing, refused its job or died; the text is its own last line."""


def engine_version() -> int | None:
    """LAMMPS's version as a date number such as 20250722, or None where the extra is not installed."""
    versions: list[int] = []
    try:
        _run({"kind": "version"}, lambda report: versions.append(int(report["version"])))
    except EngineError:
        return None
    return versions[0]


def plate_file(out: Path, plate_angle_rad: float) -> Path:
    """Where a throw's result at one plate angle is written."""
    return out / f"plate-{math.degrees(plate_angle_rad):07.3f}.npz"


def run_throw(
    throw: Throw,
    plate_angles_rad: Sequence[float],
    out: Path,
    cache: Path,
    *,
    audit: bool = False,
    on_report: Callable[[dict[str, Any]], None] = lambda report: None,
) -> None:
    """Settles and throws one load at each plate angle; release.npz and one plate file per angle appear in `out`.

    `audit` also records the force of paddle and housing on the grains. on_report is called after each part with what the worker
    says. Raises EngineError.
    """
    job = {
        "kind": "throw",
        "throw": to_dict(throw),
        "plate_angles_rad": list(plate_angles_rad),
        "cache": str(cache),
        "out": str(out),
        "audit": audit,
    }
    _run(job, on_report)


def run_stream(
    throw: Throw,
    plate_angle_rad: float,
    position_m: NDArray[Any],
    velocity_m_s: NDArray[Any],
    orientation: NDArray[Any] | None = None,
) -> Arrays:
    """Fires free grains of the mean size at the plate. position_m, velocity_m_s: (n, 3); orientation: (n, 3, 3) of clumps.

    Raises EngineError.
    """
    with TemporaryDirectory(prefix="yieldmon-dem-") as folder:
        out = Path(folder)
        job = {
            "kind": "stream",
            "throw": to_dict(throw),
            "plate_angle_rad": plate_angle_rad,
            "out": folder,
            "position_m": np.asarray(position_m).tolist(),
            "velocity_m_s": np.asarray(velocity_m_s).tolist(),
        }
        if orientation is not None:
            job["orientation"] = np.asarray(orientation).tolist()
        _run(job, lambda report: None)
        return load(plate_file(out, plate_angle_rad))


def load(path: Path) -> Arrays:
    """All arrays of an .npz, read whole; threads of a campaign read one after the other."""
    with _LOADING, np.load(path) as kept:
        return {name: kept[name] for name in kept.files}


def _run(job: dict[str, Any], on_report: Callable[[dict[str, Any]], None]) -> None:
    command = [sys.executable, "-m", "studies.dem.worker"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8"
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.write(json.dumps(job))
        process.stdin.close()
        for line in process.stdout:
            if line.startswith("{"):
                on_report(json.loads(line))
        complaint = [line for line in process.stderr.read().splitlines() if line[:1].strip()]
        code = process.wait()
    if code != 0:
        errors = [line for line in complaint if "ERROR" in line]
        cause = (errors or complaint)[-1] if complaint else f"ended with code {code} and no word"
        raise EngineError(f"discrete-element engine: {cause}")
