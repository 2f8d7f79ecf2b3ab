"""Harmonics of the paddle pattern's force, as a function of volume flow, friction, heap shape, cell, time shift and gain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import AnyArray, Array
from yieldmon.physics.pulse import Arrivals, arrivals, spectrum

from .arrival_expansion import SHAPES, ArrivalExpansions, Expanded, spectrum_and_slopes
from .arrival_law import ArrivalLaw, law_and_slope

SHAPE_NAMES = ("log_volume_flow", "log_friction", "log_shape_ratio", "log_stretch", "log_tail")
"""Parameters of the pulse before the cell; natural logarithms, so that changes are relative."""

COMMON_NAMES = (*SHAPE_NAMES, "log_cell", "shift_s", "log_gain")
"""All parameters except the scatter of each paddle; these follow as scatter_1, scatter_2, ... in the order of the pattern."""

FLOW, STRETCH, TAIL, CELL, SHIFT, GAIN = 0, 3, 4, 5, 6, 7
"""Indices of parameters among these names."""
SHAPE_COUNT = len(SHAPE_NAMES)
_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class PulseSettings:
    """Priors of machine and cell.

    Attributes
    ----------
    harmonics : int
        Harmonics of the paddle pattern that are fitted.
    model_error : float
        Relative standard deviation of the model error at each harmonic; it does not average out over windows.
    edge_release : float
        1: the housing ends at the release angle; 0: it releases the whole heap at once.
    cell_response_s : float
        Time constant of plate and cell, critically damped; 0 for none.
    scatter : float
        Relative standard deviation of a pulse's impulse about that of its load.
    vibration_n : float
        Unknown amplitude of vibration at the paddle passing frequency, N.
    arrival : ArrivalLaw
        From a calibration (`arrival_calibration.law_of`); default: straight paths.
    indexed : bool
        The phase of the pattern is relative to an index on the chain: shifts are small and the arrival law's delay applies.
    sd : mapping
        Prior standard deviations of the parameters by name (relative for log_*, s for shift_s); 0: fixed.
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
class Linear:
    """Linearised model: harmonics (m, k), derivatives (m, k, n), and the amplitude (m, k) to which the model error is
    relative."""

    waves: AnyArray
    jacobian: AnyArray
    envelope: Array

    def put(self, rows: AnyArray, others: Linear) -> None:
        """Replace rows by others."""
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
        Grain and effects by name; friction and shape_ratio are the means of their priors. density only converts volume to mass
        for effects that depend on mass, and the gain is free.
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
        self._free_shapes: list[int] = np.flatnonzero(self.prior_sd(1.0)[:SHAPE_COUNT] > 0.0).tolist()
        self.own_scatter = np.array([name.startswith("scatter_") for name in self.names])
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
        """Prior standard deviations (n,). That of the paddles' scatter decreases with the number of averaged patterns."""
        own = self.settings.scatter / np.sqrt(max(patterns, 1.0))
        sd, law = dict(self.settings.sd), self.settings.arrival.covariance
        sd |= {"log_stretch": np.sqrt(law[0]), "log_tail": np.sqrt(law[1])}
        if self.settings.cell_response_s <= 0.0:
            sd["log_cell"] = 0.0
        if self.settings.indexed and self.settings.arrival.delay_sd_s > 0.0:
            sd["shift_s"] = self.settings.arrival.delay_sd_s
        return np.array([*(float(sd[name]) for name in COMMON_NAMES), *np.full(len(self._gaps), own)])

    def prior_precision(self, patterns: float) -> Array:
        """Inverse prior covariance (n, n); rows of fixed parameters are 0."""
        sd = self.prior_sd(patterns)
        free = sd > 0.0
        precision = np.diag(np.where(free, np.where(free, sd, 1.0) ** -2.0, 0.0))
        first, second, both = self.settings.arrival.covariance
        if first > 0.0 and second > 0.0:
            block = np.array([[second, -both], [-both, first]]) / (first * second - both * both)
            precision[STRETCH : TAIL + 1, STRETCH : TAIL + 1] = block
        return precision

    def _arrivals(self, points: Array) -> Arrivals:
        """Arrivals (m, paddles, nodes) at points (m, 5): ln volume flow, ln friction, ln shape ratio, ln speed, plate angle."""
        flow, friction, ratio, speed_rad_s = (np.exp(points[:, i])[:, None] for i in range(4))
        values: dict[str, object] = dict(self.parameters)
        values["friction"], values["shape_ratio"] = friction, ratio
        throw = self.model.throw(points[:, 4:5], speed_rad_s, values)  # type: ignore[arg-type]
        return arrivals(throw, self._mass_kg(flow, self._gaps, speed_rad_s), edge_release=self.settings.edge_release)

    def fill(self, flow: Array, elevator_speed_rad_s: ArrayLike) -> Array:
        """Ratio of each paddle's load to a full one; flow and speed broadcast against the paddles."""
        return np.asarray(self._mass_kg(flow, self._gaps, np.asarray(elevator_speed_rad_s)) / self.full_paddle_kg)

    def mean_fill(self, volume_flow_m3_s: float, elevator_speed_rad_s: float) -> float:
        """Mean ratio of the paddles' loads to a full one."""
        mean_gap_m = self.machine.pattern_length_m / self._gaps.size
        return float(self._mass_kg(volume_flow_m3_s, mean_gap_m, elevator_speed_rad_s) / self.full_paddle_kg)

    def _mass_kg(self, volume_flow_m3_s: Array | float, gap_m: Array | float, elevator_speed_rad_s: ArrayLike) -> Array:
        """Mass on paddles with these gaps to the paddle before, kg; all broadcast."""
        speed_m_s = self.machine.paddle_speed_m_s(np.asarray(elevator_speed_rad_s))
        return np.asarray(volume_flow_m3_s * self.parameters["density"] * gap_m / speed_m_s)

    def frequencies_rad_s(self, elevator_speed_rad_s: ArrayLike) -> Array:
        """Angular frequencies of the harmonics, (..., k), for speeds (...)."""
        base = 2.0 * np.pi / self.machine.pattern_length_m * self.machine.paddle_speed_m_s(np.asarray(elevator_speed_rad_s))
        return np.asarray(base[..., None] * np.arange(1.0, self.settings.harmonics + 1.0))

    def shapes(self, theta: Array, elevator_speed_rad_s: float, plate_angle_rad: float) -> AnyArray:
        """Spectra (batch, paddles, k) of pulses before the cell for shape parameters theta (batch, 5)."""
        flow, stretch, tail = (np.exp(theta[:, i])[:, None] for i in (FLOW, STRETCH, TAIL))
        given = np.broadcast_to([np.log(elevator_speed_rad_s), plate_angle_rad], (len(theta), 2))
        parts = self._arrivals(np.concatenate((theta[:, :SHAPES], given), axis=1))
        omega = self.frequencies_rad_s(elevator_speed_rad_s)
        fill, law = self.fill(flow, elevator_speed_rad_s), self.settings.arrival
        where = law.conditions(plate_angle_rad, elevator_speed_rad_s, self.parameters["friction"])
        waves = spectrum(parts, omega, stretch * np.exp(law.log_stretch(fill, where)))
        late = (tail * law.tail_s(fill, where))[..., None]
        if self.settings.indexed:
            waves = waves * np.exp(-1j * omega * law.delay_s(fill, where)[..., None])
        return np.asarray(waves / (1.0 + 1j * omega * late))

    def thrown(self, theta: Array, speeds_rad_s: Array, angles_rad: Array) -> AnyArray:
        """Spectra before the cell and their derivatives with respect to the free shape parameters, (1 + free, m, paddles, k).

        theta: (m, 5). Points without an expansion of the arrivals use difference quotients of the model.
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
        fill = self.fill(np.exp(theta[:, FLOW])[:, None], speeds_rad_s[:, None])
        where = law.conditions(angles_rad[:, None], speeds_rad_s[:, None], self.parameters["friction"])
        log_stretch, by_fill = law_and_slope(law.stretch, fill, where)
        by_stretch = np.zeros((SHAPE_COUNT, size, paddles))
        by_stretch[FLOW], by_stretch[STRETCH] = by_fill, 1.0
        flat = [v.reshape(len(v), size * paddles, -1) for v in (expanded.impulse_n_s, expanded.middle_s, expanded.half_width_s)]
        waves = spectrum_and_slopes(
            Expanded(*flat),
            np.repeat(omega[:, 0], paddles),
            omega.shape[1],
            np.exp(theta[:, STRETCH, None] + log_stretch).ravel(),
            by_stretch.reshape(SHAPE_COUNT, -1),
        ).reshape(1 + SHAPE_COUNT, size, paddles, -1)
        each = omega[:, None, :]
        if self.settings.indexed:
            delay_s, by_fill = law_and_slope(law.delay, fill, where)
            waves = waves * np.exp(-1j * (delay_s[..., None] * each))
            waves[1 + FLOW] -= 1j * (by_fill[..., None] * each) * waves[0]
        if law.tail is not None:
            log_tail, by_fill = law_and_slope(law.tail, fill, where)
            lag = 1j * (np.exp(theta[:, TAIL, None] + log_tail)[..., None] * each)
            waves /= 1.0 + lag
            late = lag / (1.0 + lag) * waves[0]
            waves[1 + TAIL] -= late
            waves[1 + FLOW] -= by_fill[..., None] * late
        return np.asarray(waves[[0, *(1 + i for i in self._free_shapes)]])

    def _by_differences(self, theta: Array, elevator_speed_rad_s: float, plate_angle_rad: float) -> AnyArray:
        """`thrown` for one point (5,) by central differences of the model, in one batch."""
        free = self._free_shapes
        batch = np.repeat(theta[None, :SHAPE_COUNT], 1 + 2 * len(free), axis=0)
        for row, i in enumerate(free):
            batch[1 + 2 * row, i] += _STEP
            batch[2 + 2 * row, i] -= _STEP
        found = self.shapes(batch, elevator_speed_rad_s, plate_angle_rad)
        return np.concatenate((found[:1], (found[1::2] - found[2::2]) / (2.0 * _STEP)))

    def joined(self, shapes: AnyArray, theta: Array, speeds_rad_s: Array) -> tuple[AnyArray, AnyArray]:
        """Each paddle's contribution to the pattern's harmonics behind the cell, without and with its scatter.

        shapes: (..., m, paddles, k); theta: (m, n) or (1, n); speeds_rad_s: (m,) or (1,).
        """
        omega = self.frequencies_rad_s(speeds_rad_s)
        late_s = self._places / self.machine.paddle_speed_m_s(speeds_rad_s)[:, None] + theta[:, SHIFT, None]
        size = np.exp(theta[:, GAIN]) * (omega[:, 0] / (2.0 * np.pi))
        turn = np.exp(-1j * (late_s[..., None] * omega[:, None, :])) * size[:, None, None]
        parts = shapes * (turn * self._cell(omega, theta[:, CELL])[:, None, :])
        return parts, parts * (1.0 + theta[:, len(COMMON_NAMES) :])[..., None]

    def _cell(self, omega: Array, log_cell: Array) -> AnyArray:
        return np.asarray(1.0 / (1.0 + 1j * (omega * np.exp(log_cell)[:, None])) ** 2)

    def waves(self, theta: Array, elevator_speed_rad_s: float, plate_angle_rad: float) -> AnyArray:
        """Harmonics (k,) of the pattern, N."""
        shapes = self.shapes(theta[None, :SHAPE_COUNT], elevator_speed_rad_s, plate_angle_rad)
        return np.asarray(self.waves_behind_cell(shapes, theta[None], np.array([elevator_speed_rad_s]))[0])

    def waves_behind_cell(self, shapes: AnyArray, theta: Array, speeds_rad_s: Array) -> AnyArray:
        """Harmonics (m, k) of the pattern, N, from spectra before the cell (m, paddles, k); theta: (m, n), speeds_rad_s: (m,)."""
        return np.asarray(self.joined(shapes, theta, speeds_rad_s)[1].sum(axis=1))

    def linearised(self, theta: Array, speeds_rad_s: Array, angles_rad: Array) -> Linear:
        """Harmonics and their derivatives: the throw's by an expansion (`ArrivalExpansions`), the rest in closed form.

        Parameters
        ----------
        theta : ndarray (m, n)
        speeds_rad_s, angles_rad : ndarray (m,)
            Elevator and plate.

        Returns
        -------
        Linear
            Not finite at parameters without a wave.
        """
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return self.behind_cell(self.thrown(theta[:, :SHAPE_COUNT], speeds_rad_s, angles_rad), theta, speeds_rad_s)

    def behind_cell(self, thrown: AnyArray, theta: Array, speeds_rad_s: Array) -> Linear:
        plain, scattered = self.joined(thrown, theta, speeds_rad_s)
        sums = scattered.sum(axis=2)
        waves = sums[0]
        omega = self.frequencies_rad_s(speeds_rad_s)
        jacobian = np.zeros((*waves.shape, len(self.names)), dtype=complex)
        jacobian[..., self._free_shapes] = np.moveaxis(sums[1:], 0, -1)
        lag = 1j * (omega * np.exp(theta[:, CELL])[:, None])
        jacobian[..., CELL] = -2.0 * lag / (1.0 + lag) * waves
        jacobian[..., SHIFT] = -1j * omega * waves
        jacobian[..., GAIN] = waves
        jacobian[..., len(COMMON_NAMES) :] = np.moveaxis(plain[0], 1, -1)
        return Linear(waves, jacobian, self._envelope(plain[0], theta, omega))

    def _envelope(self, parts: AnyArray, theta: Array, omega: Array) -> Array:
        """Amplitude (m, k) to which the model error is relative: that of infinitely short pulses behind the cell."""
        felt = np.abs(self._cell(omega, theta[:, CELL]))
        return np.asarray(np.abs(parts[..., 0]).sum(axis=-1)[:, None] / felt[:, :1] * felt)

    def lasting_variance(self, envelope: Array) -> Array:
        """Variance of the real and of the imaginary part by errors that do not average out over windows, N^2, (..., k)."""
        variance = 0.5 * (self.settings.model_error * envelope) ** 2
        paddles = len(self._gaps)
        if variance.shape[-1] >= paddles:
            variance[..., paddles - 1] += 0.25 * self.settings.vibration_n**2
        return np.asarray(variance)
