"""What `yieldmon setup --json` prints."""

from __future__ import annotations

from typing import Any, TypedDict


class CellDocument(TypedDict):
    """The force cell, by the weights hung on it. sd_pct: of the gain; nonlinearity_pct: largest departure of a reading from the
    line, of the range of the forces."""

    gain_n_per_mv: float
    sd_pct: float
    zero_mv: float
    nonlinearity_pct: float
    direction: str


class SetupRecord(TypedDict):
    """What was found, as the record keeps it. date: UTC, ISO 8601; plate_angle_offset_deg: of the plate's angle from the
    actuator's; paddles_per_s: at nominal speed; answers: by key, in the units of the questions."""

    date: str
    cell: CellDocument
    plate_angle_offset_deg: float
    paddles_per_s: float
    answers: dict[str, Any]


class SetupFiles(TypedDict):
    """Files written."""

    configuration: str
    machine: str
    parameters: str
    record: str


class SetupDocument(SetupRecord):
    """`yieldmon setup --json`."""

    files: SetupFiles
