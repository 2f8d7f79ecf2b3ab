"""What has the name of a file that the service makes and is no file: a folder, a pipe, a device, a link to anywhere."""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Iterable
from pathlib import Path

_log = logging.getLogger(__name__)


def make_way(paths: Iterable[Path]) -> None:
    """Rename whatever is at `paths` and is no file to ``<name>.in-the-way``, with a number behind where that name is taken; a
    link is renamed, not what it leads to. Raises OSError."""
    for path in paths:
        try:
            mode = os.lstat(path).st_mode
        except FileNotFoundError:
            continue
        if not stat.S_ISREG(mode):
            aside = _free(path)
            path.rename(aside)
            _log.warning("%s: is not a file; renamed to %s", path, aside.name)


def _free(path: Path) -> Path:
    aside, count = path.with_name(f"{path.name}.in-the-way"), 1
    while os.path.lexists(aside):
        count += 1
        aside = path.with_name(f"{path.name}.in-the-way-{count}")
    return aside
