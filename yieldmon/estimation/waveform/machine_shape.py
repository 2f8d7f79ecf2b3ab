"""Arrival law of a machine, from the pulses of its weighed loads."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.physics.numerics import Array

from .arrival_calibration import ArrivalPoint, Terms, arrival_point, law_of
from .arrival_law import ArrivalLaw
from .pattern_fold import PatternWave
from .pulse_fit import PulseEstimate
from .pulse_model import PulseModel
from .pulse_shape import estimate_near

LEAST_LOADS = 3
TERM_NAMES = ("1", "x", "c", "xc", "c^2")
"""Terms of an `ArrivalLaw` that may be fitted to one machine's loads."""
_LOG_FILL, _ANGLE_RAD, _LOG_SPEED = 0.15, float(np.deg2rad(3.0)), 0.05
"""Widths of the groups of pulses: ln fill, plate angle, ln speed."""
_FLOW_PER_STRETCH = 2.0
"""Approximate d ln(volume flow from the shape) / d ln(stretch) (docs/internals/waveform.md)."""
_ROUNDS = 2
_EACH = 5
"""Largest number of waves of a group in a load that are fitted."""
_LEAST_LOG_FILLS, _LEAST_COSINES = 0.3, 0.1
"""Least range of ln fill and of the cosine of the plate angle for a term in them."""
_LEAST_ANGLES = 4
"""Least number of plate angles for a quadratic term."""


@dataclass(frozen=True, slots=True)
class WeighedWave:
    """A window's wave, its load, and its volume flow from the mean force, scaled to the load's weighed mass."""

    load: str
    wave: PatternWave
    volume_flow_m3_s: float


@dataclass(frozen=True, slots=True)
class LoadShape:
    """Errors of a load's waves.

    Attributes
    ----------
    load : str
    waves : int
        Number of waves.
    before : float
        Mean of ln(volume flow from the shape / weighed) with the law in use.
    left_out : float
        The same with a law fitted to the other loads; nan if its range does not include this load's pulses.
    """

    load: str
    waves: int
    before: float
    left_out: float


@dataclass(frozen=True)
class MachineShape:
    """Result of `calibrate_machine_shape`.

    Attributes
    ----------
    law : ArrivalLaw
    terms : tuple of str
        Names of the fitted terms.
    kinds : int
        Number of groups of pulses.
    loads : tuple of LoadShape
    refused : str
        Why the law is worse than the one in use; "" if it is not.
    """

    law: ArrivalLaw
    terms: tuple[str, ...]
    kinds: int
    loads: tuple[LoadShape, ...]
    refused: str


@dataclass(frozen=True)
class _Kind:
    """A group of pulses of one load with similar fill, angle and speed: their mean arrival, and some of their waves."""

    load: str
    point: ArrivalPoint
    waves: tuple[WeighedWave, ...]


def calibrate_machine_shape(pulses: PulseModel, waves: Sequence[WeighedWave]) -> MachineShape:
    """Fit the arrival law of a machine.

    Parameters
    ----------
    pulses : PulseModel
        Contains the arrival law in use.
    waves : sequence
        Waves of `LEAST_LOADS` loads or more.

    Returns
    -------
    MachineShape
        The law has terms in load and plate angle if the pulses' range is wide enough to determine them.

    Raises
    ------
    ValueError
        For too few loads, or loads that are too similar.
    """
    names = tuple(dict.fromkeys(wave.load for wave in waves))
    if len(names) < LEAST_LOADS:
        raise ValueError(f"{len(names)} loads with pulses, expected {LEAST_LOADS} or more")
    kinds = [_kind(pulses, part) for part in _kinds(pulses, waves)]
    chosen = _terms([kind.point for kind in kinds])
    law = _law(pulses, kinds, chosen)
    loads = []
    for name in names:
        own, others = ([kind for kind in kinds if (kind.load == name) is same] for same in (True, False))
        other = _law(pulses, others, _terms([kind.point for kind in others]))
        before, left_out = (_error(pulses, arrival, own) for arrival in (pulses.settings.arrival, other))
        loads.append(LoadShape(name, sum(wave.load == name for wave in waves), before, left_out))
    left_out_sd = float(np.sqrt(np.nanmean([load.left_out**2 for load in loads]))) / _FLOW_PER_STRETCH
    if np.isfinite(left_out_sd):
        # The points were adjusted to the law, so only loads left out show its error.
        law = replace(law, covariance=(max(law.covariance[0], left_out_sd**2), *law.covariance[1:]))
    return MachineShape(law, tuple(TERM_NAMES[place] for place in chosen), len(kinds), tuple(loads), _refusal(loads))


def _kinds(pulses: PulseModel, waves: Sequence[WeighedWave]) -> list[list[WeighedWave]]:
    groups: dict[tuple[str, int, int, int], list[WeighedWave]] = defaultdict(list)
    for weighed in waves:
        wave = weighed.wave
        fill = pulses.mean_fill(weighed.volume_flow_m3_s, wave.elevator_speed_rad_s)
        steps = (
            np.log(fill) / _LOG_FILL,
            wave.plate_angle_rad / _ANGLE_RAD,
            np.log(wave.elevator_speed_rad_s) / _LOG_SPEED,
        )
        first, second, third = (round(float(step)) for step in steps)
        groups[weighed.load, first, second, third].append(weighed)
    return [[group[i] for i in _spread(len(group))] for group in groups.values()]


