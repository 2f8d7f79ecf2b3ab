"""How far logs have been read is shown on a terminal, and nowhere else."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest

from yieldmon.cli.main import main
from yieldmon.resources import shipped

FRAMES = 1200


class Terminal(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def log(tmp_path: Path) -> Path:
    lines = [f"({1000.0 + 0.1 * k:.6f}) can0 18FF1A26#{k % 200:02X}00FFFFFFFFFFFF\n" for k in range(FRAMES)]
    path = tmp_path / "drive.log"
    path.write_text("".join(lines))
    return path


@pytest.mark.parametrize("terminal", [True, False])
def test_a_check_against_a_recording_shows_how_far_it_is(terminal: bool, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = Terminal() if terminal else io.StringIO()
    with monkeypatch.context() as patch:
        patch.setattr("sys.stderr", said)
        patch.setenv("COLUMNS", "80")
        main(["check-config", str(shipped("config/yieldmon.yaml")), "--log", str(log)])
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", said.getvalue())
    assert ("/2 logs" in shown) is terminal
