"""asammdf for MF4 logs alone: python-can imports it, where it is installed, and with it pandas and sympy (1.4 s of start)."""

from __future__ import annotations

import importlib
import sys


def defer() -> None:
    """Hold asammdf back from the coming import of python-can; nothing where either has been imported already."""
    if "can" not in sys.modules:
        sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # the import system's mark for "not to be found"


def provide() -> None:
    """Give python-can's MF4 reader and writer what `defer` held back.

    Raises
    ------
    ModuleNotFoundError
        Where asammdf is not installed.
    """
    if "asammdf" in sys.modules and sys.modules["asammdf"] is None:
        del sys.modules["asammdf"]
        importlib.import_module("asammdf")
        # Its classes keep the module's names, so those that python-can has handed out work as well.
        importlib.reload(importlib.import_module("can.io.mf4"))
    importlib.import_module("asammdf")
