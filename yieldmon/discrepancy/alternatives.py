"""Alternative explanations of rows that suggest an effect: other laws of the same causes, errors at one plate angle, and a law
without a cause.

The first two are errors of the model with wider priors than `Fit.shape_error`, which is for laws that are approximately correct.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from yieldmon.estimation import model_error
from yieldmon.estimation.clusters import cluster
from yieldmon.physics.effects import laws, registry
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .fit import Fit, fit

ANOTHER_LAW_SD = 0.5
"""Relative standard deviation of an effect's law if it may be a different law: from no effect to twice as much."""
TILTED = 1
"""Degree, in angle, load and speed, of the factor by which another law differs."""
FREE_SHAPE = 2
"""The same for a law that may also differ in curvature."""
_VARIED = 1e-3
"""Relative range above which load, speed or angle has a power."""
_ITERATIONS, _LARGEST_LOG = 20, 50.0
VERY_STRONG = 10.0
"""Very strong evidence, as twice its logarithm (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995)."""


@dataclass(frozen=True, slots=True)
class Needed:
    """How much one of several effects is needed if the laws of the others may be different laws.

    Attributes
    ----------
    effect : str
    evidence : float
        Twice the log evidence for it, against the others with tilted laws.
    gain : float
        Decrease of chi-square by it if the laws of the others have a free shape.
    """

    effect: str
    evidence: float
    gain: float


@dataclass(frozen=True, slots=True)
class OneAngle:
    """The plate angle whose rows, with error terms of their own, leave the best fit of the others; merit: its -2 log evidence."""

    plate_angle_rad: float
    merit: float


def needed(found: Fit, scale: float, per_parameter: float) -> list[Needed]:
    """How much each of several effects is needed, given the others; empty for fewer than two.

    scale: unit of differences in chi-square. per_parameter: what each parameter costs.
    """
    out = []
    for effect in found.effects if len(found.effects) > 1 else ():
        without = fit(found.frame, tuple(e for e in found.effects if e != effect), found.values)
        if without is None:
            continue
        chi2, volume = without.marginal(of_other_laws(without, TILTED))
        better = (chi2 - found.integrated[0]) / scale + volume - found.integrated[1]
        cost = per_parameter * (len(found.parameters) - len(without.parameters))
        free = of_other_laws(without, FREE_SHAPE)
        gain = (without.marginal(free)[0] - found.marginal(free)[0]) / scale
        out.append(Needed(effect, better - cost, gain))
    return out


def chosen_from_all(per_parameter: float) -> float:
    """Gain in chi-square that is very strong evidence for the best of all laws in the library."""
    return VERY_STRONG + per_parameter + 2.0 * float(np.log(sum(len(laws(e)) for e in registry())))


def one_angle_off(base: Fit, scale: float, per_parameter: float) -> OneAngle | None:
    """The best explanation by an error at one plate angle, in addition to the model `base`.

    The error is a constant, a share of the reading, both, or a share that depends on load and elevator speed. None if there is
    one angle only, since the cause cannot be determined then.
    """
    number = cluster(base.frame.cells.plate_angle_rad, SAME_ANGLE_RAD)
    cells, found = base.frame.cells, list[OneAngle]()
    for angle in range(int(number.max()) + 1 if number.max() > 0 else 0):
        inside = number == angle
        at = float(np.mean(cells.plate_angle_rad[inside]))
        constant, share = inside / base.frame.sd, inside * base.level
        varying = [share * (v - v.mean()) for v in (cells.load, cells.elevator_speed_rad_s)]
        for columns in ([constant], [share], [constant, share], [constant, share, *varying]):
            found.append(OneAngle(at, base.beside(np.column_stack(columns), scale, per_parameter)))
    return min(found, key=lambda one: one.merit, default=None)


def by_powers(base: Fit, scale: float, per_parameter: float) -> float | None:
    """-2 log evidence of readings in proportion to powers of load, elevator speed and sin(plate angle), without any cause;
    each power may change with the logarithms of the others.

    The fit is that of a generalised linear model with a logarithmic link (Nelder and Wedderburn, J. R. Stat. Soc. A 135, 1972).
    None if a logarithm does not exist.
    """
    cells, sd = base.frame.cells, base.frame.sd
    axes = np.stack((cells.load, cells.elevator_speed_rad_s, np.sin(cells.plate_angle_rad)))
    if np.any(axes <= 0.0):
        return None
    varied = np.log(axes[np.ptp(axes, axis=1) > _VARIED * np.max(axes, axis=1)])
    centred = [axis - axis.mean() for axis in varied]
    products = [a * b for a, b in combinations(centred, 2)]
    each = [centred, [*centred, *products]] if products else [centred]
    return min(_by_columns(base, np.column_stack((np.ones(len(sd)), *columns)), scale, per_parameter) for columns in each)


def _by_columns(base: Fit, columns: Array, scale: float, per_parameter: float) -> float:
    """-2 log evidence of readings whose logarithms are a sum of columns (cells, n)."""
    cells, sd = base.frame.cells, base.frame.sd
    predicted = model_error.level(cells.mean)
    for _ in range(_ITERATIONS):
        weight = predicted / sd
        power = np.linalg.lstsq(
            columns * weight[:, None], (np.log(predicted) + cells.mean / predicted - 1.0) * weight, rcond=None
        )[0]
        predicted = np.exp(np.clip(columns @ power, -_LARGEST_LOG, _LARGEST_LOG))
    tangent = model_error.orthonormal(columns * (predicted / sd)[:, None])
    left = (predicted - cells.mean) / sd
    own = base.frame.model_error * base.free * (model_error.level(predicted) / sd)[:, None]
    error = model_error.off(own, tangent)
    small = np.eye(error.shape[1]) + error.T @ error
    along = error.T @ left
    chi2 = float(left @ left - along @ np.linalg.solve(small, along))
    return chi2 / scale + float(np.linalg.slogdet(small)[1]) + per_parameter * float(columns.shape[1])


def of_other_laws(found: Fit, degree: int) -> Array:
    """Whitened columns of the model error and of the laws' errors, including different laws, (cells, columns)."""
    cells = found.frame.cells
    smooth = model_error.basis(cells.plate_angle_rad, cells.load, cells.elevator_speed_rad_s, most=degree)
    return np.concatenate((found.own_error, *(ANOTHER_LAW_SD * smooth * change[:, None] for change in found.changes)), axis=1)
