"""Joint diagnosis of many machines' sweeps: errors common to all belong to the model, others to single machines.

A machine is compared with the others by the ratio of its forces to theirs, at equal force at home, angle and speed. No model is
needed for this, so that an error of the model that is common to all is not attributed to one machine. Machines in the same crop
have similar grain. The scatter of friction and density between them is estimated from all machines (empirical Bayes) and is the
prior of each one. The change by an effect is computed with the model, with loads that depend on the parameters and grain free
within that prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.discrepancy.base_fit import fit_base
from yieldmon.discrepancy.candidates import library
from yieldmon.discrepancy.choice import Choice
from yieldmon.discrepancy.frame import Frame
from yieldmon.discrepancy.noise import Noise
from yieldmon.discrepancy.observations import cells
from yieldmon.discrepancy.policy import Policy
from yieldmon.discrepancy.selection import choose
from yieldmon.estimation.priors import Prior
from yieldmon.files.crops import DENSITY_SD, SHIPPED_CROP, crops

from .force_change import Visible
from .lattice import Lattice
from .machine_comparison import Comparison, Own
from .single_cause import of_one_cause

LEAST_MACHINES = 3
_STATED = 1e6
"""Degrees of freedom of a stated noise, which is assumed to be known."""


@dataclass(frozen=True)
class Found:
    """shared: effects that the model lacks for all; own: effects of single machines; misfit: variance of the visits relative to
    the stated one."""

    shared: Choice
    own: Mapping[str, Own]
    deviating: tuple[str, ...]
    misfit: float
    visible_from: tuple[Visible, ...] = ()


def examine(lattice: Lattice, rng: np.random.Generator, policy: Policy) -> Found:
    """Find the effects common to the machines of a lattice, and those of single machines."""
    kept = np.ones(len(lattice.machines), dtype=bool)
    base = fit_base(_consensus(lattice, kept, 1.0))
    comparison = Comparison(lattice, base, rng, policy)
    kept = comparison.settled(kept)
    scale = comparison.state(kept).misfit
    shared = _shared(lattice, kept, scale, rng, policy)
    # The best description of the fleet determines the shapes, whether it is named or not.
    comparison = Comparison(lattice, shared.best, rng, policy)
    again = comparison.settled(kept)
    if not np.array_equal(again, kept):
        kept = again
        shared = _shared(lattice, kept, comparison.state(kept).misfit, rng, policy)
        comparison = Comparison(lattice, shared.best, rng, policy)
    state = comparison.state(kept)
    tail = comparison.tail(state)
    own = {placed.name: comparison.own(i, state, tail) for i, placed in enumerate(lattice.machines)}
    names = tuple(placed.name for placed, keep in zip(lattice.machines, kept, strict=True) if not keep)
    return Found(shared, own, names, state.misfit, comparison.visible_from(state, tail))


def _shared(lattice: Lattice, kept: NDArray[np.bool_], misfit: float, rng: np.random.Generator, policy: Policy) -> Choice:
    frame = _consensus(lattice, kept, misfit)
    noise, effects = Noise(0.0, 1.0, _STATED, "stated"), library(frame)
    found = choose(fit_base(frame), noise, effects, rng, policy)
    return of_one_cause(found, replace(frame, prior=_of_crop(frame, lattice.grain)), noise, effects, rng, policy)


def _of_crop(frame: Frame, grain: Mapping[str, float]) -> Prior:
    """Prior of the crop's grain: about the parameters with which the machines started, with the standard deviations of the
    shipped crop, which differ little between crops."""
    mean = {p.name: grain[p.name] for p in frame.base}
    return Prior.independent(mean, {"friction": crops()[SHIPPED_CROP].friction_sd, "density": DENSITY_SD * mean["density"]})


def _consensus(lattice: Lattice, kept: NDArray[np.bool_], misfit: float) -> Frame:
    """The lattice's frame with the mean force of the kept machines, in the cells that they measured."""
    machines = [m for m, keep in zip(lattice.machines, kept, strict=True) if keep]
    frame = lattice.frame
    count = len(frame.cells)
    total, weight, spread = np.zeros(count), np.zeros(count), np.zeros(count)
    for m in machines:
        for first, factor in m.blocks:
            # Visits of one sweep have the visits home around them in common, and several may belong to one cell.
            place = m.cell[first : first + len(factor)]
            covariance = np.linalg.inv(factor.T @ factor)
            w = 1.0 / np.diag(covariance)
            shared = (place[:, None] == place) * covariance * np.outer(w, w)
            total += np.bincount(place, w * m.log_force[first : first + len(factor)], minlength=count)
            weight += np.bincount(place, w, minlength=count)
            spread += np.bincount(place, shared.sum(axis=1), minlength=count)
    seen = weight > 0.0
    rows = frame.cells.rows
    value = np.where(seen, np.exp(np.divide(total, weight, out=np.zeros(count), where=seen)), rows.value)
    # A cell that none of them measured is left out.
    sigma = value * np.where(seen, np.sqrt(misfit * spread) / np.where(seen, weight, 1.0), 1e3)
    grouped = cells(replace(rows, value=value, sigma=sigma))
    return replace(frame, cells=grouped, sd=sigma)
