"""How far logs have been read, on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch
from yieldmon.service.logs.log_record import Progress


@contextmanager
def log_progress(readings: int) -> Iterator[Progress | None]:
    """A bar on a terminal, None elsewhere; by readings of a log, since how many frames it holds shows at its end.

    Parameters
    ----------
    readings : int
        Of logs, each from begin to end.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("logs, {task.fields[frames]:,} frames"), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=readings, frames=0)
        frames = 0

        def advance(stretch: Stretch | EndOfLog) -> None:
            nonlocal frames
            if isinstance(stretch, EndOfLog):
                bar.advance(task)
            else:
                frames += stretch.frames
                bar.update(task, frames=frames)

        yield advance
