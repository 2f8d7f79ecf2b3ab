"""Harvest sources, a module a kind of file.

A source module has `KIND` (its name), `recognises(path, head) -> bool` (by name and first bytes) and
`read(path, options) -> HarvestTable` (raises InputError where nothing can be read). Modules are found by themselves; `ORDER`, a
number, says which one is asked first (default 50).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

from yieldmon.errors import NO_ROOM, InputError, no_room_to_unpack, reason
from yieldmon.field.mixed import with_note
from yieldmon.field.seconds import per_second
from yieldmon.field.sections import merge_sections
from yieldmon.field.table import HarvestTable

from .columns.header_states import without_contradicted_states
from .options import ReadOptions
from .unread import require_readable

HEAD_BYTES = 4096
Progress = Callable[[str], None]


@cache
def modules() -> tuple[ModuleType, ...]:
    """The source modules, in the order in which they are asked."""
    found = [importlib.import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__)]
    sources = [module for module in found if hasattr(module, "recognises")]
    return tuple(sorted(sources, key=lambda module: (getattr(module, "ORDER", 50), module.__name__)))


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """One source, by whichever module recognises it.

    Raises
    ------
    InputError
        For a file that is missing, of no known kind, or of which nothing can be read.
    """
    if not path.exists():
        raise InputError(str(path), "no such file", "a harvest")
    try:
        head = b""
        if path.is_file():
            with path.open("rb") as stream:
                head = stream.read(HEAD_BYTES)
        elif not path.is_dir():
            raise InputError(str(path), "is neither a file nor a folder", "a harvest")
        require_readable(str(path), head)
        for module in modules():
            if module.recognises(path, head):
                table, mixed = with_note(merge_sections(without_contradicted_states(module.read(path, options))))
                # The rows of a second are no one's where two machines made them.
                return table if mixed else per_second(table)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise no_room_to_unpack(path, error) from error
        raise InputError(str(path), reason(error), "a harvest that can be read") from error
    except MemoryError as error:
        raise InputError(str(path), "needs more memory than there is", "a harvest") from error
    kinds = ", ".join(module.KIND for module in modules())
    raise InputError(str(path), "is empty" if path.is_file() and not head else "is of no known kind", f"one of: {kinds}")
