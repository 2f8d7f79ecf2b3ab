"""A disk that is really full, under the daemon and at its start. Needs root for the mount, which the guest has."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.service import bench as service_bench
from tests.service.bench import START_S, Bench, running, wait_for
from yieldmon.service.storage.store import Store

pytestmark = pytest.mark.vcan

SETTINGS = "bus: {transmit_max_age_s: 60}\nzero: {first_zero_windows: 1}\n"


@pytest.fixture
def small_disk(vcan0: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on a file system of its own with 1 MB."""
    monkeypatch.setattr(service_bench, "PATIENCE_S", 120.0)
    folder = tmp_path / "disk"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder], check=True)
    yield folder
    subprocess.run(["umount", folder], check=True)


def fill(folder: Path) -> Path:
    ballast = folder / "ballast"
    with ballast.open("ab", buffering=0) as file:
        try:
            while True:
                file.write(bytes(512))
        except OSError:
            return ballast


def play_on(bench: Bench) -> None:
    """Windows in which a failed write shows: what is found after one is judged with the next."""
    for _ in range(3):
        bench.play(1, 60.0)
        bench.played()


def test_a_full_disk_is_a_fault_and_nothing_is_lost(small_disk: Path, tmp_path: Path) -> None:
    with running(tmp_path, SETTINGS, state=small_disk) as bench:
        bench.play(4, 0.0)
        bench.play(3, 60.0)
        bench.played()
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "the first seconds in the store")
        ballast = fill(small_disk)
        for _ in range(60):
            bench.play(1, 60.0)
            bench.played()
            if bench.daemon.writer.health().failing:
                break
        play_on(bench)
        wait_for(lambda: "StoreFailing" in bench.faults, "StoreFailing")
        measured_kg = bench.status["total"]["mass_kg"]
    fill(small_disk)
    with running(tmp_path, SETTINGS, state=small_disk, start_s=START_S + 200) as bench:
        kept_kg = bench.status["total"]["mass_kg"]
        assert 0.0 < kept_kg <= measured_kg + 10.0, "the state is read from a full disk"
        bench.play(4, 60.0)
        wait_for(lambda: bench.daemon.writer.health().failing, "a write that fails")
        play_on(bench)
        wait_for(lambda: "StoreFailing" in bench.faults, "StoreFailing after a start on a full disk")
        ballast.unlink()
        wait_for(lambda: not bench.daemon.writer.health().failing, "recovery")
        bench.play(6, 60.0)
        bench.played()
        assert "StoreFailing" not in bench.faults
    with Store(small_disk / "yieldmon.sqlite") as store:
        rows = store.seconds()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert rows[-1].total_kg == pytest.approx(sum(row.mass_kg for row in rows))
