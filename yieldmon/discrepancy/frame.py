"""What all fits to one set of cells have in common, and the model's prediction for these cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yieldmon.estimation import model_error
from yieldmon.estimation.priors import Prior
from yieldmon.physics.effects import changes_force, get_effect
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import AnyArray, Array, real

from .observations import Cells

SEARCH_NODES = 8
"""Order of the quadrature in a search: within 2e-4 of the largest reading for every effect (8e-6 for most)."""
FINAL_NODES = 12
"""The same for what is reported."""
_FLOW_STEPS = 3
"""Number of Newton steps from the flows of the known parameters."""


@dataclass(frozen=True)
class Parameter:
    """A free parameter. start: the published value, or the null value of an effect."""

    name: str
    lower: float
    upper: float
    start: float
    scale: float
    unit: str = ""
    typical: float = 0.0
    prior_sd: float = np.inf


@dataclass(frozen=True)
class Following:
    """Loads that depend on the parameters: with any parameters they give the force that was measured at the home angle.

    Tickets determine the gain: the force at home at the reference flow is always the known one, `reference_n`.

    Attributes
    ----------
    elevator_speed_rad_s, moisture_pct : ndarray (settings + 1, 1)
        The last row is the reference.
    mass_flow_kg_s : ndarray (settings + 1, flows)
        Flows with the known parameters, at which the search starts; the last row is the reference.
    share : ndarray (settings, flows)
        Ratio of the force at home to that at the reference.
    power : ndarray (settings, flows)
        d ln(force) / d ln(flow) there.
    place : ndarray of int
        Index of each of the layout's cells in the flattened (settings, flows).
    """

    elevator_speed_rad_s: Array
    moisture_pct: Array
    mass_flow_kg_s: Array
    share: Array
    power: Array
    reference_n: float
    place: NDArray[np.int64]


@dataclass(frozen=True)
class Frame:
    """What all fits to one set of cells have in common: cells, standard deviations of their means, base and fixed parameters.

    unit: size of the reading's unit relative to SI (1 for N and kg m/s). Bounds of effects in the reading's unit are scaled by
    it.
    """

    cells: Cells
    sd: Array
    base: tuple[Parameter, ...]
    fixed: Mapping[str, float]
    unit: float
    nodes: int = SEARCH_NODES
    model_error: float = model_error.FLOOR
    following: Following | None = None
    """How flows depend on the parameters (restitution is then determined as well, and is no base parameter); None: known
    flows."""
    prior: Prior | None = None
    """Prior of the base parameters; None: only their bounds."""

    @property
    def known(self) -> tuple[str, ...]:
        """Effects that are part of the model, with fixed parameters."""
        named = {name.partition(".")[0] for name in self.fixed if "." in name}
        return tuple(sorted(name for name in named if changes_force(name)))

    def with_cells(self, cells: Cells, sd: Array) -> Frame:
        """The same frame with other cells, with the accuracy of reported results."""
        return replace(self, cells=cells, sd=sd, nodes=FINAL_NODES)

    @property
    def groups(self) -> list[NDArray[np.int64]]:
        """Groups of cells to leave out: by plate angle and by load."""
        return model_error.groups_of(self.cells.plate_angle_rad, self.cells.load)


def effect_parameters(effect: str, unit: float) -> tuple[Parameter, ...]:
    """Free parameters of an effect; bounds are in the reading's unit if the effect is."""
    known = get_effect(effect)
    out = []
    for p in known.parameters:
        stretch = 1.0
        if known.unit_follows_response:
            stretch = 1.0 / unit if p.unit.startswith("1/") else unit
        out.append(
            Parameter(
                f"{effect}.{p.name}",
                p.lower * stretch,
                p.upper * stretch,
                p.null * stretch,
                abs(p.typical - p.null) * stretch,
                p.unit,
                p.typical * stretch,
                p.prior_sd * stretch,
            )
        )
    return tuple(out)


def predictions(frame: Frame, effects: Iterable[str], values: Mapping[str, ArrayLike]) -> Array:
    """Prediction for each cell of the frame, (..., cells); values are numbers, or arrays (..., 1) for a batch."""
    cells = frame.cells
    model = ForwardModel(cells.rows.machine, (*frame.known, *effects), nodes=frame.nodes)
    evaluate = model.force if cells.rows.of == "force" else model.paddle_momentum
    grid = cells.layout
    conditions = Conditions(
        grid.plate_angle_rad, grid.elevator_speed_rad_s, moisture_pct=grid.moisture_pct, **{cells.rows.load_name: grid.load}
    )
    spread = {
        name: np.asarray(v)[..., None] if np.ndim(v) else np.asarray(v) for name, v in (dict(frame.fixed) | dict(values)).items()
    }
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        if frame.following is not None:
            flow, gain = _followed(model, frame.following, spread)
            out = gain * np.asarray(evaluate(replace(conditions, mass_flow_kg_s=flow), spread, overfull="nan"))
        else:
            out = np.asarray(evaluate(conditions, spread, overfull="nan"))
    return np.asarray(out.reshape(*out.shape[:-2], -1)[..., grid.place])


def _followed(model: ForwardModel, following: Following, values: Mapping[str, AnyArray]) -> tuple[AnyArray, AnyArray]:
    """Flow of each of the layout's cells, and the gain with which the force at the reference is the known one.

    Newton steps in ln(flow) with a real slope. The last ones also make the complex parts correct, and with them the derivatives.
    """
    home = model.machine.home_plate_angle_rad
    throw = model.throw(home, following.elevator_speed_rad_s, values, following.moisture_pct)
    passes, flow = throw.passes_per_s, np.asarray(following.mass_flow_kg_s)
    load: AnyArray = flow[:-1]
    for _ in range(_FLOW_STEPS):
        last = np.broadcast_to(flow[-1:], (*load.shape[:-2], 1, flow.shape[-1]))
        force = throw.momentum(np.concatenate((load, last), axis=-2) / passes) * passes
        reference = force[..., -1:, :1]
        step = following.share * reference / force[..., :-1, :]
        load = load * real(step) ** (1.0 / following.power)
        if np.iscomplexobj(step):
            load = load * (1.0 + 1j * np.imag(step) / (real(step) * following.power))
    flat = load.reshape(*load.shape[:-2], -1)
    return flat[..., following.place], following.reference_n / reference
