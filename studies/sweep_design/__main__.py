"""Which plate angles should a sweep visit? Even steps, a D-optimal sequence of the same length, and the default between them.

    python -m studies.sweep_design [--json]

Information about friction, restitution and density that one sweep adds to the prior (the flow is free in every sweep), from the
forward model's own derivatives; two windows at each of ten angles, home windows in between as the engine drives them. The
D-optimal sequence, which visits the two ends alone and so could never show that the model is wrong between them, is found by
exchanging one angle at a time from 40 to 90 deg in steps of 2.5, for the mean over flows.
"""

from __future__ import annotations

import argparse
import json
import sys

FLOWS_KG_S = (6.0, 10.0, 16.0, 22.0)
WINDOW_NOISE = 0.022
"""Relative standard deviation of one window's force."""
FLOW_WANDER = 0.03
"""Relative standard deviation of the flow about its bracketed course, for each visited angle."""


def information(model, values, names, prior, angles_deg, flow):  # type: ignore[no-untyped-def]
    """Posterior information of the parameters after one sweep, the flow marginalised. prior: their covariance."""
    import numpy as np

    from yieldmon.physics.machine import RPM
    from yieldmon.physics.model import Conditions

    conditions = Conditions(np.radians(angles_deg), 400.0 * RPM, mass_flow_kg_s=np.full(len(angles_deg), flow))
    force, jacobian = model.derivatives(conditions, values, (*names, "mass_flow_kg_s"), of="force")
    slope = jacobian[:, -1] * flow
    noise = np.sqrt((WINDOW_NOISE * force) ** 2 / 2.0 + (FLOW_WANDER * slope) ** 2)
    scaled = np.column_stack((jacobian[:, :-1], slope)) / noise[:, None]
    full = scaled.T @ scaled
    full[:-1, :-1] += np.linalg.inv(prior)
    return full[:-1, :-1] - np.outer(full[:-1, -1], full[-1, :-1]) / full[-1, -1]


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

    def judge(angles):  # type: ignore[no-untyped-def]
        """Mean gain in log determinant over the flows, and each parameter's posterior over prior width at each flow."""
        plan = np.array([home] * 6 + list(angles))
        gain, ratios = [], {}
        for flow in FLOWS_KG_S:
            posterior = np.linalg.inv(information(model, known.values, names, prior, plan, flow))
            gain.append(np.linalg.slogdet(prior)[1] - np.linalg.slogdet(posterior)[1])
            ratios[flow] = np.sqrt(np.diag(posterior) / np.diag(prior))
        return float(np.mean(gain)), ratios

    default = SweepSettings().angles_deg
    grid = np.arange(40.0, 90.1, 2.5)
    best, (score, _) = list(default), judge(default)
    # Exchange ends where no single angle can be bettered.
    improved = True
    while improved:
        improved = False
        for i in range(len(best)):
            for angle in grid:
                trial = [*best[:i], float(angle), *best[i + 1 :]]
                found, _ = judge(trial)
                if found > score + 1e-9:
                    best, score, improved = trial, found, True
    even = (40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 75.0, 80.0, 85.0, 90.0)
    rows = []
    for label, angles in (("even steps of 5 deg", even), ("D-optimal", sorted(best)), ("default", default)):
        gain, ratios = judge(angles)
        rows.append(
            {
                "sequence": label,
                "angles_deg": list(angles),
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
        print(f"{row['sequence']}: {', '.join(f'{a:g}' for a in row['angles_deg'])} deg; {row['information_nats']} nats a sweep")
        for name in names:
            print(f"  {name:<12} posterior / prior: " + "  ".join(f"{k} kg/s {v}" for k, v in row[f"{name}_ratio"].items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
