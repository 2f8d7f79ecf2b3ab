"""What mechanics asks of every row of a campaign, whatever its kernel."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians, tan


def assert_obeyed(row: Mapping[str, str]) -> None:
    """Friction, momentum and the shares of grain that a row states are possible."""
    angle, mass = radians(float(row["plate_angle_deg"])), float(row["paddle_mass_kg"])
    normal, total = float(row["momentum_kg_m_s"]), float(row["momentum_total_kg_m_s"])
    assert 0.0 < normal <= total * (1.0 + 1e-3)
    # Friction adds at most mu cot(phi) of the normal part to the horizontal; the edges' contacts a little more.
    assert total - normal <= (float(row["friction"]) / tan(angle) + 5e-3) * normal
    assert normal < 1.75 * float(row["release_speed_m_s"]) * mass
    assert float(row["fraction_released"]) == 1.0
    touch, deflected, miss = (float(row[f"fraction_{name}"]) for name in ("touch", "deflected", "miss"))
    assert touch <= deflected + 0.02
    assert deflected + miss <= 1.0 + 1e-6
