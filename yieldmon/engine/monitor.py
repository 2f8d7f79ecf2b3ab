"""The yield monitor: frames in, results out, time only from the frames.

`Parts` are the components, each with one task; `Timeline` runs them in order of time; `Conclusion` makes the results of a window.
The monitor is their interface: frames and time, the operator's commands, and the state that survives a restart. `MonitorView`
holds the properties to read.

`feed` and `feed_run` give the same bits for the same frames, one by one or in blocks. Nothing here raises on any sequence of
frames: unusable input is left out and shown in quality and faults. One window ends each second,
`WindowSettings.grid_offset_s` after the full second of bus time.
"""

from __future__ import annotations

from collections.abc import Sequence

from yieldmon.arguments import of_other_type, require_type, require_within
from yieldmon.engine import operator_zero
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.mass.load_summary import LoadEvents, LoadSummary
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.monitor_view import MonitorView
from yieldmon.engine.parts import Parts
from yieldmon.engine.restart import remember_tickets, restore, snapshot, take_over
from yieldmon.engine.results import Result
from yieldmon.engine.runs import FrameRun
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.engine.self_calibration.calibrator import SelfCalibrator
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, Weighing
from yieldmon.engine.settings import MARKET_MOISTURE_PCT, EngineSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, THOUSAND_KERNELS_G, Sources
from yieldmon.engine.state import EngineState, TicketState
from yieldmon.engine.timeline import Timeline
from yieldmon.frames import Frame
from yieldmon.physics.machine import Machine
from yieldmon.signal_ranges import SignalRanges


