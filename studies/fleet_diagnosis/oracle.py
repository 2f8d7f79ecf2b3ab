"""What could be seen of a machine's own effect, and distinguished from others, by one who knows the virtual combine's laws.

    python -m studies.fleet_diagnosis.oracle [SHARED ...]

For each pair of a shared effect and an own one: the signature that the combine's own physics gives at one machine's visits, and
its squared length in standard deviations, the mean gain in chi-square of a likelihood-ratio test between that law's shape and
none: (1) with the other machines' mean and the machine's grain known exactly; (2) with the mean as eleven machines show it; (3)
with grain of the machine's own as well, with the scatter that alike machines show. In brackets: machines of 100 whose gain
passes the limit of one false name in 500 fleets, for that one shape. Needed: sweeps for 80 of 100 in (3). Nearest: of the other
own effects, all sizes, by the squared distance that is left in (3); below 6 even the oracle has the two tied.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from studies.fleet_diagnosis.__main__ import (
    DAYS,
    HOME_KG_S,
    MACHINES,
    OWN,
    SHARED,
    SWEEPS_A_DAY,
    Array,
    Force,
    calibrated,
    day_of,
    shown,
)
from yieldmon.discrepancy.detectability import POWER_80
from yieldmon.discrepancy.policy import DEFAULT
from yieldmon.estimation.self_calibration.home_flow import AwayVisits
from yieldmon.files import parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import real
from yieldmon.service.logs.sweep_table import away_of_seconds

SEED = 3
GRAIN_SD = (0.003, 10.0)
"""Friction, and density in kg/m3: between machines, as the estimator learns it from nine alike ones (0.015 and 0.02 steps)."""
SIZES = (0.1, 0.3, 0.6, 1.0, 1.3)
"""Of a rival, over that which is hidden."""
_GRID_KG_S = np.geomspace(2.5, 24.0, 100)


@dataclass(frozen=True)
class Visits:
    """Of one machine: angle, speed and flow, (visits,), and the inverse Cholesky factor of each sweep's covariance."""

    angle_rad: Array
    speed_rad_s: Array
    flow_kg_s: Array
    factors: tuple[Array, ...]

    def whitened(self, values: Array) -> Array:
        """Of visits, (visits,) or (visits, columns)."""
        out, at = [], 0
        for factor in self.factors:
            out.append(factor @ values[at : at + len(factor)])
            at += len(factor)
        return np.concatenate(out)


def visits_of(sweeps: Sequence[AwayVisits], power: float) -> Visits:
    """power: of force by flow."""
    names = "plate_angle_rad", "elevator_speed_rad_s", "mass_flow_kg_s"
    angle, speed, flow = (np.concatenate([getattr(s, name) for s in sweeps]) for name in names)
    covariances = (np.diag(s.force_variance) + power**2 * s.flow_covariance for s in sweeps)
    return Visits(angle, speed, flow, tuple(np.linalg.inv(np.linalg.cholesky(c)) for c in covariances))


def signature(machine: Machine, own: Force, common: Force, visits: Visits) -> Array:
    """ln of the machine's force over that of the others at equal force at home, gains brought to one at HOME_KG_S."""
    at = np.array([machine.home_plate_angle_rad]), np.array([machine.nominal_elevator_speed_rad_s])
    gain = float(common(np.array([HOME_KG_S]), *at)[0] / own(np.array([HOME_KG_S]), *at)[0])
    out = np.zeros(visits.flow_kg_s.size)
    flow = np.clip(visits.flow_kg_s, 3.5, 21.0)
    for speed in np.unique(np.round(visits.speed_rad_s, 6)):
        here = np.abs(visits.speed_rad_s - speed) < 1e-4
        home = np.full(_GRID_KG_S.size, machine.home_plate_angle_rad), np.full(_GRID_KG_S.size, speed)
        level, others = (np.log(f(_GRID_KG_S, *home)) for f in (lambda *x: gain * own(*x), common))
        like = np.exp(np.interp(np.interp(np.log(flow[here]), np.log(_GRID_KG_S), level), others, np.log(_GRID_KG_S)))
        place = visits.angle_rad[here], visits.speed_rad_s[here]
        out[here] = np.log(gain * own(flow[here], *place)) - np.log(common(like, *place))
    return out


