"""How a stream of unequal grain is cut by the plate's edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.physics.numerics import AnyArray, erf, real
from yieldmon.physics.stages import Arrival

KERNEL_M = 0.01
"""About one kernel: what a stream of unequal grain blurs an edge by."""


def share_beyond(distance_m: AnyArray, width_m: AnyArray) -> AnyArray:
    """Share of a stream that lies beyond an edge, its path `distance_m` beyond it: 1/2 (1 + erf(distance / width))."""
    z = distance_m / width_m
    share: AnyArray = 0.5 * (1.0 + erf(z))
    return share


def blur_low_edge(arrival: Arrival, width_m: AnyArray) -> Arrival:
    """The low edge cuts the stream over `width_m` more (in quadrature) by where its paths now meet the plate's line.

    A width of 0 leaves the arrival as it is.
    """
    meets = np.isfinite(real(arrival.from_low_edge_m)) & (real(arrival.normal_speed_m_s) > 0.0)
    blurs = real(width_m) > 0.0
    added = np.where(blurs, width_m, 1.0)
    width = np.sqrt(added * added + arrival.edge_blur_m * arrival.edge_blur_m)
    above = share_beyond(np.where(meets, -arrival.from_low_edge_m, -1.0), width)
    return replace(
        arrival,
        landing_share=np.where(blurs, np.where(meets, above, 0.0), arrival.landing_share),
        edge_blur_m=np.where(blurs, width, arrival.edge_blur_m),
    )


def landing_momentum(arrival: Arrival, towards: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Momentum of what lands, of the paths that go `towards` the plate: into it and down it, kg m/s, node axis of length 1."""
    landed = np.where(towards, arrival.landing_share * arrival.jet.mass_kg, 0.0)
    into: AnyArray = np.sum(landed * np.where(towards, arrival.normal_speed_m_s, 0.0), axis=-1, keepdims=True)
    along: AnyArray = np.sum(landed * np.where(towards, arrival.tangential_speed_m_s, 0.0), axis=-1, keepdims=True)
    return into, along
