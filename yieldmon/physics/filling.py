"""Stage 1, filling: what the mass flow puts on each paddle [8.1-8.3]."""

from __future__ import annotations

from .numerics import AnyArray
from .stages import Setting


def offered_mass(mass_flow_kg_s: AnyArray, setting: Setting) -> AnyArray:
    """M = m-dot d / V, kg per paddle, for paddles filled on the straight run [8.1]."""
    return mass_flow_kg_s / setting.passes_per_s


def mass_flow(paddle_mass_kg: AnyArray, setting: Setting) -> AnyArray:
    """The inverse of `offered_mass`, kg/s."""
    return paddle_mass_kg * setting.passes_per_s
