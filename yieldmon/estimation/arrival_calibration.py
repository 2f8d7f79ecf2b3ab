"""An arrival law from waves at known volume flows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from yieldmon.physics.numerics import Array

from .arrival_law import TERMS, ArrivalLaw, features
from .pattern_fold import PatternWave
from .pulse_fit import PulseEstimate
from .pulse_model import GAIN, SHIFT, PulseModel
from .pulse_shape import estimate, look_for_start

SEVERAL_GRAINS = (tuple(range(TERMS)), (0, 1, 2, 3, 4, 8, 9), (0, 1, 2, 3, 4, 5, 8, 9))
"""Terms of stretch, tail and delay for a calibration over loads, plate angles, speeds and frictions."""
_TYPICAL_LOG_TAIL = float(np.log(0.004))


def calibrate_arrival(
    pulses: PulseModel | Sequence[PulseModel],
    waves: Sequence[PatternWave],
    volume_flows_m3_s: Sequence[float],
    *,
    terms: int | tuple[Sequence[int], Sequence[int], Sequence[int]] = 2,
) -> ArrivalLaw:
    """The arrival law that waves at known volume flows follow.

    Parameters
    ----------
    pulses : PulseModel or sequence
        One, or one for each wave where their grain differs. Its own arrival law is not used; friction, shape_ratio and cell are
        held at their means.
    waves, volume_flows_m3_s : sequences
        More than terms.
    terms : int or tuple
        Which coefficients of stretch, tail and delay are free: so many of the first `ArrivalLaw` names, or their places, as
        `SEVERAL_GRAINS`. One plate angle determines two.

    Returns
    -------
    ArrivalLaw
        covariance from the residuals; fills, plate_angles_rad and elevator_speeds_rad_s those of the waves.

    Raises
    ------
    ValueError
        For too few waves.
    """
    chosen = tuple(tuple(range(terms)) for _ in range(3)) if isinstance(terms, int) else terms
    most = max(map(len, chosen))
    if len(waves) <= most:
        raise ValueError(f"{len(waves)} waves, expected more than {most}, the terms of the law")
    models = [pulses] * len(waves) if isinstance(pulses, PulseModel) else list(pulses)
    wide = ArrivalLaw(tail=(_TYPICAL_LOG_TAIL,), covariance=(0.3**2, 0.7**2, 0.0))
    rows, targets, fills = [], [], []
    for model, wave, flow in zip(models, waves, volume_flows_m3_s, strict=True):
        sd = {**model.settings.sd, "log_volume_flow": 0.0, "log_friction": 0.0, "log_shape_ratio": 0.0, "log_cell": 0.0}
        fit = _at_flow(PulseModel(model.model, model.parameters, replace(model.settings, arrival=wide, sd=sd)), wave, flow)
        fills.append(model.mean_fill(flow, wave.elevator_speed_rad_s))
        where = wide.conditions(wave.plate_angle_rad, wave.elevator_speed_rad_s, model.parameters["friction"])
        rows.append(features(fills[-1], where))
        targets.append((fit.values["log_stretch"], fit.values["log_tail"] + _TYPICAL_LOG_TAIL, fit.values["shift_s"]))
    laws, left = zip(*map(partial(_fitted_law, np.array(rows)), chosen, np.array(targets).T), strict=True)
    spread, indexed = np.array(left) @ np.array(left).T, models[0].settings.indexed
    angles, speeds = [wave.plate_angle_rad for wave in waves], [wave.elevator_speed_rad_s for wave in waves]
    return ArrivalLaw(
        laws[0],
        laws[1],
        (float(spread[0, 0]), float(spread[1, 1]), float(spread[0, 1])),
        delay=laws[2] if indexed else (),
        delay_sd_s=float(np.sqrt(spread[2, 2])) if indexed else 0.0,
        fills=(min(fills), max(fills)),
        plate_angles_rad=(min(angles), max(angles)),
        elevator_speeds_rad_s=(min(speeds), max(speeds)),
    )


def _fitted_law(rows: Array, places: Sequence[int], target: Array) -> tuple[tuple[float, ...], Array]:
    """Coefficients (TERMS,) of a law with some terms free, and its residuals (waves,) over the root of their degrees of freedom.

    rows: (waves, TERMS), from `features`. target: (waves,).
    """
    table = rows[:, list(places)]
    found = np.linalg.lstsq(table, target, rcond=None)[0]
    whole = np.zeros(TERMS)
    whole[list(places)] = found
    return tuple(float(v) for v in whole), (target - table @ found) / np.sqrt(len(target) - len(places))


def _at_flow(pulses: PulseModel, wave: PatternWave, volume_flow_m3_s: float) -> PulseEstimate:
    """The fit with the flow held."""
    near = look_for_start(pulses, wave)
    begin = pulses.start(volume_flow_m3_s, shift_s=float(near[SHIFT]), log_gain=float(near[GAIN]))
    return estimate(pulses, wave, start=begin, centre=begin.copy())
