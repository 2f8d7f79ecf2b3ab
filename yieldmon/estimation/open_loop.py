"""Open loop: force to mass flow, one window at a time, with known parameters (thesis, section 9.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yieldmon.arguments import require_type
from yieldmon.physics.machine import FASTEST_ELEVATOR_RPM, RPM
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import AnyArray, Array, chebyshev_points, refuse_shapes
from yieldmon.physics.throw import Throw

from .beyond_range import error_beyond
from .load_curves import LoadCurves
from .load_pattern import following
from .parameters import ParameterSet

_GRID = chebyshev_points(24)
_ALONG_CURVE = np.linspace(0.0, 1.0, 161)
"""Heap thicknesses over that of a full paddle at which `OpenLoop.force_curve` is given."""
_STENCIL = np.array([-1.0, 0.0, 1.0])
_NEAR = np.arange(4)
_LEAST_STEP = 1e-9
_EXACT = 1e-13
"""Relative error of the force at which a flow is found."""
_THIN = 1e-4
"""Heap thickness, 1 - h0/l, at which momentum is in proportion to load."""
_NEAR_ERROR = 1e-3
"""Relative, of a load curve between knots: twice the most that it is found to be."""
_THIN_CELLS = 2
"""Cells of the grid at its ends in which curves between knots decide nothing."""
_DIAGONAL = np.eye(4, dtype=bool)


class FlowStatus(IntEnum):
    """Status of a flow estimate.

    Attributes
    ----------
    OK
        An estimate within the calibrated range.
    NO_GRAIN
        The force is at or below that of an empty machine; the flow is 0 within its standard deviation.
    OUTSIDE_CALIBRATION
        An estimate, but flow, angle, speed or moisture lie outside the range that the parameters were calibrated in.
    SATURATED
        More force than a full paddle gives; no estimate (nan).
    NOT_AVAILABLE
        An input is missing or meaningless; no estimate (nan).

    Examples
    --------
    >>> api.FlowStatus(1).name
    'NO_GRAIN'
    """

    OK = 0
    NO_GRAIN = 1
    OUTSIDE_CALIBRATION = 2
    SATURATED = 3
    NOT_AVAILABLE = 4


@dataclass(frozen=True, slots=True)
class FlowEstimate:
    """Mass flow, its standard deviation and status, of one shape.

    Parameters
    ----------
    mass_flow_kg_s : ndarray
        kg/s, nan where there is none.
    std_dev_kg_s : ndarray
        Standard deviation, kg/s.
    status : ndarray of int
        `FlowStatus` codes.
    noise_std_dev_kg_s : ndarray
        The part of the standard deviation that changes from window to window, kg/s; the rest is the parameters'.

    Examples
    --------
    >>> parameters = api.load_parameters()
    >>> estimator = api.OpenLoop(api.ForwardModel(api.Machine(), parameters.effects), parameters)
    >>> found = estimator.estimate([0.0, 90.0], np.radians(70.0), 400.0 * api.RPM)
    >>> [api.FlowStatus(code).name for code in found.status]
    ['NO_GRAIN', 'OK']
    """

    mass_flow_kg_s: Array
    std_dev_kg_s: Array
    status: NDArray[np.int64]
    noise_std_dev_kg_s: Array | None = None


def invert_force(throw: Throw, force_n: Array, *, near: Array | None = None) -> tuple[Array, Array]:
    """Mass flow at which `throw` gives `force_n`, and d(force)/d(mass flow) there, by a bracketed solver.

    throw and force have shapes that broadcast to S; returns two arrays of shape S. The bracket is an empty to a full paddle; of
    several solutions the lowest is taken. At or below the empty reading the flow is 0 and the slope that of thin loads; above the
    highest reading both are nan. Inside the bracket: inverse interpolation over a grid in heap thickness, then Halley steps that
    may not leave their interval.

    near: (*S, g), about what `throw` reads over the grid, where it is known without asking; where the search ends is the throw's
    own, but whether it does, and in which of several solutions, is what `near` says (see `decided_by`).
    """
    passes = np.asarray(throw.passes_per_s)
    shape = np.broadcast_shapes(passes.shape[:-1], force_n.shape)
    target = force_n[..., None] / passes
    grid = throw.load_curve(_GRID)[1] if near is None else near
    rows = np.arange(int(np.prod(shape)))[:, None]
    grid = np.broadcast_to(grid, (*shape, _GRID.size)).reshape(-1, _GRID.size)
    goal = np.broadcast_to(target, (*shape, 1)).reshape(-1, 1)
    reaches = grid >= goal
    found = np.any(reaches, axis=-1).reshape(shape)
    right = np.maximum(reaches.argmax(axis=-1)[:, None], 1)
    empty = grid[:, :1]
    below = np.less_equal(goal, empty).reshape(shape)
    # Momentum rises as thickness squared, so its root is nearly linear in the thickness.
    around = np.minimum(np.maximum(right - 2, 0), _GRID.size - 4) + _NEAR
    root = np.sqrt(np.maximum(grid[rows, around] - empty, 0.0))
    start = _inverse_interpolation(root, _GRID[around], np.sqrt(np.maximum(goal - empty, 0.0)))
    # An interval more on either side: `near` is only about what the throw reads.
    low, high = _GRID[np.maximum(right - 2, 0)], _GRID[np.minimum(right + 1, _GRID.size - 1)]
    q = np.minimum(np.maximum(start, low), high).reshape(*shape, 1)
    low, high = low.reshape(q.shape), high.reshape(q.shape)
    q = np.minimum(np.maximum(q, 2.0 * _LEAST_STEP), 1.0 - 2.0 * _LEAST_STEP)
    # Where there is no grain only the slope of the thinnest heaps is wanted; nearer to none its differences drown in rounding.
    no_grain = below.reshape(q.shape)
    q = np.where(no_grain, _THIN, q)
    gain = np.full(q.shape, np.nan)
    settled = ~found.reshape(q.shape)
    for _ in range(60):
        width = 1e-3 * np.minimum(np.minimum(q, 1.0 - q), high - low) + _LEAST_STEP
        mass, momentum = throw.load_curve(q + width * _STENCIL)
        before, centre, after = momentum[..., :1], momentum[..., 1:2], momentum[..., 2:]
        slope = (after - before) / (2.0 * width)
        curve = (after - 2.0 * centre + before) / (width * width)
        error = centre - target
        low, high = np.where(error < 0.0, q, low), np.where(error > 0.0, q, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = error / slope
            trial = q - newton / (1.0 - 0.5 * newton * curve / slope)
        trial = np.where((trial >= low) & (trial <= high), trial, 0.5 * (low + high))
        here = _slope_at(throw.offered_along_curve(np.where(no_grain, q, trial)), mass, momentum)
        near_enough = (np.abs(trial - q) <= 1e-4 * q) | (np.abs(error) <= _EXACT * np.abs(target)) | no_grain
        # A row that has settled stays as it is, so that its result does not depend on the rows beside it.
        q, gain = np.where(settled, q, trial), np.where(settled, gain, here)
        settled = settled | near_enough
        if settled.all():
            break
    flow = (throw.offered_along_curve(q) * passes)[..., 0]
    return np.where(below, 0.0, np.where(found, flow, np.nan)), np.where(found, gain[..., 0], np.nan)


def decided_by(near: Array, force_n: Array, passes_per_s: Array) -> NDArray[np.bool_]:
    """(n,): where curves that are off by _NEAR_ERROR, (n, g), leave no doubt that there is a solution and which is the lowest."""
    goal = (force_n / passes_per_s)[:, None]
    reached = near >= goal
    right = reached.argmax(axis=1)
    ahead = np.arange(1, near.shape[1]) <= right[:, None] + 1
    with np.errstate(invalid="ignore"):
        rises = np.diff(near, axis=1) > _NEAR_ERROR * np.abs(near[:, 1:])
    inside: NDArray[np.bool_] = (right >= _THIN_CELLS) & (right < near.shape[1] - _THIN_CELLS)
    decided: NDArray[np.bool_] = inside & np.all(rises | ~ahead, axis=1)
    return decided


def broadcast_inputs(
    force_n: ArrayLike,
    plate_angle_rad: ArrayLike,
    elevator_speed_rad_s: ArrayLike,
    force_std_dev_n: ArrayLike,
    moisture_pct: ArrayLike | None,
) -> tuple[tuple[Array, ...], NDArray[np.bool_]]:
    """The inputs in this order as arrays of one shape, unknown moisture as nan, and where the first four can be used.

    Raises ValueError for shapes that do not broadcast.
    """
    given = {
        "force_n": force_n,
        "plate_angle_rad": plate_angle_rad,
        "elevator_speed_rad_s": elevator_speed_rad_s,
        "force_std_dev_n": force_std_dev_n,
        "moisture_pct": np.nan if moisture_pct is None else moisture_pct,
    }
    refuse_shapes("inputs", given)
    arrays = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in given.values()))
    force, angle, speed, noise, _ = arrays
    usable = np.isfinite(force) & (np.abs(angle) <= np.pi) & (speed > 0.0) & (speed <= FASTEST_ELEVATOR_RPM * RPM)
    usable = usable & np.isfinite(noise) & (noise >= 0.0)
    return tuple(arrays), usable


def with_status(
    flow: Array, sd: Array, noise_sd: Array, *, outside: NDArray[np.bool_], empty: NDArray[np.bool_], usable: NDArray[np.bool_]
) -> FlowEstimate:
    """Flow and standard deviations (nan flow: above a full paddle) with their status; nan where that is saturated or unknown."""
    status = np.full(flow.shape, int(FlowStatus.OK))
    status = np.where(outside, FlowStatus.OUTSIDE_CALIBRATION, status)
    status = np.where(empty, FlowStatus.NO_GRAIN, status)
    status = np.where(np.isnan(flow), FlowStatus.SATURATED, status)
    status = np.where(usable & (np.isfinite(sd) | np.isnan(flow)), status, FlowStatus.NOT_AVAILABLE)
    known = (status != FlowStatus.SATURATED) & (status != FlowStatus.NOT_AVAILABLE)
    flow, sd, noise_sd = (np.where(known, v, np.nan) for v in (flow, sd, noise_sd))
    return FlowEstimate(flow, sd, status, noise_sd)


class OpenLoop:
    """Force to mass flow with one set of parameters.

    Parameters
    ----------
    model : ForwardModel
        With the effects that the parameters name; `load_pattern`, which weighed loads add to a set, is added to it.
    parameters : ParameterSet
        Their covariance, own_error and scale_error enter the standard deviation of the flow.

    Attributes
    ----------
    model : ForwardModel
    parameters : ParameterSet

    Raises
    ------
    ValueError
        For a model that is no ForwardModel, parameters that are no ParameterSet, and other effects in them than in the model.

    References
    ----------
    "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), chapter 8, solved for the flow.

    Examples
    --------
    >>> parameters = api.load_parameters()
    >>> estimator = api.OpenLoop(api.ForwardModel(api.Machine(), parameters.effects), parameters)
    >>> estimator.invert([60.0, 90.0], np.radians(70.0), 400.0 * api.RPM).round(2)
    array([ 6.86, 11.95])
    """

    def __init__(self, model: ForwardModel, parameters: ParameterSet) -> None:
        require_type("parameters", parameters, ParameterSet, "a ParameterSet, such as ParameterSet(values=...)")
        require_type("model", model, ForwardModel, "a ForwardModel")
        model = following(model, parameters)
        if set(parameters.effects) != set(model.effects):
            raise ValueError(f"the parameters name the effects {parameters.effects}; the model has {model.effects}")
        self.model = model
        self.parameters = parameters
        names = parameters.covariance_names
        base = {name: np.asarray(value) for name, value in parameters.values.items()}
        # One row as it is and one a parameter: a step of a thousandth of its standard deviation keeps the difference linear and
        # above rounding.
        steps = np.array([1e-3 * parameters.standard_deviation(name) for name in names])
        self._steps = steps
        moves = np.diag(steps)
        self._rows = {
            name: value + (np.concatenate(([0.0], moves[names.index(name)])) if name in names else 0.0)
            for name, value in base.items()
        }

    def invert(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        moisture_pct: ArrayLike | None = None,
    ) -> Array:
        """Mass flow alone.

        Parameters
        ----------
        force_n : array_like
            Mean horizontal force above zero load, N.
        plate_angle_rad, elevator_speed_rad_s : array_like
            rad, -pi to pi; rad/s, above 0, up to 1900 rpm.
        moisture_pct : array_like, optional
            %, where an effect needs it.

        Returns
        -------
        ndarray
            kg/s: 0 at or below the empty reading; nan above that of a full paddle, and where an input is missing or outside its
            range.
        """
        given = broadcast_inputs(force_n, plate_angle_rad, elevator_speed_rad_s, 0.0, moisture_pct)
        (force, angle, speed, _, moist), usable = self._usable(*given)
        return np.where(usable, self._inverted(force, angle, speed, moist)[0], np.nan)

    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = 0.0,
        moisture_pct: ArrayLike | None = None,
    ) -> FlowEstimate:
        """Mass flow with standard deviation and status.

        Parameters
        ----------
        force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct : array_like
            As in `invert`; nan where unknown.
        force_std_dev_n : array_like
            Of the force, from window noise, N, 0 or more.

        Returns
        -------
        FlowEstimate
        """
        given = broadcast_inputs(force_n, plate_angle_rad, elevator_speed_rad_s, force_std_dev_n, moisture_pct)
        (force, angle, speed, noise, moist), usable = self._usable(*given)
        varied = self.model.throw(angle[..., None], speed[..., None], self._rows, moist[..., None]) if len(self._steps) else None
        flow, gain = self._inverted(force, angle, speed, moist, varied)
        spread = np.hypot(noise, self._parameter_force_sd(flow, varied))
        own = np.hypot(self.parameters.own_error, error_beyond(self.parameters, flow, angle, speed))
        own = np.hypot(own, self.parameters.scale_error)
        spread = np.hypot(spread, own * np.abs(force))
        with np.errstate(divide="ignore", invalid="ignore"):
            sd, noise_sd = spread / np.abs(gain), noise / np.abs(gain)
        outside = self.parameters.calibrated.outside(flow, angle, speed, moist)
        return with_status(flow, sd, noise_sd, outside=outside, empty=flow <= 0.0, usable=usable)

    def force_curve(
        self, plate_angle_rad: float, elevator_speed_rad_s: float, moisture_pct: float = float("nan")
    ) -> tuple[Array, Array]:
        """Force over mass flow, from an empty to a full paddle.

        Parameters
        ----------
        plate_angle_rad, elevator_speed_rad_s, moisture_pct
            As in `invert`, one of each.

        Returns
        -------
        force_n : ndarray (g,)
            N; nan where moisture is missing.
        mass_flow_kg_s : ndarray (g,)
            kg/s, rising from 0.
        """
        throw = _throw(self.model, self.parameters.values, plate_angle_rad, elevator_speed_rad_s, moisture_pct)
        mass, momentum = throw.load_curve(_ALONG_CURVE)
        passes = throw.passes_per_s
        return momentum * passes, mass * passes

    def _usable(self, inputs: tuple[Array, ...], usable: NDArray[np.bool_]) -> tuple[tuple[Array, ...], NDArray[np.bool_]]:
        """What `broadcast_inputs` gave, with the inputs of an empty machine at home in place of what cannot be used."""
        force, angle, speed, noise, moist = inputs
        if self.model.needs_moisture:
            usable = usable & np.isfinite(moist)
            moist = np.where(np.isfinite(moist), moist, 0.0)
        machine = self.model.machine
        force, noise = np.where(usable, force, 0.0), np.where(usable, noise, 0.0)
        angle = np.where(usable, angle, machine.home_plate_angle_rad)
        speed = np.where(usable, speed, machine.nominal_elevator_speed_rad_s)
        return (force, angle, speed, noise, moist), usable

    def _inverted(
        self, force: Array, angle: Array, speed: Array, moisture: Array, varied: Throw | None = None
    ) -> tuple[Array, Array]:
        """As `inverted`. varied: a throw at these settings, the first of whose sets of parameters are ours."""
        missed = None
        if varied is not None:
            missed = np.broadcast_to(varied.miss_rotation_rad[..., :1, :], (*force.shape, 1, 1)).reshape(-1, 1, 1)
        return inverted(self.model, self.parameters.values, force, angle, speed, moisture, missed)

    def _parameter_force_sd(self, flow: Array, throw: Throw | None) -> Array:
        """Standard deviation of the predicted force from the parameters' covariance, N. throw: with a set of parameters as they
        are and one for each step."""
        if throw is None:
            return np.zeros(flow.shape)
        force = throw.momentum(np.nan_to_num(flow)[..., None] / throw.passes_per_s) * throw.passes_per_s
        with np.errstate(divide="ignore", invalid="ignore"):
            jacobian = np.where(self._steps > 0.0, (force[..., 1:] - force[..., :1]) / self._steps, 0.0)
        variance = np.zeros(flow.shape)
        for i in range(jacobian.shape[-1]):
            for j in range(jacobian.shape[-1]):
                variance = variance + jacobian[..., i] * jacobian[..., j] * self.parameters.covariance[i, j]
        return np.sqrt(np.maximum(variance, 0.0))


def inverted(
    model: ForwardModel,
    values: Mapping[str, float],
    force_n: Array,
    plate_angle_rad: Array,
    elevator_speed_rad_s: Array,
    moisture_pct: Array | None = None,
    miss_rotation_rad: AnyArray | None = None,
) -> tuple[Array, Array]:
    """`invert_force` of arrays of one shape, begun near its end where the load curve of these values is at hand.

    miss_rotation_rad: (n, 1, 1), of the settings one after the other, where another throw has found it.
    """
    if model.needs_moisture:
        return invert_force(_throw(model, values, plate_angle_rad, elevator_speed_rad_s, moisture_pct), force_n)
    shape = force_n.shape
    if not force_n.size:
        return np.empty(shape), np.empty(shape)
    rows = [column.ravel() for column in (force_n, plate_angle_rad, elevator_speed_rad_s)]
    near = _curves_of(model, tuple(values.items())).near(*rows[1:])
    sure = decided_by(near, rows[0], model.machine.passes_per_s(rows[2]))
    flow, gain = np.empty(sure.shape), np.empty(sure.shape)
    for part, curve in ((sure, near[sure]), (~sure, None)):
        if part.any():
            force, angle, speed = (column[part] for column in rows)
            missed = None if miss_rotation_rad is None else miss_rotation_rad[part]
            flow[part], gain[part] = invert_force(_throw(model, values, angle, speed, None, missed), force, near=curve)
    return flow.reshape(shape), gain.reshape(shape)


def _throw(
    model: ForwardModel,
    values: Mapping[str, float],
    angle: ArrayLike,
    speed: ArrayLike,
    moisture: ArrayLike | None,
    miss_rotation_rad: AnyArray | None = None,
) -> Throw:
    return model.throw(
        np.asarray(angle)[..., None],
        np.asarray(speed)[..., None],
        values,
        None if moisture is None else np.asarray(moisture)[..., None],
        miss_rotation_rad=miss_rotation_rad,
    )


@lru_cache(maxsize=4)
def _curves_of(model: ForwardModel, values: tuple[tuple[str, float], ...]) -> LoadCurves:
    """One for all estimators of the same values, whatever is known of their errors."""
    return LoadCurves(partial(_curve, model, dict(values)))


def _curve(model: ForwardModel, values: Mapping[str, float], plate_angle_rad: Array, elevator_speed_rad_s: Array) -> Array:
    momentum = model.throw(plate_angle_rad[:, None], elevator_speed_rad_s[:, None], values).load_curve(_GRID)[1]
    return np.asarray(np.broadcast_to(momentum, (plate_angle_rad.size, _GRID.size)))


def _slope_at(mass: Array, masses: Array, momentum: Array) -> Array:
    """d(momentum)/d(mass) (..., 1) at a mass by the parabola through three neighbours (..., 3); the masses a second cancel in
    d(force)/d(flow)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.diff(momentum) / np.diff(masses)
        bend = np.diff(slopes) / (masses[..., 2:] - masses[..., :1])
        return np.asarray(slopes[..., :1] + bend * (2.0 * mass - masses[..., :1] - masses[..., 1:2]))


def _inverse_interpolation(values: Array, places: Array, goal: Array) -> Array:
    """Place at which a function through (places, values) takes the value goal; Lagrange in the values, along the last axis."""
    gaps = values[..., :, None] - values[..., None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (goal[..., None] - values[..., None, :]) / gaps
        total = np.sum(places * np.prod(np.where(_DIAGONAL, 1.0, ratios), axis=-1), axis=-1, keepdims=True)
    return np.where(np.isfinite(total), total, 0.5 * (places[..., 1:2] + places[..., 2:3]))
