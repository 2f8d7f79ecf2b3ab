"""By what a partition's result is known: hashes of the software, of the configuration and of the inputs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yieldmon
from yieldmon.files import digests, machine_file, parameter_file
from yieldmon.service.config.configuration import Configuration

_LIBRARIES = ("numpy", "scipy", "pyarrow")
"""Packages besides ours that make the bits of a result."""


@dataclass(frozen=True, slots=True)
class Software:
    """version: of yieldmon; source_sha256: of its source files; libraries: versions of the packages that make the numbers."""

    version: str
    source_sha256: str
    libraries: str


@dataclass(frozen=True, slots=True)
class Identity:
    """All that a partition's result follows from."""

    software: Software
    parameters_sha256: str
    inputs_sha256: str

    @property
    def key(self) -> str:
        """Hash of all three."""
        return _digest(asdict(self))


@cache
def software() -> Software:
    """The software that runs here."""
    digest = hashlib.sha256()
    root = Path(yieldmon.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = " ".join(f"{name}-{_version(name)}" for name in _LIBRARIES)
    return Software(yieldmon.__version__, digest.hexdigest(), libraries)


def parameters_sha256(configured: Configuration) -> str:
    """Of a configuration with its machine, its parameters and the files that it names."""
    calibrator = configured.calibrator
    return _digest({
        "document": configured.document.model_dump(mode="json"),
        "machine": machine_file.to_document(configured.machine),
        "parameters": parameter_file.to_document(configured.parameters),
        "databases": [digests.of_file(path) for path in configured.database_paths],
        "moisture_map": repr(calibrator.moisture_map) if calibrator is not None else "",
    })  # fmt: skip


def inputs_sha256(logs: list[tuple[str, str]], tickets_sha256: str, crop: str, sharing: Sequence[tuple[str, str]] = ()) -> str:
    """Of the logs (name, SHA-256 of the content), in their order, the tickets, the crop, and the days that share the tickets."""
    shared = {"sharing": list(sharing)} if sharing else {}
    return _digest({"logs": logs, "tickets": tickets_sha256, "crop": crop, **shared})


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
