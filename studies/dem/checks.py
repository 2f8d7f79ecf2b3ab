"""Checks of the engine run itself, against what mechanics demands of any such run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from studies.dem import clump, records, runner
from studies.dem.job import RPM, Contact, Throw, kernel_defaults, merged, throw_from_dict

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One check: passed when value is at most limit. `what` says what the value is."""

    name: str
    value: float
    limit: float
    what: str

    @property
    def passed(self) -> bool:
        return bool(self.value <= self.limit)


LIGHT = Throw(paddle_mass_kg=0.06, settle_revolutions=0.4, seed=11)
"""A load of 148 grains: a second or two of work."""
HANDFUL = replace(LIGHT, paddle_mass_kg=0.02)
LIGHT_CLUMPS = throw_from_dict(merged(kernel_defaults("clump"), {"paddle_mass_kg": 0.03, "settle_revolutions": 0.25, "seed": 11}))
"""75 clumps, 300 spheres."""
HOME_RAD = 70.0 * pi / 180.0


def throw_files(throw: Throw, plate_angle_rad: float, folder: Path, audit: bool = False) -> tuple[runner.Arrays, runner.Arrays]:
    """Release and plate arrays of one throw at one angle."""
    runner.run_throw(throw, [plate_angle_rad], folder, folder / "heaps", audit=audit)
    return runner.load(folder / "release.npz"), runner.load(runner.plate_file(folder, plate_angle_rad))


@cache
def audited_throw(throw: Throw) -> tuple[runner.Arrays, runner.Arrays]:
    """A throw at the home angle, with the forces of all walls."""
    with TemporaryDirectory() as folder:
        return throw_files(throw, HOME_RAD, Path(folder), audit=True)


def bounces(restitution: float, time_step_s: float, speed_m_s: float = 6.0, count: int = 40) -> runner.Arrays:
    """Single frictionless grains, far apart, against an upright plate, each at its own phase of the time step."""
    throw = Throw(
        paddle_mass_kg=1.0, time_step_s=time_step_s, gravity_m_s2=0.0, contact=Contact(friction=0.0, restitution=restitution)
    )
    return against_plate(throw, speed_m_s, count)


def against_plate(throw: Throw, speed_m_s: float, count: int, orientation: Array | None = None) -> runner.Arrays:
    """Grains of the mean size on a grid, far apart, against an upright plate, each at its own phase of the time step."""
    m = throw.machine
    rows, columns = np.divmod(np.arange(count), 5)
    phase = np.arange(count) / count * speed_m_s * throw.time_step_s
    position = np.column_stack(
        [
            m.plate_pivot_x_m - throw.grain.reach_m - 0.005 - phase,
            m.plate_pivot_y_m + 0.02 + rows * (m.plate_length_m - 0.04) / (count / 5),
            -0.1 + 0.05 * columns,
        ]
    )
    velocity = np.tile([speed_m_s, 0.0, 0.0], (count, 1))
    return runner.run_stream(throw, 0.5 * pi, position, velocity, orientation)


def clump_bounces(orientation: Array, time_step_s: float, friction: float = 0.0, speed_m_s: float = 6.0) -> runner.Arrays:
    """Single clumps, turned as orientation (n, 3, 3) says and not turning, against an upright plate without gravity."""
    throw = replace(
        LIGHT_CLUMPS, time_step_s=time_step_s, gravity_m_s2=0.0, contact=replace(LIGHT_CLUMPS.contact, friction=friction)
    )
    return against_plate(throw, speed_m_s, len(orientation), orientation)


def sphere_first(count: int) -> Array:
    """Orientations (count, 3, 3) in which one sphere, each in its turn, is straight between the centre of mass and the plate."""
    normal = np.array([0.0, 0.0, 1.0])
    lines = [c / np.linalg.norm(c) for c in clump.published_clump().centre_m]
    return np.array([np.array([u, np.cross(normal, u), normal]) for u in (lines[i % len(lines)] for i in range(count))])


def at_random(count: int, seed: int = 5) -> Array:
    """Orientations (count, 3, 3) at random."""
    return clump.random_orientations(count, np.random.default_rng(seed))


def grains_conserved(light: Throw = LIGHT) -> CheckResult:
    """No grain is lost between the settled heap and the plate's end, other than through the box's limits."""
    release, plate = audited_throw(light)
    counted = np.isfinite(plate["end_velocity_m_s"][:, 0]).sum()
    unreleased = np.isnan(release["let_go_s"]).sum() - np.isnan(plate["let_go_s"]).sum()
    lost_inside = (~plate["present"] & np.isnan(plate["free_s"])).sum()
    value = abs(light.grain_count - counted) + lost_inside + (unreleased < 0)
    return CheckResult("grains_conserved", float(value), 0.0, "grains missing from the count or lost before they came free")