class Monitor(MonitorView):
    """One yield monitor on one bus.

    Parameters
    ----------
    settings : EngineSettings
        Every number that the engine uses, as `load_configuration` gives it.
    machine : Machine
    estimator : OpenLoop
        Turns force into flow; anything with `parameters` and `estimate` of the same arguments.
    calibrator : SelfCalibrator, optional
        Updates the parameters from sweeps and reference masses; None: they stay.
    sources : Sources
        Which message and signal brings what; the shipped DBC by default.
    ranges : SignalRanges, optional
        Of the signals that are published; None: those of the shipped DBC.
    drives_plate : bool
        False for a log, whose plate follows no command: sweeps in the log update the parameters, and none is commanded.
    waveform_later : bool
        True: the samples' shape is evaluated only in `completed`, after the window's frames have been sent.

    Notes
    -----
    `feed`, `feed_run` and `tick` never raise on any sequence of frames. Operator commands are plain methods; they take effect
    with the next window or tick. `build_monitor` makes a monitor from a configuration.

    Examples
    --------
    >>> loaded = api.load_configuration(api.shipped("config/yieldmon.yaml"))
    >>> monitor = api.build_monitor(loaded.engine, loaded.machine, loaded.parameters)
    >>> frames = [api.Frame(0.1 * tenth, "ElevatorSpeed", {"ElevatorSpeed": 400.0}) for tenth in range(25)]
    >>> windows = [result for frame in frames for result in monitor.feed(frame) if isinstance(result, api.WindowResult)]
    >>> [code.value for code in windows[0].record.faults]
    ['SensorMissing', 'PlateFeedbackStale']
    """

    def __init__(
        self,
        settings: EngineSettings,
        machine: Machine,
        estimator: FlowEstimator,
        calibrator: SelfCalibrator | None = None,
        *,
        sources: Sources = DEFAULT_SOURCES,
        ranges: SignalRanges | None = None,
        drives_plate: bool = True,
        waveform_later: bool = False,
    ) -> None:
        require_type("settings", settings, EngineSettings, "`engine` of what `load_configuration` gives")
        require_type("machine", machine, Machine, "a Machine")
        parts = Parts.of(settings, machine, estimator, calibrator, sources=sources, ranges=ranges, drives_plate=drives_plate)
        super().__init__(parts, sources)
        self._timeline = Timeline(parts, waveform_later=waveform_later)

    # Frames

    def feed(self, frame: Frame) -> list[Result]:
        """Take one frame.

        Parameters
        ----------
        frame : Frame
            Of any message; those that the engine does not use only advance the time.

        Returns
        -------
        list of WindowResult or PlateCommand
            What happened, in order, usually nothing.

        Raises
        ------
        InputError
            For what is no Frame.
        """
        if not isinstance(frame, Frame):
            raise of_other_type("frame", frame, "a Frame, as `Codec.decode` makes it of a can.Message")
        return self._timeline.take(frame)

    def tick(self, time_s: float) -> list[Result]:
        """Advance the bus time without a frame that the engine uses.

        Parameters
        ----------
        time_s : float
            Bus time, s.

        Returns
        -------
        list of WindowResult or PlateCommand
            What happened, in order.
        """
        return self._timeline.tick(time_s)

    def begin_log(self) -> None:
        """The next frame is the first of another log of the same bus.

        If it comes long after the last one (`clock.max_gap_s`), the recorder paused: no clock jumped, and no frames were lost.
        """
        self._timeline.begin_log()

    def completed(self, results: Sequence[Result]) -> list[Result]:
        """The results last returned, with the shape of their windows' samples evaluated; for `waveform_later`.

        Parameters
        ----------
        results : sequence of WindowResult or PlateCommand
            As one call of `feed`, `feed_run` or `tick` returned them.

        Returns
        -------
        list of WindowResult or PlateCommand
            The same with the windows' `record` and `waveform` filled in.
        """
        return self._timeline.conclusion.completed(results)

    def feed_run(self, run: FrameRun, *, reports: bool = True) -> list[Result]:
        """Take a run of frames: the same as `feed` frame by frame, to the bit, at a fraction of its cost.

        Parameters
        ----------
        run : FrameRun
            Frames as columns.
        reports : bool
            False leaves out the frames that publish a window, which reading a log does not need.

        Returns
        -------
        list of WindowResult or PlateCommand
            What happened, in order.
        """
        return self._timeline.take_run(run, publishing=reports)

    # Loads

    def start_load(self) -> LoadEvents:
        """Begin a new load.

        Returns
        -------
        list of LoadOpened or LoadClosed
        """
        return self._parts.loads.start(self._parts.bus_now)

    def reset_totals(self) -> LoadEvents:
        """Set all masses to 0 and begin a new load.

        Returns
        -------
        list of LoadOpened or LoadClosed
        """
        self._parts.since_zero.totals_reset()
        self._parts.updater.totals_reset(self.totals.total_kg)
        return self._parts.loads.reset(self._parts.bus_now)

    def stop_load(self) -> LoadEvents:
        """The load is complete; mass measured from now on belongs to no load until the next one starts.

        Returns
        -------
        list of LoadOpened or LoadClosed
        """
        return self._parts.loads.stop(self._parts.bus_now)

    # Grain

    def set_market_moisture(self, moisture_pct: float) -> None:
        """Set the market moisture of the crop, at which dry mass is counted from now on.

        Parameters
        ----------
        moisture_pct : float
            Wet basis, 0 to 40 %; the configuration's `totals.moisture_reference_pct` takes precedence.

        Raises
        ------
        InputError
            For another moisture.
        """
        require_within("moisture_pct", moisture_pct, *MARKET_MOISTURE_PCT, "%")
        self._parts.loads.set_market_moisture(moisture_pct)

    def set_kernel_weight(self, thousand_kernel_weight_g: float) -> bool:
        """Set the thousand-kernel weight of the grain harvested from now on.

        Parameters
        ----------
        thousand_kernel_weight_g : float
            g; 0: not known.

        Returns
        -------
        bool
            False where the waveform is not evaluated.

        Raises
        ------
        InputError
            For a weight that no grain has.
        """
        require_within("thousand_kernel_weight_g", thousand_kernel_weight_g, 0.0, THOUSAND_KERNELS_G[1], "g")
        if self._parts.waveform is None:
            return False
        self._parts.waveform.kernel_weight_g = thousand_kernel_weight_g
        return True

    def set_estimator(self, estimator: FlowEstimator, calibration_age_s: float | None, harvested_kg: float = 0.0) -> None:
        """Use other parameters.

        Parameters
        ----------
        estimator : OpenLoop
            As in `Monitor`.
        calibration_age_s : float or None
            Time since they were calibrated, s; None where it is not known.
        harvested_kg : float
            Grain since then, kg: drift widens the standard deviations by it. Parameters that were in use before keep their own.
        """
        self._use(estimator, calibration_age_s, harvested_kg)
        self._parts.loads.scale_is_set()

    def _use(self, estimator: FlowEstimator, calibration_age_s: float | None, harvested_kg: float = 0.0) -> None:
        if dict(estimator.parameters.values) != dict(self._parts.updater.estimator.parameters.values):
            self._parts.flow_meter.moisture.forget()
        self._parts.updater.use(estimator, calibration_age_s, harvested_kg)
        self._parts.updater.scale_alarm.accept()

    def know_calibration_age(self, calibration_age_s: float | None) -> None:
        """Set the age of the calibration where it was not known, as before the computer's clock was set.

        Parameters
        ----------
        calibration_age_s : float or None
            Time since the parameters in use were calibrated, s; None where it is not known.
        """
        if self._parts.updater.calibration_age_s is None:
            self._parts.updater.restore_age(calibration_age_s)

    def change_crop(self, estimator: FlowEstimator, calibration_age_s: float | None, *, before: str, now: str) -> None:
        """Use the parameters of another crop. Waiting tickets of the crop before wait for its return; a sweep under way ends.

        Parameters
        ----------
        estimator, calibration_age_s
            As in `set_estimator`.
        before, now : str
            Names of the crops.
        """
        self.abort_sweep()
        self._parts.updater.change_grain(before, now, estimator)
        self._use(estimator, calibration_age_s)
        self._parts.loads.change_crop(before, now)

    # Zero

    def calibrate_zero(self, *, despite_signs: bool = True) -> bool:
        """Zero-flow calibration: the operator states that the elevator runs empty for the next seconds.

        Parameters
        ----------
        despite_signs : bool
            Take the zero even where those seconds show signs of grain; False: wait until they do not.

        Returns
        -------
        bool
            True where an earlier calibration is suspect, so that an undo restores the zero before that one.
        """
        return operator_zero.calibrate(self._parts, despite_signs=despite_signs)

    def undo_zero(self) -> tuple[dict[int, MissedMass], LoadEvents]:
        """Restore the zero before the operator's last calibration.

        Returns
        -------
        missed : dict of int to MissedMass
            Mass that was missed since then, by load number; `missed_mass.NO_LOAD` where none was open.
        events : list of LoadOpened or LoadClosed
            The loads that changed.

        Raises
        ------
        ValueError
            When there is no such zero.
        """
        return operator_zero.undo(self._parts)

    # Tickets

    def ticket(
        self, load_number: int, mass_kg: float, std_dev_kg: float, *, crop: str = "", common_kg: float = 0.0
    ) -> ReferenceMass:
        """A scale ticket for a load.

        Parameters
        ----------
        load_number : int
        mass_kg, std_dev_kg : float
            Weighed mass and its standard deviation, kg.
        crop : str
            Of the load, where another crop is harvested now.
        common_kg : float
            The part of std_dev_kg by another combine's monitor, the same error in all tickets that have one.

        Returns
        -------
        ReferenceMass
            Counts when the window or sweep under way ends; of another crop, once that is harvested again.

        Raises
        ------
        ValueError
            When the load is not known or a number makes no sense.
        """
        weighing = Weighing(load_number, mass_kg, std_dev_kg, common_kg)
        return self._parts.updater.ticket(weighing, loads=self.loads, now_s=self._parts.bus_now, crop=crop)

    def ticket_departure(
        self, load_number: int, mass_kg: float, std_dev_kg: float, *, of_crop: FlowEstimator | None = None
    ) -> tuple[float, float] | None:
        """Compare a scale ticket that is not entered yet with its load.

        Parameters
        ----------
        load_number, mass_kg, std_dev_kg
            As `ticket` has them.
        of_crop : FlowEstimator, optional
            With the parameters of the load's crop; None: those in use.

        Returns
        -------
        (float, float) or None
            ln of the weighed mass over the load's by these parameters, and its standard deviation; None where the load was
            not measured completely, or the parameters are a curve without a model.

        Raises
        ------
        ValueError
            As `ticket`.
        """
        weighing = Weighing(load_number, mass_kg, std_dev_kg)
        return self._parts.updater.departure(weighing, loads=self.loads, now_s=self._parts.bus_now, of_crop=of_crop)

    def update_again(
        self,
        load_numbers: Sequence[int],
        again: Sequence[Weighing],
        *,
        rests_on: Sequence[int] | None = None,
        crop: str = "",
        stay: Sequence[Weighing] = (),
    ) -> LoadEvents:
        """Tickets were taken back: the parameters from before them are updated again by the other tickets.

        Parameters
        ----------
        load_numbers : sequence of int
            The loads that the tickets taken back covered.
        again : sequence of Weighing
            Tickets that update them again, in the order of entry, one with each window or sweep that ends.
        rests_on : sequence of int, optional
            Loads with tickets that the parameters in use rest on; None where these are the same as before.
        crop : str
            Of all these, where another crop is harvested now: then they wait for its return.
        stay : sequence of Weighing
            Other tickets for the same loads that the parameters in use rest on and that stay counted.

        Returns
        -------
        list of LoadClosed or LoadRestated
            Loads whose standard deviation these tickets had widened.

        Raises
        ------
        ValueError
            As `ticket`.
        """
        gone, known = frozenset(load_numbers), None if rests_on is None else frozenset(rests_on)
        self._parts.updater.update_again(gone, again, known, loads=self.loads, now_s=self._parts.bus_now, crop=crop, stay=stay)
        if known is not None:
            return self._parts.loads.scale_was_right(gone, again={weighing.load_number for weighing in again}, crop=crop)
        return () if crop or gone & self.counted_loads else self._parts.loads.forget_weights(gone)

    # Sweeps and faults

    def request_sweep(self) -> None:
        """Sweep as soon as the conditions hold."""
        self.sweep.request()

    def abort_sweep(self) -> bool:
        """End a sweep, under way or asked for, and take the plate home.

        Returns
        -------
        bool
            False where there was none.
        """
        return self.sweep.abort(self._parts.clock.now_s or 0.0)

    def report_fault(self, code: FaultCode, present: bool, detail: str = "") -> None:
        """Report a condition that the service detects, such as a bus error or a failing store; it holds until reported gone.

        Parameters
        ----------
        code : FaultCode
        present : bool
        detail : str
            Shown with the fault.
        """
        self.faults.report(code, present, detail)

    # Restart and reload

    def snapshot(self) -> EngineState:
        """The state to keep for a restart.

        Returns
        -------
        EngineState
        """
        return snapshot(self._parts, self._timeline.conclusion.windows)

    def restore(self, state: EngineState) -> None:
        """Continue from a snapshot; to be called before the first frame.

        Parameters
        ----------
        state : EngineState
        """
        restore(self._parts, state)
        self._timeline.conclusion.restore(state.windows)

    def remember_since_zero(self, seconds: Sequence[KeptSecond]) -> None:
        """After a restart: the seconds measured since the operator's last zero calibration.

        Parameters
        ----------
        seconds : sequence of KeptSecond
        """
        self._parts.since_zero.add(seconds)

    def know_load(self, load: LoadSummary, seconds: Sequence[KeptSecond]) -> None:
        """Add a closed load of an earlier run, so that a ticket for it updates the parameters as one for a load of this run does.

        Parameters
        ----------
        load : LoadSummary
        seconds : sequence of KeptSecond
            Of that load.
        """
        self._parts.updater.masses.tickets.know_load(self._parts.loads.as_stated(load), seconds)

    def remember_tickets(self, tickets: Sequence[TicketState]) -> None:
        """After `restore` and `know_load`: the tickets of the state; tickets for unknown loads are ignored.

        Parameters
        ----------
        tickets : sequence of TicketState
        """
        remember_tickets(self._parts, tickets)

    def take_over(self, before: Monitor, *, tickets: bool) -> None:
        """After `restore` from the state of the monitor in use until now: take over what that state does not contain.

        A zero calibration under way, what was measured since the last one, signs of grain in the last second, and the noise
        measured with grain and without.

        Parameters
        ----------
        before : Monitor
            Its noise is not taken over where machine or waveform settings differ.
        tickets : bool
            Whether to take over its tickets too.
        """
        take_over(self._parts, before._parts, tickets=tickets)
