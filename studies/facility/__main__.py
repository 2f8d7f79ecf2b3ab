"""Make config/parameters/corn.yaml: one calibration of the virtual combine's corn on the virtual test facility.

    python -m studies.facility

Eight flows, five plate angles and three elevator speeds, 20 s each, twice (seed 20261121); gravity is known and held. The table
is kept as tests/data/corn_facility.csv. A real machine gets its own calibration the same way, from its own table.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SEED = 20261121
TABLE = ROOT / "tests" / "data" / "corn_facility.csv"
OUT = ROOT / "config" / "parameters" / "corn.yaml"


def main() -> int:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    from studies.facility import facility
    from yieldmon.physics.machine import Machine
    from yieldmon.plant.scenario import load
    from yieldmon.resources import shipped

    rows = facility.measure(
        load(shipped("config/scenarios/demo.yaml")),
        Machine(),
        (0.3, 3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 26.0),
        (40.0, 55.0, 70.0, 80.0, 90.0),
        (330.0, 400.0, 470.0),
        averaging_s=20.0,
        trials=2,
        seed=SEED,
    )
    facility.write_csv(TABLE, rows)
    options = ["--effects", "gravity", "--fix", "gravity.acceleration_m_s2=9.81", "--fix", "shape_ratio=2", "--seed", str(SEED)]
    table = str(TABLE.relative_to(ROOT))
    command = [sys.executable, "-m", "yieldmon", "calibrate", table, "--out", str(OUT), *options]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
