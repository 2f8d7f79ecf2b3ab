"""What `yieldmon self-calibrate --json` prints."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from .common import Number


class SweepFlow(TypedDict):
    """Mean flow of one group of rows, kg/s, with its standard deviation and central interval; paddle_mass_kg: the same for a
    paddle. error_pct: against the load column, where it states one load for the group."""

    group: str
    mass_flow_kg_s: float
    std_dev_kg_s: float
    interval_kg_s: list[float]
    paddle_mass_kg: float
    true_mass_flow_kg_s: NotRequired[float]
    error_pct: NotRequired[float]


class SweepFlowErrors(TypedDict):
    """Of the groups with error_pct."""

    mean_abs: float
    max_abs: float


class UpdatedParameter(TypedDict):
    """Before and after, with standard deviations. ratio: sd over prior_sd; learned: whether it moved."""

    prior: float
    prior_sd: float
    value: float
    sd: float
    ratio: float
    learned: bool


class ScaleDocument(TypedDict):
    """The direction that no sweep determines alone. prior_sd: of ln a before; ratio: after over before; shift: of ln a."""

    direction: str
    observable: bool
    ratio: Number
    shift: float
    prior_sd: float


class UpdateDocument(TypedDict):
    """An update of the parameters. consistent: the misfit is no more than noise and model error explain, else nothing is updated;
    unobservable: directions that the sweeps leave as they were; p_value: of so large a chi2 by chance."""

    updated: bool
    consistent: bool
    reason: str
    parameters: dict[str, UpdatedParameter]
    scale: ScaleDocument
    unobservable: list[str]
    chi2: Number
    dof: int
    p_value: Number


class SelfCalibrationDocument(TypedDict):
    """`yieldmon self-calibrate --json`. level: of the intervals; updates: one, or with --separate one for each group; drift: of
    --drift; written: the file of --out."""

    file: str
    level: float
    groups: list[SweepFlow]
    error_pct: SweepFlowErrors | None
    updates: list[UpdateDocument]
    drift: NotRequired[dict[str, float]]
    written: NotRequired[str]
