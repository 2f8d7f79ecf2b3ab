"""A stand-in for the engine's process: writes plausible records at once, so that the bookkeeping can be tested without LAMMPS.

Run as a script it works through a campaign and says each row on stdout: ``python fake_engine.py CAMPAIGN.yaml FOLDER``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.dem import campaign, runner
from studies.dem.job import Throw
from studies.dem.worker import save

GRAINS = 12


def run_throw(
    throw: Throw,
    plate_angles_rad: Sequence[float],
    out: Path,
    cache: Path,
    *,
    audit: bool = False,
    on_report: Callable[[dict[str, Any]], None] = lambda report: None,
) -> None:
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(throw.seed)
    free = np.column_stack([np.zeros(GRAINS), rng.uniform(-0.15, -0.05, GRAINS), np.zeros(GRAINS)])
    along = {
        "let_go_s": np.zeros(GRAINS),
        "let_go_radius_m": rng.uniform(0.1, 0.155, GRAINS),
        "let_go_lead_rad": np.zeros(GRAINS),
        "tip_s": np.full(GRAINS, 0.01),
        "free_s": np.linspace(0.01, 0.03, GRAINS),
        "free_position_m": free,
        "free_velocity_m_s": np.tile([7.0, 0.3, 0.0], (GRAINS, 1)),
    }
    mass = np.full(GRAINS, throw.paddle_mass_kg / GRAINS)
    save(out / "release.npz", heap_position_m=free, heap_velocity_m_s=free, radius_m=mass, mass_kg=mass, settled_step=0, **along)
    for angle in plate_angles_rad:
        force = np.full((200, 2), throw.paddle_mass_kg) * [np.sin(angle), -np.cos(angle)]
        save(
            runner.plate_file(out, angle),
            plate_angle_rad=angle,
            time_step_s=throw.time_step_s,
            mass_kg=mass,
            start_s=0.004,
            normal_force_n=force,
            total_force_n=force,
            normal_moment_n_m=force[:, 0] * 0.05,
            touch_s=np.full(GRAINS, 0.02),
            end_velocity_m_s=np.zeros((GRAINS, 3)),
            engine_version=0,
            **along,
        )
        on_report({"stage": "plate", "plate_angle_rad": angle, "seconds": 0.0})


def main() -> None:
    runner.run_throw = run_throw  # type: ignore[assignment]
    runner.engine_version = lambda: 0
    plan = campaign.parse(Path(sys.argv[1]).read_text(encoding="utf-8"), sys.argv[1])
    ledger = campaign.Ledger(Path(sys.argv[2]))
    put_down = ledger.add

    def add(throw: Throw, plate_angle_rad: float, row: campaign.Row) -> None:
        put_down(throw, plate_angle_rad, row)
        print(ledger.row_file(throw, plate_angle_rad).name, flush=True)

    ledger.add = add  # type: ignore[method-assign]
    campaign.run(plan, ledger, 1, lambda text: None)


if __name__ == "__main__":
    main()
