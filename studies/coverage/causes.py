"""What a load's stated standard deviation is made of, and what its error is.

Stated: the causes of the load's budget, as it is at the end of the run. Of the error: the parameters' part is what changes when
the load's forces are read with the parameters that the machine has (the shipped set); the zero's, when they are taken from the
true zero besides; noise, when the same harvest has no scatter of the paddles and no electrical noise; the rest is the model's,
that of the plate's motion and of the ends of the load.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from studies.coverage import __main__ as study
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.resources import shipped
from yieldmon.service.config import configuration

STATED = ("noise", "parameters", "zero", "moisture", "all")
ERRORS = ("noise", "parameters", "zero", "rest", "all")


def table(case: study.Case, duration_s: float, seeds: range) -> str:
    """Root mean squares over the loads of all machines, % of a load, as text."""
    rows = [row for seed in seeds for row in causes(case, duration_s, seed)]
    stated, errors = (np.array([row[k] for row in rows]) for k in (0, 1))
    z = errors[:, -1] / stated[:, -1]
    lines = [f"{case.name}: {len(rows)} loads of {len(seeds)} machines, z {np.mean(z):+.2f}, sd {np.std(z):.2f}"]
    for what, names, found in (("stated", STATED, stated), ("error", ERRORS, errors)):
        sizes = np.sqrt(np.mean(found**2, axis=0))
        lines.append(f"{what:>8}: " + ", ".join(f"{name} {size:.2f}" for name, size in zip(names, sizes, strict=True)))
    return "\n".join(lines)


def causes(case: study.Case, duration_s: float, seed: int) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Of each load of one machine what is stated, by STATED, and its error, by ERRORS; % of the load."""
    loaded = configuration.load(shipped("config/yieldmon.yaml"))
    sizes, parameters = study.drawn(case, loaded, seed)
    run = study.harvest(loaded, parameters, sizes, duration_s, seed)
    quiet = study.harvest(loaded, loaded.parameters, replace(sizes, scatter_pct=0.0, noise_mv=0.0), duration_s, seed)
    rows = []
    for number, load in run.loads.items():
        true, without = (_read(of, number, loaded.parameters, loaded.machine) for of in (run, quiet))
        summary = run.posted.get(number, load.closed)
        budget, measured_kg = summary.budget, summary.measured_kg
        stated = (
            (budget.noise_kg2 + budget.motion_kg**2) ** 0.5,
            budget.parameters_kg,
            budget.zero_kg,
            budget.moisture_kg,
            summary.std_dev_kg,
        )
        rest = without[1] / quiet.loads[number].true_kg
        errors = (true[1] / load.true_kg / rest, measured_kg / true[0], true[0] / true[1], rest, measured_kg / load.true_kg)
        rows.append((tuple(100.0 * part / measured_kg for part in stated), tuple(100.0 * float(np.log(part)) for part in errors)))
    return rows


def _read(run: study.Harvest, number: int, parameters: ParameterSet, machine: Machine) -> tuple[float, float]:
    """The load's mass with these parameters, kg, and the same with the true zero."""
    records = run.records[run.loads[number].first : run.loads[number].last]

    def column(name: str) -> Array:
        return np.array([getattr(record, name) for record in records])

    truth = run.combine.truth.columns
    true_zero_mv = np.interp(column("time_s") - 0.5, truth["time_s"], truth["zero_mv"])
    more_n = (column("zero_mv") - true_zero_mv) * machine.sensor.gain_n_per_mv
    loop = OpenLoop(ForwardModel(machine, parameters.effects), parameters)
    angle, speed, seconds = column("plate_angle_rad"), column("elevator_speed_rad_s"), column("duration_s")
    first, second = (
        float(np.nansum(loop.invert(column("force_n") + by_n, angle, speed) * seconds))
        for by_n in (np.zeros(len(records)), more_n)
    )
    return first, second
