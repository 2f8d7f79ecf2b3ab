"""The interface of a self-calibration, as the monitor uses it, and the outcome of an update."""

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
    """The step from one update to the next, as a smoother needs it to correct the time between.

    Attributes
    ----------
    from_version : int
        Of the parameters in use between the two updates.
    begin_s, end_s : float
        Bus times of the updates, s.
    advance : Advance
        States (parameters, then their rates) and covariances at both ends, before the second update.
    state : tuple of float
        State after the second update.
    widening : float
        Factor by which the second update widened the parameters' prior covariance.
    sweep_alone : bool
        Whether the second update rests on a sweep alone, without a weighed mass or a known density.
    names : tuple of str
        Of the parameters in the states; empty where not known.
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
    """Outcome of an update by a sweep or a weighed mass.

    Attributes
    ----------
    estimator : FlowEstimator or None
        To use from now on; None where the parameters stay.
    reason : str
        One sentence for the operator.
    identifiable : bool
        Whether the data made the parameters more certain.
    weighed : bool
        Whether it was an update by a reference mass, without a sweep.
    checks : tuple of ScaleCheck
        Masses weighed since the last call, compared with the parameters before the update.
    step : CalibrationStep or None
        None where the update does not follow on the one before it.
    moved_by_moisture : bool
        Whether a moisture map has moved the parameters to the moisture of the last window.
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
        """Update from reference masses. record: the last window; references: all reference masses kept; model_error: contained in
        the standard deviations of their loads."""

    def update_from_kernels(
        self, record: WindowRecord, measurement: KernelMeasurement, estimator: FlowEstimator
    ) -> CalibrationOutcome:
        """Update from kernel noise. record: the last window."""

    def follow(self, record: WindowRecord, estimator: FlowEstimator) -> CalibrationOutcome | None:
        """The parameters moved by the estimated steady drift since the last update; None where that is negligible. record: the
        last window."""

    def drift_std_dev(self, record: WindowRecord, estimator: FlowEstimator) -> float:
        """Relative standard deviation of the force by drift since the last update of the parameters, beyond their covariance.
        record: the last window."""

    def sweep_worth(
        self, record: WindowRecord, stops_deg: Sequence[float], channels: OtherChannels, estimator: FlowEstimator
    ) -> SweepWorth | None:
        """The information gain of a sweep that begins now; None where it is not known. record: the last window, at home;
        stops_deg: plate angle of each window of the sweep."""

    def use(self, estimator: FlowEstimator, harvested_kg: float = 0.0) -> None:
        """Use other parameters than those of the last update: earlier ones, or new ones from outside, estimated harvested_kg of
        grain ago."""

    @property
    def counted(self) -> frozenset[str]:
        """Names of the weighed loads that count, of any crop."""

    @property
    def doubted(self) -> frozenset[str]:
        """Names of the weighed loads that contradict them and wait until another agrees, of any crop."""

    def forget(
        self,
        load_numbers: frozenset[int],
        estimator: FlowEstimator,
        counted: Sequence[ReferenceMass] | None = None,
        scale: Sequence[ReferenceMass] = (),
    ) -> bool:
        """Forget the weights of these loads, which may be used again.

        counted: tickets of the present crop that the restored parameters rest on; None: the parameters did not change. scale:
        masses of the tank scale; those used after the restored parameters are used again. Returns whether there are such masses.
        """

    def change_grain(self, before: str, now: str, used: Sequence[ReferenceMass], estimator: FlowEstimator | None = None) -> None:
        """Another crop from now on. The weighed loads of the crop before, and its parameters before them, are kept for its
        return. used: masses of the new crop that were handed over before; estimator: in use from now on."""

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""

    def snapshot(self, now_s: float, total_kg: float) -> CalibratorState | None:
        """The state to keep for a restart beside the parameters; None: nothing."""

    def restore(self, state: CalibratorState, parameters: ParameterSet, total_kg: float) -> None:
        """Continue from a snapshot, with the parameters that were in use then."""

    def remember(self, masses: Sequence[ReferenceMass], estimator: FlowEstimator, model_error: AngleError = NO_ERROR) -> None:
        """After `restore`: reference masses that were handed over before. model_error: as `weigh` has it."""
