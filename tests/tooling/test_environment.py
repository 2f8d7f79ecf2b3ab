"""With which environment variables tools/test runs a part."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "test"


def test_a_part_computes_with_the_processors_own_code(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    monkeypatch.setenv("OPENBLAS_L2_SIZE", "512")
    monkeypatch.setenv("YIELDMON_KEPT", "as it was")
    tool = runpy.run_path(str(TOOL))
    names = "print(sorted(name for name in os.environ if name.startswith(('OPENBLAS_', 'YIELDMON_KEPT'))))"
    assert tool["run"](tool["Part"]("unit", (sys.executable, "-c", f"import os; {names}"))).passed == 1
    assert "['YIELDMON_KEPT']" in capfd.readouterr().out
