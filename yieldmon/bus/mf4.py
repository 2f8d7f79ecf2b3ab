"""asammdf for MF4 logs alone: python-can imports it, where it is installed, and with it pandas and sympy (1.4 s of start)."""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import PathFinder
from importlib.util import find_spec

_NAME = "asammdf"


def defer() -> None:
    """Hold asammdf back from the coming import of python-can; nothing where either has been imported already."""
    if not {"can", _NAME} & sys.modules.keys():
        sys.modules[_NAME] = None  # type: ignore[assignment]  # the import system's mark for "not to be found"


def _is_held() -> bool:
    return _NAME in sys.modules and sys.modules[_NAME] is None


def require() -> None:
    """Raises ModuleNotFoundError where asammdf is not installed; imports nothing."""
    found = PathFinder.find_spec(_NAME) if _is_held() else find_spec(_NAME)
    if found is None:
        raise ModuleNotFoundError(f"No module named {_NAME!r}", name=_NAME)


def provide() -> None:
    """Give python-can's MF4 writer what `defer` held back.

    Raises
    ------
    ModuleNotFoundError
        Where asammdf is not installed.
    """
    if _is_held():
        del sys.modules[_NAME]
        importlib.import_module(_NAME)
        # Its classes keep the module's names, so those that python-can has handed out work as well.
        importlib.reload(importlib.import_module("can.io.mf4"))
    importlib.import_module(_NAME)
