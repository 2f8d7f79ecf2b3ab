"""asammdf for MF4 logs alone: python-can imports it, where it is installed, and with it pandas and sympy (1.4 s of start)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from importlib.machinery import PathFinder
from types import ModuleType
from typing import NoReturn

_NAME = "asammdf"


class _Deferred:
    """Among the import system's finders: asammdf is not to be found for now. No subclass of theirs: importlib.abc takes 10 ms."""

    def find_spec(self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> None:
        if fullname == _NAME:
            _refuse()


def _refuse() -> NoReturn:
    raise ModuleNotFoundError(f"No module named {_NAME!r}", name=_NAME)


def defer() -> None:
    """Hold asammdf back from the coming import of python-can; nothing where either has been imported already."""
    if not {"can", _NAME} & sys.modules.keys():
        sys.meta_path.insert(0, _Deferred())


def require() -> None:
    """Raises ModuleNotFoundError where asammdf is not installed; imports nothing."""
    hidden = _NAME in sys.modules and sys.modules[_NAME] is None
    if hidden or PathFinder.find_spec(_NAME) is None:
        _refuse()


def provide() -> None:
    """Give python-can's MF4 writer what `defer` held back.

    Raises
    ------
    ModuleNotFoundError
        Where asammdf is not installed.
    """
    deferred = [finder for finder in sys.meta_path if isinstance(finder, _Deferred)]
    for finder in deferred:
        sys.meta_path.remove(finder)
    importlib.import_module(_NAME)
    if deferred:
        # Its classes keep the module's names, so those that python-can has handed out work as well.
        importlib.reload(importlib.import_module("can.io.mf4"))
