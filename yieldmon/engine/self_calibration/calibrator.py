"""What the monitor asks of a self-calibration, and what comes of an update."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.self_calibration.scale_alarm import ScaleCheck
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.estimation.self_calibration.steady_drift import Advance
from yieldmon.estimation.self_calibration.sweep_worth import OtherChannels, SweepWorth
from yieldmon.estimation.waveform.common_bias import KernelMeasurement


@dataclass(frozen=True, slots=True)
class CalibrationStep:
    """From one update to the next, as a smoother needs it to correct the time between.

    from_version: parameters in use between them. begin_s, end_s: bus time. advance: states (parameters, then their rates) and
    covariances at both ends, before the second update; state: what that made of them. widening: what it multiplied the
    parameters' covariance before it by. sweep_alone: whether a sweep alone led to it, without a weighed mass or a known density.
    names: of the parameters in the states; empty where they are not known.
    """

    from_version: int
    begin_s: float
    end_s: float
    advance: Advance
    state: tuple[float, ...]
    widening: float = 1.0
    sweep_alone: bool = False
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CalibrationOutcome:
    """What a sweep or a weighed mass changed. estimator: the one to use from now on, or None where the parameters stay.

    reason: one sentence for the operator. identifiable: what was to be determined was narrowed. weighed: a reference mass alone
    changed it, no sweep. checks: masses weighed since the last call, held against the parameters as they were before it.
    step: what a smoother needs to correct the time before; None where the update does not follow on the one before it.
    moved_by_moisture: the parameters hold at the moisture of the last window, to which a map has moved them.
    """

    estimator: FlowEstimator | None
    reason: str
    identifiable: bool = True
    weighed: bool = False
    checks: tuple[ScaleCheck, ...] = ()
    step: CalibrationStep | None = None
    moved_by_moisture: bool = False


class SelfCalibrator(Protocol):
    """Updates parameters from the windows of a sweep and from reference masses."""

    def update(self, records: Sequence[WindowRecord], estimator: FlowEstimator, *, use_sweep: bool = True) -> CalibrationOutcome:
        """records: the usable windows of one whole sweep. estimator: the one in use.

        use_sweep: False while the model disagrees with what sweeps show; then only an independent density updates.
        """

    def weigh(
        self,
        record: WindowRecord,
        references: Sequence[ReferenceMass],
        estimator: FlowEstimator,
        model_error: AngleError = NO_ERROR,
    ) -> CalibrationOutcome:
        """What reference masses change. record: the last window; references: all reference masses kept; model_error: that their
        loads are stated with."""

    def update_from_kernels(
        self, record: WindowRecord, measurement: KernelMeasurement, estimator: FlowEstimator
    ) -> CalibrationOutcome:
        """What kernel noise changes. record: the last window."""

    def follow(self, record: WindowRecord, estimator: FlowEstimator) -> CalibrationOutcome | None:
        """Where the estimated drift has led the parameters since the last update; None: no further than is worth a
        step. record: the last window."""

    def drift_std_dev(self, record: WindowRecord, estimator: FlowEstimator) -> float:
        """Relative standard deviation of the force by drift since the last update of the parameters, beyond their covariance.
        record: the last window."""

    def sweep_worth(
        self, record: WindowRecord, stops_deg: Sequence[float], channels: OtherChannels, estimator: FlowEstimator
    ) -> SweepWorth | None:
        """What a sweep from now on is worth. record: the last window, at home; stops_deg: plate angle of each window of
        the sweep; None: not known."""

    def use(self, estimator: FlowEstimator, harvested_kg: float = 0.0) -> None:
        """Other parameters than the last update led to: those from before an update, since when they hold again; or from outside,
        estimated so much grain ago."""

    @property
    def counted(self) -> frozenset[str]:
        """Names of the weighed loads that count, of any crop."""

    @property
    def doubted(self) -> frozenset[str]:
        """Names of those that contradict them and wait until another agrees with them, of any crop."""

    def forget(
        self,
        load_numbers: frozenset[int],
        estimator: FlowEstimator,
        counted: Sequence[ReferenceMass] | None = None,
        scale: Sequence[ReferenceMass] = (),
    ) -> bool:
        """What was weighed of these loads counts no more and may be used anew. counted: tickets of the present crop that the
        parameters in use rest on, which came back; None: the parameters are as before. scale: masses of the tank scale; those
        that led to what went are used anew. Returns whether there are such."""

    def change_grain(self, before: str, now: str, used: Sequence[ReferenceMass], estimator: FlowEstimator | None = None) -> None:
        """Another crop from now on: what was weighed of the one before is kept for its return, and what its parameters were
        before that. used: masses of the new one that were handed over before; estimator: in use from now on."""

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """What is to outlive a restart beside the parameters; None: nothing."""

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """Go on from a snapshot, with the parameters that were in use then."""

    def remember(self, masses: Sequence[ReferenceMass], estimator: FlowEstimator, model_error: AngleError = NO_ERROR) -> None:
        """After `restore`: reference masses that were handed over before. model_error: as `weigh` has it."""
