"""Cost of `yieldmon diagnose` on the published discrete-element table (`tools/bench -k diagnosis`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from yieldmon.discrepancy import diagnosis
from yieldmon.files import parameter_file, table
from yieldmon.physics.machine import Machine

DATA = Path(__file__).parents[1] / "data"


@pytest.mark.benchmark(group="diagnose, discrete-element table, default split")
def test_diagnosis_of_the_published_table(benchmark):
    data, start = table.load(DATA / "dem_table.csv"), parameter_file.load(None)
    shares: list[float] = []

    def tell(text: str, share: float) -> None:
        shares.append(share)

    found = benchmark.pedantic(lambda: diagnosis.diagnose(data, Machine(), start, progress=tell), rounds=3, iterations=1)
    assert found.verdict == "effect"
    assert min(shares) == 0.0
    assert len(set(shares)) >= 8
