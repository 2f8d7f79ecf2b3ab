"""The crop as the virtual combine sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from yieldmon.plant.effects import MoistureDependence


@dataclass(frozen=True, slots=True)
class Grain:
    """Bulk properties of the grain on a paddle.

    friction: grain on paddle, -. restitution: a single kernel on the plate, -. bulk_density_kg_m3: of the heap.
    shape_ratio: angle (rad) that a heap reaches ahead of its paddle when it fills the paddle to the centre.
    moisture_pct: wet basis; properties are those at this moisture.
    """

    friction: float = 0.2
    restitution: float = 0.55
    bulk_density_kg_m3: float = 1100.0
    shape_ratio: float = 2.0
    moisture_pct: float = 15.0

    def at_moisture(self, moisture_pct: float, dependence: MoistureDependence | None) -> Grain:
        """This grain at another moisture; without a dependence only the moisture itself changes."""
        if dependence is None:
            return replace(self, moisture_pct=moisture_pct)
        step = moisture_pct - self.moisture_pct
        return replace(
            self,
            friction=self.friction * (1.0 + dependence.friction_per_pct * step),
            restitution=self.restitution * (1.0 + dependence.restitution_per_pct * step),
            bulk_density_kg_m3=self.bulk_density_kg_m3 * (1.0 + dependence.density_per_pct * step),
            moisture_pct=moisture_pct,
        )
