"""Packages of the extras that tests need and that may not be installed."""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder

import pytest

from yieldmon.bus.log_files import mf4

#: Also where `yieldmon.bus.log_files.mf4` holds it back, which `importlib.util.find_spec` takes for not installed.
HAS_MF4 = PathFinder.find_spec("asammdf") is not None
#: Marks of a test that reads or writes MF4.
MF4 = (pytest.mark.mf4, pytest.mark.skipif(not HAS_MF4, reason="needs the mf4 extra"))


def hide(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    """As where the package is not installed."""
    if package == "asammdf" and HAS_MF4:
        mf4.provide()  # what is held back, would be found again
    for name in (package, f"{package}.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
