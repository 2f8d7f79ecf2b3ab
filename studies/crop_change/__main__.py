"""Loads of a crop after another one was weighed: with its published properties, and with the other one's scale and curve.

    python -m studies.crop_change --first 301 --changes 6           # 24 machines, six changes of crop each, 5 CPU-min
    python -m studies.crop_change --first 301 --by-model            # the same grain by the model's law

On each machine one crop is weighed in one to five loads, then another begins. Eight further loads of that one are judged before
its first ticket and after each of three.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from studies.crop_change import machines as m
from yieldmon import api
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.other_crop import carried
from yieldmon.files.crops import crops
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.physics.numerics import Array

TICKETS, FURTHER, MOST_BEFORE = 3, 8, 5
_NOISE = 0.004
"""Of a further load's mass, relative: scatter of its windows and its zero."""
WAYS = ("published", "carried")


@dataclass(frozen=True)
class Change:
    """A change of crop on a machine: tickets of the crop before and of the next one, and further loads of that one."""

    before: str
    after: str
    first: list[ReferenceMass]
    tickets: list[ReferenceMass]
    further: list[ReferenceMass]


def drawn(machine: m.Stranger, random: np.random.Generator, *, by_model: bool) -> Change:
    """Two crops and their loads."""
    before, after = map(str, random.choice(list(crops()), 2, replace=False))
    count = int(random.integers(1, MOST_BEFORE + 1))
    return Change(
        before,
        after,
        m.loads(machine, before, m.flows(before, count, random), 1, random, by_model=by_model),
        m.loads(machine, after, m.flows(after, TICKETS, random), 50, random, by_model=by_model),
        m.loads(machine, after, m.flows(after, FURTHER, random, m.FURTHER_KG_S), 80, random, by_model=by_model),
    )


def judged(machine: m.Stranger, change: Change, way: str) -> dict[str, Any]:
    """Relative error and standard deviation of the first ticket's load as it is measured, and of the further loads before the
    first ticket and after each."""
    monitor = _Monitor(machine.measured, crops()[change.before].parameters())
    for ticket in change.first:
        monitor.weigh(ticket)
    published, weighed = crops()[change.after].parameters(), monitor.known
    found = carried(published, weighed, crops()[change.before].parameters(), change.before)
    monitor.change(change, published if way == "published" or found is None else found)
    first, rows = monitor.errors(change.tickets[:1]), [monitor.errors(change.further)]
    refused = 0
    for ticket in change.tickets:
        refused += not monitor.weigh(ticket)
        rows.append(monitor.errors(change.further))
    stages = np.array(rows)
    return {
        "way": way, "before": change.before, "after": change.after, "loads_before": len(change.first), "refused": refused,
        "first": first[0].round(4).tolist(), "error": stages[..., 0].round(4).tolist(),
        "std_dev": stages[..., 1].round(4).tolist(),
    }  # fmt: skip


class _Monitor:
    """The estimator and the calibrator of a daemon."""

    def __init__(self, machine: api.Machine, known: ParameterSet) -> None:
        self._machine = machine
        self._calibrator = ClosedLoopCalibrator(api.ForwardModel(machine, known.effects), CalibratorSettings())
        self._use(known)
        self._kept: list[ReferenceMass] = []

    def _use(self, known: ParameterSet) -> None:
        self._estimator: Any = api.OpenLoop(api.ForwardModel(self._machine, known.effects), known)

    @property
    def known(self) -> ParameterSet:
        """In use."""
        used: ParameterSet = self._estimator.parameters
        return used

    def change(self, change: Change, known: ParameterSet) -> None:
        """Another crop from now on."""
        self._use(replace(known, version=self.known.version + 1))
        self._kept = []
        self._calibrator.change_grain(change.before, change.after, (), self._estimator)
        self._calibrator.use(self._estimator)

    def weigh(self, ticket: ReferenceMass) -> bool:
        """A ticket; whether it updates the parameters."""
        forces = ticket.forces
        assert forces is not None
        flow = self._estimator.invert(forces.force_n, forces.plate_angle_rad, forces.elevator_speed_rad_s)
        self._kept.append(replace(ticket, measured_kg=max(float(forces.duration_s @ np.nan_to_num(flow)), 1.0)))
        found = self._calibrator.weigh(_record(ticket), tuple(self._kept), self._estimator)
        if found.estimator is not None:
            self._estimator = found.estimator
        return found.identifiable

    def errors(self, loads: Sequence[ReferenceMass]) -> Array:
        """(n, 2) relative error and standard deviation of loads."""
        rows = []
        for load in loads:
            forces = load.forces
            assert forces is not None
            found = self._estimator.estimate(forces.force_n, forces.plate_angle_rad, forces.elevator_speed_rad_s)
            flow, std_dev = (float(forces.duration_s @ part) for part in (found.mass_flow_kg_s, found.std_dev_kg_s))
            rows.append((flow / load.measured_kg - 1.0, np.hypot(std_dev / load.measured_kg, _NOISE)))
        return np.array(rows)


