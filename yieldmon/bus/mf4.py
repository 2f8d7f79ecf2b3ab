"""asammdf for MF4 logs alone: python-can imports it, where it is installed, and with it pandas and sympy (1.4 s of start)."""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import PathFinder
from importlib.util import find_spec

_held: list[str] = []
"""What is being held back."""


def defer() -> None:
    """Hold asammdf back from the coming import of python-can; nothing where either has been imported already."""
    if not {"can", "asammdf"} & sys.modules.keys():
        sys.modules["asammdf"] = None  # type: ignore[assignment]  # the import system's mark for "not to be found"
        _held.append("asammdf")


def require() -> None:
    """Raises ModuleNotFoundError where asammdf is not installed; imports nothing."""
    found = PathFinder.find_spec("asammdf") if _held else find_spec("asammdf")
    if found is None:
        raise ModuleNotFoundError("No module named 'asammdf'", name="asammdf")


def provide() -> None:
    """Give python-can's MF4 writer what `defer` held back.

    Raises
    ------
    ModuleNotFoundError
        Where asammdf is not installed.
    """
    if _held:
        del sys.modules[_held.pop()]
        importlib.import_module("asammdf")
        # Its classes keep the module's names, so those that python-can has handed out work as well.
        importlib.reload(importlib.import_module("can.io.mf4"))
    importlib.import_module("asammdf")
