"""A simulation whose log cannot be written leaves none, nor a truth of one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.file_limit import files_end_at
from yieldmon.cli.main import main


@pytest.mark.parametrize("suffix", ["log", "asc", "csv", "db", "trc"])
def test_no_part_of_a_log_is_left(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, truth = tmp_path / f"a.{suffix}", tmp_path / "truth.csv"
    with files_end_at(50_000):
        assert main(["simulate", "--duration", "30", "--log", str(log), "--truth", str(truth)]) == 1
    assert f"{log}: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["log", "asc", "csv", "db", "trc"])
def test_the_earlier_log_stays(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / f"a.{suffix}"
    log.write_bytes(b"earlier")
    with files_end_at(50_000):
        assert main(["simulate", "--duration", "30", "--log", str(log), "--force"]) == 1
    assert f"{log}: " in capsys.readouterr().err
    assert [(path, path.read_bytes()) for path in tmp_path.iterdir()] == [(log, b"earlier")]


def test_a_truth_stands_beside_a_log_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--duration", "2", "--log", str(tmp_path / "a.foo"), "--truth", str(tmp_path / "t.csv")]) == 2
    assert "is not an ending of a log that can be written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
