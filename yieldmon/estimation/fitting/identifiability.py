"""What a set of rows can and cannot determine, from the model's own Fisher information.

Parameters enter by their relative change (1 + restitution stands for restitution, as the momentum knows it), so that directions
compare. A direction is a combination of changes; its standard deviation says how far one may go along it unnoticed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics import grain
from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .batch import MomentumBatch

FLOW = "mass flow"
UNOBSERVABLE = 1e-7
"""Singular value, as a share of the largest, below which no measurement moves along a direction."""
_SAME_SIZE = 1e-6
"""Relative difference within which two components are equally large."""
_POORLY_KNOWN = 0.05
"""Relative standard deviation from which a direction is called poorly determined."""
_WORTH_NAMING = 0.1


@dataclass(frozen=True, slots=True)
class Direction:
    """A combination of relative changes (unit length) that the rows determine with relative_sd (inf: not at all)."""

    names: tuple[str, ...]
    components: tuple[float, ...]
    relative_sd: float

    def words(self) -> str:
        """e.g. `mass flow +1.00, density +1.00, 1 + restitution -1.00`, the largest change being 1."""
        top = max(abs(c) for c in self.components)
        parts = [(n, c / top) for n, c in zip(self.names, self.components, strict=True) if abs(c) > _WORTH_NAMING * top]
        return ", ".join(f"{shown(n)} {c:+.2f}" for n, c in sorted(parts, key=lambda p: -round(abs(p[1]), 2)))

    @property
    def is_scale(self) -> bool:
        """Whether this is (mass flow, density, impact gain) -> (a, a, 1/a), which changes no force at any angle or speed."""
        expected = np.array([_scale_component(n) for n in self.names])
        size = np.linalg.norm(expected)
        return bool(size > 0.0 and abs(expected @ np.array(self.components)) > (1.0 - 1e-6) * size)


@dataclass(frozen=True, slots=True)
class Remedy:
    """One more measurement and what it would do: the worst relative_sd after it."""

    measurement: str
    worst_sd_after: float


@dataclass(frozen=True)
class Report:
    """With the loads known (a calibration) and with one unknown flow for each load (a sweep)."""

    known_load: tuple[Direction, ...]
    unknown_load: tuple[Direction, ...]
    remedies: tuple[Remedy, ...]
    sentences: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Plain data."""

        def plain(found: Sequence[Direction]) -> list[dict[str, Any]]:
            return [
                {
                    "direction": d.words(),
                    "components": dict(zip(d.names, d.components, strict=True)),
                    "relative_sd": d.relative_sd,
                    "is_scale": d.is_scale,
                }
                for d in found
            ]

        return {
            "known_load": plain(self.known_load),
            "unknown_load": plain(self.unknown_load),
            "remedies": [{"measurement": r.measurement, "worst_sd_after": r.worst_sd_after} for r in self.remedies],
            "sentences": list(self.sentences),
        }


def shown(name: str) -> str:
    """A parameter as the directions mean it."""
    return "1 + restitution" if name == "restitution" else name


def natural_scale(name: str, value: float) -> float:
    """What a parameter's relative change is relative to; with k1's and k2's own sign, so that a gain changes by one share."""
    if "." in name:
        known = effect_parameter(name)
        return max(abs(value), abs(known.typical - known.null), 1e-12)
    return grain.natural_scale(grain.GRAIN[name], value)


def directions(jacobian: Array, names: Sequence[str]) -> tuple[Direction, ...]:
    """Singular directions of whitened relative derivatives (rows, n), the worst determined first."""
    rows, width = jacobian.shape
    size = np.linalg.norm(jacobian, axis=0)
    if rows < width:
        jacobian = np.vstack((jacobian, np.zeros((width - rows, width))))
    _, values, vectors = np.linalg.svd(jacobian, full_matrices=False)
    limit = UNOBSERVABLE * max(float(size.max(initial=0.0)), 1e-300)
    free = values <= limit
    vectors[free] = _scale_first(vectors[free], names)[::-1]
    found = []
    for value, vector in zip(values[::-1], vectors[::-1], strict=True):
        # Of equally large ones the flow's: which is largest would otherwise turn with rounding, from one processor to another.
        largest = np.flatnonzero(np.abs(vector) > (1.0 - _SAME_SIZE) * np.abs(vector).max()).tolist()
        leading = next((place for place in largest if names[place] == FLOW), largest[0])
        sign = np.sign(vector[leading])
        found.append(
            Direction(tuple(names), tuple(float(v) for v in sign * vector), 1.0 / float(value) if value > limit else float("inf"))
        )
    return tuple(found)


