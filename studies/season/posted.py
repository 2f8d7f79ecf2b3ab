"""Strategy (c), one ticket a day, kept and posted by the daemon's own code.

What differs from `study.Keeper`: sweeps and tickets go to `engine.self_calibration.closed_loop_calibrator` as window records and
reference masses, the steps between updates through their documents in the store, and the loads are measured again by
`service.history.remeasuring`. A night of 14 hours lies between two days of harvest.
"""

from __future__ import annotations

from dataclasses import fields
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.season import season as seasons
from studies.season import study
from studies.season.season import Season
from studies.season.study import Array, Keeper, Strategy, StudySettings
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.load_forces import LoadForceSums, WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.scenario import Scenario
from yieldmon.service.history import remeasuring
from yieldmon.service.history.parameter_timeline import timeline
from yieldmon.service.history.update_steps import step_document
from yieldmon.service.logs.measured_loads import measured_loads
from yieldmon.service.storage.batch import Step
from yieldmon.service.storage.rows import SecondRow, second_row

POSTED = Strategy("(c) by the daemon", moisture_map=True, sweeps=True, tickets_per_day=1)
TICKET_ERROR = 0.002
"""As in `study.Keeper`; `self_calibration.reference_error` of the daemon."""
_NIGHT_S = 14.0 * 3600.0
_UNKNOWN: dict[str, Any] = {f.name: nan if f.type == "float" else 0 for f in fields(WindowRecord)} | {"faults": ()}


class DaemonKeeper(Keeper):
    """See the module's docstring."""

    def __init__(self, season: Season, first: ParameterSet, settings: StudySettings) -> None:
        super().__init__(season, first, POSTED, settings)
        loop = ClosedLoopSettings(
            flow="process", flow_process_sd=0.12, flow_process_time_s=30.0, model_error=settings.model_error,
            learned_information=settings.learned_information, kept_ratio=settings.kept_ratio,
        )  # fmt: skip
        self.daemon = ClosedLoopCalibrator(
            self.model,
            CalibratorSettings(
                loop,
                drift=settings.wandering,
                steady_per_kilotonne=settings.steady_per_kilotonne,
                steady_drift_memory_kt=settings.steady_drift_memory_kt,
                reference_error=TICKET_ERROR,
            ),
        )
        self.estimator: FlowEstimator = OpenLoop(self.model, self.parameters)
        self.versions = {self.parameters.version: self.parameters}
        self.version_of = np.zeros(season.time_s.size, dtype=int)
        self.steps: list[Step] = []
        self.references: list[ReferenceMass] = []
        self.reasons: list[str] = []
        self.seconds: list[SecondRow] = []
        self.evening_kg = np.full(season.loads.mass_kg.size, np.nan)

    def _bus_s(self, windows: Array | NDArray[np.intp]) -> Array:
        """A load that runs past the end of a day is brought in before the night."""
        begun = self.season.time_s[self.season.loads.start[self.season.load[windows]]]
        return np.asarray(self.season.time_s[windows] + _NIGHT_S * np.floor((begun - 1.0) / self.settings.day_s))

    def _measure(self, start: int, stop: int) -> None:
        super()._measure(start, stop)
        self.version_of[start:stop] = self.parameters.version

    def _records(self, windows: Array | NDArray[np.intp]) -> list[WindowRecord]:
        season, total = self.season, np.nancumsum(self.flow)
        columns = {
            "time_s": self._bus_s(windows), "mass_kg": np.nan_to_num(self.flow[windows]), "mass_flow_kg_s": self.flow[windows],
            "force_n": self.force[windows], "force_std_dev_n": np.hypot(self.force_sd[windows], 0.1),
            "plate_angle_rad": np.radians(self.angle_deg[windows]), "total_kg": total[windows],
            "elevator_speed_rad_s": season.elevator_speed_rpm[windows] * RPM,
            "moisture_pct": season.moisture_reading_pct[windows],
        }  # fmt: skip
        numbers = season.load[windows] + 1
        return [
            WindowRecord(
                **_UNKNOWN
                | {
                    "duration_s": 1.0,
                    "coverage": 1.0,
                    "load_number": int(numbers[i]),
                    "parameter_version": int(self.version_of[windows[i]]),
                }
                | {name: float(column[i]) for name, column in columns.items()}
            )
            for i in range(len(windows))
        ]

    def _swept(self, used: Array, place: int, length: int) -> None:
        self._told(self.daemon.update(self._records(used), self.estimator), place + length)

    def _weigh(self, number: int, mass_kg: float, sd_kg: float, hour: float) -> None:
        start, end = int(self.season.loads.start[number]), int(self.season.loads.end[number])
        windows = np.arange(start, end)
        sums, records = LoadForceSums(), self._records(windows)
        for r in records:
            sums.add(
                number + 1, r.mass_kg, WindowForces(1.0, r.force_n, r.plate_angle_rad, r.elevator_speed_rad_s, r.moisture_pct)
            )
        measured = float(np.nansum(self.flow[windows]))
        self.references.append(
            ReferenceMass(
                ReferenceSource.TICKET,
                records[0].time_s - 1.0,
                records[-1].time_s,
                mass_kg,
                sd_kg,
                measured,
                True,
                number + 1,
                forces=sums.of(number + 1),
            )
        )
        self._told(self.daemon.weigh(records[-1], self.references, self.estimator), end)

    def _follow(self, stop: int) -> None:
        outcome = self.daemon.follow(self._records(np.arange(stop - 1, stop))[0], self.estimator)
        if outcome is not None:
            self._told(outcome, stop)

    def _told(self, outcome: CalibrationOutcome, stop: int) -> None:
        if outcome.estimator is not None:
            self.estimator = outcome.estimator
            self.parameters = outcome.estimator.parameters
            self.versions[self.parameters.version] = self.parameters
            if outcome.step is not None:
                self.steps.append(Step(self.parameters.version, outcome.step.end_s, step_document(outcome.step)))
            self.updates += 1
        self.reasons.append(outcome.reason)
        self._remember(float(self.season.time_s[stop - 1]) / 3600.0)

    def _post(self, end: int) -> None:
        """As the daemon does it with its store's rows."""
        begin, last = int(self.season.loads.start[self.ticketed]), int(self.season.loads.end[end - 1])
        new = [second_row(i, record) for i, record in enumerate(self._records(np.arange(begin, last)), begin + 1)]
        known, now_s = timeline(self.steps, self.parameters), new[-1].time_s
        self.seconds = remeasuring.rows_of_whole_loads([*self.seconds, *new], now_s - remeasuring.SPAN_S, None, 1)
        whole = remeasuring.rows_of_whole_loads(self.seconds, remeasuring.earliest_s(known, now_s), None, 1)
        found = remeasuring.remeasured(measured_loads(whole, self.versions), known, self.machine)
        for name, again in found.items():
            windows = slice(int(self.season.loads.start[name - 1]), int(self.season.loads.end[name - 1]))
            self.posted_kg[name - 1] = again.factor * float(np.nansum(self.flow[windows]))
        first = slice(self.ticketed, end)
        self.evening_kg[first] = self.posted_kg[first]
        self.ticketed = end

    def evening_within_1_pct(self) -> float:
        """Share of the loads within 1 % as the evening's own ticket left them, 0 to 1; those after the last as measured."""
        measured = np.add.reduceat(np.nan_to_num(self.flow), self.season.loads.start)
        kept = np.where(np.isfinite(self.evening_kg), self.evening_kg, measured)
        return float(np.mean(np.abs(kept / self.season.loads.mass_kg - 1.0) <= 0.01))


