"""How much grain the harvest brings: pieces of flow put end to end, sampled on a fine grid.

Flow means mass flow at the impact plate. The threshing and cleaning of the machine smooths every step with one time constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from yieldmon.physics.numerics import Array
from yieldmon.strict_model import StrictModel

FlowKgS = Annotated[float, Field(ge=0, le=30)]
DurationS = Annotated[float, Field(gt=0, le=1e6)]

SAMPLE_INTERVAL_S = 0.01

_SMALLEST_FLOW_KG_S = 0.02
"""The tail of a smoothed stop ends here: the last kernels are not worth a paddle's computation."""


class Steady(StrictModel):
    """Constant flow."""

    kind: Literal["steady"]
    duration_s: DurationS
    flow_kg_s: FlowKgS


class Ramp(StrictModel):
    """Linear from one flow to another."""

    kind: Literal["ramp"]
    duration_s: DurationS
    from_kg_s: FlowKgS
    to_kg_s: FlowKgS


class Step(StrictModel):
    """Flows of equal duration, one after the other."""

    kind: Literal["step"]
    duration_s: DurationS
    flows_kg_s: Annotated[list[FlowKgS], Field(min_length=1)]


class Oscillating(StrictModel):
    """A sine about a mean, cut off at zero."""

    kind: Literal["oscillating"]
    duration_s: DurationS
    mean_kg_s: FlowKgS
    amplitude_kg_s: FlowKgS
    period_s: Annotated[float, Field(ge=0.5, le=3600)]


class StopAndGo(StrictModel):
    """A harvest day: passes at a yield that changes along the field, headlands, and stops to unload.

    Pass lengths and yields scatter; every `unload_every` passes the machine stops to unload, at the end of `duration_s` it stops.
    """

    kind: Literal["stop-and-go"]
    duration_s: DurationS
    flow_kg_s: FlowKgS
    flow_variation_pct: Annotated[float, Field(ge=0, le=60)] = 20.0
    pass_s: Annotated[float, Field(ge=10, le=3600)] = 180.0
    headland_s: Annotated[float, Field(ge=3, le=600)] = 25.0
    unload_every: Annotated[int, Field(ge=1, le=1000)] = 4
    unload_s: Annotated[float, Field(ge=5, le=1800)] = 90.0


class Off(StrictModel):
    """No grain and the elevator stopped."""

    kind: Literal["off"]
    duration_s: DurationS


Piece = Annotated[Steady | Ramp | Step | Oscillating | StopAndGo | Off, Field(discriminator="kind")]


class FlowProfile(StrictModel):
    """Pieces of flow in order; after the last one they begin again. `variation_pct` is a slow random factor on all of them."""

    pieces: Annotated[list[Piece], Field(min_length=1)]
    variation_pct: Annotated[float, Field(ge=0, le=50)] = 2.0
    variation_time_s: Annotated[float, Field(ge=0.5, le=600)] = 5.0
    smoothing_s: Annotated[float, Field(ge=0, le=10)] = 0.7


@dataclass(frozen=True, slots=True)
class Harvest:
    """Flow on a grid of SAMPLE_INTERVAL_S from time 0: flow_kg_s, whether the header is in the crop, whether the drive is on."""

    flow_kg_s: Array
    working: NDArray[np.bool_]
    driven: NDArray[np.bool_]


def harvest(profile: FlowProfile, duration_s: float, rng: np.random.Generator) -> Harvest:
    """Sample a profile; rng makes the scatter of passes and the slow variation."""
    wanted = round(duration_s / SAMPLE_INTERVAL_S) + 1
    flows: list[Array] = []
    driven: list[NDArray[np.bool_]] = []
    have = 0
    while have < wanted:
        for piece in profile.pieces:
            flow = _sample(piece, rng)
            flows.append(flow)
            driven.append(np.full(len(flow), not isinstance(piece, Off)))
            have += len(flow)
    raw = np.concatenate(flows)[:wanted]
    on = np.concatenate(driven)[:wanted]
    working = raw > 0.0
    flow = raw * _slow_factor(wanted, profile, rng)
    if profile.smoothing_s > 0.0:
        flow = _smooth(flow, profile.smoothing_s)
    flow = np.where(on & (flow >= _SMALLEST_FLOW_KG_S), np.minimum(flow, 30.0), 0.0)
    return Harvest(flow, working, on)


def _smooth(flow: Array, time_constant_s: float) -> Array:
    keep = np.exp(-SAMPLE_INTERVAL_S / time_constant_s)
    start = [keep * flow[0]]
    return np.asarray(scipy.signal.lfilter([1.0 - keep], [1.0, -keep], flow, zi=start)[0])


def _slow_factor(count: int, profile: FlowProfile, rng: np.random.Generator) -> Array:
    noise = correlated_noise(count, profile.variation_time_s / SAMPLE_INTERVAL_S, rng)
    return np.asarray(1.0 + profile.variation_pct / 100.0 * noise)


def correlated_noise(count: int, correlation_samples: float, rng: np.random.Generator) -> Array:
    """First-order (Ornstein-Uhlenbeck) noise of unit standard deviation."""
    keep = np.exp(-1.0 / correlation_samples)
    white = rng.standard_normal(count)
    start = [keep * rng.standard_normal()]
    return np.asarray(scipy.signal.lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, zi=start)[0])


def _count(duration_s: float) -> int:
    return max(1, round(duration_s / SAMPLE_INTERVAL_S))


def _sample(piece: Piece, rng: np.random.Generator) -> Array:
    count = _count(piece.duration_s)
    match piece:
        case Steady():
            return np.full(count, piece.flow_kg_s)
        case Ramp():
            return np.linspace(piece.from_kg_s, piece.to_kg_s, count)
        case Step():
            each = np.minimum(np.arange(count) * len(piece.flows_kg_s) // count, len(piece.flows_kg_s) - 1)
            return np.asarray(piece.flows_kg_s, dtype=float)[each]
        case Oscillating():
            time = np.arange(count) * SAMPLE_INTERVAL_S
            wave = piece.mean_kg_s + piece.amplitude_kg_s * np.sin(2.0 * np.pi * time / piece.period_s)
            return np.asarray(np.maximum(wave, 0.0))
        case StopAndGo():
            return _stop_and_go(piece, count, rng)
        case Off():
            return np.zeros(count)


def _stop_and_go(piece: StopAndGo, count: int, rng: np.random.Generator) -> Array:
    flow = np.zeros(count)
    place, passes = _count(piece.headland_s), 0
    scatter = piece.flow_variation_pct / 100.0
    while place < count:
        length = _count(piece.pass_s * rng.uniform(0.7, 1.3))
        end = min(place + length, count)
        level = piece.flow_kg_s * (1.0 + scatter * rng.uniform(-1.0, 1.0))
        along = correlated_noise(length, 20.0 / SAMPLE_INTERVAL_S, rng)[: end - place]
        flow[place:end] = np.maximum(level * (1.0 + 0.5 * scatter * along), 0.1 * level)
        passes += 1
        pause = piece.unload_s if passes % piece.unload_every == 0 else piece.headland_s
        place = end + _count(pause * rng.uniform(0.8, 1.2))
    return flow


def at(values: Array | NDArray[np.bool_], time_s: float) -> float:
    """A profile's value at the sample nearest to a time, the last one after its end."""
    return float(values[min(int(time_s / SAMPLE_INTERVAL_S + 0.5), len(values) - 1)])
