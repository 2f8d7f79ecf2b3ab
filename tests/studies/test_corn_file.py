"""The shipped corn file is what its command gives, and its covariance covers the grain that it was made with."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from studies.facility.__main__ import FITTED, OUT, TABLE, from_truth
from yieldmon.cli.main import main
from yieldmon.files import parameter_file
from yieldmon.plant.scenario import load
from yieldmon.resources import shipped

LOW, HIGH = 0.0717, 12.84
"""Chi-square with three degrees of freedom at 0.5 and 99.5 %."""


def test_the_shipped_corn_is_what_calibrate_makes_of_its_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--effects", "gravity", "--fix", "gravity.acceleration_m_s2=9.81", "--fix", "shape_ratio=2", "--starts", "2"]
    assert main(["calibrate", str(TABLE), "--out", str(tmp_path / "corn.yaml"), *words]) == 0
    capsys.readouterr()
    made, known = parameter_file.load(tmp_path / "corn.yaml"), parameter_file.load(OUT)
    assert dict(made.values) == pytest.approx(dict(known.values), rel=1e-6)
    assert made.covariance_names == known.covariance_names
    assert made.covariance == pytest.approx(known.covariance, rel=1e-3)
    assert known.provenance["data_sha256"] == hashlib.sha256(TABLE.read_bytes()).hexdigest()


def test_the_shipped_corn_covers_its_truth() -> None:
    known = parameter_file.load(OUT)
    square, p_value = from_truth(known, load(shipped("config/scenarios/demo.yaml")).crop)
    assert LOW < square < HIGH
    assert 0.005 < p_value < 0.995
    # Nor by being vague: each parameter within 6 % of itself.
    assert all(known.standard_deviation(name) < 0.06 * known.values[name] for name in FITTED)
