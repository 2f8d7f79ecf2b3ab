"""Volume flow of grain from the shape of the paddles' pulses.

The mean force gives flow only together with density and impact gain: (flow, density, 1 + e) -> (a, a, 1/a) changes no sample. But
how deep a heap is, and with it when its grain arrives, depends on flow / density alone. This module fits the forward model's
pulses (`yieldmon.physics.pulse`) to the harmonics of the paddle pattern and gives that quotient, the volume flow, with its
covariance; the pulses' size is left free. Source: Gauss-Newton with Gaussian priors; for the term of the model's own
error Kennedy and O'Hagan, J. R. Statist. Soc. B 63 (2001).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import AnyArray, Array
from yieldmon.physics.pulse import Arrivals, arrivals, spectrum

from .arrival_expansion import SHAPES, ArrivalExpansions, Expanded, spectrum_and_slopes

SHAPE_NAMES = ("log_volume_flow", "log_friction", "log_shape_ratio", "log_stretch", "log_tail")
"""Parameters that move the pulse before the cell; natural logarithms, so that a change is a relative one."""

COMMON_NAMES = (*SHAPE_NAMES, "log_cell", "shift_s", "log_gain")
"""All parameters but the paddles' own scatter, which follow as scatter_1, scatter_2, ... in the order of the pattern."""

_FLOW, _STRETCH, _TAIL, _CELL, _SHIFT, _GAIN = 0, 3, 4, 5, 6, 7
_SHAPES = len(SHAPE_NAMES)
_TYPICAL_LOG_TAIL = float(np.log(0.004))
_STEP = 1e-4
_LARGEST_STEP = 0.4
_SETTLED = 1e-3
"""Squared length of the last step, in posterior standard deviations; the model is not computed anew for so short a one."""
_WEIGHED_ANEW = 3
"""Steps with weights of their own; from then on they stay, so that the fit settles."""
_PARTS = (1.0, 0.5, 0.25, 0.1)
"""Of a step, tried until the fit is better."""
_SCAN = np.geomspace(0.06, 0.9, 16)
"""Fills (load over a full paddle) at which a start is looked for."""
_SHIFTS = 256
_SIDE_BY_SIDE = 32
"""Windows fitted at once: enough to share the cost of array operations, few enough for the cache."""
_INDEX_REACH_S = 0.015
_LEAST_FILL = 0.02
BEYOND_FILL = 1.1
BEYOND_SPEED = 1.1
BEYOND_ANGLE_RAD = float(np.deg2rad(5.0))
TERMS = 14
"""Of an `ArrivalLaw`."""
ONE_GRAIN = 6
"""The first terms of a law: those that loads and plate angles of one grain at one speed can tell apart."""
SEVERAL_GRAINS = (tuple(range(TERMS)), (0, 1, 2, 3, 4, 8, 9), (0, 1, 2, 3, 4, 5, 8, 9))
"""Terms of stretch, tail and delay for a calibration over loads, plate angles, speeds and frictions."""


class ShapeVerdict(IntEnum):
    """Whether the pulses' shape gives a volume flow, else what stands in the way."""

    NOT_LOOKED_AT = 0
    USED = 1
    NO_SAMPLES = 2
    NO_GRAIN = 3
    NOT_STILL = 4
    NO_PULSES = 5
    FEW_TURNS = 6
    OUTSIDE_CALIBRATION = 7


@dataclass(frozen=True, slots=True)
class ArrivalLaw:
    """How a dense stream's arrival differs from that of straight paths, as a calibration found it.

    ln stretch and ln tail are each a sum of coefficients times, in this order,

        1, x, c, xc, c^2, x^2, xc^2, x^2 c, r, p, xr, xp, cr, cp

    x: ln of load over a full paddle, c: cosine of the plate angle, r and p: ln of elevator speed and of friction over those of
    `reference`. Coefficients not given are 0. Stretch: time over which the stream arrives over that of straight paths, for
    grain that strikes grain. Tail: mean time (s) for which grain goes on pushing once its path has met the plate, exponentially
    distributed.

    Attributes
    ----------
    stretch : tuple of float
    tail : tuple of float or None
        None: no tail.
    covariance : tuple of 3 float
        Of ln stretch and ln tail about the laws: variance, variance, covariance.
    delay : tuple of float
        Mean delay (s) of the whole pulse, in the same terms; only where an index gives the paddles' place.
    delay_sd_s : float
        Standard deviation about it.
    reference : tuple of 2 float
        Elevator speed (rad/s) and friction at which r and p are 0.
    fills : tuple of 2 float
        Least and largest load over a full paddle that was calibrated; (0, inf) where the law is not from a calibration.
    plate_angles_rad, elevator_speeds_rad_s : tuple of 2 float
        The same for plate angle and elevator speed.
    """

    stretch: tuple[float, ...] = ()
    tail: tuple[float, ...] | None = None
    covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay: tuple[float, ...] = ()
    delay_sd_s: float = 0.0
    reference: tuple[float, float] = (400.0 * RPM, 0.3)
    fills: tuple[float, float] = (0.0, float("inf"))
    plate_angles_rad: tuple[float, float] = (-float("inf"), float("inf"))
    elevator_speeds_rad_s: tuple[float, float] = (0.0, float("inf"))

    def conditions(
        self, plate_angle_rad: ArrayLike, elevator_speed_rad_s: ArrayLike, friction: float
    ) -> tuple[Array, Array, Array]:
        """c, r and p of the laws; angles and speeds broadcast against fills."""
        speed, usual = self.reference
        cosine, faster = np.cos(plate_angle_rad), np.log(np.asarray(elevator_speed_rad_s) / speed)
        return np.asarray(cosine), np.asarray(faster), np.asarray(np.log(friction / usual))

    def delay_s(self, fill: AnyArray, conditions: tuple[Array, Array, Array]) -> Array:
        """Mean delay at fills, s."""
        return _law(self.delay, fill, conditions)[0]

    def log_stretch(self, fill: AnyArray, conditions: tuple[Array, Array, Array]) -> Array:
        """ln stretch at fills."""
        return _law(self.stretch, fill, conditions)[0]

    def tail_s(self, fill: AnyArray, conditions: tuple[Array, Array, Array]) -> Array:
        """Tail at fills, s."""
        if self.tail is None:
            return np.zeros(np.shape(fill))
        return np.asarray(np.exp(_law(self.tail, fill, conditions)[0]))

    def outside(self, fill: float, plate_angle_rad: float, elevator_speed_rad_s: float) -> str:
        """Why the law says nothing there; empty where it does.

        Values may lie beyond those of the calibration by BEYOND_FILL, BEYOND_SPEED (factors) and BEYOND_ANGLE_RAD.
        """
        least, largest = self.fills
        if not least / BEYOND_FILL <= fill <= largest * BEYOND_FILL:
            return f"load {fill:.2f} of a full paddle, calibrated {least:.2f} to {largest:.2f}"
        low, high = self.plate_angles_rad
        if not low - BEYOND_ANGLE_RAD <= plate_angle_rad <= high + BEYOND_ANGLE_RAD:
            shown, first, last = np.rad2deg([plate_angle_rad, low, high])
            return f"plate at {shown:.0f} deg, calibrated {first:.0f} to {last:.0f} deg"
        slow, fast = self.elevator_speeds_rad_s
        if not slow / BEYOND_SPEED <= elevator_speed_rad_s <= fast * BEYOND_SPEED:
            shown, first, last = np.array([elevator_speed_rad_s, slow, fast]) / RPM
            return f"elevator at {shown:.0f} rpm, calibrated {first:.0f} to {last:.0f} rpm"
        return ""


