"""Totals that are set to 0, and a store that is copied, while the daemon runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.file_limit import files_end_at
from tests.service.bench import START_S, running
from yieldmon.cli.main import main
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.storage.store import Store
from yieldmon.units import Units, UnitSystem


def test_totals_are_archived_and_reset_and_stay_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "archive.sqlite"
    socket = ["--socket", str(tmp_path / "yieldmon.sock")]
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.play(6, 60.0)
        bench.played()
        total_kg = bench.status["total"]["mass_kg"]
        assert total_kg > 5.0
        with pytest.raises(ControlError, match=r"the total is .*; expected this figure, to confirm the reset"):
            ask(tmp_path / "yieldmon.sock", {"command": "totals-reset", "total_kg": 1})
        assert bench.daemon.writer.wait_until_written(10.0)
        assert main(["totals", "archive", str(out), *socket]) == 0
        assert main(["totals", "archive", str(out), *socket]) == 2
        capsys.readouterr()
        assert main(["totals", "reset", "7 t", *socket]) == 2
        assert capsys.readouterr().err.endswith(f"is {Units().mass(total_kg)}; expected this figure, to confirm the reset\n")
        assert main(["totals", "reset", str(round(total_kg)), *socket]) == 0
        assert "set to 0; load 2 begins" in capsys.readouterr().out
        bench.play(3, 0.0)
        bench.played()
        assert bench.status["total"]["mass_kg"] < 0.5 * total_kg
        left_kg = bench.status["total"]["mass_kg"]
    with Store(out) as store:
        assert store.seconds()[-1].total_kg == pytest.approx(total_kg)
    with running(tmp_path, start_s=START_S + 60.0) as bench:
        assert bench.status["total"]["mass_kg"] == pytest.approx(left_kg, abs=1.0)
        assert bench.status["load"]["number"] == 2
        assert bench.status["store"]["note"] is None


@pytest.mark.parametrize(
    ("system", "what"),
    [(UnitSystem.METRIC, "figure"), (UnitSystem.METRIC, "line"), (UnitSystem.US, "line"), (UnitSystem.US, "number")],
)
def test_totals_are_reset_by_the_figure_that_status_shows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], system: UnitSystem, what: str
) -> None:
    with running(tmp_path, f"units: {system}\nbus: {{transmit_max_age_s: 60}}\n") as bench:
        bench.play(14, 0.0)
        bench.play(6, 60.0)
        bench.played()
        socket = ["--socket", str(tmp_path / "yieldmon.sock")]
        assert main(["status", *socket]) == 0
        shown = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("total"))
        figure, around = shown.removeprefix("total").split("±")
        number = figure.strip().removesuffix(" lb")
        typed = {"line": f"{figure}±{around}", "figure": figure, "number": number.replace(",", "")}[what]
        assert main(["totals", "reset", *typed.split(), *socket]) == 0
        assert capsys.readouterr().out == f"totals: {figure.strip()} set to 0; load 2 begins\n"


def test_an_archive_that_outgrows_its_medium_is_one_line_about_that(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is left of it, and nothing is said against the store."""
    store, folder = tmp_path / "s.sqlite", tmp_path / "usb"
    with Store(store):
        folder.mkdir()
    with files_end_at(8192):
        assert main(["totals", "archive", "--store", str(store), str(folder / "a.sqlite")]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"yieldmon: {folder / 'a.sqlite'}: ")
    assert said.count("\n") == 1
    assert "a daemon's store" not in said
    assert list(folder.iterdir()) == []
