"""The clean-grain elevator: its speed under load, and the paddles that come round with their loads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from pydantic import Field

from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.numerics import Array
from yieldmon.plant.profiles import SAMPLE_INTERVAL_S, Harvest, correlated_noise
from yieldmon.strict_model import StrictModel


class ElevatorSettings(StrictModel):
    """Speed of the upper sprocket, rpm, and how steady it is."""

    speed_rpm: Annotated[float, Field(ge=250, le=599)] = 400.0
    droop_pct_at_25_kg_s: Annotated[float, Field(ge=0, le=20)] = 3.0
    noise_pct: Annotated[float, Field(ge=0, le=5)] = 0.3
    noise_time_s: Annotated[float, Field(ge=0.05, le=60)] = 2.0
    lag_s: Annotated[float, Field(ge=0.02, le=10)] = 0.5


@dataclass(frozen=True, slots=True)
class Run:
    """Elevator on the grid of SAMPLE_INTERVAL_S.

    speed_rad_s: sprocket, as the speed frame states it. chain_m: chain travel since the start. flow: the harvest's.
    """

    speed_rad_s: Array
    chain_m: Array


@dataclass(frozen=True, slots=True)
class Paddles:
    """Paddles in order: time_s when each points up, mass_kg on it, and the paddle speed as a sprocket speed (slip taken off).

    delivered_until_s: the time up to which each paddle's mass counts as having flowed past the plate; the first entry of
    `delivered_until_s` belongs to the first paddle, mass flows evenly between entries.
    """

    time_s: Array
    mass_kg: Array
    speed_rad_s: Array
    delivered_until_s: Array


def run(settings: ElevatorSettings, machine: Machine, harvest: Harvest, slip_share: float, rng: np.random.Generator) -> Run:
    """Speed and chain travel for a harvest."""
    nominal = settings.speed_rpm * RPM
    target = nominal * (1.0 - settings.droop_pct_at_25_kg_s / 100.0 * harvest.flow_kg_s / 25.0) * harvest.driven
    keep = np.exp(-SAMPLE_INTERVAL_S / settings.lag_s)
    speed = np.asarray(scipy.signal.lfilter([1.0 - keep], [1.0, -keep], target, zi=[keep * target[0]])[0])
    noise = correlated_noise(len(speed), settings.noise_time_s / SAMPLE_INTERVAL_S, rng)
    speed = speed * (1.0 + settings.noise_pct / 100.0 * noise)
    speed = np.where(speed < 1.0 * RPM, 0.0, speed)
    chain_speed = (1.0 - slip_share) * machine.sprocket_pitch_radius_m * speed
    travel = np.concatenate([[0.0], np.cumsum(0.5 * (chain_speed[1:] + chain_speed[:-1]))]) * SAMPLE_INTERVAL_S
    return Run(speed, travel)


def paddles(
    elevator: Run,
    harvest: Harvest,
    machine: Machine,
    *,
    slip_share: float,
    lag_s: float,
    first_gap: float,
    full_paddle_kg: float,
) -> Paddles:
    """Paddles that pass the top, each with the grain that flowed while its own gap of chain went by.

    lag_s: mean time from a paddle's pointing up to its grain's reaching the plate; loads are taken from the flow that is due
    there then. first_gap: phase of the chain at time 0, in pattern lengths (0-1). What a paddle cannot hold (full_paddle_kg)
    waits for the next ones.
    """
    grid = np.arange(len(harvest.flow_kg_s)) * SAMPLE_INTERVAL_S
    gaps = np.asarray(machine.paddle_spacings_m)
    count = int(elevator.chain_m[-1] / machine.pattern_length_m + 3) * len(gaps)
    places = np.cumsum(np.resize(gaps, count)) - (1.0 + first_gap) * machine.pattern_length_m
    within = (places > 0.0) & (places < elevator.chain_m[-1])
    moving = np.concatenate([[True], np.diff(elevator.chain_m) > 0.0])
    time = np.interp(places[within], elevator.chain_m[moving], grid[moving])
    mean_gap_s = machine.paddle_spacing_m / max(float(elevator.speed_rad_s.max()) * machine.sprocket_pitch_radius_m, 1e-9)
    until = time + lag_s + 0.5 * mean_gap_s
    flowed = np.concatenate([[0.0], np.cumsum(0.5 * (harvest.flow_kg_s[1:] + harvest.flow_kg_s[:-1]))]) * SAMPLE_INTERVAL_S
    mass = np.diff(np.interp(until, grid, flowed), prepend=0.0)
    speed = np.interp(time, grid, elevator.speed_rad_s) * (1.0 - slip_share)
    return Paddles(time, _carry_over(mass, full_paddle_kg), speed, until)


def _carry_over(mass: Array, full_kg: float) -> Array:
    if mass.size == 0 or mass.max() <= full_kg:
        return mass
    held = np.empty_like(mass)
    waiting = 0.0
    for i, load in enumerate(mass):
        held[i] = min(load + waiting, full_kg)
        waiting += load - held[i]
    return held
