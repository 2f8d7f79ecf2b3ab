"""What `yieldmon process --json` prints."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from .common import Harvested, Number


class FactoryComparisonSummary(TypedDict):
    """Seconds with a flow of ours and of the factory's monitor."""

    seconds: int
    our_mean_kg_s: float
    factory_mean_kg_s: float
    factory_over_ours_pct: Number
    correlation: Number


class SameTimesSummary(TypedDict):
    """Seconds for which `log` and `other` have different frames of the impact sensor."""

    log: str
    other: str
    seconds: int


class ReprocessedLoad(TypedDict):
    """A load's mass as measured and as recomputed."""

    load: int
    before_kg: float
    after_kg: float


class ReprocessSummary(TypedDict):
    """`yieldmon process STORE --json`. seconds_unusable: with mass, but without a known force, angle or speed."""

    windows: int
    before_mass_kg: float
    total_mass_kg: float
    loads: list[ReprocessedLoad]
    seconds_unusable: int


class ProcessSummary(Harvested):
    """`yieldmon process --json`; with --separate one for each log, by name.

    faults: how often each came; damages: places of the logs that were skipped; gaps: stretches without samples, gap_s long in
    all; overlap_s: seconds of times that were read already, with overlap_kg; same_times: logs that have such; missing: share of
    the seconds without an input, by its name; frames_lost_share: of the seconds, those under FramesLost; plate_away_share: of
    the seconds, those with the plate away from home, where there is no zero; contested_kg: mass in no total, as more frames
    came than one node sends; before_zero_s: seconds of grain before the first zero; sensor_interval_s: median time from one
    frame of the impact sensor to the next, where it is far from mapped_interval_s, that of the mapping.
    """

    frames: int
    frames_of_ours: int
    frames_malformed: int
    messages_incomplete: int
    windows: int
    total_mass_kg: float
    total_std_dev_kg: Number
    dry_mass_kg: Number
    faults: dict[str, int]
    damages: list[str]
    zero_known: bool
    gaps: NotRequired[int]
    gap_s: NotRequired[float]
    overlap_s: NotRequired[float]
    overlap_kg: NotRequired[float]
    same_times: NotRequired[list[SameTimesSummary]]
    missing: NotRequired[dict[str, float]]
    frames_lost_share: NotRequired[float]
    plate_away_share: NotRequired[float]
    contested_kg: NotRequired[float]
    before_zero_s: NotRequired[int]
    sensor_interval_s: NotRequired[float]
    mapped_interval_s: NotRequired[float]
    factory: NotRequired[FactoryComparisonSummary]
