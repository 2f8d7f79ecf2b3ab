"""Flows that follow the parameters: at home the force is the measured one, whatever the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.discrepancy.frame import Frame, predictions
from yieldmon.discrepancy.machines.lattice import lay, reference_force_n, with_force
from yieldmon.estimation.self_calibration.home_flow import AwayVisits
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE, SHIPPED = Machine(), parameter_file.load()
MODEL = ForwardModel(MACHINE, SHIPPED.effects)
HOME = MACHINE.home_plate_angle_rad


def laid(angles_deg: tuple[float, ...] = (40.0, 50.0, 60.0, 90.0)) -> Frame:
    """A lattice of two sweeps at two speeds, whose forces are the model's own."""
    made = []
    for rpm, flow in ((380.0, 6.0), (420.0, 14.0)):
        angle = np.radians(angles_deg)
        speed, load = np.full(angle.size, rpm * RPM), np.full(angle.size, flow)
        force = MODEL.force(Conditions(angle, speed, mass_flow_kg_s=load, moisture_pct=15.0), SHIPPED.values)
        made.append(AwayVisits(angle, speed, load, np.real(force), 15.0, np.full(angle.size, 2e-4), 1e-4 * np.eye(angle.size)))
    return lay(MACHINE, SHIPPED, 10.0, [("m", made)]).frame


def at_home(frame: Frame) -> Frame:
    """The same cells with the plate at home."""
    layout = replace(frame.cells.layout, plate_angle_rad=np.full_like(frame.cells.layout.plate_angle_rad, HOME))
    return replace(frame, cells=replace(frame.cells, layout=layout))


@pytest.mark.parametrize(
    ("effects", "values"),
    [
        ((), {}),
        ((), {"friction": 0.5, "density": 1400.0}),
        (("lever_arm",), {"lever_arm.slope": 1.2}),
        (("plate_angle_offset",), {"plate_angle_offset.angle_rad": 0.05, "friction": 0.4}),
        (("cell_nonlinearity",), {"cell_nonlinearity.softening_per_n": 0.003}),
    ],
)
def test_force_at_home_is_the_measured_one_whatever_the_parameters(effects: tuple[str, ...], values: dict[str, float]) -> None:
    frame = at_home(laid())
    known = {name: SHIPPED.values[name] for name in ("friction", "density")}
    measured = np.real(predictions(frame, (), known))
    where = Conditions(
        HOME, frame.cells.elevator_speed_rad_s, mass_flow_kg_s=frame.cells.load, moisture_pct=frame.cells.moisture_pct
    )
    np.testing.assert_allclose(measured, np.real(MODEL.force(where, SHIPPED.values)), rtol=1e-4)
    np.testing.assert_allclose(np.real(predictions(frame, effects, known | values)), measured, rtol=2e-3)


def test_derivatives_follow_too() -> None:
    frame, step = laid(), 1e-30
    known = {name: SHIPPED.values[name] for name in ("friction", "density")}
    for name, by in (("friction", 1e-4), ("density", 0.1)):
        there, here = (np.real(predictions(frame, (), known | {name: known[name] + sign * by})) for sign in (1.0, -1.0))
        slope = np.imag(predictions(frame, (), known | {name: np.asarray(known[name] + 1j * step)})) / step
        np.testing.assert_allclose(slope, (there - here) / (2.0 * by), rtol=2e-2, atol=1e-4 * np.abs(slope).max())


def test_a_gain_is_brought_to_the_force_that_is_asked_for() -> None:
    asked = 1.07 * reference_force_n(MODEL, SHIPPED, 11.0, 15.0)
    found = with_force(MODEL, SHIPPED, asked, 11.0, 15.0)
    assert reference_force_n(MODEL, found, 11.0, 15.0) == pytest.approx(asked, rel=1e-9)
    assert {name for name in SHIPPED.values if found.values[name] != SHIPPED.values[name]} == {"restitution"}
