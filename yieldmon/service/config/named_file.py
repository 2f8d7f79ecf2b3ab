"""Files that a configuration names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from yieldmon.errors import InputError

Content = TypeVar("Content")


def load_named(path: Path, key: str, load: Callable[[Path], Content], file: Path, expected: str = "a YAML file") -> Content:
    """What a file holds that a configuration names; one that cannot be opened is the fault of the key.

    Parameters
    ----------
    path : Path
        Of the configuration.
    key : str
        That names the file.
    load : callable
        Reads it; raises InputError.
    file : Path
    expected : str
        What it should be.

    Returns
    -------
    Content

    Raises
    ------
    InputError
    """
    try:
        return load(file)
    except InputError as error:
        if error.where != str(file) or not isinstance(error.__cause__, OSError):
            raise
        raise InputError(f"{path}: {key}: {file}", error.problem, f"{expected}, named from {path.parent}") from error
