"""Packages of the extras that tests need and that may not be installed."""

from __future__ import annotations

from importlib.machinery import PathFinder

import pytest

#: Also where `yieldmon.bus.mf4` holds it back, which `importlib.util.find_spec` takes for not installed.
HAS_MF4 = PathFinder.find_spec("asammdf") is not None
#: Marks of a test that reads or writes MF4.
MF4 = (pytest.mark.mf4, pytest.mark.skipif(not HAS_MF4, reason="needs the mf4 extra"))
