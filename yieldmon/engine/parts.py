"""The parts that a monitor is composed of, each with one task; made once from settings and machine."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.engine.clock import BusClock
from yieldmon.engine.flow import FlowMeter
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.health import FaultBook
from yieldmon.engine.inputs import Inputs
from yieldmon.engine.mass.area import AreaCounter
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.unloading import Unloading
from yieldmon.engine.measurement import Measurement
from yieldmon.engine.publishing import Publisher
from yieldmon.engine.sampling.impact_sensors import ImpactSensors
from yieldmon.engine.sampling.since_zero import SinceZero
from yieldmon.engine.schedule import Schedule
from yieldmon.engine.self_calibration.calibrator import SelfCalibrator
from yieldmon.engine.self_calibration.parameter_updater import ParameterUpdater
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import Sources
from yieldmon.engine.sweeps.plate import Plate
from yieldmon.engine.uneven_seconds import UnevenSeconds
from yieldmon.engine.waveform.waveform import Waveform
from yieldmon.physics.machine import Machine
from yieldmon.signal_ranges import SignalRanges


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of one monitor, in the order in which a window passes through them.

    Attributes
    ----------
    settings : EngineSettings
    machine : Machine
    clock : BusClock
        Bus time to engine time.
    schedule : Schedule
        When windows end and plate commands are due.
    inputs : Inputs
        Last values of the slow inputs.
    sensors : ImpactSensors
        Samples to windows.
    measurement : Measurement
        Window to force: zero, harvest gate, noise.
    uneven : UnevenSeconds
        Force of the seconds in which the flow begins, ends or jumps.
    flow_meter : FlowMeter
        Force to flow and its error budget.
    waveform : Waveform or None
        Flow from pulse shape and kernel noise; None where it is off.
    area : AreaCounter
        Harvested area.
    loads : Loads
        Loads and totals.
    unloading : Unloading
        When the grain tank has been emptied, which begins a load.
    plate : Plate
        Sweeps and plate commands.
    faults : FaultBook
    since_zero : SinceZero
        Seconds since the operator's zero calibration, for an undo.
    updater : ParameterUpdater
        The estimator in use and its updates.
    publisher : Publisher
        Records to frames.
    """

    settings: EngineSettings
    machine: Machine
    clock: BusClock
    schedule: Schedule
    inputs: Inputs
    sensors: ImpactSensors
    measurement: Measurement
    uneven: UnevenSeconds
    flow_meter: FlowMeter
    waveform: Waveform | None
    area: AreaCounter
    loads: Loads
    unloading: Unloading
    plate: Plate
    faults: FaultBook
    since_zero: SinceZero
    updater: ParameterUpdater
    publisher: Publisher

    @classmethod
    def of(
        cls,
        settings: EngineSettings,
        machine: Machine,
        estimator: FlowEstimator,
        calibrator: SelfCalibrator | None,
        *,
        sources: Sources,
        ranges: SignalRanges | None,
        drives_plate: bool,
    ) -> Parts:
        """New parts; arguments as in `Monitor`."""
        windows = settings.windows
        schedule = Schedule(
            window_s=windows.window_s,
            command_interval_s=settings.plate.command_interval_s,
            grid_offset_s=windows.grid_offset_s,
        )
        return cls(
            settings=settings,
            machine=machine,
            clock=BusClock(settings.clock),
            schedule=schedule,
            inputs=Inputs(settings.inputs, sources),
            sensors=ImpactSensors(windows, machine, sources, traces=settings.waveform.enabled),
            measurement=Measurement(settings, machine, sources),
            uneven=UnevenSeconds(settings, machine, estimator),
            flow_meter=FlowMeter(settings, machine),
            waveform=Waveform(settings.waveform, machine) if settings.waveform.enabled else None,
            area=AreaCounter(machine.implement, settings.gate),
            loads=Loads(settings),
            unloading=Unloading(settings),
            plate=Plate(settings, machine, driven=drives_plate),
            faults=FaultBook(),
            since_zero=SinceZero(settings, machine),
            updater=ParameterUpdater(settings, machine, estimator, calibrator),
            publisher=Publisher(ranges),
        )

    @property
    def bus_now(self) -> float:
        """Bus time, s; nan before the first frame."""
        return float("nan") if self.clock.now_s is None else self.clock.bus_time(self.clock.now_s)
