"""The JSON documents that other programs read: what `--json` prints, as types.

Lists are JSON arrays; `None` is `null` and stands for unknown. A key that is not always there is `NotRequired`. Keys are only
added within a major version. The schemas in ``docs/reference/schemas`` are made from these types.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

Number = float | None
Verdict = Literal["effect", "none", "unknown"]


class Harvested(TypedDict):
    """Area of the open load, and the yields of the mass whose area is known."""

    area_m2: Number
    mass_of_unknown_area_kg: float
    yield_kg_m2: Number
    dry_yield_kg_m2: Number


# status


class StatusCrop(TypedDict):
    """The crop that is measured, its bushel where it has one, and the moisture of dry mass."""

    name: str
    bushel_kg: Number
    market_moisture_pct: float


class StatusNow(TypedDict):
    """What a driver looks at: the last second, and the yield of the last seconds."""

    mass_flow_kg_s: Number
    std_dev_kg_s: Number
    quality: str | None
    yield_kg_m2: Number
    moisture_pct: Number
    ground_speed_m_s: Number
    plate_angle_deg: Number
    elevator_speed_rpm: Number


class StatusConfiguration(TypedDict):
    """File in use; what the last reload said, how many there were; keys that the file has under a former name."""

    file: str
    reload: str
    reloads: int
    notes: list[str]


class StdDevByCause(TypedDict):
    """Parts of a mass's standard deviation, kg."""

    noise: Number
    parameters: Number
    zero: Number
    moisture: Number


class StatusLoad(Harvested):
    """The load, open or the last one. contested_mass_kg: measured while more than one node sent samples."""

    number: int
    open: bool
    field: str
    crop: str
    mass_kg: float
    contested_mass_kg: float
    std_dev_kg: Number
    std_dev_by_cause_kg: StdDevByCause
    dry_mass_kg: Number


class StatusTotal(TypedDict):
    """All mass since the totals were set to 0; dry mass is that of known moisture."""

    mass_kg: float
    std_dev_kg: Number
    std_dev_by_cause_kg: StdDevByCause
    dry_mass_kg: float
    contested_mass_kg: float
    mass_of_unknown_moisture_kg: float


class StatusWaveform(TypedDict):
    """What the last second's samples say beside their mean: volume flow from the pulses' shape and the flow that it means, flow
    from kernel noise, or why there is none. shape_verdict, kernel_verdict: as in records, by name. contradiction:
    of shape and mean force. stretch_by_mean_force: the `waveform.stretch` with which both would agree over the last windows; with
    `waveform.shape_terms` a factor on that of the terms."""

    published: bool
    shape_volume_flow_m3_s: Number
    shape_volume_std_dev_m3_s: Number
    shape_flow_kg_s: Number
    shape_std_dev_kg_s: Number
    shape_verdict: str
    shape_missing_because: str | None
    kernel_flow_kg_s: Number
    kernel_std_dev_kg_s: Number
    kernel_verdict: str
    kernel_missing_because: str | None
    thousand_kernel_weight_g: Number
    contradiction: str | None
    stretch_by_mean_force: Number


class StatusSweep(TypedDict):
    """Sweeps of the plate. last_update: what the last whole sweep or weighed mass changed, or why nothing."""

    state: str
    progress_pct: float
    sweeps: int
    due_in_s: Number
    aborted_because: str | None
    last_update: str | None


class ValueWithStdDev(TypedDict):
    """A parameter."""

    value: float
    std_dev: float


class StatusParameters(TypedDict):
    """Parameters in use, by name; age_s since they were calibrated or updated. estimator: "physical", "alpha_beta", "table"."""

    version: int
    age_s: Number
    estimator: str
    values: dict[str, ValueWithStdDev]
    provenance: dict[str, str]


class StatusFault(TypedDict):
    """A fault that is shown. since_s: bus time."""

    code: str
    severity: str
    since_s: Number
    occurrences: int
    detail: str
    cause: str
    effect: str
    remedy: str