def _scale_first(null: Array, names: Sequence[str]) -> Array:
    """A basis of the same space that begins with the scale direction, if that lies in it; any basis would do for the rest."""
    scale = np.array([_scale_component(n) for n in names])
    size = np.linalg.norm(scale)
    if len(null) < 2 or size == 0.0 or np.linalg.norm(null @ scale) < (1.0 - 1e-9) * size:
        return null
    scale = scale / size
    rest = null - np.outer(null @ scale, scale)
    return np.vstack((scale, np.linalg.svd(rest)[2][: len(null) - 1]))


def relative_jacobian(
    model: ForwardModel, conditions: Conditions, values: Mapping[str, float], names: Sequence[str], noise_sd: ArrayLike
) -> tuple[Array, Array]:
    """Whitened derivatives of momentum by relative changes of `names` (rows, n), and by that of the load (rows, 1)."""
    fixed = {k: v for k, v in values.items() if k not in names}
    batch = MomentumBatch(model, conditions, names, fixed)
    _, jacobian, by_load = batch.at_load(np.array([values[n] for n in names]), batch.load)
    sd = np.broadcast_to(np.asarray(noise_sd, dtype=float), (batch.rows,))[:, None]
    relative = jacobian * np.array([natural_scale(n, values[n]) for n in names]) / sd
    return relative, (by_load * batch.load)[:, None] / sd


def report(
    model: ForwardModel, conditions: Conditions, parameters: ParameterSet, names: Sequence[str], noise_sd: ArrayLike
) -> Report:
    """Report on rows that exist or are planned. names: the parameters in question; noise_sd of a row's momentum."""
    values = parameters.values
    relative, by_load = relative_jacobian(model, conditions, values, names, noise_sd)
    known = directions(relative, names)
    loads = MomentumBatch(model, conditions, (), values).load
    free = np.unique(loads)
    # One free relative change of the load for each distinct load, projected out: what is left determines the parameters.
    nuisance = by_load * (loads[:, None] == free[None, :])
    together = np.hstack((nuisance, relative))
    unknown = share_flow(directions(together, flow_names(free.size, names)), free.size, names)
    remedies = tuple(_remedies(model, conditions, values, names, noise_sd=noise_sd, relative=relative, loads=loads))
    return Report(known, unknown, remedies, tuple(_sentences(known, unknown, remedies)))


def flow_names(flows: int, names: Sequence[str]) -> tuple[str, ...]:
    """Names for several unknown flows and the parameters."""
    return (*(f"{FLOW} {i + 1}" for i in range(flows)), *names)


def share_flow(found: Iterable[Direction], flows: int, names: Sequence[str]) -> tuple[Direction, ...]:
    """The directions that are not about one flow alone, with the flows' changes averaged into one component."""
    out = []
    for d in found:
        parts = np.array(d.components)
        if np.linalg.norm(parts[flows:]) < 0.1:
            continue
        merged = np.concatenate(([parts[:flows].mean()], parts[flows:]))
        size = float(np.linalg.norm(merged))
        out.append(Direction((FLOW, *names), tuple(float(v) for v in merged / size), d.relative_sd * size))
    return tuple(out)


def _worst(jacobian: Array) -> float:
    values = np.linalg.svd(jacobian, compute_uv=False)
    if jacobian.shape[0] < jacobian.shape[1] or values[-1] <= UNOBSERVABLE * values[0]:
        return float("inf")
    return 1.0 / float(values[-1])


