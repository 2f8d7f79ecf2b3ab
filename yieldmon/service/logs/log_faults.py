"""What the daemon would show on a recording: the same engine over the same frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from yieldmon.engine.faults import FAULTS, FaultCode
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.results import Result, events_in
from yieldmon.errors import InputError
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.logs.log_record import Progress, measure
from yieldmon.service.storage.rows import SecondRow

_MENDS = {FaultCode.ZERO_DRIFTED: "; if that was grain, the sensor's sign is wrong: negative scale"}
"""Of a new sensor, beside what a fault says."""


def faults_on(configuration: Configuration, log: str, progress: Progress | None = None) -> list[str]:
    """Each fault with its seconds and what it said first, a sentence each.

    Parameters
    ----------
    configuration : Configuration
    log : str
        Path of a log that can be read.
    progress : callable, optional
        Called with each stretch that is done.

    Returns
    -------
    list of str
        In the order of the faults' codes; empty also where nothing of the log reaches the engine.
    """
    seconds, windows, said = Counter[str](), 0, dict[str, str]()

    def take(row: SecondRow) -> None:
        nonlocal windows
        windows += 1
        seconds.update((row.faults or "").split())

    def collect(results: Sequence[Result]) -> None:
        for event in events_in(results):
            if isinstance(event, FaultEvent) and event.active:
                said.setdefault(event.code.value, event.detail)

    try:
        measure([log], configuration, take, take_results=collect, progress=progress)
    except InputError:
        return []
    return [
        f"on this recording the daemon shows {code.value} in {seconds[code.value]} of {windows} s: "
        f"{said.get(code.value) or definition.remedy}{_MENDS.get(code, '') if said.get(code.value) else ''}"
        for code, definition in FAULTS.items()
        if seconds[code.value]
    ]
