"""A fourth ticket that is another truck's grain: python -m studies.setup.outlier [--first N] [--seeds N]

After the set-up of `study.py` three loads at different flows are weighed and given to the daemon's calibrator one after the
other. The fourth is weighed too much or too little by 5 to 10, 10 to 20 or 30 %, at another flow. It must be named, and the mass
of ten further loads must not change by more than 0.5 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.setup.study import LOAD_FLOWS, TICKET_SD, Combine, answers, combine, noise_sd
from yieldmon.cli._setup import derive
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.calibrator import CalibrationOutcome
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.self_calibration.load_forces import LoadForceSums, WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

SIZES = ((0.05, 0.10), (0.10, 0.20), (0.30, 0.30))
OTHER_FLOWS = ((4.0, 8.0), (13.0, 15.0), (19.0, 22.0))
NOT_MOVED = 0.005


@dataclass(frozen=True)
class Trial:
    """size: of the fourth ticket's error, signed. moved: relative change of further loads' mass by it, mean.
    three_error: relative error of the further loads after three tickets, mean; one_error: after the first."""

    seed: int
    size: float
    named: bool
    moved: float
    three_error: float
    one_error: float


@dataclass(frozen=True)
class _Harvested:
    kg: float
    flow_kg_s: np.ndarray
    force_n: np.ndarray
    speed_rad_s: np.ndarray


class _Machine:
    """A set-up machine and the daemon's calibrator on it."""

    def __init__(self, truth: Combine, machine: Machine, prior: ParameterSet) -> None:
        self.truth, self.machine = truth, machine
        self.cell = machine.sensor.gain_n_per_mv / truth.machine.sensor.gain_n_per_mv
        self.model = ForwardModel(machine, prior.effects)
        self.calibrator = ClosedLoopCalibrator(self.model)
        self.estimator = OpenLoop(self.model, prior)
        self.references: list[ReferenceMass] = []
        self.now_s = 0.0

    def harvest(self, kg: float, flow_kg_s: float, rng: np.random.Generator) -> _Harvested:
        flow, force, speed = self.truth.load(kg, flow_kg_s, rng)
        return _Harvested(float(flow.sum()), flow, force * self.cell, speed)

    def measured(self, load: _Harvested) -> np.ndarray:
        """kg of each second with the parameters in use."""
        angle = np.full(load.flow_kg_s.size, self.machine.home_plate_angle_rad)
        return np.nan_to_num(self.estimator.invert(load.force_n, angle, load.speed_rad_s))

    def ticket(self, load: _Harvested, weighed_kg: float) -> CalibrationOutcome:
        """As the daemon's engine hands it on."""
        number, mass, sums = len(self.references) + 1, self.measured(load), LoadForceSums()
        for kg, force, speed in zip(mass, load.force_n, load.speed_rad_s, strict=True):
            angle = self.machine.home_plate_angle_rad
            sums.add(number, float(kg), WindowForces(1.0, float(force), angle, float(speed)))
        end_s, noise = self.now_s + mass.size, noise_sd(self.estimator, load.force_n, load.speed_rad_s)
        self.references.append(
            ReferenceMass(
                ReferenceSource.TICKET,
                self.now_s,
                end_s,
                weighed_kg,
                TICKET_SD * weighed_kg,
                float(mass.sum()),
                True,
                number,
                budget=MassBudget(noise_kg2=(noise * float(mass.sum())) ** 2),
                forces=sums.of(number),
            )
        )
        self.now_s = end_s
        outcome = self.calibrator.weigh(
            _record(end_s, sum(a.measured_kg for a in self.references)), self.references, self.estimator
        )
        if outcome.estimator is not None:
            self.estimator = OpenLoop(self.model, outcome.estimator.parameters)
        return outcome

    def errors(self, loads: Sequence[_Harvested]) -> np.ndarray:
        return np.array([float(self.measured(load).sum()) / load.kg - 1.0 for load in loads])


def _record(time_s: float, total_kg: float) -> WindowRecord:
    names = WindowRecord.__dataclass_fields__
    plain: dict[str, Any] = {name: float("nan") if field.type == "float" else 0 for name, field in names.items()}
    return WindowRecord(**{**plain, "faults": (), "time_s": time_s, "total_kg": total_kg})


def trial(seed: int, low: float, high: float) -> Trial:
    """One machine, three tickets and a wrong fourth."""
    rng = np.random.default_rng([20261123, seed, round(1000 * low)])
    truth = combine(rng)
    said = answers(truth, rng)
    here = _Machine(truth, derive.machine(said), derive.parameters(said))
    further = [here.harvest(3000.0, flow, rng) for flow in np.linspace(3.5, 21.5, 10)]
    one_error = float("nan")
    for number, (least, most) in enumerate(LOAD_FLOWS[:3]):
        load = here.harvest(rng.uniform(2000.0, 9000.0), rng.uniform(least, most), rng)
        here.ticket(load, load.kg * (1.0 + TICKET_SD * rng.standard_normal()))
        if number == 0:
            one_error = float(np.mean(here.errors([here.harvest(3000.0, float(np.mean(load.flow_kg_s)), rng)])))
    before = here.errors(further)
    least, most = OTHER_FLOWS[int(rng.integers(len(OTHER_FLOWS)))]
    load = here.harvest(rng.uniform(2000.0, 9000.0), rng.uniform(least, most), rng)
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))
    outcome = here.ticket(load, load.kg * (1.0 + size))
    moved = float(np.mean((1.0 + here.errors(further)) / (1.0 + before) - 1.0))
    return Trial(seed, size, "load 4 contradicts" in outcome.reason, moved, float(np.mean(before)), one_error)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--first", type=int, default=1)
    options = parser.parse_args()
    print("| fourth ticket wrong by | trials | named | moved by more than 0.5 % | largest move, % | mean after three, worst, % |")
    print("|---|---|---|---|---|---|")
    for low, high in SIZES:
        found = [trial(seed, low, high) for seed in range(options.first, options.first + options.seeds)]
        named, moved = [t.named for t in found], np.abs([t.moved for t in found])
        size = f"{100 * low:.0f} to {100 * high:.0f} %" if high > low else f"{100 * low:.0f} %"
        three = 100.0 * max(abs(t.three_error) for t in found)
        print(
            f"| {size} | {len(found)} | {sum(named)} | {int(np.sum(moved > NOT_MOVED))} | {100.0 * moved.max():.2f} "
            f"| {three:.2f} |",
            flush=True,
        )
        for t in found:
            if not t.named or abs(t.moved) > NOT_MOVED:
                print(f"seed {t.seed}: {100 * t.size:+.1f} %, named {t.named}, moved {100 * t.moved:+.2f} %", flush=True)


if __name__ == "__main__":
    main()
