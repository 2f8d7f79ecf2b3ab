"""Make config/parameters/corn.yaml: one calibration of the virtual combine's corn on the virtual test facility.

    python -m studies.facility
    python -m studies.facility --crops [--json]

Eight flows, five plate angles and three elevator speeds, 20 s each, twice (seed 20261121); gravity is known and held. The table
is kept as tests/data/corn_facility.csv. A real machine gets its own calibration the same way, from its own table. --crops: the
same with the grain of every shipped crop (config/crops.yaml) in the combine, nothing written: how far each calibration is from
its truth, in its own standard deviations.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from yieldmon.estimation.parameters import ParameterSet
    from yieldmon.physics.numerics import Array
    from yieldmon.plant.scenario import Scenario, ScenarioCrop

ROOT = Path(__file__).resolve().parents[2]
SEED = 20261121
TABLE = ROOT / "tests" / "data" / "corn_facility.csv"
OUT = ROOT / "config" / "parameters" / "corn.yaml"
FITTED = ("friction", "density", "restitution")
FIXED = {"gravity.acceleration_m_s2": 9.81, "shape_ratio": 2.0}


def measured(scenario: Scenario, seed: int) -> dict[str, Array]:
    """The facility's table of a scenario's grain."""
    from studies.facility import facility
    from yieldmon.physics.machine import Machine

    return facility.measure(
        scenario,
        Machine(),
        (0.3, 3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 26.0),
        (40.0, 55.0, 70.0, 80.0, 90.0),
        (330.0, 400.0, 470.0),
        averaging_s=20.0,
        trials=2,
        seed=seed,
    )


def from_truth(found: ParameterSet, crop: ScenarioCrop) -> tuple[float, float]:
    """Chi-square with three degrees of freedom of a calibration from the grain that it was made with, and its p."""
    import numpy as np
    from scipy.stats import chi2

    truth = {"friction": crop.friction, "density": crop.bulk_density_kg_m3, "restitution": crop.restitution}
    away = np.array([found.values[name] - truth[name] for name in FITTED])
    square = float(away @ np.linalg.solve(found.covariance_of(FITTED), away))
    return square, float(chi2.sf(square, len(FITTED)))


def of_crops() -> Iterator[dict[str, Any]]:
    """A row for each shipped crop whose paddle holds the facility's largest flow at its lowest speed."""
    import numpy as np

    from yieldmon.estimation.fitting.calibration import calibrate, default_start
    from yieldmon.estimation.fitting.measurements import Measurements
    from yieldmon.files.crops import crops
    from yieldmon.physics.machine import RPM, Machine
    from yieldmon.physics.model import Conditions, ForwardModel
    from yieldmon.plant.scenario import load
    from yieldmon.resources import shipped

    demo, machine = load(shipped("config/scenarios/demo.yaml")), Machine()
    model = ForwardModel(machine, ("gravity",))
    for number, (name, crop) in enumerate(crops().items()):
        known = crop.parameters().values
        grain = demo.crop.model_copy(
            update={key: known[key] for key in ("friction", "restitution")} | {"bulk_density_kg_m3": known["density"]}
        )
        try:
            rows = measured(demo.model_copy(update={"crop": grain}), SEED + number)
        except ValueError as error:
            yield {"crop": name, "problem": str(error)}
            continue
        speed = rows["elevator_speed_rpm"] * RPM
        at = Conditions(np.radians(rows["plate_angle_deg"]), speed, mass_flow_kg_s=rows["mass_flow_kg_s"])
        table = Measurements(at, machine.per_paddle(rows["force_n"], speed), machine.per_paddle(rows["sigma"], speed))
        start = default_start(model, table, ("restitution",), FIXED)
        found = calibrate(model, table, start, FITTED, starts=5, intervals=False, rng=np.random.default_rng(SEED)).parameter_set
        square, p_value = from_truth(found, grain)
        away = {key: round(100.0 * (found.values[key] / known[key] - 1.0), 2) for key in FITTED}
        yield {"crop": name, "chi_square": round(square, 2), "p": round(p_value, 4), "error_pct": away}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--crops", action="store_true", help="calibrations of all shipped crops against their truths")
    parser.add_argument("--json", action="store_true", help="of --crops")
    args = parser.parse_args()
    if args.crops:
        for row in of_crops():
            print(json.dumps(row) if args.json else "  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
        return 0
    from studies.facility import facility
    from yieldmon.plant.scenario import load
    from yieldmon.resources import shipped

    facility.write_csv(TABLE, measured(load(shipped("config/scenarios/demo.yaml")), SEED))
    options = ["--effects", "gravity", *(word for name, value in FIXED.items() for word in ("--fix", f"{name}={value:g}"))]
    command = [sys.executable, "-m", "yieldmon", "calibrate", str(TABLE.relative_to(ROOT)), "--out", str(OUT), "--force"]
    return subprocess.run([*command, *options, "--seed", str(SEED)], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
