"""Checks of the engine run itself, against what mechanics demands of any such run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from yieldmon.plant.dem import records, runner
from yieldmon.plant.dem.job import Contact, Throw


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
HOME_RAD = 70.0 * pi / 180.0


def throw_files(throw: Throw, plate_angle_rad: float, folder: Path, audit: bool = False) -> tuple[runner.Arrays, runner.Arrays]:
    """Release and plate arrays of one throw at one angle."""
    runner.run_throw(throw, [plate_angle_rad], folder, folder / "heaps", audit=audit)
    return runner.load(folder / "release.npz"), runner.load(runner.plate_file(folder, plate_angle_rad))


@cache
def audited_light_throw() -> tuple[runner.Arrays, runner.Arrays]:
    """LIGHT at the home angle, with the forces of all walls."""
    with TemporaryDirectory() as folder:
        return throw_files(LIGHT, HOME_RAD, Path(folder), audit=True)


def bounces(restitution: float, time_step_s: float, speed_m_s: float = 6.0, count: int = 40) -> runner.Arrays:
    """Single frictionless grains, far apart, against an upright plate, each at its own phase of the time step."""
    throw = Throw(
        paddle_mass_kg=1.0, time_step_s=time_step_s, gravity_m_s2=0.0, contact=Contact(friction=0.0, restitution=restitution)
    )
    m = throw.machine
    rows, columns = np.divmod(np.arange(count), 5)
    phase = np.arange(count) / count * speed_m_s * time_step_s
    position = np.column_stack([
        m.plate_pivot_x_m - throw.grain.radius_m - 0.005 - phase,
        m.plate_pivot_y_m + 0.02 + rows * (m.plate_length_m - 0.04) / (count / 5),
        -0.1 + 0.05 * columns,
    ])
    velocity = np.tile([speed_m_s, 0.0, 0.0], (count, 1))
    return runner.run_stream(throw, 0.5 * pi, position, velocity)


def grains_conserved() -> CheckResult:
    """No grain is lost between the settled heap and the plate's end, other than through the box's limits."""
    release, plate = audited_light_throw()
    counted = np.isfinite(plate["end_velocity_m_s"][:, 0]).sum()
    unreleased = np.isnan(release["let_go_s"]).sum() - np.isnan(plate["let_go_s"]).sum()
    lost_inside = (~plate["present"] & np.isnan(plate["free_s"])).sum()
    value = abs(LIGHT.grain_count - counted) + lost_inside + (unreleased < 0)
    return CheckResult("grains_conserved", float(value), 0.0, "grains missing from the count or lost before they came free")


def momentum_balance() -> CheckResult:
    """Horizontal momentum of grains, plate, paddle and housing together stays as it was."""
    _, plate = audited_light_throw()
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


def thin_stream() -> CheckResult:
    """Twelve kernels, thrown, give (1 + e) times the normal momentum with which they arrive."""
    throw = replace(LIGHT, paddle_mass_kg=12 * LIGHT.grain.mass_kg, settle_revolutions=0.25)
    angle = 0.5 * pi
    frame = records.PlateFrame.of(throw.machine, angle)
    arrived = struck = 0.0
    for seed in range(3):
        with TemporaryDirectory() as folder:
            _, plate = throw_files(replace(throw, seed=seed), angle, Path(folder))
        touched = np.isfinite(plate["touch_s"])
        arrived += float(plate["mass_kg"][touched] @ (plate["touch_velocity_m_s"][touched, :2] @ frame.inward))
        struck += float(records.impulse_n_s(plate["normal_force_n"], float(plate["time_step_s"])) @ frame.inward)
    value = abs(struck / arrived / (1.0 + throw.contact.restitution) - 1.0)
    return CheckResult("thin_stream", value, 0.03, "error of impulse / ((1 + e) arriving momentum), 3 throws of 12 kernels")


def half_time_step() -> CheckResult:
    """Halving the time step moves the impulse, mean of four seeds, by less than 2 %."""
    angle = HOME_RAD
    impulse = {}
    for step in (LIGHT.time_step_s, 0.5 * LIGHT.time_step_s):
        total = 0.0
        for seed in range(4):
            with TemporaryDirectory() as folder:
                _, plate = throw_files(replace(LIGHT, time_step_s=step, seed=seed), angle, Path(folder))
            total += float(records.impulse_n_s(plate["normal_force_n"], step)[0])
        impulse[step] = total
    whole, half = impulse.values()
    return CheckResult("half_time_step", abs(whole / half - 1.0), 0.02, "change of the normal impulse, mean of 4 seeds")


def repeatable() -> CheckResult:
    """The same job gives the same bits, whether its heap is fresh or from the cache."""
    angle = HOME_RAD
    throw = replace(LIGHT, paddle_mass_kg=0.02)
    with TemporaryDirectory() as folder:
        first = throw_files(throw, angle, Path(folder))[1]
        cached = throw_files(throw, angle, Path(folder))[1]
    with TemporaryDirectory() as folder:
        fresh = throw_files(throw, angle, Path(folder))[1]
    different = sum(
        first[name].tobytes() != again[name].tobytes() for again in (cached, fresh) for name in first
    )
    return CheckResult("repeatable", float(different), 0.0, "arrays that differ in any bit between three runs of one seed")


CHECKS: tuple[Callable[[], CheckResult], ...] = (
    grains_conserved, momentum_balance, bounce_fine_step, bounce_working_step, thin_stream, half_time_step, repeatable,
)
