"""Frame of a fit of the published model, and its best fit without any effect."""

from __future__ import annotations

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.grain import GRAIN, GrainParameter, evenly, fitted
from yieldmon.physics.numerics import Array, real

from .fit import Fit, fit_all
from .frame import Frame, Parameter, predictions
from .observations import Cells

_REFERENCE_FORCE_N = 60.0
"""Largest force of a table in N for which the effects' bounds in N are used."""


def base_frame(cells: Cells, sd: Array, parameters: ParameterSet, form: str, *, keep_effects: bool = False) -> Frame:
    """Frame for the published model in `form` ("restitution" or "exchange"); friction and density free, the shape ratio fixed.


    keep_effects: effects with parameters in the set are part of the model, with these values. Bounds and starts are those of the
    registry.
    """
    top = float(np.max(np.abs(cells.mean)))
    force = top if cells.rows.of == "force" else top * float(np.median(_passes(cells)))
    unit = 1.0 if cells.rows.si else force / _REFERENCE_FORCE_N
    given = parameters.values
    base = tuple(_base(GRAIN[name], unit) for name in fitted(form))
    others = {b.name for b in base}
    held = {p.name: float(given[p.name]) for p in GRAIN.values() if not p.form and p.name in given and p.name not in others}
    kept = {name: float(value) for name, value in given.items() if keep_effects and "." in name}
    return Frame(cells, sd, base, held | kept, unit)


def fit_base(frame: Frame) -> Fit:
    """Best fit from several starts of friction and density; raises ValueError if the loads overfill paddles at every start."""
    first = {p.name: p.start for p in frame.base}
    densities = (*evenly("density", 3), GRAIN["density"].search[1])
    starts = [first] + [first | {"friction": f, "density": d} for f in evenly("friction", 3) for d in densities]
    found = []
    for start in starts:
        linear = _solve_gain(frame, start)
        if linear is not None:
            found.append(linear)
    if not found:
        raise ValueError("the loads overfill the paddles at every admissible density")
    found.sort(key=lambda pair: pair[0])
    fits = [f for f in fit_all(frame, (), [start for _, start in found[:3]]) if f is not None]
    return min(fits, key=lambda f: f.chi2)


def _solve_gain(frame: Frame, start: dict[str, float]) -> tuple[float, dict[str, float]] | None:
    """chi2 and start with the best gain (1 + e, or k1 and k2) at this friction and density; the reading is linear in it."""
    if frame.following is not None:
        residual = (real(predictions(frame, (), start)) - frame.cells.mean) / frame.sd
        return (float(residual @ residual), start) if np.all(np.isfinite(residual)) else None
    y = frame.cells.mean / frame.sd
    if "restitution" in start:
        unit = real(predictions(frame, (), start | {"restitution": 0.0})) / frame.sd
        if not (np.all(np.isfinite(unit)) and unit @ unit > 0.0):
            return None
        gain = float(np.clip((unit @ y) / (unit @ unit), 1.0, 2.0))
        return float(np.sum((gain * unit - y) ** 2)), start | {"restitution": gain - 1.0}
    first = real(predictions(frame, (), start | {"k1": 1.0, "k2": 0.0})) / frame.sd
    second = real(predictions(frame, (), start | {"k1": 0.0, "k2": 1.0})) / frame.sd
    columns = np.stack((first, second), axis=-1)
    if not np.all(np.isfinite(columns)):
        return None
    gains = np.linalg.lstsq(columns, y, rcond=None)[0]
    limits = {p.name: (p.lower, p.upper) for p in frame.base}
    gains = np.array([np.clip(g, *limits[n]) for g, n in zip(gains, ("k1", "k2"), strict=True)])
    return float(np.sum((columns @ gains - y) ** 2)), start | {"k1": float(gains[0]), "k2": float(gains[1])}


def _base(known: GrainParameter, unit: float) -> Parameter:
    """Where it starts is the registry's matter, so that no verdict depends on the parameters that one begins with."""
    stretch = unit if known.follows_response else 1.0
    low, high = known.search
    return Parameter(known.name, low * stretch, high * stretch, known.typical * stretch, known.step * stretch, known.unit)


def _passes(cells: Cells) -> Array:
    machine = cells.rows.machine
    return machine.passes_per_s(cells.elevator_speed_rad_s)
