"""A machine's own arrival law, from pulses of its weighed loads."""

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
"""Of an `ArrivalLaw` that one machine's loads may free."""
_LOG_FILL, _ANGLE_RAD, _LOG_SPEED = 0.15, float(np.deg2rad(3.0)), 0.05
"""Within these, pulses are of one kind."""
_FLOW_PER_STRETCH = 2.0
"""d ln(volume flow by the shape) / d ln(stretch), about (docs/internals/waveform.md)."""
_ROUNDS = 2
_EACH = 5
"""Waves of a kind in a load that are fitted."""
_LEAST_LOG_FILLS, _LEAST_COSINES = 0.3, 0.1
"""Range that it takes to free a term with load, or with plate angle."""
_LEAST_ANGLES = 4
"""For a term that is quadratic in plate angle."""


@dataclass(frozen=True, slots=True)
class WeighedWave:
    """A window's wave, its load, and its volume flow by the mean force, scaled to the load's weighed mass."""

    load: str
    wave: PatternWave
    volume_flow_m3_s: float


@dataclass(frozen=True, slots=True)
class LoadShape:
    """A load's waves: how many, and by how much the volume flow of their shape is off, relative: mean of ln(shape / weighed).

    before: with the law that was in use; left_out: with that of the other loads, nan where these do not reach its pulses.
    """

    load: str
    waves: int
    before: float
    left_out: float


@dataclass(frozen=True)
class MachineShape:
    """The law fitted to loads, its free terms, and the evidence of the loads for it. refused: why it is worse than the one in
    use."""

    law: ArrivalLaw
    terms: tuple[str, ...]
    kinds: int
    loads: tuple[LoadShape, ...]
    refused: str


@dataclass(frozen=True)
class _Kind:
    """Pulses of one load, fill, angle and speed: their mean arrival, and some of their waves."""

    load: str
    point: ArrivalPoint
    waves: tuple[WeighedWave, ...]


def calibrate_machine_shape(pulses: PulseModel, waves: Sequence[WeighedWave]) -> MachineShape:
    """The arrival law of a machine.

    Parameters
    ----------
    pulses : PulseModel
        With the arrival law that is in use.
    waves : sequence
        Of `LEAST_LOADS` loads or more.

    Returns
    -------
    MachineShape
        Its law has a term with load, or with plate angle, where the pulses' range is wide enough to determine it.

    Raises
    ------
    ValueError
        For too few loads, or loads too much alike.
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
        # The points were moved until the law passes through them: how far it is off elsewhere only loads left out say.
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
    """Places of the terms that the points' range determines, fewer than points."""
    cosines = np.cos([point.plate_angle_rad for point in points])
    by_load = bool(np.ptp([np.log(point.fill) for point in points]) >= _LEAST_LOG_FILLS)
    by_angle = bool(np.ptp(cosines) >= _LEAST_COSINES)
    several = bool(np.unique(cosines.round(1)).size >= _LEAST_ANGLES)
    free = (True, by_load, by_angle, by_load and by_angle, by_angle and several)
    wanted = [place for place, determined in enumerate(free) if determined]
    return tuple(wanted[: max(1, len(points) // 2)])


def _law(pulses: PulseModel, kinds: Sequence[_Kind], terms: tuple[int, ...]) -> ArrivalLaw:
    """The kinds' law, and then the one with which fits that leave friction, heap and cell free as well are right in the mean."""
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
    """As the daemon fits them."""
    model = PulseModel(pulses.model, pulses.parameters, replace(pulses.settings, arrival=law))
    return model, estimate_near(model, [w.wave for w in waves], [w.volume_flow_m3_s for w in waves])


def _agreeing_stretches(pulses: PulseModel, law: ArrivalLaw, kinds: Sequence[_Kind]) -> list[float]:
    """ln stretch with which each kind gives its weighed volume flow in the mean; the kind's own where no fit settles."""
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
    """Mean of ln(volume flow by the shape / weighed) over the kinds' waves, fitted as the daemon fits them."""
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