class StatusBus(TypedDict):
    """Counts since the start. dropped: never reached the engine; kernel_drops: nor the receiver. incomplete: messages of several
    frames that lacked one. late, refused: not sent. time_stamps: who stamped the frames."""

    interface: str
    channel: str
    time_stamps: str
    frames_per_s: float
    received: int
    dropped: int
    kernel_drops: int
    error_frames: int
    bus_offs: int
    interface_losses: int
    failures: int
    malformed: int
    incomplete: int
    sent: int
    late: int
    refused: int
    last_refusal: str | None


class NetworkPartner(TypedDict):
    """A node that has claimed an address."""

    address: int
    name: str


class StatusTaskController(TypedDict):
    """Connection to a task controller."""

    state: str
    server: int | None
    task_active: bool
    problem: str | None


class StatusNetwork(TypedDict):
    """Our NAME and address, and the other nodes."""

    name: str | None
    address: int | None
    claim: str
    partners: list[NetworkPartner]
    task_controller: StatusTaskController | None


class StatusSignals(TypedDict):
    """Rates of the impact sensors, aliasing by elevator speed (rpm), constant quantities, and notes on the mapping."""

    rate_hz: list[float]
    aliasing_std_dev_pct: dict[str, float]
    fixed: dict[str, float]
    notes: list[str]


class StatusStore(TypedDict):
    """The store. failing: why records cannot be written. pending batches wait, the oldest for waiting_s; records_dropped
    one-second records found no place in memory; replacements: times a damaged, removed or replaced file was put in order."""

    file: str
    note: str | None
    failing: str | None
    pending: int
    waiting_s: float
    committed: int
    records_dropped: int
    batches_refused: int
    replacements: int
    replaced_because: str


class StatusFigures(TypedDict):
    """What a running daemon is doing. windows: the last one-second records, quality and operating state by name. loads: the last
    ten, as `yieldmon load list --json` has them. waveform: None where it is switched off."""

    version: str
    uptime_s: float
    state: str
    units: str
    crop: StatusCrop
    now: StatusNow
    configuration: StatusConfiguration
    load: StatusLoad
    loads: list[dict[str, Any]]
    total: StatusTotal
    windows: list[dict[str, float | str | None]]
    zero_mv: Number
    zero_waits_for: str | None
    sweep: StatusSweep
    waveform: StatusWaveform | None
    parameters: StatusParameters
    faults: list[StatusFault]
    bus: StatusBus
    network: StatusNetwork
    signals: StatusSignals
    store: StatusStore


class Status(StatusFigures):
    """`yieldmon status --json`. age_s: of the figures; stale: older than they should be."""

    age_s: float
    stale: bool


# process


class FactoryComparisonSummary(TypedDict):
    """Seconds with a flow of ours and of the factory's monitor."""

    seconds: int
    our_mean_kg_s: float
    factory_mean_kg_s: float
    factory_over_ours_pct: Number
    correlation: Number


class ReprocessedLoad(TypedDict):
    """A load's mass as measured and as measured again."""

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
    """`yieldmon process --json`; with --separate one for each log, by name. faults: how often each came."""

    frames: int
    frames_of_ours: int
    frames_malformed: int
    messages_incomplete: int
    windows: int
    total_mass_kg: float
    dry_mass_kg: Number
    faults: dict[str, int]
    damages: list[str]
    zero_known: bool
    gaps: NotRequired[int]
    gap_s: NotRequired[float]
    overlap_s: NotRequired[float]
    overlap_kg: NotRequired[float]
    missing: NotRequired[dict[str, float]]
    factory: NotRequired[FactoryComparisonSummary]


# calibrate


class CalibratedParameter(TypedDict):
    """A fitted parameter. confidence: of the interval, which is open where the data do not bound it."""

    value: float
    standard_error: Number
    interval: list[Number]
    confidence: float
    at_bound: str | None
    open_below: bool
    open_above: bool
    determined: bool


class Correlation(TypedDict):
    """Of the fitted parameters, in the order of the names."""

    names: list[str]
    matrix: list[list[Number]]


class ResidualSummary(TypedDict):
    """Of the rows, in the reading's unit. outlier_rows count from 1."""

    rms: Number
    rms_over_max_pct: Number
    pure_error_sd: Number
    pure_error_dof: Number
    pure_error_over_max_pct: Number
    lack_of_fit_f: Number
    lack_of_fit_p: Number
    outlier_rows: list[int]


