"""A store's seconds recomputed with other parameters, another zero or another delay: without the samples, which are gone.

Kept of a second are mean force, its noise, speed, angle and moisture. The gate stays as it was: a second that was judged to be
without grain has none, unless another zero says otherwise. The standard deviation of its flow that is neither noise nor the
parameters' (zero, moisture, the model's error) stays the same relative to the flow.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.documents.process import ReprocessedLoad
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.finite import finite
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.service.storage.load_ends import load_of
from yieldmon.service.storage.rows import SecondRow

_PLACED = ("latitude_deg", "longitude_deg", "ground_speed_m_s", "course_deg")


@dataclass(frozen=True)
class Reprocessed:
    """rows: the seconds recomputed. unusable: seconds with mass whose force, angle or speed is not known; they stay as they
    were."""

    rows: tuple[SecondRow, ...]
    before_kg: float
    after_kg: float
    unusable: int


def recomputed(
    rows: Sequence[SecondRow],
    machine: Machine,
    parameters: ParameterSet,
    settings: EngineSettings,
    *,
    sets: Mapping[int, ParameterSet],
    zero_mv: float | None = None,
    delay_s: int = 0,
    between: Container[int] = (),
) -> Reprocessed:
    """The rows with flow, mass and totals of these parameters.

    Parameters
    ----------
    rows : sequence of SecondRow
        In order, (n,).
    machine : Machine
    parameters : ParameterSet
    settings : EngineSettings
    sets : mapping of int to ParameterSet
        Those that measured the rows, by version. Where a row's is missing its flow has no standard deviation.
    zero_mv : float, optional
        For all seconds, mV; None: each its own.
    delay_s : int
        Place and speed of so many seconds earlier belong to a second's grain.
    between : container of int
        Numbers of the seconds that belong to no load and count in the total alone.

    Returns
    -------
    Reprocessed
    """
    force, zero = column(rows, "force_n"), column(rows, "zero_mv")
    counted = np.array([row.mass_kg > 0.0 for row in rows], dtype=bool)
    if zero_mv is not None:
        force = force + (zero - zero_mv) * machine.sensor.gain_n_per_mv
        # Contested seconds are in no total, whatever the zero.
        covered = np.array([row.coverage > 0.0 and row.load_number > 0 and not row.surplus_frames for row in rows], dtype=bool)
        counted = covered & ((force > settings.gate.grain_on_n) | (counted & ~np.isfinite(force)))
    flow, std_dev = _flows(rows, machine, parameters, force, counted)
    std_dev = np.hypot(std_dev, flow * _beyond(rows, machine, sets))
    out: list[SecondRow] = []
    total_kg, load_kg, load, unusable = 0.0, 0.0, -1, 0
    for i, row in enumerate(rows):
        known = bool(np.isfinite(flow[i]))
        kept = bool(counted[i]) and not known
        unusable += kept
        mass_kg = row.mass_kg if kept else float(flow[i]) * _seconds(row, settings.windows.min_coverage) if known else 0.0
        load_kg = (0.0 if row.load_number != load else load_kg) + (mass_kg if load_of(row, between) is not None else 0.0)
        total_kg, load = total_kg + mass_kg, row.load_number
        changed = {
            "mass_kg": mass_kg, "load_kg": load_kg, "total_kg": total_kg, "load_std_dev_kg": None, "total_std_dev_kg": None,
            "noise_std_dev_kg_s": None,
        } | _places(rows, i, delay_s)  # fmt: skip
        if known:
            changed |= {"mass_flow_kg_s": float(flow[i]), "std_dev_kg_s": finite(float(std_dev[i]))}
            changed |= {"parameter_version": parameters.version, "force_n": float(force[i])}
        if zero_mv is not None and row.zero_mv is not None:
            changed |= {"zero_mv": zero_mv, "force_n": finite(float(force[i]))}
        out.append(replace(row, **changed))
    before_kg = float(sum(row.mass_kg for row in rows))
    return Reprocessed(tuple(out), before_kg, total_kg, unusable)


def _flows(
    rows: Sequence[SecondRow], machine: Machine, parameters: ParameterSet, force_n: Array, counted: Array
) -> tuple[Array, Array]:
    """Flow and its standard deviation, kg/s, of each row that counts, by its force, N; nan where an input is not known."""
    model = ForwardModel(machine, parameters.effects)
    noise, angle, speed, moisture = (
        column(rows, name) for name in ("force_std_dev_n", "plate_angle_deg", "elevator_speed_rpm", "moisture_pct")
    )
    usable = counted & np.isfinite(force_n) & np.isfinite(angle) & np.isfinite(speed)
    if model.needs_moisture:
        usable &= np.isfinite(moisture)
    flow, std_dev = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    if np.any(usable):
        found = estimator_of(machine, parameters, model).estimate(
            force_n[usable], np.radians(angle[usable]), speed[usable] * RPM, np.nan_to_num(noise[usable]), moisture[usable]
        )
        flow[usable], std_dev[usable] = found.mass_flow_kg_s, found.std_dev_kg_s
    return flow, std_dev


def _beyond(rows: Sequence[SecondRow], machine: Machine, sets: Mapping[int, ParameterSet]) -> Array:
    """Relative standard deviation of each row's flow beyond noise and parameters, (n,). That of the row before, or else of the
    first, where it cannot be told, since nothing was counted; nan where nothing is known of the parameters."""
    rate, stated, noise, force, version = (
        column(rows, name) for name in ("mass_flow_kg_s", "std_dev_kg_s", "noise_std_dev_kg_s", "force_n", "parameter_version")
    )
    found = np.full(len(rows), np.nan)
    counted = (rate > 0.0) & (force > 0.0) & np.isfinite(stated)
    for number, parameters in sets.items():
        of_version = counted & (version == number)
        flow, std_dev = _flows(rows, machine, parameters, force, of_version)
        with np.errstate(invalid="ignore", divide="ignore"):
            own_noise = flow * column(rows, "force_std_dev_n") / force
            common = np.maximum((std_dev**2 - own_noise**2) / flow**2, 0.0)
            # The published flow is filtered, and its noise no larger than that of the second.
            in_all = (stated**2 - np.where(np.isfinite(noise), noise, own_noise) ** 2) / rate**2
            found = np.where(of_version, np.sqrt(np.maximum(in_all - common, 0.0)), found)
    known = np.flatnonzero(np.isfinite(found))
    if not known.size:
        return found
    last = np.maximum.accumulate(np.where(np.isfinite(found), np.arange(len(rows)), known[0]))
    return np.where(np.isin(version, list(sets)), found[last], np.nan)


def loads_of_rows(before: Sequence[SecondRow], after: Sequence[SecondRow], between: Container[int] = ()) -> list[ReprocessedLoad]:
    """Each load's mass as measured and as recomputed; between as in `recomputed`."""
    masses: dict[int, list[float]] = {}
    for one, other in zip(before, after, strict=True):
        if (one.mass_kg or other.mass_kg) and load_of(one, between) is not None:
            sums = masses.setdefault(one.load_number, [0.0, 0.0])
            sums[0] += one.mass_kg
            sums[1] += other.mass_kg
    return [{"load": number, "before_kg": was, "after_kg": now} for number, (was, now) in sorted(masses.items())]


def column(rows: Sequence[SecondRow], name: str) -> Array:
    """A column of rows, shape (rows,); nan where it is not known."""
    return np.array([np.nan if (v := getattr(row, name)) is None else v for row in rows], dtype=float)


def _seconds(row: SecondRow, min_coverage: float) -> float:
    """The time that a second's flow stands for."""
    return float(row.duration_s if row.coverage >= min_coverage else row.duration_s * row.coverage)


def _places(rows: Sequence[SecondRow], i: int, delay_s: int) -> dict[str, float | None]:
    if not delay_s:
        return {}
    # Where the clock was set back between the two, the earlier one's place is of another time.
    earlier = rows[i - delay_s] if i >= delay_s and 0.0 < rows[i].time_s - rows[i - delay_s].time_s < delay_s + 2.0 else None
    return {name: None if earlier is None else getattr(earlier, name) for name in _PLACED}
