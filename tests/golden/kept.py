"""The kept outputs: where they lie and how an output is compared with the kept one."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import platform
import re
from pathlib import Path

import numpy as np
import yaml

from tests.golden.cases import TESTS

FOLDER = Path(__file__).resolve().parent / "outputs"
HASHES = FOLDER / "sha256-0.1.0.json"
DIFFERENCES = FOLDER / "differences.yaml"
MACHINES = FOLDER / "machines.yaml"
#: Between machines whose floating point differs in the last digits, numbers are compared instead of bytes.
RELATIVE_TOLERANCE = 1e-6
ABSOLUTE_TOLERANCE = 1e-9
#: Of an error in percent, 100 (a / b - 1), where a and b agree to RELATIVE_TOLERANCE; it may itself be near 0.
ERROR_TOLERANCE_PCT = 100.0 * RELATIVE_TOLERANCE

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def normalized(text: str) -> str:
    """The text without the place of this checkout."""
    return text.replace(str(TESTS), "tests")


def sha256(text: str) -> str:
    """Hash of an output."""
    return hashlib.sha256(text.encode()).hexdigest()


def machine() -> str:
    """What decides about the last digits of floating-point results here: the C library and OpenBLAS choose their code by the
    processor's maker as well."""
    show = np.show_config(mode="dicts")
    found = show.get("SIMD Extensions", {}).get("found", []) if isinstance(show, dict) else []
    return f"{platform.machine()} {_maker()} numpy {np.__version__} {' '.join(found)}"


def environment() -> dict[str, str]:
    """This process's, without what makes OpenBLAS choose other code than the processor's own, which changes last digits."""
    return {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS_")}


def _maker() -> str:
    """Of the processor, as Linux names it."""
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text().splitlines() if listed.exists() else []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("vendor_id")), platform.processor())


def load(name: str) -> str:
    """The kept output of a case."""
    return gzip.decompress((FOLDER / f"{name}.gz").read_bytes()).decode()


def save(name: str, text: str) -> None:
    """Keep an output."""
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.gz").write_bytes(gzip.compress(text.encode(), 9, mtime=0))


def hashes() -> dict[str, str]:
    """Hashes of version 0.1.0's outputs by case, and the machine they come from under `machine`."""
    found: dict[str, str] = json.loads(HASHES.read_text())
    return found


def machines() -> dict[str, str]:
    """Machines that outputs come from which were kept anew on another one than that of the hashes, by case."""
    found: dict[str, str] = yaml.safe_load(MACHINES.read_text()) or {}
    return found


def machine_of(name: str) -> str:
    """The machine that a case's kept output comes from."""
    return machines().get(name, hashes()["machine"])


def differences() -> dict[str, str]:
    """Reasons of the outputs that differ from version 0.1.0's on purpose, by case."""
    found: dict[str, str] = yaml.safe_load(DIFFERENCES.read_text()) or {}
    return found


def first_difference(text: str, expected: str) -> str:
    """Where two outputs differ by more than the tolerances; empty where they do not.

    Text between numbers is compared exactly, numbers by RELATIVE_TOLERANCE and ABSOLUTE_TOLERANCE, JSON's members `error_pct` by
    ERROR_TOLERANCE_PCT.
    """
    ours, kept = text.splitlines(), expected.splitlines()
    if len(ours) != len(kept):
        return f"{len(ours)} lines, expected {len(kept)}"
    for number, (line, other) in enumerate(zip(ours, kept, strict=True), 1):
        if line == other:
            continue
        same_text = _NUMBER.sub("#", line) == _NUMBER.sub("#", other)
        values = [[float(part) for part in _NUMBER.findall(part)] for part in (line, other)]
        absolute = ERROR_TOLERANCE_PCT if '"error_pct": ' in line else ABSOLUTE_TOLERANCE
        if not same_text or not np.allclose(*values, rtol=RELATIVE_TOLERANCE, atol=absolute):
            return f"line {number}: {line[:200]!r}, expected {other[:200]!r}"
    return ""