def compare(hours: float, seed: int, drift_exponent: float) -> dict[str, float]:
    """Strategy (c) of one season by the daemon's code and by the study's own."""
    settings = seasons.SeasonSettings(hours=hours, drift_exponent=drift_exponent)
    machine = Machine()
    # The season applies its own moisture dependence; the scenario's would count it twice.
    scenario = study.scenario_of(settings).model_copy(update={"effects": Scenario().effects})
    season = seasons.simulate(settings, machine, scenario, seed)
    first = study.first_calibration(settings, machine, seed)
    keeper = DaemonKeeper(season, first, study.StudySettings())
    by_daemon = study.harvested(keeper)
    by_study = study.run(season, first, study.STRATEGIES[3], study.StudySettings())
    return {
        "seed": seed,
        "loads": len(by_daemon.load_error_pct),
        "live_within_1_pct": round(by_daemon.loads_within_1_pct, 3),
        "posted_within_1_pct": round(by_daemon.posted_within_1_pct, 3),
        "evening_within_1_pct": round(keeper.evening_within_1_pct(), 3),
        "live_mean_abs_pct": round(by_daemon.mean_abs_load_error_pct, 3),
        "posted_mean_abs_pct": round(float(np.mean(np.abs(by_daemon.posted_error_pct))), 3),
        "posted_worst_pct": round(float(np.max(np.abs(by_daemon.posted_error_pct))), 3),
        "library_live_within_1_pct": round(by_study.loads_within_1_pct, 3),
        "library_posted_within_1_pct": round(by_study.posted_within_1_pct, 3),
    }
