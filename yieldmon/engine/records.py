"""What the engine hands on about each window, and the seam to the self-calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike

from yieldmon.engine.anchors import ReferenceMass
from yieldmon.engine.faults import FaultCode
from yieldmon.estimation.open_loop import FlowEstimate
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import EstimateQuality, OperatingState


@dataclass(frozen=True, slots=True)
class WindowRecord:
    """One second of measurement. nan where a value is not known; angles in rad, speeds in rad/s.

    time_s: bus time of the window's end; its result belongs to duration_s before it, less half a paddle pattern. coverage: share
    measured. mass_flow_kg_s: as published, weighed with the windows before. mass_kg: added to the totals, as measured.
    plate_still: the plate did not move while the window was formed. sweep_id and sweep_step: 0 and -1 outside sweeps;
    usable_for_calibration: the window counts for its sweep step.
    """

    time_s: float
    window: int
    duration_s: float
    coverage: float
    force_n: float
    force_std_dev_n: float
    elevator_speed_rad_s: float
    plate_angle_rad: float
    plate_still: bool
    moisture_pct: float
    test_weight_kg_m3: float
    mass_flow_kg_s: float
    std_dev_kg_s: float
    quality: EstimateQuality
    operating_state: OperatingState
    mass_kg: float
    load_kg: float
    total_kg: float
    load_number: int
    zero_mv: float
    pulse_mv: float
    saturated_share: float
    lost_frames: int
    surplus_frames: int
    repeated_frames: int
    sweep_id: int
    sweep_step: int
    usable_for_calibration: bool
    parameter_version: int
    faults: tuple[FaultCode, ...]
    latitude_deg: float
    longitude_deg: float
    ground_speed_m_s: float
    course_deg: float


class FlowEstimator(Protocol):
    """Force to mass flow with the parameters in use; `estimation.open_loop.OpenLoop` is one."""

    @property
    def parameters(self) -> ParameterSet:
        """The parameters in use."""

    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = ...,
        moisture_pct: ArrayLike | None = ...,
    ) -> FlowEstimate:
        """Mass flow, standard deviation and status; inputs that are nan give a status, never an exception."""


@dataclass(frozen=True, slots=True)
class CalibrationOutcome:
    """What a sweep or a weighed mass taught. estimator: the one to use from now on, or None where the parameters stay.

    reason: one sentence for the operator. identifiable: what was to be determined was narrowed. weighed: a reference mass alone
    taught, no sweep.
    """

    estimator: FlowEstimator | None
    reason: str
    identifiable: bool = True
    weighed: bool = False


@dataclass(frozen=True, slots=True)
class CalibratorState:
    """What self-calibration knows beside the parameters.

    waited_s, harvested_kg: since the last lesson. moisture_pct: of the grain for which the parameters hold. drifting: the r
    parameters that have a steady rate; rates: (r,), per kilotonne; covariance: (r, n + r) of the rates with the n parameters that
    have a variance, and with each other.
    """

    waited_s: float
    harvested_kg: float
    moisture_pct: float | None
    drifting: tuple[str, ...]
    rates: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


class SelfCalibrator(Protocol):
    """Learns from the windows of a sweep and from reference masses."""

    def update(
        self,
        records: Sequence[WindowRecord],
        anchors: Sequence[ReferenceMass],
        estimator: FlowEstimator,
        *,
        believe_sweep: bool = True,
    ) -> CalibrationOutcome:
        """records: the usable windows of one whole sweep. anchors: all reference masses kept. estimator: the one in use.

        believe_sweep: False while the model disagrees with what sweeps show; then only reference masses teach.
        """

    def weigh(
        self, record: WindowRecord, anchors: Sequence[ReferenceMass], estimator: FlowEstimator
    ) -> CalibrationOutcome:
        """What reference masses alone teach, between sweeps. record: the last window; anchors: all reference masses kept."""

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """What is to outlive a restart beside the parameters; None: nothing."""

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """Go on from a snapshot, with the parameters that were in use then."""
