"""What `yieldmon calibrate --json` prints: by a table, as a curve, by weighed loads, of the pulses' shape."""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict

from .common import Number


class CalibratedParameter(TypedDict):
    """A fitted parameter. standard_error, interval: by the rows' scatter; confidence: of the interval, which is open where the
    data do not bound it. std_dev: with the model's own error, as the parameter file has it."""

    value: float
    standard_error: Number
    std_dev: Number
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


class LoadShape(TypedDict):
    """Volume flow by the shape of a load's pulses: its error with the arrival in use, and where only the others calibrate."""

    load: str
    waves: int
    before_error_pct: Number
    left_out_error_pct: Number


class PulseShapeDocument(TypedDict):
    """`yieldmon calibrate --pulse-shape --json`. std_dev: of ln stretch and ln tail."""

    file: str
    loads: list[LoadShape]
    kinds: int
    terms: list[str]
    log_stretch: list[float]
    log_tail: list[float]
    std_dev: list[float]
    load_share: list[float]
    plate_angle_deg: list[float]
    elevator_speed_rpm: list[float]
    kernel_bias: Number
    kernel_bias_std_dev: Number
    notes: list[str]
    refused: str
    written: NotRequired[str]


class TapDocument(TypedDict):
    """`yieldmon calibrate --taps --json`. each_s: of each tap that counts; left_out: taps by reason."""

    file: str
    taps: int
    left_out: dict[str, int]
    response_s: float
    std_dev_s: float
    each_s: list[float]
    misfit_pct: float
    before_s: float
    refused: str
    written: NotRequired[str]
