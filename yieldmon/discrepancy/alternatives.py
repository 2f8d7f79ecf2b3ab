"""What else could make rows look as if named effects were at work: other laws of the same causes, and one plate angle off.

Both are errors of the model with wider priors than `Fit.shape_error`, which is for laws that are right in the main.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yieldmon.estimation import model_error
from yieldmon.estimation.clusters import cluster
from yieldmon.physics.effects import laws, registry
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .fit import Fit, fit

ANOTHER_LAW_SD = 0.5
"""Relative standard deviation of an effect's law where it may be another law altogether: anything from none of it to twice."""
TILTED = 1
"""Degree, in angle, load and speed, of the factor by which another law differs in the main."""
FREE_SHAPE = 2
"""The same of one that may bend as well."""
VERY_STRONG = 10.0
"""Twice the log evidence that is very strong (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995)."""


@dataclass(frozen=True, slots=True)
class Needed:
    """How far several effects need one of them, `effect`, where the laws of the others may be other laws altogether.

    evidence: twice the log evidence for it, against others with tilted laws. gain: chi-square that it still gains where theirs
    have a free shape.
    """

    effect: str
    evidence: float
    gain: float


@dataclass(frozen=True, slots=True)
class OneAngle:
    """The plate angle whose rows, off by terms of their own, explain the others best; merit: -2 log evidence of that."""

    plate_angle_rad: float
    merit: float


def needed(found: Fit, scale: float, per_parameter: float) -> list[Needed]:
    """Each of several effects beside the others; empty for fewer than two.

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
    """Gain in chi-square that is very strong evidence for an effect that was chosen as the best of the library's laws."""
    return VERY_STRONG + per_parameter + 2.0 * float(np.log(sum(len(laws(e)) for e in registry())))


def one_angle_off(base: Fit, scale: float, per_parameter: float) -> OneAngle | None:
    """The rows of one plate angle off by themselves, beside the model `base`.

    By a constant, by a share of the reading, by both, or by a share that changes with load and elevator speed as well.
    None where there is one angle only: what is off there could be anything.
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


def of_other_laws(found: Fit, degree: int) -> Array:
    """Whitened columns of the model's own error and of what laws may be off, other laws included, shape (cells, columns)."""
    cells = found.frame.cells
    smooth = model_error.basis(cells.plate_angle_rad, cells.load, cells.elevator_speed_rad_s, most=degree)
    return np.concatenate((found.own_error, *(ANOTHER_LAW_SD * smooth * change[:, None] for change in found.changes)), axis=1)