def _record(ticket: ReferenceMass) -> WindowRecord:
    """The window in which a ticket is entered."""
    return WindowRecord(
        time_s=ticket.end_s + 10.0, window=0, duration_s=1.0, coverage=1.0, force_n=80.0, force_std_dev_n=0.4,
        elevator_speed_rad_s=40.0, plate_angle_rad=1.2, plate_still=True, moisture_pct=nan, test_weight_kg_m3=nan,
        mass_flow_kg_s=10.0, std_dev_kg_s=0.1, quality=EstimateQuality.OK, operating_state=OperatingState.HARVESTING,
        mass_kg=10.0, load_kg=0.0, total_kg=3000.0 * ticket.load_number, load_number=1, zero_mv=0.0, pulse_mv=50.0,
        saturated_share=0.0, lost_frames=0, surplus_frames=0, repeated_frames=0, sweep_id=0, sweep_step=0,
        usable_for_calibration=True, parameter_version=1, faults=(), latitude_deg=nan, longitude_deg=nan,
        ground_speed_m_s=nan, course_deg=nan,
    )  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """What the page has."""
    out = [
        "| begins as | judged | error: rms, mean | stated, rms | z: sd, rms | within 1 / 2 | beyond 3 | log score | refused |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for way in WAYS:
        own = [row for row in rows if row["way"] == way]
        error, std_dev = (np.array([row[key] for row in own]) for key in ("error", "std_dev"))
        first = np.array([row["first"] for row in own])
        stages = [("first load", first[:, 0], first[:, 1])]
        stages += [(f"after {k}", error[:, k], std_dev[:, k]) for k in range(TICKETS + 1)]
        for title, off, stated in stages:
            z = off / stated
            cells = (
                way, title, f"{100 * _rms(off):.1f}, {100 * np.mean(np.abs(off)):.1f} %", f"{100 * _rms(stated):.1f} %",
                f"{np.std(z):.2f}, {_rms(z):.2f}", f"{100 * np.mean(np.abs(z) <= 1):.0f} / {100 * np.mean(np.abs(z) <= 2):.0f} %",
                f"{1000 * np.mean(np.abs(z) > 3):.0f} of 1000", f"{np.mean(-0.5 * z**2 - np.log(stated)):.2f}",
                sum(row["refused"] for row in own) if title == f"after {TICKETS}" else "",
            )  # fmt: skip
            out.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(out)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1, help="first seed (default: %(default)s)")
    parser.add_argument("--machines", type=int, default=24, help="how many (default: %(default)s)")
    parser.add_argument("--changes", type=int, default=10, help="of crop on each (default: %(default)s)")
    parser.add_argument("--by-model", action="store_true", help="force by the model's own law, with this grain")
    parser.add_argument("--out", type=Path, help="write every change here, a JSON line each")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for seed in range(args.first, args.first + args.machines):
        machine, random = m.draw(seed), np.random.default_rng([seed, 7])
        for _ in range(args.changes):
            change = drawn(machine, random, by_model=args.by_model)
            rows += [{"seed": seed, **judged(machine, change, way)} for way in WAYS]
    print(table(rows))
    if args.out is not None:
        git = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
        head = {"commit": git.stdout.strip(), "first": args.first, "by_model": args.by_model}
        args.out.write_text("".join(json.dumps(row) + "\n" for row in (head, *rows)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
