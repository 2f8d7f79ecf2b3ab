"""What `yieldmon diagnose --json` prints."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

from .common import Number

Verdict = Literal["effect", "none", "unknown"]


class EffectValue(TypedDict):
    """A parameter of an effect."""

    value: float
    sd: float
    unit: str


class NamedEffect(TypedDict):
    """An effect, in the order in which they were added. equivalent: names that these data do not distinguish from it. confidence,
    name_confidence: null where not known, of leading candidates only."""

    name: str
    stage: str
    parameters: dict[str, EffectValue]
    law: str
    name_confidence: Number
    confidence: Number
    equivalent: list[str]


class RegionDocument(TypedDict):
    """Where model and rows differ; each range is lowest and highest."""

    plate_angle_deg: list[float]
    fill: list[float]
    elevator_speed_rpm: list[float]
    mean_error_pct: float
    p_value: float


class MeasureDocument(TypedDict):
    """Distance of a model from the rows, in the reading's unit; `Gap` says from which."""

    rms: Number
    rms_over_max_pct: Number
    lack_of_fit_f: Number
    p_value: Number


class HeldOutDocument(TypedDict):
    """The same on rows that no fit has seen, with 95 % intervals."""

    rows: int
    before: MeasureDocument
    after: MeasureDocument
    lack_of_fit_f_interval: list[list[float]] | None
    closed_interval_pct: list[float] | None


class Gap(TypedDict):
    """How far the model was off and is now. before, after, with_leading (with `leading`): fitted to all rows but outliers and
    judged on them; held_out: on held-out rows, fitted to the others. closed_pct: share of the gap that the effects close."""

    before: MeasureDocument
    after: MeasureDocument
    held_out: HeldOutDocument | None
    noise_floor_rms: float
    closed_pct: Number
    with_leading: NotRequired[MeasureDocument]


class ExperimentRow(TypedDict):
    """A setting to measure at."""

    plate_angle_deg: float
    mass_flow_kg_s: float
    elevator_speed_rpm: float


class NextExperiment(TypedDict):
    """Rows that distinguish the pairs of effects best; power of the hardest pair, and of each."""

    rows: list[ExperimentRow]
    separates: list[list[str]]
    power: float
    powers: list[float]


class BaseModel(TypedDict):
    """The published model's fit."""

    form: str
    parameters: dict[str, float]
    p_any_effect: float


class CandidateDocument(TypedDict):
    """An effect that was looked at; lack_of_fit_f: with it alone, on the rows searched (those not held out)."""

    name: str
    law: str
    lack_of_fit_f: float
    cross_validated: Number
    p_value: float
    refused: str


class StopGap(TypedDict):
    """A correction without a cause, for these rows alone."""

    kind: str
    axes: list[str]
    closed_pct: Number
    cells: list[dict[str, float]]


class DiagnosisDocument(TypedDict):
    """`yieldmon diagnose --json`. partial, remaining and stop_gap are there with the verdict `unknown`, leading too if it has
    candidates."""

    verdict: Verdict
    effects: list[NamedEffect]
    where: list[RegionDocument]
    gap: Gap
    next_experiment: NextExperiment
    minimum_detectable: dict[str, float]
    undetectable: list[str]
    base: BaseModel
    candidates: list[CandidateDocument]
    notes: list[str]
    partial: NotRequired[list[str]]
    leading: NotRequired[list[NamedEffect]]
    remaining: NotRequired[list[RegionDocument]]
    stop_gap: NotRequired[StopGap]
