"""The pulse that one paddle's load gives to the plate, as a spectrum.

Grain at radius rho lies over the angle psi(rho) ahead of its paddle [8.6]. Where the housing ends at the top, grain that lies
ahead passes its end before the paddle does, by its own angle; that spreads each radius's arrival evenly over psi / Omega. Time
counts from the moment at which the paddle points up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import settling
from .numerics import AnyArray, Array
from .throw import Throw


@dataclass(frozen=True, slots=True)
class Arrivals:
    """A pulse as parts that each arrive evenly over a stretch of time; arrays with the nodes on the last axis.

    Attributes
    ----------
    impulse_n_s : ndarray (..., n)
        Horizontal impulse of each part.
    middle_s : ndarray (..., n)
        Middle of its arrival after the paddle points up.
    half_width_s : ndarray (..., n)
        Half of the time over which it arrives.
    """

    impulse_n_s: Array
    middle_s: Array
    half_width_s: Array

    @property
    def total_n_s(self) -> Array:
        """Impulse of the whole pulse (...)."""
        return np.asarray(self.impulse_n_s.sum(axis=-1))

    @property
    def mean_s(self) -> Array:
        """Mean arrival time (...), weighted by impulse; nan for a pulse without impulse."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray((self.impulse_n_s * self.middle_s).sum(axis=-1) / self.total_n_s)

    @property
    def sd_s(self) -> Array:
        """Standard deviation of the arrival time (...), weighted by impulse."""
        off = self.middle_s - self.mean_s[..., None]
        square = off * off + self.half_width_s * self.half_width_s / 3.0
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.sqrt((self.impulse_n_s * square).sum(axis=-1) / self.total_n_s))


def arrivals(throw: Throw, paddle_mass_kg: ArrayLike, *, edge_release: float = 1.0) -> Arrivals:
    """Arrival of the grain of loads that each paddle is offered.

    Parameters
    ----------
    throw : Throw
        Setting and parameters.
    paddle_mass_kg : array_like
        Offered load, kg; broadcasts against the throw's arrays.
    edge_release : float
        1 for a housing that ends at the release angle, 0 for one that lets the whole heap go when its paddle points up.

    Returns
    -------
    Arrivals
        nan for a load above a full paddle.
    """
    reading = throw.reading(np.asarray(paddle_mass_kg))
    impulse, setting = reading.impulse, throw.setting
    arrival = impulse.arrival
    normal = impulse.normal_gain * arrival.normal_speed_m_s * np.sin(setting.plate_angle_rad)
    horizontal = impulse.weight * (normal + impulse.tangential_m_s * np.cos(setting.plate_angle_rad))
    landed = arrival.landing_share * arrival.jet.mass_kg
    lands = (landed != 0.0) & np.isfinite(arrival.flight_time_s)
    share = np.where(lands, landed * horizontal, np.where(np.isnan(landed), np.nan, 0.0))
    angle = settling.opening_angle(arrival.jet.release_radius, arrival.jet.inner_radius, setting.shape_ratio)
    half = 0.5 * edge_release * np.where(angle > 0.0, angle, 0.0) / setting.elevator_speed_rad_s
    flight = np.where(lands, arrival.flight_time_s, 0.0)
    middle = arrival.jet.travel_angle_rad / setting.elevator_speed_rad_s + flight - half
    return Arrivals(*np.broadcast_arrays(share, middle, half))


def spectrum(parts: Arrivals, angular_frequency_rad_s: ArrayLike, stretch: ArrayLike = 1.0) -> AnyArray:
    """Fourier transform of the pulse's force, integral of F(t) exp(-i w t) dt, N s.

    Parameters
    ----------
    parts : Arrivals
        Shape (..., n).
    angular_frequency_rad_s : array_like
        Shape (k,) or (..., k).
    stretch : array_like
        Factor (...) of all times about the mean arrival: how much longer the stream arrives than its straight paths say.

    Returns
    -------
    ndarray
        Complex, (..., k).
    """
    omega = np.asarray(angular_frequency_rad_s)[..., None, :]
    factor = np.asarray(stretch)[..., None]
    mean = parts.mean_s[..., None]
    middle = mean + factor * (parts.middle_s - mean)
    half = factor * parts.half_width_s
    wave = np.exp(-1j * omega * middle[..., :, None]) * np.sinc(omega * half[..., :, None] / np.pi)
    return np.asarray((parts.impulse_n_s[..., :, None] * wave).sum(axis=-2))