def _spread(count: int) -> list[int]:
    return sorted({int(place) for place in np.linspace(0, count - 1, min(count, _EACH)).round()})


def _kind(pulses: PulseModel, waves: Sequence[WeighedWave]) -> _Kind:
    points = [arrival_point(pulses, weighed.wave, weighed.volume_flow_m3_s) for weighed in waves]

    def mean(name: str) -> Array:
        return np.asarray(np.mean([getattr(point, name) for point in points], axis=0))

    numbers = (float(mean(name)) for name in ("fill", "plate_angle_rad", "elevator_speed_rad_s"))
    return _Kind(waves[0].load, ArrivalPoint(mean("features"), mean("found"), *numbers), tuple(waves))


def _terms(points: Sequence[ArrivalPoint]) -> tuple[int, ...]:
    """Indices of the terms that the points' range determines; fewer than points."""
    cosines = np.cos([point.plate_angle_rad for point in points])
    by_load = bool(np.ptp([np.log(point.fill) for point in points]) >= _LEAST_LOG_FILLS)
    by_angle = bool(np.ptp(cosines) >= _LEAST_COSINES)
    several = bool(np.unique(cosines.round(1)).size >= _LEAST_ANGLES)
    free = (True, by_load, by_angle, by_load and by_angle, by_angle and several)
    wanted = [place for place, determined in enumerate(free) if determined]
    return tuple(wanted[: max(1, len(points) // 2)])


def _law(pulses: PulseModel, kinds: Sequence[_Kind], terms: tuple[int, ...]) -> ArrivalLaw:
    """The law of the groups, adjusted so that fits with free friction, heap and cell have the weighed flow in the mean."""
    chosen: Terms = (terms, terms[:2], terms[:1])
    points = [kind.point for kind in kinds]
    law = law_of(points, terms=chosen)
    for _ in range(_ROUNDS):
        wanted = _agreeing_stretches(pulses, law, kinds)
        points = [
            replace(point, found=np.array([log_stretch, *point.found[1:]]))
            for point, log_stretch in zip(points, wanted, strict=True)
        ]
        law = law_of(points, terms=chosen)
    return law


def _fits(pulses: PulseModel, law: ArrivalLaw, waves: Sequence[WeighedWave]) -> tuple[PulseModel, list[PulseEstimate]]:
    """Fit waves with a law, in the same way as the daemon."""
    model = PulseModel(pulses.model, pulses.parameters, replace(pulses.settings, arrival=law))
    return model, estimate_near(model, [w.wave for w in waves], [w.volume_flow_m3_s for w in waves])


def _agreeing_stretches(pulses: PulseModel, law: ArrivalLaw, kinds: Sequence[_Kind]) -> list[float]:
    """ln stretch with which each group's mean volume flow is the weighed one; the group's own if no fit converges."""
    wanted = []
    for kind in kinds:
        model, fits = _fits(pulses, law, kind.waves)
        found = []
        for fit, weighed in zip(fits, kind.waves, strict=True):
            if not np.isfinite(fit.volume_flow_m3_s):
                continue
            flow, stretch = (fit.names.index(name) for name in ("log_volume_flow", "log_stretch"))
            slope = fit.covariance[flow, stretch] / fit.covariance[flow, flow]
            fill = model.fill(np.asarray(fit.volume_flow_m3_s), weighed.wave.elevator_speed_rad_s).mean()
            where = law.conditions(weighed.wave.plate_angle_rad, weighed.wave.elevator_speed_rad_s, pulses.parameters["friction"])
            by_law = float(law.log_stretch(np.asarray(fill), where))
            off = np.log(weighed.volume_flow_m3_s / fit.volume_flow_m3_s)
            found.append(by_law + fit.values["log_stretch"] + slope * off)
        wanted.append(float(np.mean(found)) if found else float(kind.point.found[0]))
    return wanted


def _error(pulses: PulseModel, law: ArrivalLaw, kinds: Sequence[_Kind]) -> float:
    """Mean of ln(volume flow from the shape / weighed) over the groups' waves, fitted in the same way as in the daemon."""
    waves = [weighed for kind in kinds for weighed in kind.waves]
    _, fits = _fits(pulses, law, waves)
    errors = [np.log(fit.volume_flow_m3_s / w.volume_flow_m3_s) for fit, w in zip(fits, waves, strict=True)]
    known = [float(error) for error in errors if np.isfinite(error)]
    return float(np.mean(known)) if known else float("nan")


def _refusal(loads: Sequence[LoadShape]) -> str:
    before, after = (float(np.sqrt(np.nanmean([getattr(load, name) ** 2 for load in loads]))) for name in ("before", "left_out"))
    if after <= before:
        return ""
    return f"left out in turn, the loads' volume flows are off by {after:.1%}, with the arrival in use by {before:.1%}"
