"""What measures now: a monitor, the journal of what it does, and the last seconds of both."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence

from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, records_in
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.files.crops import shipped_name
from yieldmon.service.assembly import calibration_age_s, monitor_of
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.memory import Memory, choose_parameters
from yieldmon.service.history.resumption import resume, successor
from yieldmon.service.operator import commands
from yieldmon.service.operator.command_queue import Job
from yieldmon.service.operator.control_protocol import Answer
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.rows import SecondRow

_LAST_ROWS = 10


class Measuring:
    """Goes on from what a store remembers; the engine's thread alone uses it.

    Parameters
    ----------
    configuration : Configuration
    memory : Memory

    Attributes
    ----------
    monitor : Monitor
        A reload makes another.
    journal : Journal
    record : WindowRecord or None
        Of the last window of that monitor.
    """

    def __init__(self, configuration: Configuration, memory: Memory) -> None:
        configured = configuration.parameters
        self._configuration = configuration
        parameters, origin = choose_parameters(memory, configured)
        self.journal = Journal(memory, configured, now_s=time.time())
        self.journal.new_monitor(parameters, origin)
        self.monitor: Monitor = monitor_of(configuration, parameters, waveform_later=True)
        resume(self.monitor, memory, origin, configured, time.time())
        commands.set_crop(self.monitor, self.journal)
        self.record: WindowRecord | None = None
        self._rows: deque[SecondRow] = deque(maxlen=_LAST_ROWS)

    @property
    def rows(self) -> tuple[SecondRow, ...]:
        """Of the last seconds, of this monitor and those before it."""
        return tuple(self._rows)

    def take(self, completed: Sequence[Result]) -> int:
        """Enter results of the monitor, completed; returns the windows among them."""
        rows = self.journal.take(completed)
        if rows:
            self._rows.extend(rows)
            self.monitor.know_calibration_age(calibration_age_s(self.monitor.estimator.parameters, time.time()))
            self.record = records_in(completed)[-1]
        return len(rows)

    def batch(self, counters: Mapping[str, int]) -> Batch:
        """All that came since the last one; counters: of traffic."""
        return self.journal.batch(self.monitor, time.time(), counters)

    def execute(self, job: Job) -> Answer:
        """Carry out a command. Raises InputError where it is refused."""
        answer = commands.execute(job.request, self.monitor, self.journal, time.time(), job.stored)
        fresh = self.journal.parameters.take_fresh()
        if fresh is not None:
            self._replace(successor(self.monitor, self._configuration, fresh, time.time(), loads=self.journal.loads))
            self.journal.new_monitor(fresh, ParameterOrigin.HARDWARE)
        return answer

    def reset_totals(self) -> None:
        """Masses from 0, in a new load."""
        self.journal.happened(self.monitor.reset_totals())

    def add(self, configuration: Configuration, more: Totals) -> None:
        """Masses that another monitor measured after what this one did join its own."""
        self._replace(successor(self.monitor, configuration, None, time.time(), more))

    def use(self, configuration: Configuration) -> None:
        """Go on with another configuration; its parameters are taken where their file says others than before. All that came is
        in a batch."""
        self._configuration = configuration
        fresh = self.journal.parameters.unlike(configuration.parameters)
        self._replace(successor(self.monitor, configuration, fresh, time.time(), loads=self.journal.loads))
        # The next batch brings both: the file's name alone would make a start take the parameters before it for the file's.
        self.journal.parameters.configure(configuration.parameters)
        self.journal.new_monitor(self.monitor.estimator.parameters, ParameterOrigin.FILE)

    @property
    def of_another_crop(self) -> tuple[str, ...]:
        """A line where the parameters in use say that they are of another crop than the one that is harvested."""
        own, named = self.monitor.estimator.parameters.provenance.get("crop", ""), self.journal.crop
        if not own or not named or (shipped_name(own) or own.lower()) == (shipped_name(named) or named.lower()):
            return ()
        return (
            f"the parameters are of {own}, the load is of {named}: `yieldmon load start --crop {named}` uses those of {named}",
        )

    def _replace(self, monitor: Monitor) -> None:
        commands.set_crop(monitor, self.journal)
        self.monitor, self.record = monitor, None
