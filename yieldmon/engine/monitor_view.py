"""The readable state of a monitor."""

from __future__ import annotations

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.health import FaultBook
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.parts import Parts
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import Sources
from yieldmon.engine.sweeps.disagreement import Disagreement
from yieldmon.engine.sweeps.sweep import PlateSweep
from yieldmon.engine.waveform.waveform_reading import WaveformReading
from yieldmon.estimation.waveform.kernel_noise import KernelVerdict
from yieldmon.physics.machine import Machine


class MonitorView:
    """Read-only view of a monitor.

    Attributes
    ----------
    settings : EngineSettings
    machine : Machine
    sources : Sources
    faults : FaultBook
        Active faults, since when and why.
    """

    def __init__(self, parts: Parts, sources: Sources) -> None:
        self._parts = parts
        self.settings: EngineSettings = parts.settings
        self.machine: Machine = parts.machine
        self.sources = sources
        self.faults: FaultBook = parts.faults

    @property
    def totals(self) -> Totals:
        """Mass measured so far."""
        return self._parts.loads.totals

    @property
    def loads(self) -> tuple[LoadSummary, ...]:
        """Loads completed since the start, and the open one."""
        return self._parts.loads.all

    @property
    def open_load(self) -> LoadSummary | None:
        """The load that is open."""
        return self._parts.loads.open

    @property
    def estimator(self) -> FlowEstimator:
        """The estimator in use."""
        return self._parts.updater.estimator

    @property
    def outcome(self) -> CalibrationOutcome | None:
        """What the last whole sweep or weighed mass changed."""
        return self._parts.updater.outcome

    @property
    def disagreement(self) -> Disagreement:
        """Whether the model disagrees with the sweeps."""
        return self._parts.updater.disagreement

    @property
    def reference_masses(self) -> tuple[ReferenceMass, ...]:
        """Reference masses kept, by time."""
        return self._parts.updater.masses.kept

    @property
    def counted_loads(self) -> frozenset[int]:
        """Loads whose tickets new tickets are compared with, of any crop."""
        return self._parts.updater.counted_loads

    @property
    def scale_counted(self) -> bool:
        """Whether masses of the tank scale are among those that new tickets are compared with."""
        return self._parts.updater.scale_counted

    @property
    def doubted_loads(self) -> frozenset[int]:
        """Loads whose tickets contradict the counted ones and wait until another ticket agrees with them, of any crop."""
        return self._parts.updater.doubted_loads

    @property
    def earlier_loads(self) -> tuple[LoadSummary, ...]:
        """Closed loads of earlier runs whose tickets can update the parameters."""
        return self._parts.updater.masses.tickets.earlier_loads

    @property
    def masses_wait(self) -> bool:
        """Whether a reference mass has not been used for an update yet."""
        return self._parts.updater.masses_wait

    @property
    def zero_waits_for(self) -> str:
        """What a requested zero is waiting for; "" where none is requested."""
        return self._parts.measurement.zero_waits_for

    @property
    def area_unknown_because(self) -> str:
        """Why no area is known of the last second's grain; "" where one is."""
        return self._parts.area.unknown_because

    @property
    def signs_of_grain(self) -> str:
        """Signs of grain, against which the zero should not be calibrated now; "" where there are none."""
        return self._parts.measurement.signs_of_grain

    @property
    def signs_against_zero(self) -> str:
        """`signs_of_grain` except a force without paddle pulses: the signs that make an operator's zero suspect."""
        return self._parts.measurement.signs_against_zero

    @property
    def waveform(self) -> WaveformReading | None:
        """Shape and kernel noise of the last window's samples; None where they are not evaluated."""
        return self._parts.waveform.last if self._parts.waveform is not None else None

    @property
    def only_kernels_set_scale(self) -> bool:
        """Whether kernel noise gives a flow and nothing confirms its scale, see `ParameterSet.scale_is_measured`: a wrong
        thousand-kernel weight makes the flow wrong by as much."""
        seen = self.waveform
        return seen is not None and seen.kernels is KernelVerdict.USED and not self.estimator.parameters.scale_is_measured

    @property
    def kernel_weight_g(self) -> float:
        """Thousand-kernel weight as last reported or configured, g; 0: not known."""
        return self._parts.waveform.kernel_weight_g if self._parts.waveform is not None else 0.0

    @property
    def sweep(self) -> PlateSweep:
        """The plate sweeps."""
        return self._parts.plate.sweep

    @property
    def bus_time_s(self) -> float:
        """Bus time, nan before the first frame."""
        return self._parts.bus_now

    @property
    def due_s(self) -> float:
        """Bus time from which the next frame closes a window or commands the plate, s; -inf before the first frame."""
        return self._parts.clock.bus_time(self._parts.schedule.next_s)
