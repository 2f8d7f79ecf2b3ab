"""Plate angles measured from another line: asked about on published tables written so, and on no table as it was published."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from yieldmon.estimation.fitting import angle_lines
from yieldmon.estimation.fitting.calibration import calibrate, default_start
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.files import table
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

DATA = Path(__file__).parents[1] / "data"
ANGLES = np.radians([40.0, 60.0, 80.0])
ASKED = "are the angles clockwise from the horizontal in which the grain flies"


@pytest.mark.parametrize(("name", "impact"), [("dem", ("restitution",)), ("bench", ("k1", "k2"))])
@pytest.mark.parametrize(("turned", "said"), [(False, ""), (True, "with 90 deg less each plate angle the model would miss by ")])
def test_published_tables(name: str, impact: tuple[str, ...], turned: bool, said: str) -> None:
    data = table.load(DATA / f"{name}_table.csv")
    rows = Measurements(data.conditions(Machine()), data.momentum(Machine()))
    if turned:
        angle = 0.5 * np.pi - rows.columns()[0]
        rows = replace(rows, conditions=replace(rows.conditions, plate_angle_rad=angle))
    model = ForwardModel(Machine())
    start, free = default_start(model, rows, impact), ("friction", "density", *impact)
    asked = [line for line in calibrate(model, rows, start, free, starts=2, intervals=False).sentences if ASKED in line]
    assert [line[: len(said)] for line in asked] == ([said] if said else [])


def by_first(values: dict[float, float]) -> Callable[[Array], float]:
    """The misfit by the first angle, deg; ValueError for others."""

    def refit(angle_rad: Array) -> float:
        found = values.get(round(float(np.degrees(angle_rad[0])), 6))
        if found is None:
            raise ValueError("the loads overfill the paddles")
        return found

    return refit


@pytest.mark.parametrize(
    ("angles", "misfit", "others", "begin"),
    [
        (ANGLES, 0.4, {50.0: 0.03, 140.0: 0.2}, "with 90 deg less each plate angle the model would miss by 3 %"),
        (ANGLES, 0.4, {50.0: 0.2, 140.0: 0.03}, "with 180 deg less each plate angle the model would miss by 3 %"),
        (ANGLES, 0.4, {140.0: 0.03}, "with 180 deg less each plate angle the model would miss by 3 %"),
        (ANGLES, 0.4, {50.0: 0.14, 140.0: 0.2}, ""),
        (ANGLES, 0.4, {}, ""),
        (ANGLES, 0.049, {50.0: 0.001}, ""),
        (ANGLES[[0, 0, 1]], 0.4, {50.0: 0.03}, ""),
    ],
    ids=[
        "from the vertical",
        "counter-clockwise",
        "one cannot be fitted",
        "too little better",
        "none can",
        "explained",
        "two angles",
    ],
)
def test_question(angles: Array, misfit: float, others: dict[float, float], begin: str) -> None:
    asked = angle_lines.question(angles, misfit, by_first(others))
    assert asked[: len(begin) or None] == begin
