"""What `yieldmon estimate --json` prints."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from .common import Number


class EstimatedRow(TypedDict):
    """A row of the table, from 1. status: "ok", else what is to be known of the flow, or why there is none.
    true_mass_flow_kg_s, error_pct: where the table has loads."""

    row: int
    mass_flow_kg_s: Number
    std_dev_kg_s: Number
    paddle_mass_kg: Number
    status: str
    true_mass_flow_kg_s: NotRequired[Number]
    error_pct: NotRequired[Number]


class EstimateDocument(TypedDict):
    """`yieldmon estimate --json`."""

    file: str
    rows: list[EstimatedRow]