def grain_columns(machine: Machine, visits: Visits) -> Array:
    """What one standard deviation of friction and of density changes at equal force at home, (visits, 2)."""
    shipped = parameter_file.load()
    model = ForwardModel(machine, shipped.effects)

    def log_force(values: dict[str, float], angle_rad: Array | float) -> Array:
        where = Conditions(angle_rad, visits.speed_rad_s, mass_flow_kg_s=visits.flow_kg_s)
        return np.log(real(np.asarray(model.force(where, values))))

    def ratio(values: dict[str, float]) -> Array:
        return log_force(values, visits.angle_rad) - log_force(values, machine.home_plate_angle_rad)

    columns = []
    for name, sd in zip(("friction", "density"), GRAIN_SD, strict=True):
        moved = {**shipped.values, name: shipped.values[name] + sd}
        columns.append(ratio(moved) - ratio(dict(shipped.values)))
    return np.stack(columns, axis=-1)


def mean_columns(visits: Visits) -> Array:
    """The other machines' mean, each angle by itself with a slope in flow and one in speed, (visits, columns); one sd of each."""
    slopes = (visits.flow_kg_s / HOME_KG_S, visits.speed_rad_s / visits.speed_rad_s.mean())
    parts = []
    for angle in np.unique(np.round(visits.angle_rad, 3)):
        here = np.abs(visits.angle_rad - angle) < 2e-3
        parts += [here * shape for shape in (np.ones(here.size), *map(np.log, slopes))]
    columns = np.stack(parts, axis=-1)
    white = visits.whitened(columns)
    return np.asarray(columns @ np.linalg.cholesky(np.linalg.inv((MACHINES - 1) * white.T @ white)))


def beside(white: Array, columns: Array) -> Array:
    """Gram matrix of whitened shapes (visits, n) beside columns with unit weights."""
    inside = columns.T @ white
    return np.asarray(white.T @ white - inside.T @ np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, inside))


def report(shared: str, machine: Machine) -> None:
    """Print the rows of one shared effect."""
    common = shown(machine, {shared: SHARED[shared]})
    rng = np.random.default_rng([SEED, list(SHARED).index(shared)])
    days = [day_of(machine, common, rng) for _ in range(DAYS)]
    parameters = calibrated(machine, parameter_file.load(), common)
    visits = visits_of(away_of_seconds(days, machine, parameters), 0.9)
    mean, grain = (visits.whitened(columns) for columns in (mean_columns(visits), grain_columns(machine, visits)))
    known = (mean[:, :0], mean, np.concatenate((mean, grain), axis=1))
    names = [name for name in OWN if name != shared]

    def white(name: str, times: float) -> Array:
        sizes = {key: times * value for key, value in OWN[name].items()}
        return visits.whitened(signature(machine, shown(machine, {shared: SHARED[shared], name: sizes}), common, visits))

    every = {name: np.stack([white(name, times) for times in SIZES], axis=-1) for name in names}
    limit = float(np.sqrt(stats.chi2.isf(DEFAULT.next_p / MACHINES, 1)))
    for name in names:
        one = every[name][:, SIZES.index(1.0)]
        gains = [float(beside(one[:, None], columns)[0, 0]) for columns in known]
        power = [float(stats.norm.sf(limit - np.sqrt(gain))) for gain in gains]
        sweeps = np.ceil(DAYS * SWEEPS_A_DAY * (limit + POWER_80) ** 2 / gains[-1])
        rivals = {}
        for other in names:
            if other != name:
                gram = beside(np.concatenate((one[:, None], every[other]), axis=1), known[-1])
                shares = np.clip(gram[0, 1:] / np.diag(gram)[1:], 0.0, 1.3)
                rivals[other] = float(np.min(gram[0, 0] - 2.0 * shares * gram[0, 1:] + shares**2 * np.diag(gram)[1:]))
        nearest = min(rivals, key=lambda other: rivals[other])
        seen = " | ".join(f"{gain:.0f} ({100.0 * p:.0f})" for gain, p in zip(gains, power, strict=True))
        print(f"| {shared} | {name} | {seen} | {sweeps:.0f} | {nearest} {rivals[nearest]:.1f} |", flush=True)


def main() -> int:
    """Exit code 0."""
    print("| shared | own | all known | others' mean | grain too | needed | nearest |\n|---|---|---|---|---|---|---|")
    for shared in sys.argv[1:] or list(SHARED):
        report(shared, Machine())
    return 0


if __name__ == "__main__":
    sys.exit(main())