class Basin(TypedDict):
    """Where random starts ended."""

    starts: int
    relative_cost: Number
    values: list[Number]


class ComparedModel(TypedDict):
    """Load from reading, each load left out in turn."""

    model: str
    rms_over_max_pct: Number
    mean_abs_pct: Number
    max_abs_pct: Number
    rows_without_answer: int


class CalibrationDocument(TypedDict):
    """`yieldmon calibrate DATA --json`."""

    file: str
    rows: int
    response_unit: str
    parameters: dict[str, CalibratedParameter]
    fixed: dict[str, float]
    correlation: Correlation
    residual: ResidualSummary
    starts: int
    basins: list[Basin]
    notes: list[str]
    moisture_pct: NotRequired[float]
    comparison: NotRequired[list[ComparedModel]]
    identifiability: NotRequired[dict[str, Any]]
    profiles: NotRequired[list[dict[str, Any]]]
    written: NotRequired[str]


class CurveErrors(TypedDict):
    """Of the loads' flow, %; left_out: where only the other loads calibrate."""

    fitted_mean: float
    fitted_max: float
    left_out_mean: Number
    left_out_max: Number


class CurveCalibrationDocument(TypedDict):
    """`yieldmon calibrate --estimator --json`. mass_flow_kg_s: lowest and highest."""

    file: str
    rows: int
    estimator: str
    plate_angles_deg: list[float]
    coefficients: dict[str, float]
    mass_flow_kg_s: list[float]
    relative_std_dev_pct: float
    error_pct: CurveErrors
    loads: int
    written: NotRequired[str]


class LoadResidualSummary(TypedDict):
    """Of the loads, kg."""

    rms: float
    rms_over_max_pct: float
    outlier_rows: list[int]


class WeighedLoad(TypedDict):
    """A load as weighed, and as measured with the parameters before and after; its error where only the others calibrate."""

    load: str
    weighed_kg: float
    before_kg: float
    after_kg: float
    left_out_error_pct: Number
    outlier: bool


class LoadCalibrationDocument(TypedDict):
    """`yieldmon calibrate --loads --json`. next_load_sd_pct: standard deviation of a next load's error."""

    file: str
    rows: int
    response_unit: str
    parameters: dict[str, CalibratedParameter]
    fixed: dict[str, float]
    held: list[str]
    correlation: Correlation
    residual: LoadResidualSummary
    starts: int
    basins: list[Basin]
    loads: list[WeighedLoad]
    scale: float
    scale_sd_pct: float
    load_dependence: bool
    next_load_sd_pct: Number
    sweeps: int
    refused: bool
    notes: list[str]
    written: NotRequired[str]


# diagnose


class EffectValue(TypedDict):
    """A parameter of an effect."""

    value: float
    sd: float
    unit: str


class NamedEffect(TypedDict):
    """An effect, in the order in which they were added. equivalent: names that these data do not distinguish from it."""

    name: str
    stage: str
    parameters: dict[str, EffectValue]
    law: str
    name_confidence: float
    confidence: float
    equivalent: list[str]


class RegionDocument(TypedDict):
    """Where model and rows differ; each range is lowest and highest."""

    plate_angle_deg: list[float]
    fill: list[float]
    elevator_speed_rpm: list[float]
    mean_error_pct: float
    p_value: float


class MeasureDocument(TypedDict):
    """Distance of a model from the rows, in the reading's unit."""

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
    """How far the model was off and is now. closed_pct: share of the gap that the effects close."""

    before: MeasureDocument
    after: MeasureDocument
    held_out: HeldOutDocument | None
    noise_floor_rms: float
    closed_pct: Number


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
    """An effect that was looked at."""

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
    """`yieldmon diagnose --json`. partial, remaining and stop_gap are there with the verdict `unknown`."""

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
    remaining: NotRequired[list[RegionDocument]]
    stop_gap: NotRequired[StopGap]


#: Name of the schema -> type.
DOCUMENTS: dict[str, Any] = {
    "status": Status,
    "process": ProcessSummary,
    "calibrate": CalibrationDocument,
    "calibrate-curve": CurveCalibrationDocument,
    "calibrate-loads": LoadCalibrationDocument,
    "diagnose": DiagnosisDocument,
}
