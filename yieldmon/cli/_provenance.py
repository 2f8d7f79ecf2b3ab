"""Where parameters come from, as the verbs that calibrate note it in what they write."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from yieldmon import utc
from yieldmon.cli import _notes
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import digests
from yieldmon.files.table import Table


def today() -> str:
    """Date and time by this machine's clock, in UTC."""
    return utc.text(datetime.now(UTC))


def of_table(data: Table) -> dict[str, str]:
    """Of a measurement table."""
    return {"data": Path(data.path).name, "data_sha256": data.sha256, "date": today()}


def note_same_table(data: Table, known: ParameterSet, option: str) -> None:
    """Point out that parameters known beforehand, those of an option, were estimated from the table that is to update them."""
    if known.provenance.get("data_sha256") == data.sha256:
        _notes.note(f"{data.path}: the parameters of {option} come from this table, so its rows count twice")


def of_loads(sources: Sequence[str], tickets: str | Path, until_s: float | None = None) -> dict[str, str]:
    """Of logs or stores of weighed loads and a table of their tickets. until_s: Unix time of the end of the last load, s."""
    until = {}
    if until_s is not None and until_s > utc.EARLIEST_BUS_TIME_S:
        until["loads_until"] = utc.text(utc.moment(until_s))
    return until | {
        "data": ", ".join(Path(source).name for source in sources),
        "tickets": Path(tickets).name,
        "tickets_sha256": digests.of_file(tickets),
        "date": today(),
    }
