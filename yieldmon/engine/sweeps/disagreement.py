"""Residual patterns of the last sweeps, and the verdict whether together they contradict the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import degrees, isfinite
from typing import Any

import numpy as np

from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import DisagreementSettings
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, AngleError
from yieldmon.estimation.self_calibration.angle_pattern import without_pattern
from yieldmon.estimation.self_calibration.closed_loop_inputs import SWEEP_COLUMNS
from yieldmon.estimation.self_calibration.misfit import (
    NO_MISFIT,
    Misfit,
    ReducedSweep,
    common_misfit,
    pooled_residuals,
    reduce_sweep,
)
from yieldmon.estimation.self_calibration.sweep_model_error import model_error, unswept_error
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.units import counted


@dataclass(frozen=True, slots=True)
class SweepPattern:
    """One sweep as plain numbers: bus time of its end, s; plate angles, deg; logarithm of the force in N that each would have had
    at the sweep's mean flow, kg/s, and speed, rad/s, and its standard deviation; moisture, %, and logarithm of the force at home
    at that flow, None where not known."""

    time_s: float
    plate_angle_deg: tuple[float, ...]
    log_force: tuple[float, ...]
    sd: tuple[float, ...]
    mass_flow_kg_s: float
    elevator_speed_rad_s: float
    moisture_pct: float | None
    home_log_force: float | None = None

    @classmethod
    def of(cls, time_s: float, sweep: ReducedSweep) -> SweepPattern:
        """Rounded, because it is stored with the state once a second."""
        return cls(
            time_s,
            _short(np.degrees(sweep.plate_angle_rad)),
            _short(sweep.log_force),
            _short(sweep.sd),
            round(sweep.mass_flow_kg_s, 5),
            round(sweep.elevator_speed_rad_s, 5),
            round(sweep.moisture_pct, 3) if isfinite(sweep.moisture_pct) else None,
            round(sweep.home_log_force, 6) if isfinite(sweep.home_log_force) else None,
        )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> SweepPattern:
        """Inverse of `dataclasses.asdict`. Raises TypeError, and ValueError where the columns differ in length."""
        plain: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in data.items()}
        pattern = cls(**plain)
        angles, forces, sds = len(pattern.plate_angle_deg), len(pattern.log_force), len(pattern.sd)
        if not angles == forces == sds:
            raise ValueError(
                f"engine state: a sweep's pattern has {angles} angles, {forces} forces and {sds} standard deviations"
            )
        return pattern

    def reduced(self) -> ReducedSweep:
        """The same as arrays."""
        return ReducedSweep(
            np.radians(self.plate_angle_deg),
            np.array(self.log_force),
            np.array(self.sd),
            self.mass_flow_kg_s,
            self.elevator_speed_rad_s,
            float("nan") if self.moisture_pct is None else self.moisture_pct,
            float("nan") if self.home_log_force is None else self.home_log_force,
        )


@dataclass(frozen=True, slots=True)
class DisagreementState:
    """State over a restart: the patterns kept, oldest first; whether the model disagrees; the patterns of sweeps that ended
    early, oldest first."""

    patterns: tuple[SweepPattern, ...] = ()
    present: bool = False
    unfinished: tuple[SweepPattern, ...] = ()

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> DisagreementState:
        """Inverse of `dataclasses.asdict`. Raises KeyError or TypeError, and ValueError as `SweepPattern.from_dict`."""
        patterns, unfinished = (
            tuple(SweepPattern.from_dict(pattern) for pattern in rows) for rows in (data["patterns"], data.get("unfinished", ()))
        )
        return cls(patterns, data["present"], unfinished)


class Disagreement:
    """Keeps the patterns and judges them by `DisagreementSettings`."""

    def __init__(self, settings: DisagreementSettings, machine: Machine) -> None:
        self._settings = settings
        self._machine = machine
        self._state = DisagreementState()
        self._region = ""
        self._under_way: SweepPattern | None = None

    @property
    def state(self) -> DisagreementState:
        """State to keep for a restart."""
        return self._state

    @property
    def present(self) -> bool:
        """Whether the model cannot explain the sweeps' common pattern."""
        return self._state.present

    @property
    def region(self) -> str:
        """Angles and size of the disagreement, for the operator; "" for none."""
        return self._region

    def restore(self, state: DisagreementState, parameters: ParameterSet) -> None:
        """Continue from a stored state, with the parameters now in use."""
        self._state = state
        self._region = _in_words(self._misfit(state, without_pattern(parameters)), len(state.patterns))

    def add(self, records: Sequence[WindowRecord], parameters: ParameterSet) -> None:
        """Add the usable windows of a complete sweep, with the parameters in use; a sweep without a pattern is ignored."""
        self._under_way = None
        pattern = self._pattern(records, parameters)
        if pattern is None:
            return
        kept = replace(self._state, patterns=(*self._state.patterns, pattern)[-self._settings.keep_sweeps :])
        misfit = self._misfit(kept, without_pattern(parameters))
        self._state = replace(kept, present=misfit.disagrees)
        self._region = _in_words(misfit, len(kept.patterns))

    def look(self, records: Sequence[WindowRecord], parameters: ParameterSet) -> None:
        """Set the usable windows of the sweep under way, which count only in `model_error`."""
        self._under_way = self._pattern(records, parameters)

    def end_early(self, *, usable: bool) -> None:
        """The sweep under way ended early. usable: keep its pattern."""
        pattern, self._under_way = self._under_way, None
        if pattern is not None and usable:
            self._state = replace(self._state, unfinished=(*self._state.unfinished, pattern)[-self._settings.keep_sweeps :])

    def unswept_error(self, parameters: ParameterSet, angles_deg: Sequence[float]) -> AngleError:
        """Error of the force by these parameters that a first sweep of these angles may show."""
        return unswept_error(self._model(parameters), parameters, np.radians(angles_deg))

    @property
    def seen(self) -> bool:
        """Whether there is a pattern of any sweep, or of a part of one."""
        return bool(self._state.patterns or self._state.unfinished or self._under_way)

    def model_error(self, parameters: ParameterSet) -> AngleError:
        """Error of the force by these parameters, by the patterns kept and that of the sweep under way."""
        under_way = () if self._under_way is None else (self._under_way,)
        sweeps = [pattern.reduced() for pattern in (*self._state.patterns, *self._state.unfinished, *under_way)]
        if not sweeps:
            return NO_ERROR
        return model_error(self._model(parameters), parameters, sweeps, tolerance=self._settings.tolerance)

    def _pattern(self, records: Sequence[WindowRecord], parameters: ParameterSet) -> SweepPattern | None:
        columns = {name: np.array([getattr(record, name) for record in records]) for name in SWEEP_COLUMNS}
        parameters = without_pattern(parameters)
        reduced = reduce_sweep(self._model(parameters), parameters, **columns) if records else None
        return None if reduced is None else SweepPattern.of(float(records[-1].time_s), reduced)

    def _model(self, parameters: ParameterSet) -> ForwardModel:
        return ForwardModel(self._machine, parameters.effects)

    def _misfit(self, state: DisagreementState, parameters: ParameterSet) -> Misfit:
        model = self._model(parameters)
        sweeps = [pattern.reduced() for pattern in state.patterns]
        if model.needs_moisture:
            sweeps = [sweep for sweep in sweeps if isfinite(sweep.moisture_pct)]
        if len(sweeps) < self._settings.least_sweeps:
            return NO_MISFIT
        residuals, shared = pooled_residuals(model, parameters, sweeps)
        return common_misfit(
            residuals,
            shared=shared,
            least_sweeps=self._settings.least_sweeps,
            level=self._settings.end_p if state.present else self._settings.begin_p,
            tolerance=self._settings.tolerance,
        )


def _in_words(found: Misfit, sweeps: int) -> str:
    if not found.disagrees:
        return ""
    low, high = (f"{degrees(angle):.0f}" for angle in found.plate_angle_rad)
    where = f"at {low} deg" if low == high else f"from {low} to {high} deg"
    share = 100.0 * found.mean_relative_error
    return f"{where} the model's force is {abs(share):.1f} % too {'high' if share > 0.0 else 'low'} ({counted(sweeps, 'sweep')})"


def _short(values: Array) -> tuple[float, ...]:
    return tuple(round(value, 6) for value in values.tolist())
