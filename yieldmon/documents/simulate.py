"""What `yieldmon simulate --json` prints."""

from __future__ import annotations

from typing import TypedDict


class SimulatedLoad(TypedDict):
    """A load that the virtual combine unloaded. time_s: from the beginning; mass_kg: its true mass."""

    time_s: float
    mass_kg: float


class SimulationDocument(TypedDict):
    """`yieldmon simulate --json`. frames: how many of each message, and under "not sent" those that the bus did not take.
    total_mass_kg, largest_mass_flow_kg_s: the truth. log, truth: files written."""

    scenario: str
    seed: int
    duration_s: float
    frames: dict[str, int]
    total_mass_kg: float
    largest_mass_flow_kg_s: float
    loads: list[SimulatedLoad]
    log: str | None
    truth: str | None
