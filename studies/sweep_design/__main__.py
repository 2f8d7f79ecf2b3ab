"""Which plate angles should a sweep visit? Even steps, a D-optimal sequence of the same length, and the default between them;
and what the plate's position adds as a second swept variable (thesis, section 4.2).

    python -m studies.sweep_design [--json]

Information about friction, restitution and density that one sweep adds to the prior (the flow is free in every sweep), from the
forward model's own derivatives; two windows at each of ten angles, home windows in between as the engine drives them. The
D-optimal sequence, which visits the two ends alone and so could never show that the model is wrong between them, is found by
exchanging one angle at a time from 40 to 90 deg in steps of 2.5, for the mean over flows. With position, each visit is an angle
and a place of the plate, 50 mm nearer to the elevator, as built, or 50 mm further away.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from yieldmon.physics.model import ForwardModel
    from yieldmon.physics.numerics import Array

Visit = tuple[float, float]
"""Plate angle, deg, and the plate's place, m."""

FLOWS_KG_S = (6.0, 10.0, 16.0, 22.0)
WINDOW_NOISE = 0.022
"""Relative standard deviation of one window's force."""
FLOW_WANDER = 0.03
"""Relative standard deviation of the flow about its bracketed course, for each visited angle."""
PLACES_M = (-0.05, 0.0, 0.05)
"""Of the plate from where the machine has it, away from the elevator."""


def information(
    model: ForwardModel, values: Mapping[str, float], names: Sequence[str], prior: Array, visits: Sequence[Visit], flow: float
) -> Array:
    """Posterior information of the parameters after one sweep, the flow marginalised.

    prior: their covariance. visits: (angle, deg; plate position, m) of each.
    """
    import numpy as np

    from yieldmon.physics.machine import RPM
    from yieldmon.physics.model import Conditions

    angles_deg, places_m = np.array(visits).T
    flows = np.full(len(visits), flow)
    conditions = Conditions(np.radians(angles_deg), 400.0 * RPM, mass_flow_kg_s=flows, plate_position_m=places_m)
    force, jacobian = model.derivatives(conditions, values, (*names, "mass_flow_kg_s"), of="force")
    slope = jacobian[:, -1] * flow
    noise = np.sqrt((WINDOW_NOISE * force) ** 2 / 2.0 + (FLOW_WANDER * slope) ** 2)
    scaled = np.column_stack((jacobian[:, :-1], slope)) / noise[:, None]
    full = scaled.T @ scaled
    full[:-1, :-1] += np.linalg.inv(prior)
    return np.asarray(full[:-1, :-1] - np.outer(full[:-1, -1], full[-1, :-1]) / full[-1, -1])


def main() -> int:
    import numpy as np

    from yieldmon.engine.settings import SweepSettings
    from yieldmon.files import parameter_file
    from yieldmon.physics.machine import Machine
    from yieldmon.physics.model import ForwardModel

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    known = parameter_file.load()
    model = ForwardModel(Machine(), known.effects)
    names = ("friction", "restitution", "density")
    prior = np.diag([(share * known.values[n]) ** 2 for n, share in zip(names, (0.2, 0.1, 0.1), strict=True)])
    home = float(np.degrees(Machine().home_plate_angle_rad))

    def judge(visits: Sequence[Visit]) -> tuple[float, dict[float, Array]]:
        """Mean gain in log determinant over the flows, and each parameter's posterior over prior width at each flow."""
        plan = [(home, 0.0)] * 6 + list(visits)
        gain, ratios = [], {}
        for flow in FLOWS_KG_S:
            posterior = np.linalg.inv(information(model, known.values, names, prior, plan, flow))
            gain.append(np.linalg.slogdet(prior)[1] - np.linalg.slogdet(posterior)[1])
            ratios[flow] = np.sqrt(np.diag(posterior) / np.diag(prior))
        return float(np.mean(gain)), ratios

    def best_of(start: Sequence[Visit], grid: Sequence[Visit]) -> list[Visit]:
        """Exchange, which ends where no single visit can be bettered."""
        best, (score, _) = list(start), judge(start)
        improved = True
        while improved:
            improved = False
            for i in range(len(best)):
                for visit in grid:
                    trial = [*best[:i], visit, *best[i + 1 :]]
                    found, _ = judge(trial)
                    if found > score + 1e-9:
                        best, score, improved = trial, found, True
        return sorted(best)

    default = [(angle, 0.0) for angle in SweepSettings().angles_deg]
    angles = np.arange(40.0, 90.1, 2.5).tolist()
    in_place = [(angle, 0.0) for angle in angles]
    everywhere = [(angle, place) for angle in angles for place in PLACES_M]
    even = [(angle, 0.0) for angle in (40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 75.0, 80.0, 85.0, 90.0)]
    at_home = [(home, place) for place in (-0.05, -0.05, -0.05, -0.025, -0.025, 0.025, 0.025, 0.05, 0.05, 0.05)]
    turned = [(angle, place) for (angle, _), place in zip(default, [0.05, -0.05] * 5, strict=True)]
    rows: list[dict[str, Any]] = []
    for label, visits in (
        ("even steps of 5 deg", even),
        ("D-optimal", best_of(default, in_place)),
        ("default", default),
        ("position alone, at home", at_home),
        ("default angles, position to and fro", turned),
        ("D-optimal in angle and position", best_of(default, everywhere)),
    ):
        gain, ratios = judge(visits)
        rows.append(
            {
                "sequence": label,
                "angles_deg": [angle for angle, _ in visits],
                "positions_m": [place for _, place in visits],
                "information_nats": round(0.5 * gain, 3),
                "friction_ratio": {f"{flow:g}": round(float(r[0]), 3) for flow, r in ratios.items()},
                "restitution_ratio": {f"{flow:g}": round(float(r[1]), 3) for flow, r in ratios.items()},
                "density_ratio": {f"{flow:g}": round(float(r[2]), 3) for flow, r in ratios.items()},
            }
        )
    if args.json:
        print(json.dumps(rows, indent=2))
        return 0
    for row in rows:
        visited = zip(row["angles_deg"], row["positions_m"], strict=True)
        shown = ", ".join(f"{angle:g}" + (f" at {1000.0 * place:+g} mm" if place else "") for angle, place in visited)
        print(f"{row['sequence']}: {shown} deg; {row['information_nats']} nats a sweep")
        for name in names:
            print(f"  {name:<12} posterior / prior: " + "  ".join(f"{k} kg/s {v}" for k, v in row[f"{name}_ratio"].items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