def momentum_balance(light: Throw = LIGHT) -> CheckResult:
    """Horizontal momentum of grains, plate, paddle and housing together stays as it was."""
    _, plate = audited_throw(light)
    dt = float(plate["time_step_s"])
    gained = plate["mass_kg"] @ (plate["end_velocity_m_s"] - plate["start_velocity_m_s"])[:, 0]
    struck = float(records.impulse_n_s(plate["total_force_n"], dt)[0])
    pushed = float(records.impulse_n_s(plate["other_wall_force_n"], dt)[0])
    value = abs(gained + struck - pushed) / struck
    return CheckResult("momentum_balance", float(value), 0.005, "unexplained change of momentum over the plate's impulse")


def bounce_fine_step() -> CheckResult:
    """Each single bounce gives e, at a time step fine enough for the contact itself."""
    e = 0.75
    grains = bounces(e, 2.0e-6)
    value = np.abs(-grains["end_velocity_m_s"][:, 0] / grains["start_velocity_m_s"][:, 0] - e).max()
    return CheckResult("bounce_fine_step", float(value), 0.002, "largest error of e over 40 bounces at 2e-6 s")


def bounce_working_step() -> CheckResult:
    """The mean bounce gives e at the working time step."""
    e = 0.75
    grains = bounces(e, LIGHT.time_step_s)
    value = abs(float(np.mean(-grains["end_velocity_m_s"][:, 0] / grains["start_velocity_m_s"][:, 0])) - e)
    return CheckResult("bounce_working_step", value, 0.002, "error of the mean e over 40 bounces at the working step")


def _gain_of_touch(throw: Throw, seeds: int) -> float:
    """Impulse on an upright plate over the normal momentum with which grain touches it, of `seeds` throws together."""
    angle = 0.5 * pi
    frame = records.PlateFrame.of(throw.machine, angle)
    arrived = struck = 0.0
    for seed in range(seeds):
        with TemporaryDirectory() as folder:
            _, plate = throw_files(replace(throw, seed=seed), angle, Path(folder))
        touched = np.isfinite(plate["touch_s"])
        arrived += float(plate["mass_kg"][touched] @ (plate["touch_velocity_m_s"][touched, :2] @ frame.inward))
        struck += float(records.impulse_n_s(plate["normal_force_n"], float(plate["time_step_s"])) @ frame.inward)
    return struck / arrived


def thin_stream() -> CheckResult:
    """Twelve kernels, thrown, give (1 + e) times the normal momentum with which they arrive."""
    throw = replace(LIGHT, paddle_mass_kg=12 * LIGHT.grain.mass_kg, settle_revolutions=0.25)
    value = abs(_gain_of_touch(throw, 3) / (1.0 + throw.contact.restitution) - 1.0)
    return CheckResult("thin_stream", value, 0.03, "error of impulse / ((1 + e) arriving momentum), 3 throws of 12 kernels")


def half_time_step(light: Throw = LIGHT, seeds: int = 4) -> CheckResult:
    """Halving the time step moves the impulse, mean of the seeds, by less than 2 %."""
    angle = HOME_RAD
    impulse = {}
    for step in (light.time_step_s, 0.5 * light.time_step_s):
        total = 0.0
        for seed in range(seeds):
            with TemporaryDirectory() as folder:
                _, plate = throw_files(replace(light, time_step_s=step, seed=seed), angle, Path(folder))
            total += float(records.impulse_n_s(plate["normal_force_n"], step)[0])
        impulse[step] = total
    whole, half = impulse.values()
    return CheckResult("half_time_step", abs(whole / half - 1.0), 0.02, f"change of the normal impulse, mean of {seeds} seeds")


def repeatable(throw: Throw = HANDFUL) -> CheckResult:
    """The same job gives the same bits, whether its heap is fresh or from the cache."""
    angle = HOME_RAD
    with TemporaryDirectory() as folder:
        first = throw_files(throw, angle, Path(folder))[1]
        cached = throw_files(throw, angle, Path(folder))[1]
    with TemporaryDirectory() as folder:
        fresh = throw_files(throw, angle, Path(folder))[1]
    different = sum(first[name].tobytes() != again[name].tobytes() for again in (cached, fresh) for name in first)
    return CheckResult("repeatable", float(different), 0.0, "arrays that differ in any bit between three runs of one seed")


def _restitution(grains: runner.Arrays) -> Array:
    """Leaving over arriving speed across the upright plate, (n,)."""
    ratio: Array = -grains["end_velocity_m_s"][:, 0] / grains["start_velocity_m_s"][:, 0]
    return ratio


def clump_bounce_central() -> CheckResult:
    """A clump that strikes with one sphere straight before its centre of mass bounces as a sphere does."""
    value = np.abs(_restitution(clump_bounces(sphere_first(20), 2.0e-6)) - LIGHT_CLUMPS.contact.restitution).max()
    return CheckResult("clump_bounce_central", float(value), 0.002, "largest error of e over 20 central bounces at 2e-6 s")