def _features(fill: float, conditions: tuple[Array, Array, Array]) -> Array:
    x = float(np.log(min(max(fill, _LEAST_FILL), 1.0)))
    c, r, p = (float(v) for v in conditions)
    return np.array([1.0, x, c, x * c, c * c, x * x, x * c * c, x * x * c, r, p, x * r, x * p, c * r, c * p])


def _law(coefficients: tuple[float, ...], fill: AnyArray, conditions: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """A law's value at fills, and its derivative by ln fill."""
    k = (*coefficients, *(0.0,) * (TERMS - len(coefficients)))
    c, r, p = conditions
    one = k[0] + c * (k[2] + k[4] * c) + k[8] * r + k[9] * p + c * (k[12] * r + k[13] * p)
    line = k[1] + c * (k[3] + k[6] * c) + k[10] * r + k[11] * p
    square = k[5] + k[7] * c
    log_fill = np.log(np.minimum(np.maximum(fill, _LEAST_FILL), 1.0))
    inside = (fill >= _LEAST_FILL) & (fill <= 1.0)
    return np.asarray(one + log_fill * (line + square * log_fill)), np.where(inside, line + 2.0 * square * log_fill, 0.0)


@dataclass(frozen=True, slots=True)
class PulseSettings:
    """What is known of machine and cell before a pulse is seen.

    Attributes
    ----------
    harmonics : int
        Harmonics of the paddle pattern that are fitted.
    model_error : float
        Standard deviation of the model's own error, relative, at each harmonic; it does not average out over windows.
    edge_release : float
        1: the housing ends at the release angle; 0: it lets the whole heap go at once.
    cell_response_s : float
        Time constant of plate and cell, critically damped; 0 for none.
    scatter : float
        Relative standard deviation of one pulse's impulse about what its load gives.
    vibration_n : float
        Amplitude of vibration at paddle passing that is not known, N.
    arrival : ArrivalLaw
        From a calibration (`calibrate_arrival`); straight paths where none was made.
    indexed : bool
        The phase of the pattern is counted from an index on the chain: shifts are small and the arrival law's delay holds.
    sd : mapping
        Prior standard deviations of the parameters by name (relative for log_*, s for shift_s); 0 holds one fixed.
    """

    harmonics: int = 24
    model_error: float = 0.05
    edge_release: float = 1.0
    cell_response_s: float = 0.008
    scatter: float = 0.07
    vibration_n: float = 3.0
    arrival: ArrivalLaw = field(default_factory=ArrivalLaw)
    indexed: bool = False
    sd: Mapping[str, float] = field(
        default_factory=lambda: {
            "log_volume_flow": 1.5,
            "log_friction": 0.3,
            "log_shape_ratio": 0.02,
            "log_cell": 0.2,
            "shift_s": 0.05,
            "log_gain": 3.0,
        }
    )


@dataclass(frozen=True, slots=True)
class PatternWave:
    """Harmonics of the force over the paddle pattern.

    Attributes
    ----------
    amplitudes_n : ndarray (k,)
        Complex: mean of F(t) exp(-i w_k t) for the harmonics 1 .. k, N.
    noise_n : ndarray (k,)
        Standard deviation of real and imaginary part each, from noise that averages out over time, N.
    patterns : float
        Repeats of the pattern that were averaged.
    elevator_speed_rad_s, plate_angle_rad : float
    """

    amplitudes_n: AnyArray
    noise_n: Array
    patterns: float
    elevator_speed_rad_s: float
    plate_angle_rad: float


@dataclass(frozen=True)
class PulseEstimate:
    """Parameters of a window's pulses.

    Attributes
    ----------
    volume_flow_m3_s : float
        Mass flow over bulk density on the paddle.
    relative_sd, random_sd : float
        Standard deviation of its logarithm: whole, and the part that averages out over windows.
    values : dict
        All parameters by name.
    names, covariance :
        Order and posterior covariance (n, n).
    misfit : float
        Mean square of the residuals in their own standard deviations, model error included; about 1 where the model holds.
    relative_residual : float
        Root of the summed squares of the residual harmonics over that of the harmonics.
    converged : bool
    outside : str
        Why the volume flow is not to be used: the fit lies outside the loads, plate angles or speeds of the arrival law's
        calibration.
        Empty where it lies inside.
    """

    volume_flow_m3_s: float
    relative_sd: float
    random_sd: float
    values: dict[str, float]
    names: tuple[str, ...]
    covariance: Array
    misfit: float
    relative_residual: float
    converged: bool
    outside: str = ""

    def standard_deviation(self, name: str) -> float:
        """Posterior standard deviation of a parameter."""
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


@dataclass(frozen=True, slots=True)
class Linear:
    """Model at points: harmonics (m, k), derivatives (m, k, n), and the size (m, k) to which the model's error is relative."""

    waves: AnyArray
    jacobian: AnyArray
    envelope: Array

    def put(self, rows: AnyArray, others: Linear) -> None:
        """Take these rows from others."""
        self.waves[rows], self.jacobian[rows], self.envelope[rows] = others.waves, others.jacobian, others.envelope

    def at(self, rows: AnyArray) -> Linear:
        """Some of the points."""
        return Linear(self.waves[rows], self.jacobian[rows], self.envelope[rows])


class PulseModel:
    """Harmonics of the paddle pattern as a function of volume flow, friction, heap shape, cell and time shift.

    Parameters
    ----------
    model : ForwardModel
        Machine and named effects.
    parameters : mapping
        Grain and effects by name; friction and shape_ratio are the priors' means. density only sets what mass a volume has for
        effects that act on mass, and the gain is free.
    settings : PulseSettings
    """

    def __init__(self, model: ForwardModel, parameters: Mapping[str, float], settings: PulseSettings | None = None) -> None:
        self.model = model
        self.machine: Machine = model.machine
        self.parameters = dict(parameters)
        self.settings = settings or PulseSettings()
        self._gaps = np.asarray(self.machine.paddle_spacings_m)
        self.names = (*COMMON_NAMES, *(f"scatter_{i + 1}" for i in range(len(self._gaps))))
        self._places = np.cumsum(self._gaps)
        size = self.machine.paddle_width_m * self.machine.paddle_length_m**2
        self.full_paddle_kg = 0.5 * self.parameters["shape_ratio"] * self.parameters["density"] * size
        self._free_shapes: list[int] = np.flatnonzero(self.prior_sd(1.0)[:_SHAPES] > 0.0).tolist()
        self._own_scatter = np.array([name.startswith("scatter_") for name in self.names])
        self._expansions = ArrivalExpansions(self._arrivals)

    def fundamental_rad_s(self, elevator_speed_rad_s: float) -> float:
        """Angular frequency of the paddle pattern."""
        return 2.0 * np.pi * self.machine.paddle_speed_m_s(elevator_speed_rad_s) / self.machine.pattern_length_m

    def start(self, volume_flow_m3_s: float, *, shift_s: float = 0.0, log_gain: float = 0.0) -> Array:
        """Parameter vector of the priors' means at a volume flow."""
        s, p = self.settings, self.parameters
        cell = np.log(s.cell_response_s) if s.cell_response_s > 0.0 else -np.inf
        head = [np.log(volume_flow_m3_s), np.log(p["friction"]), np.log(p["shape_ratio"]), 0.0, 0.0, cell, shift_s, log_gain]
        return np.array([*head, *np.zeros(len(self._gaps))])

    def prior_sd(self, patterns: float) -> Array:
        """Prior standard deviations (n,); the paddles' scatter shrinks with the patterns averaged."""
        own = self.settings.scatter / np.sqrt(max(patterns, 1.0))
        sd, law = dict(self.settings.sd), self.settings.arrival.covariance
        sd |= {"log_stretch": np.sqrt(law[0]), "log_tail": np.sqrt(law[1])}
        if self.settings.cell_response_s <= 0.0:
            sd["log_cell"] = 0.0
        if self.settings.indexed and self.settings.arrival.delay_sd_s > 0.0:
            sd["shift_s"] = self.settings.arrival.delay_sd_s
        return np.array([*(float(sd[name]) for name in COMMON_NAMES), *np.full(len(self._gaps), own)])

    def prior_precision(self, patterns: float) -> Array:
        """Inverse prior covariance (n, n); zero rows for what is held."""
        sd = self.prior_sd(patterns)
        free = sd > 0.0
        precision = np.diag(np.where(free, np.where(free, sd, 1.0) ** -2.0, 0.0))
        first, second, both = self.settings.arrival.covariance
        if first > 0.0 and second > 0.0:
            block = np.array([[second, -both], [-both, first]]) / (first * second - both * both)
            precision[_STRETCH : _TAIL + 1, _STRETCH : _TAIL + 1] = block
        return precision

    def _arrivals(self, points: Array) -> Arrivals:
        """Arrivals (m, paddles, nodes) at points (m, 5): ln volume flow, ln friction, ln shape ratio, ln speed, plate angle."""
        flow, friction, ratio, speed_rad_s = (np.exp(points[:, i])[:, None] for i in range(4))
        values: dict[str, object] = dict(self.parameters)
        values["friction"], values["shape_ratio"] = friction, ratio
        throw = self.model.throw(points[:, 4:5], speed_rad_s, values)  # type: ignore[arg-type]
        mass = flow * self.parameters["density"] * self._gaps / self.machine.paddle_speed_m_s(speed_rad_s)
        return arrivals(throw, mass, edge_release=self.settings.edge_release)

    def _fill(self, flow: Array, elevator_speed_rad_s: ArrayLike) -> Array:
        """Loads over a full paddle; flow and speed broadcast against the paddles."""
        mass = flow * self.parameters["density"] * self._gaps / self.machine.paddle_speed_m_s(np.asarray(elevator_speed_rad_s))
        return np.asarray(mass / self.full_paddle_kg)

    def mean_fill(self, volume_flow_m3_s: float, elevator_speed_rad_s: float) -> float:
        """Load over a full paddle, mean of the paddles."""
        return float(self._fill(np.asarray(volume_flow_m3_s), elevator_speed_rad_s).mean())

    def frequencies_rad_s(self, elevator_speed_rad_s: ArrayLike) -> Array:
        """Of the harmonics, (..., k) for speeds (...)."""
        base = 2.0 * np.pi / self.machine.pattern_length_m * self.machine.paddle_speed_m_s(np.asarray(elevator_speed_rad_s))
        return np.asarray(base[..., None] * np.arange(1.0, self.settings.harmonics + 1.0))

    def shapes(self, theta: Array, elevator_speed_rad_s: float, plate_angle_rad: float) -> AnyArray:
        """Spectra (batch, paddles, k) of pulses before the cell for shape parameters theta (batch, 5)."""
        flow, stretch, tail = (np.exp(theta[:, i])[:, None] for i in (_FLOW, _STRETCH, _TAIL))
        given = np.broadcast_to([np.log(elevator_speed_rad_s), plate_angle_rad], (len(theta), 2))
        parts = self._arrivals(np.concatenate((theta[:, :SHAPES], given), axis=1))
        omega = self.frequencies_rad_s(elevator_speed_rad_s)
        fill, law = self._fill(flow, elevator_speed_rad_s), self.settings.arrival
        where = law.conditions(plate_angle_rad, elevator_speed_rad_s, self.parameters["friction"])
        waves = spectrum(parts, omega, stretch * np.exp(law.log_stretch(fill, where)))
        late = (tail * law.tail_s(fill, where))[..., None]
        if self.settings.indexed:
            waves = waves * np.exp(-1j * omega * law.delay_s(fill, where)[..., None])
        return np.asarray(waves / (1.0 + 1j * omega * late))

    def _thrown(self, theta: Array, speeds_rad_s: Array, angles_rad: Array) -> AnyArray:
        """Spectra before the cell and their derivatives by the free ones of the shape's parameters, (1 + free, m, paddles, k).

        theta: (m, 5). Where arrivals have no expansion, by differences of the stages themselves.
        """
        points = np.concatenate((theta[:, :SHAPES], np.log(speeds_rad_s)[:, None], angles_rad[:, None]), axis=1)
        finite = np.flatnonzero(np.all(np.isfinite(points), axis=1))
        found = np.empty((1 + len(self._free_shapes), len(theta), self._gaps.size, self.settings.harmonics), dtype=complex)
        expanded, known = self._expansions.at(points[finite])
        rows = finite[known]
        if rows.size:
            found[:, rows] = self._of_expanded(expanded, theta[rows], speeds_rad_s[rows], angles_rad[rows])
        for row in np.setdiff1d(np.arange(len(theta)), rows).tolist():
            found[:, row] = self._by_differences(theta[row], float(speeds_rad_s[row]), float(angles_rad[row]))
        return found

    def _of_expanded(self, expanded: Expanded, theta: Array, speeds_rad_s: Array, angles_rad: Array) -> AnyArray:
        size, paddles = len(theta), self._gaps.size
        omega, law = self.frequencies_rad_s(speeds_rad_s), self.settings.arrival
        fill = self._fill(np.exp(theta[:, _FLOW])[:, None], speeds_rad_s[:, None])
        where = law.conditions(angles_rad[:, None], speeds_rad_s[:, None], self.parameters["friction"])
        log_stretch, by_fill = _law(law.stretch, fill, where)
        by_stretch = np.zeros((_SHAPES, size, paddles))
        by_stretch[_FLOW], by_stretch[_STRETCH] = by_fill, 1.0
        flat = [v.reshape(len(v), size * paddles, -1) for v in (expanded.impulse_n_s, expanded.middle_s, expanded.half_width_s)]
        waves = spectrum_and_slopes(
            Expanded(*flat),
            np.repeat(omega[:, 0], paddles),
            omega.shape[1],
            np.exp(theta[:, _STRETCH, None] + log_stretch).ravel(),
            by_stretch.reshape(_SHAPES, -1),
        ).reshape(1 + _SHAPES, size, paddles, -1)
        each = omega[:, None, :]
        if self.settings.indexed:
            delay_s, by_fill = _law(law.delay, fill, where)
            waves = waves * np.exp(-1j * (delay_s[..., None] * each))
            waves[1 + _FLOW] -= 1j * (by_fill[..., None] * each) * waves[0]
        if law.tail is not None:
            log_tail, by_fill = _law(law.tail, fill, where)
            lag = 1j * (np.exp(theta[:, _TAIL, None] + log_tail)[..., None] * each)
            waves /= 1.0 + lag
            late = lag / (1.0 + lag) * waves[0]
            waves[1 + _TAIL] -= late
            waves[1 + _FLOW] -= by_fill[..., None] * late
        return np.asarray(waves[[0, *(1 + i for i in self._free_shapes)]])

    def _by_differences(self, theta: Array, elevator_speed_rad_s: float, plate_angle_rad: float) -> AnyArray:
        """The same for one point (5,), by central differences of the stages themselves, in one batch."""
        free = self._free_shapes
        batch = np.repeat(theta[None, :_SHAPES], 1 + 2 * len(free), axis=0)
        for row, i in enumerate(free):
            batch[1 + 2 * row, i] += _STEP
            batch[2 + 2 * row, i] -= _STEP
        found = self.shapes(batch, elevator_speed_rad_s, plate_angle_rad)
        return np.concatenate((found[:1], (found[1::2] - found[2::2]) / (2.0 * _STEP)))

    def _joined(self, shapes: AnyArray, theta: Array, speeds_rad_s: Array) -> tuple[AnyArray, AnyArray]:
        """Each paddle's part of the pattern's harmonics behind the cell, and 1 + scatter applied.

        shapes: (..., m, paddles, k); theta: (m, n) or (1, n); speeds_rad_s: as many.
        """
        omega = self.frequencies_rad_s(speeds_rad_s)
        late_s = self._places / self.machine.paddle_speed_m_s(speeds_rad_s)[:, None] + theta[:, _SHIFT, None]
        size = np.exp(theta[:, _GAIN]) * (omega[:, 0] / (2.0 * np.pi))
        turn = np.exp(-1j * (late_s[..., None] * omega[:, None, :])) * size[:, None, None]
        parts = shapes * (turn * self._cell(omega, theta[:, _CELL])[:, None, :])
        return parts, parts * (1.0 + theta[:, len(COMMON_NAMES) :])[..., None]

    def _cell(self, omega: Array, log_cell: Array) -> AnyArray:
        return np.asarray(1.0 / (1.0 + 1j * (omega * np.exp(log_cell)[:, None])) ** 2)

    def waves(self, theta: Array, elevator_speed_rad_s: float, plate_angle_rad: float) -> AnyArray:
        """Harmonics (k,) of the pattern, N."""
        shapes = self.shapes(theta[None, :_SHAPES], elevator_speed_rad_s, plate_angle_rad)
        return np.asarray(self._joined(shapes, theta[None], np.array([elevator_speed_rad_s]))[1][0].sum(axis=0))

    def linearised(self, theta: Array, speeds_rad_s: Array, angles_rad: Array) -> Linear:
        """Harmonics and their derivatives: the throw's by an expansion (`ArrivalExpansions`), the rest in closed form.

        Parameters
        ----------
        theta : ndarray (m, n)
        speeds_rad_s, angles_rad : ndarray (m,)
            Elevator and plate.
        """
        return self._behind_cell(self._thrown(theta[:, :_SHAPES], speeds_rad_s, angles_rad), theta, speeds_rad_s)

    def _behind_cell(self, thrown: AnyArray, theta: Array, speeds_rad_s: Array) -> Linear:
        plain, scattered = self._joined(thrown, theta, speeds_rad_s)
        sums = scattered.sum(axis=2)
        waves = sums[0]
        omega = self.frequencies_rad_s(speeds_rad_s)
        jacobian = np.zeros((*waves.shape, len(self.names)), dtype=complex)
        jacobian[..., self._free_shapes] = np.moveaxis(sums[1:], 0, -1)
        lag = 1j * (omega * np.exp(theta[:, _CELL])[:, None])
        jacobian[..., _CELL] = -2.0 * lag / (1.0 + lag) * waves
        jacobian[..., _SHIFT] = -1j * omega * waves
        jacobian[..., _GAIN] = waves
        jacobian[..., len(COMMON_NAMES) :] = np.moveaxis(plain[0], 1, -1)
        return Linear(waves, jacobian, self._envelope(plain[0], theta, omega))

    def _envelope(self, parts: AnyArray, theta: Array, omega: Array) -> Array:
        """Size (m, k) to which the model's error is relative: that of pulses without width, behind the cell."""
        felt = np.abs(self._cell(omega, theta[:, _CELL]))
        return np.asarray(np.abs(parts[..., 0]).sum(axis=-1)[:, None] / felt[:, :1] * felt)

    def lasting_variance(self, envelope: Array) -> Array:
        """Variance (..., k) of real and imaginary part each, of what stays the same from window to window, N^2."""
        variance = 0.5 * (self.settings.model_error * envelope) ** 2
        paddles = len(self._gaps)
        if variance.shape[-1] >= paddles:
            variance[..., paddles - 1] += 0.25 * self.settings.vibration_n**2
        return np.asarray(variance)


@dataclass(frozen=True, slots=True)
class _Waves:
    """Waves of windows side by side: amplitudes and variances of what averages out (m, k), the rest (m,)."""

    amplitudes_n: AnyArray
    random: Array
    patterns: Array
    speeds_rad_s: Array
    angles_rad: Array

    @classmethod
    def of(cls, waves: Sequence[PatternWave]) -> _Waves:
        return cls(
            np.array([wave.amplitudes_n for wave in waves]),
            np.array([wave.noise_n for wave in waves]) ** 2,
            np.array([wave.patterns for wave in waves]),
            np.array([wave.elevator_speed_rad_s for wave in waves]),
            np.array([wave.plate_angle_rad for wave in waves]),
        )

    def at(self, rows: AnyArray) -> _Waves:
        """Some of them."""
        return _Waves(
            self.amplitudes_n[rows], self.random[rows], self.patterns[rows], self.speeds_rad_s[rows], self.angles_rad[rows]
        )


class _Priors:
    """Standard deviations and precisions of the priors of windows side by side.

    free: (n,), the parameters that are fitted, f of them; sd: (m, n); precision: (m, f, f).
    """

    def __init__(self, pulses: PulseModel, patterns: Array) -> None:
        own = pulses._own_scatter
        self.sd = np.tile(pulses.prior_sd(1.0), (len(patterns), 1))
        self.sd[:, own] = (pulses.settings.scatter / np.sqrt(np.maximum(patterns, 1.0)))[:, None]
        self.free: AnyArray = self.sd[0] > 0.0
        self.own: AnyArray = own[self.free]
        one = pulses.prior_precision(1.0)[np.ix_(self.free, self.free)]
        self.precision = np.tile(one, (len(patterns), 1, 1))
        places = np.flatnonzero(self.own)
        self.precision[:, places, places] = self.sd[:, self.free][:, places] ** -2.0


def estimate(
    pulses: PulseModel, wave: PatternWave, *, start: Array | None = None, centre: Array | None = None, iterations: int = 15
) -> PulseEstimate:
    """Fit the pulses to one wave.

    Parameters
    ----------
    pulses : PulseModel
    wave : PatternWave
        With `harmonics` amplitudes.
    start : ndarray (n,), optional
        Where to begin; default: looked for over all fills and shifts.
    centre : ndarray (n,), optional
        Means of the priors; default: the settings' own, at the start's flow, shift and gain.

    Returns
    -------
    PulseEstimate
        converged is False where no step settled; its values are then the last ones.
    """
    theta = look_for_start(pulses, wave) if start is None else np.array(start, dtype=float)
    mean = _own_centres(pulses, theta[None]) if centre is None else np.asarray(centre, dtype=float)[None]
    shown = _Waves.of([wave])
    if not np.all(np.isfinite(theta[pulses.prior_sd(wave.patterns) > 0.0])):
        return _nothing(pulses, theta)
    return _fitted(pulses, shown, theta[None], mean, iterations)[0]


def estimate_near(
    pulses: PulseModel, waves: Sequence[PatternWave], volume_flows_m3_s: Sequence[float], *, iterations: int = 15
) -> list[PulseEstimate]:
    """Fit the pulses to many waves side by side, each begun at a volume flow that is nearly known.

    Shift and gain are those of the best correlation over the whole pattern. An answer does not depend on the waves beside it.

    Parameters
    ----------
    pulses : PulseModel
    waves : sequence of PatternWave
    volume_flows_m3_s : sequence
        One for each wave, e.g. from the mean force.

    Returns
    -------
    list of PulseEstimate
        nan where the flow is above what the paddles hold.
    """
    found: list[PulseEstimate] = []
    for first in range(0, len(waves), _SIDE_BY_SIDE):
        part = slice(first, first + _SIDE_BY_SIDE)
        shown, flows = _Waves.of(waves[part]), np.asarray(volume_flows_m3_s[part], dtype=float)
        theta = np.tile(pulses.start(1.0), (flows.size, 1))
        theta[:, _FLOW] = np.log(flows)
        thrown = pulses._thrown(theta[:, :_SHAPES], shown.speeds_rad_s, shown.angles_rad)
        theta[:, _SHIFT], theta[:, _GAIN] = _aligned(pulses, shown, pulses._behind_cell(thrown, theta, shown.speeds_rad_s).waves)
        begun = pulses._behind_cell(thrown, theta, shown.speeds_rad_s)
        found += _fitted(pulses, shown, theta, _own_centres(pulses, theta), iterations, begun)
    return found


def _aligned(pulses: PulseModel, shown: _Waves, waves: AnyArray) -> tuple[Array, Array]:
    """Shift (s) and ln gain (m,) with which waves (m, k) come nearest; nan where none does."""
    envelope = np.abs(shown.amplitudes_n)
    lasting = pulses.lasting_variance(envelope) + 1e-6 * envelope.max(axis=1, keepdims=True) ** 2
    weight = 1.0 / (shown.random + lasting)
    products = np.zeros((len(waves), _SHIFTS), dtype=complex)
    products[:, 1 : 1 + waves.shape[1]] = weight * np.conj(waves) * shown.amplitudes_n
    fits = np.fft.ifft(products).real * _SHIFTS
    best = np.argmax(fits, axis=1)
    period_s = 2.0 * np.pi / pulses.frequencies_rad_s(shown.speeds_rad_s)[:, 0]
    shift_s = best * period_s / _SHIFTS
    if pulses.settings.indexed:
        shift_s = np.where(best > _SHIFTS // 2, shift_s - period_s, shift_s)
    size = fits[np.arange(len(waves)), best] / (weight * np.abs(waves) ** 2).sum(axis=1)
    known = size > 0.0
    return np.where(known, shift_s, np.nan), np.log(np.where(known, size, np.nan))


def _own_centres(pulses: PulseModel, theta: Array) -> Array:
    """The priors' means (m, n) at the starts' flow, shift and gain."""
    mean = np.tile(pulses.start(1.0), (len(theta), 1))
    mean[:, [_FLOW, _GAIN]] = theta[:, [_FLOW, _GAIN]]
    mean[:, _SHIFT] = 0.0 if pulses.settings.indexed else theta[:, _SHIFT]
    return mean


def _fitted(
    pulses: PulseModel, shown: _Waves, theta: Array, mean: Array, iterations: int, begun: Linear | None = None
) -> list[PulseEstimate]:
    """Gauss-Newton for windows side by side, from theta (m, n); begun: the model there."""
    priors = _Priors(pulses, shown.patterns)
    free = priors.free
    theta[:, ~free] = mean[:, ~free]
    at = pulses.linearised(theta, shown.speeds_rad_s, shown.angles_rad) if begun is None else begun
    limits = np.minimum(_LARGEST_STEP, 3.0 * np.where(free, priors.sd, 1.0))
    limits[:, _SHIFT] = np.pi / (8.0 * pulses.frequencies_rad_s(shown.speeds_rad_s)[:, 0])
    converged = np.zeros(len(theta), dtype=bool)
    variance = np.full(shown.random.shape, np.nan)
    going = np.flatnonzero(np.all(np.isfinite(theta[:, free]), axis=1))
    for turn in range(iterations):
        known = np.all(np.isfinite(at.waves[going]), axis=1)
        lost, rows = going[~known], going[known]
        if lost.size:
            theta[lost, _FLOW] -= 0.1
            at.put(lost, pulses.linearised(theta[lost], shown.speeds_rad_s[lost], shown.angles_rad[lost]))
        if rows.size:
            anew = rows if turn < _WEIGHED_ANEW else rows[np.isnan(variance[rows, 0])]
            variance[anew] = shown.random[anew] + pulses.lasting_variance(at.envelope[anew])
            step, best, settled = _step(shown, at, theta, mean, priors, variance, rows)
            done, rest = rows[settled], rows[~settled]
            theta[done] += step[settled]
            converged[done] = True
            if rest.size:
                whole = np.clip(step[~settled], -limits[rest], limits[rest])
                theta[rest] = _shortened(pulses, shown, at, theta[rest], mean, priors, variance, rest, whole, best[~settled])
            going = np.sort(np.concatenate((lost, rest)))
        if not going.size:
            break
    return _results(pulses, shown, theta, at, converged, priors)


def _step(
    shown: _Waves, at: Linear, theta: Array, mean: Array, priors: _Priors, variance: Array, rows: AnyArray
) -> tuple[Array, Array, AnyArray]:
    """Of rows: whole steps (r, n), what is to become less (r,), and whether the step is too short to go on (r,)."""
    free, prior = priors.free, priors.precision[rows]
    white, residual = _whitened(at.jacobian[rows][..., free], shown.amplitudes_n[rows] - at.waves[rows], variance[rows])
    across = white.swapaxes(1, 2)
    normal = across @ white + prior
    away = (theta - mean)[rows][:, free]
    pull = _times(prior, away)
    short: Array = np.asarray(np.linalg.solve(normal, (_times(across, residual) - pull)[..., None])[..., 0], dtype=np.float64)
    step = np.zeros((rows.size, theta.shape[1]))
    step[:, free] = short
    best = (residual * residual).sum(axis=1) + (away * pull).sum(axis=1)
    return step, best, (short * _times(normal, short)).sum(axis=1) < _SETTLED


def _shortened(
    pulses: PulseModel, shown: _Waves, at: Linear, theta: Array, mean: Array, priors: _Priors, variance: Array, rows: AnyArray,
    whole: Array, best: Array,
) -> Array:  # fmt: skip
    """theta (r, n) of rows after the longest part of the whole step that makes the fit better; `at` is put there."""
    tried, left = theta.copy(), np.arange(rows.size)
    for part in _PARTS:
        those = rows[left]
        tried[left] = theta[left] + part * whole[left]
        there = pulses.linearised(tried[left], shown.speeds_rad_s[those], shown.angles_rad[those])
        at.put(those, there)
        away = (tried[left] - mean[those])[:, priors.free]
        off = (np.abs(shown.amplitudes_n[those] - there.waves) ** 2 / variance[those]).sum(axis=1)
        left = left[~(off + (away * _times(priors.precision[those], away)).sum(axis=1) < best[left])]
        if not left.size:
            break
    return tried


def _times(matrices: Array, vectors: Array) -> Array:
    """Products (m, a) of matrices (m, a, b) and vectors (m, b)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _whitened(jacobian: AnyArray, off_n: AnyArray, variance: Array) -> tuple[Array, Array]:
    """Derivatives (m, 2 k, n) and residuals (m, 2 k), real parts first, in standard deviations."""
    weight = 1.0 / np.sqrt(variance)
    residual, slopes = off_n * weight, jacobian * weight[..., None]
    return np.concatenate((slopes.real, slopes.imag), axis=1), np.concatenate((residual.real, residual.imag), axis=1)


def _covariances(white: Array, random: Array, variance: Array, priors: _Priors) -> tuple[Array, Array]:
    """Posterior covariances (m, n, n), zero for fixed parameters, and the part of them that comes from what averages out.

    white: derivatives (m, 2 k, f) by the free parameters.
    """
    across = white.swapaxes(1, 2)
    small = np.linalg.inv(across @ white + priors.precision)
    share = random / variance
    both = np.concatenate((share, share), axis=1)
    noise = across @ (both[..., None] * white)
    # The paddles' scatter is drawn anew in every window, as noise is.
    places = np.flatnonzero(priors.own)
    noise[:, places, places] += priors.precision[:, places, places]
    count, n = priors.sd.shape
    full, averaging = (np.zeros((count, n, n)) for _ in range(2))
    inside = np.ix_(np.arange(count), np.flatnonzero(priors.free), np.flatnonzero(priors.free))
    full[inside], averaging[inside] = small, small @ noise @ small
    return full, averaging


def _nothing(pulses: PulseModel, theta: Array) -> PulseEstimate:
    nan, n = float("nan"), theta.size
    values = dict(zip(pulses.names, theta.tolist(), strict=True))
    return PulseEstimate(nan, nan, nan, values, pulses.names, np.full((n, n), nan), nan, nan, False)


def _results(
    pulses: PulseModel, shown: _Waves, theta: Array, at: Linear, converged: AnyArray, priors: _Priors
) -> list[PulseEstimate]:
    known = np.all(np.isfinite(at.waves), axis=1) & np.all(np.isfinite(theta[:, priors.free]), axis=1)
    if not known.any():
        return [_nothing(pulses, row) for row in theta]
    if not known.all():
        # What has no value must not reach the inverses.
        rows = np.flatnonzero(known)
        kept = _results(pulses, shown.at(rows), theta[rows], at.at(rows), converged[rows], _Priors(pulses, shown.patterns[rows]))
        fits = iter(kept)
        return [next(fits) if good else _nothing(pulses, row) for good, row in zip(known.tolist(), theta, strict=True)]
    variance = shown.random + pulses.lasting_variance(at.envelope)
    off_n = shown.amplitudes_n - at.waves
    white, residual = _whitened(at.jacobian[..., priors.free], off_n, variance)
    covariance, averaging = _covariances(white, shown.random, variance, priors)
    misfit = np.mean(residual**2, axis=1)
    sd = np.sqrt(covariance[:, _FLOW, _FLOW] * np.maximum(1.0, misfit))
    size = np.sqrt((np.abs(shown.amplitudes_n) ** 2).sum(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(size > 0.0, np.sqrt((np.abs(off_n) ** 2).sum(axis=1)) / size, np.nan)
    flows = np.exp(theta[:, _FLOW])
    fills = pulses._fill(flows[:, None], shown.speeds_rad_s[:, None]).mean(axis=1)
    law = pulses.settings.arrival
    columns = (
        flows,
        sd,
        np.sqrt(averaging[:, _FLOW, _FLOW]),
        misfit,
        left,
        converged,
        fills,
        shown.angles_rad,
        shown.speeds_rad_s,
    )
    return [
        PulseEstimate(
            volume_flow_m3_s=flow,
            relative_sd=relative_sd,
            random_sd=random_sd,
            values=dict(zip(pulses.names, values, strict=True)),
            names=pulses.names,
            covariance=posterior,
            misfit=off,
            relative_residual=rest,
            converged=good,
            outside=law.outside(fill, angle, speed),
        )
        for values, posterior, (flow, relative_sd, random_sd, off, rest, good, fill, angle, speed) in zip(
            theta.tolist(), covariance, zip(*(column.tolist() for column in columns), strict=True), strict=True
        )
    ]


def information(
    pulses: PulseModel, theta: Array, *, elevator_speed_rad_s: float, plate_angle_rad: float, noise_n: Array, patterns: float
) -> tuple[Array, Array]:
    """What a window can determine, before it is measured: posterior covariance and its part that averages out, both (n, n).

    Parameters
    ----------
    theta : ndarray (n,)
        Parameters at which, in the order of `pulses.names`.
    noise_n : ndarray (k,)
        As in `PatternWave`.
    """
    at = pulses.linearised(theta[None], np.array([elevator_speed_rad_s]), np.array([plate_angle_rad]))
    priors, random = _Priors(pulses, np.array([patterns])), noise_n[None] ** 2
    variance = random + pulses.lasting_variance(at.envelope)
    white, _ = _whitened(at.jacobian[..., priors.free], at.waves, variance)
    full, averaging = _covariances(white, random, variance, priors)
    return full[0], averaging[0]


def sample_noise_n(
    pulses: PulseModel, *, sample_sd_n: float, samples: float, shot_n2_s: float = 0.0, duration_s: float = 1.0
) -> Array:
    """noise_n of a wave averaged from `samples` samples of white noise, and of shot noise of a given density over duration_s."""
    variance = 0.5 * sample_sd_n**2 / samples + 0.5 * shot_n2_s / duration_s
    return np.full(pulses.settings.harmonics, np.sqrt(variance))


def look_for_start(pulses: PulseModel, wave: PatternWave) -> Array:
    """Fill, shift and gain that come nearest, over all fills and all shifts of the pattern."""
    speed, angle = wave.elevator_speed_rad_s, wave.plate_angle_rad
    p, machine = pulses.parameters, pulses.machine
    flows = _SCAN * pulses.full_paddle_kg / p["density"] * machine.paddle_speed_m_s(speed) / machine.paddle_spacing_m
    batch = np.repeat(pulses.start(1.0)[None, :_SHAPES], flows.size, axis=0)
    batch[:, 0] = np.log(flows)
    waves = pulses._joined(pulses.shapes(batch, speed, angle), pulses.start(1.0)[None], np.array([speed]))[0].sum(axis=1)
    known = np.all(np.isfinite(waves), axis=1)
    waves = np.where(known[:, None], waves, 0.0)
    envelope = np.abs(wave.amplitudes_n)
    weight = 1.0 / (wave.noise_n**2 + pulses.lasting_variance(envelope) + 1e-6 * envelope.max() ** 2)
    shift = np.arange(_SHIFTS) * (2.0 * np.pi / pulses.fundamental_rad_s(speed) / _SHIFTS)
    omega = pulses.fundamental_rad_s(speed) * np.arange(1.0, wave.amplitudes_n.size + 1.0)
    product = (weight * np.conj(waves) * wave.amplitudes_n) @ np.exp(1j * np.outer(omega, shift))
    size = (weight * np.abs(waves) ** 2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(known[:, None] & (product.real > 0.0), product.real / size[:, None], np.nan)
        fitted = np.where(np.isfinite(gain), gain * product.real, -np.inf)
    if pulses.settings.indexed:
        period = 2.0 * np.pi / pulses.fundamental_rad_s(speed)
        shift = np.where(shift > 0.5 * period, shift - period, shift)
        fitted = np.where(np.abs(shift) < _INDEX_REACH_S, fitted, -np.inf)
    row, column = np.unravel_index(int(np.argmax(fitted)), fitted.shape)
    size_there = float(gain[row, column])
    found = float(np.log(size_there)) if size_there > 0.0 else float("nan")
    return pulses.start(float(flows[row]), shift_s=float(shift[column]), log_gain=found)


def calibrate_arrival(
    pulses: PulseModel | Sequence[PulseModel],
    waves: Sequence[PatternWave],
    volume_flows_m3_s: Sequence[float],
    *,
    terms: int | tuple[Sequence[int], Sequence[int], Sequence[int]] = 2,
) -> ArrivalLaw:
    """The arrival law that waves at known volume flows follow.

    Parameters
    ----------
    pulses : PulseModel or sequence
        One, or one for each wave where their grain differs. Its own arrival law is not used; friction, shape_ratio and cell are
        held at their means.
    waves, volume_flows_m3_s : sequences
        More than terms.
    terms : int or tuple
        Which coefficients of stretch, tail and delay are free: so many of the first `ArrivalLaw` names, or their places, as
        `SEVERAL_GRAINS`. One plate angle determines two.

    Returns
    -------
    ArrivalLaw
        covariance from the residuals; fills, plate_angles_rad and elevator_speeds_rad_s those of the waves.

    Raises
    ------
    ValueError
        For too few waves.
    """
    chosen = tuple(tuple(range(terms)) for _ in range(3)) if isinstance(terms, int) else terms
    most = max(map(len, chosen))
    if len(waves) <= most:
        raise ValueError(f"{len(waves)} waves, expected more than {most}, the terms of the law")
    models = [pulses] * len(waves) if isinstance(pulses, PulseModel) else list(pulses)
    wide = ArrivalLaw(tail=(_TYPICAL_LOG_TAIL,), covariance=(0.3**2, 0.7**2, 0.0))
    rows, targets, fills = [], [], []
    for model, wave, flow in zip(models, waves, volume_flows_m3_s, strict=True):
        sd = {**model.settings.sd, "log_volume_flow": 0.0, "log_friction": 0.0, "log_shape_ratio": 0.0, "log_cell": 0.0}
        fit = _at_flow(PulseModel(model.model, model.parameters, replace(model.settings, arrival=wide, sd=sd)), wave, flow)
        fills.append(model.mean_fill(flow, wave.elevator_speed_rad_s))
        where = wide.conditions(wave.plate_angle_rad, wave.elevator_speed_rad_s, model.parameters["friction"])
        rows.append(_features(fills[-1], where))
        targets.append((fit.values["log_stretch"], fit.values["log_tail"] + _TYPICAL_LOG_TAIL, fit.values["shift_s"]))
    laws, left = [], []
    for places, target in zip(chosen, np.array(targets).T, strict=True):
        table = np.array(rows)[:, list(places)]
        found = np.linalg.lstsq(table, target, rcond=None)[0]
        whole = np.zeros(TERMS)
        whole[list(places)] = found
        laws.append(tuple(float(v) for v in whole))
        left.append((target - table @ found) / np.sqrt(len(waves) - len(places)))
    spread, indexed = np.array(left) @ np.array(left).T, models[0].settings.indexed
    angles, speeds = [wave.plate_angle_rad for wave in waves], [wave.elevator_speed_rad_s for wave in waves]
    return ArrivalLaw(
        laws[0],
        laws[1],
        (float(spread[0, 0]), float(spread[1, 1]), float(spread[0, 1])),
        delay=laws[2] if indexed else (),
        delay_sd_s=float(np.sqrt(spread[2, 2])) if indexed else 0.0,
        fills=(min(fills), max(fills)),
        plate_angles_rad=(min(angles), max(angles)),
        elevator_speeds_rad_s=(min(speeds), max(speeds)),
    )


def _at_flow(pulses: PulseModel, wave: PatternWave, volume_flow_m3_s: float) -> PulseEstimate:
    """The fit with the flow held."""
    near = look_for_start(pulses, wave)
    begin = pulses.start(volume_flow_m3_s, shift_s=float(near[_SHIFT]), log_gain=float(near[_GAIN]))
    return estimate(pulses, wave, start=begin, centre=begin.copy())


def select(names: Sequence[str], covariance: Array, chosen: Sequence[str]) -> Array:
    """The covariance of some parameters."""
    index = [names.index(name) for name in chosen]
    return np.asarray(covariance[np.ix_(index, index)])
