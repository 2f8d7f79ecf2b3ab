"""Excerpts of real harvests as files."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

HARVESTS = Path(__file__).parents[1] / "data" / "harvests"


@pytest.fixture(scope="session")
def corn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """6,000 rows of a real field in Ag Leader text, no delay taken out."""
    path = tmp_path_factory.mktemp("corn") / "corn.txt"
    path.write_bytes(gzip.decompress((HARVESTS / "agleader_corn.txt.gz").read_bytes()))
    return path


@pytest.fixture(scope="session")
def harvests() -> Path:
    """The folder of the excerpts."""
    return HARVESTS