def clump_bounce_energy() -> CheckResult:
    """No bounce adds energy, turning included, with friction or without, at the working step."""
    shape = clump.clump_of_volume(LIGHT_CLUMPS.grain.volume_m3)
    gained = -np.inf
    for friction in (0.0, LIGHT_CLUMPS.contact.friction):
        grains = clump_bounces(at_random(40), LIGHT_CLUMPS.time_step_s, friction)
        states = ((grains[f"{when}_sphere_position_m"], grains[f"{when}_sphere_velocity_m_s"]) for when in ("start", "end"))
        before, after = (clump.kinetic_energy_j(shape, grains["mass_kg"], np.ones(40), *state) for state in states)
        gained = max(gained, float((after / before).max() - 1.0))
    return CheckResult("clump_bounce_energy", gained, 0.0, "largest gain of kinetic energy over 80 bounces, share")


def clump_bounce_impulse() -> CheckResult:
    """What the plate gets from each single bounce is what the clump's momentum loses, however many spheres touch."""
    grains = clump_bounces(at_random(10), LIGHT_CLUMPS.time_step_s, LIGHT_CLUMPS.contact.friction)
    lost = grains["mass_kg"] * (grains["start_velocity_m_s"] - grains["end_velocity_m_s"])[:, 0]
    value = np.abs(grains["grain_impulse_n_s"][:, 1] / lost - 1.0).max()
    return CheckResult("clump_bounce_impulse", float(value), 1e-9, "largest error of a bounce's impulse, share of it")


def clump_thin_stream() -> CheckResult:
    """Twelve clumps, thrown, give the normal momentum with which they arrive times what single bounces at random give."""
    throw = replace(LIGHT_CLUMPS, paddle_mass_kg=12 * LIGHT_CLUMPS.grain.mass_kg)
    gain = 1.0 + float(_restitution(clump_bounces(at_random(80), throw.time_step_s, throw.contact.friction)).mean())
    value = abs(_gain_of_touch(throw, 4) / gain - 1.0)
    return CheckResult("clump_thin_stream", value, 0.05, "error of impulse / (arriving momentum * gain of single bounces)")


def clump_does_not_roll() -> CheckResult:
    """Pushed along a level plate at rolling friction 0.01, a clump comes to rest where a sphere rolls on."""
    speeds = {}
    for light in (LIGHT, LIGHT_CLUMPS):
        throw = replace(
            light,
            gravity_m_s2=-light.gravity_m_s2,
            elevator_speed_rad_s=0.16 * 400.0 * RPM / 0.15,
            contact=replace(light.contact, rolling_friction=0.01),
        )
        m = throw.machine
        under = throw.grain.radius_m if throw.grain.clump is None else float(throw.grain.clump.radius_m.max())
        position = np.array([[m.plate_pivot_x_m + 0.03, m.plate_pivot_y_m + under + 1e-5, 0.0]])
        # The clump lies flat, its short axis upright.
        flat = np.array([[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]])
        grains = runner.run_stream(throw, 0.0, position, np.array([[0.15, 0.0, 0.0]]), flat if throw.grain.clump else None)
        speeds[throw.grain.kernel] = float(np.linalg.norm(grains["end_velocity_m_s"][0]))
    return CheckResult("clump_does_not_roll", speeds["clump"] / speeds["sphere"], 0.01, "speed of clump / sphere after 0.15 s")


CHECKS: tuple[Callable[[], CheckResult], ...] = (
    grains_conserved,
    momentum_balance,
    bounce_fine_step,
    bounce_working_step,
    thin_stream,
    half_time_step,
    repeatable,
)


def _of_clumps(check: Callable[..., CheckResult], light: Throw) -> Callable[[], CheckResult]:
    def named() -> CheckResult:
        return replace(check(light), name=named.__name__)

    named.__name__ = f"clump_{check.__name__}"
    named.__doc__ = check.__doc__
    return named


CLUMP_CHECKS: tuple[Callable[[], CheckResult], ...] = (
    _of_clumps(grains_conserved, LIGHT_CLUMPS),
    _of_clumps(momentum_balance, LIGHT_CLUMPS),
    clump_bounce_central,
    clump_bounce_energy,
    clump_bounce_impulse,
    clump_thin_stream,
    clump_does_not_roll,
    _of_clumps(half_time_step, replace(LIGHT_CLUMPS, paddle_mass_kg=0.06)),
    _of_clumps(repeatable, replace(LIGHT_CLUMPS, paddle_mass_kg=0.01)),
)
CHECKS_OF = {"sphere": CHECKS, "clump": CLUMP_CHECKS}