def _remedies(
    model: ForwardModel,
    conditions: Conditions,
    values: Mapping[str, float],
    names: Sequence[str],
    *,
    noise_sd: ArrayLike,
    relative: Array,
    loads: Array,
) -> Iterable[Remedy]:
    """The best of: knowing one parameter within 5 %, or three more rows at another angle, speed or load."""
    tried = []
    for j, name in enumerate(names):
        row = np.zeros((1, len(names)))
        row[0, j] = 1.0 / 0.05
        tried.append(Remedy(f"know {shown(name)} within 5 %", _worst(np.vstack((relative, row)))))
    machine = model.machine
    middle_noise = float(np.median(np.asarray(noise_sd, dtype=float)))
    angles = np.radians(
        np.arange(np.ceil(np.degrees(machine.min_plate_angle_rad)), np.degrees(machine.max_plate_angle_rad) + 0.5, 10.0)
    )
    speeds = machine.nominal_elevator_speed_rad_s * np.array([0.75, 1.0, 1.25])
    amounts = np.unique([loads.min(), np.median(loads), loads.max()])
    places = np.unique([*machine.plate_travel_m, 0.0])
    grid = np.array([(a, s, m, p) for a in angles for s in speeds for m in amounts if m > 0.0 for p in places])
    by_flow = conditions.paddle_mass_kg is None
    moisture = None if conditions.moisture_pct is None else float(np.nanmedian(np.asarray(conditions.moisture_pct, dtype=float)))
    planned = Conditions(
        grid[:, 0], grid[:, 1], grid[:, 2] if by_flow else None, None if by_flow else grid[:, 2], moisture, grid[:, 3]
    )
    extra, _ = relative_jacobian(model, planned, values, names, middle_noise)
    unit = "kg/s" if by_flow else "kg a paddle"
    for row, (angle, speed, load, place) in zip(extra, grid, strict=True):
        if np.all(np.isfinite(row)):
            moved = f", plate moved by {1000.0 * place:+.0f} mm" if place else ""
            at = f"{np.degrees(angle):.0f} deg, {speed * 30.0 / np.pi:.0f} rpm, {load:.3g} {unit}{moved}"
            text = f"three more rows at {at} (load known)"
            tried.append(Remedy(text, _worst(np.vstack((relative, np.sqrt(3.0) * row[None])))))
    tried.sort(key=lambda r: r.worst_sd_after)
    return tried[:5]


def _sentences(known: Sequence[Direction], unknown: Sequence[Direction], remedies: Sequence[Remedy]) -> Iterable[str]:
    for d in known:
        if not np.isfinite(d.relative_sd):
            yield f"with the loads known, nothing is determined along: {d.words()}."
        elif d.relative_sd > _POORLY_KNOWN:
            yield f"with the loads known, this is poorly determined ({100.0 * d.relative_sd:.2g} %): {d.words()}."
    for d in unknown:
        if d.is_scale:
            yield (
                "with the load unknown (a sweep), the scale is exactly unobservable: (mass flow, density, impact gain) -> "
                "(a, a, 1/a) changes no force at any angle or speed; only a weighed load, a known density or a known impact gain "
                "fixes it."
            )
        elif not np.isfinite(d.relative_sd):
            yield f"with the load unknown (a sweep), nothing is determined along: {d.words()}."
        elif d.relative_sd > _POORLY_KNOWN:
            yield f"with the load unknown (a sweep), this is poorly determined ({100.0 * d.relative_sd:.2g} %): {d.words()}."
    if known and known[0].relative_sd > _POORLY_KNOWN and remedies:
        best = remedies[0]
        after = f"{100.0 * best.worst_sd_after:.2g} %"
        yield f"what would help most: {best.measurement}; the worst direction would then be known to {after}."


def _scale_component(name: str) -> float:
    """Relative change of a parameter in the scale direction."""
    if name.startswith(FLOW):
        return 1.0
    return grain.GRAIN[name].along_scale if name in grain.GRAIN else 0.0


def scale_tangent(name: str, value: float) -> float:
    """d(parameter) / d(ln a) along (mass flow, density, impact gain) -> (a, a, 1/a), which changes no force."""
    return _scale_component(name) * natural_scale(name, value)


def scaled(parameters: ParameterSet, factor: float) -> ParameterSet:
    """The set moved along the scale direction: density x factor, impact gain / factor. Every force at flow x factor stays."""
    values = dict(parameters.values)
    values["density"] *= factor
    if "restitution" in values:
        values["restitution"] = (1.0 + values["restitution"]) / factor - 1.0
    else:
        values["k1"] /= factor
        values["k2"] /= factor
    return replace(parameters, values=values)
