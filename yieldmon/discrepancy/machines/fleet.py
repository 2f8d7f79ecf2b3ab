"""What many machines' sweeps show together: what all show is the model's, what one shows beside the others its own.

A machine is compared with the others: its forces over theirs, at equal force at home, angle and speed. That needs no model, so
that what the model lacks for all does not count against one. Machines that cut one crop share its grain; how much friction and
density differ between them is estimated from them all (empirical Bayes), and is the prior of each machine's own. What an effect
would show is the model's change by it, loads following, with grain free within that prior.
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
"""Degrees of freedom of a stated noise: it is known."""


@dataclass(frozen=True)
class Found:
    """shared: what the model lacks for all; own: by machine; misfit: variance of the visits over what is stated."""

    shared: Choice
    own: Mapping[str, Own]
    deviating: tuple[str, ...]
    misfit: float
    visible_from: tuple[Visible, ...] = ()


def examine(lattice: Lattice, rng: np.random.Generator, policy: Policy) -> Found:
    """What the machines of a lattice share, and what each has beside the others."""
    kept = np.ones(len(lattice.machines), dtype=bool)
    base = fit_base(_consensus(lattice, kept, 1.0))
    comparison = Comparison(lattice, base, rng, policy)
    kept = comparison.settled(kept)
    scale = comparison.state(kept).misfit
    shared = _shared(lattice, kept, scale, rng, policy)
    # What describes the fleet best gives the shapes, named or not.
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
    """What is known of the crop's grain before any sweep: about the parameters that the machines began with, as wide as for the
    shipped crop (those of the others differ little)."""
    mean = {p.name: grain[p.name] for p in frame.base}
    return Prior.independent(mean, {"friction": crops()[SHIPPED_CROP].friction_sd, "density": DENSITY_SD * mean["density"]})


def _consensus(lattice: Lattice, kept: NDArray[np.bool_], misfit: float) -> Frame:
    """The lattice's frame with the mean force of the machines that are kept, in the cells that they measured."""
    machines = [m for m, keep in zip(lattice.machines, kept, strict=True) if keep]
    frame = lattice.frame
    count = len(frame.cells)
    total, weight, spread = np.zeros(count), np.zeros(count), np.zeros(count)
    for m in machines:
        for first, factor in m.blocks:
            # Visits of one sweep share the visits home that bracket them, and several of them may be of one cell.
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
