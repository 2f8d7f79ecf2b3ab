"""Heaps of another cross-section than the one that was calibrated: covered as published, or shown as a contradiction.

Pulses are of `studies.waveform.heaps`, which knows nothing of the product's stages. Gain
and stretch are those with which its wedge is right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from studies.waveform import heaps
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.results import WindowResult
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.waveform.channel_combination import combine, heap_slope
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE, FLOW_KG_S = Machine(), 8.0
KNOWN = heaps.known(0.543)
VALUES = KNOWN.values
MODEL = ForwardModel(MACHINE, KNOWN.effects)


def last_windows(stream: heaps.Stream) -> list[WindowResult]:
    """The last ones, when thirty windows have been compared and a fault has had its time to be shown."""
    return heaps.seen(heaps.traffic(stream, FLOW_KG_S, 52.0, 1), KNOWN, (1.053, 0.03))


def test_the_heap_that_was_calibrated_is_right_and_contradicts_nothing() -> None:
    records = [window.record for window in last_windows(heaps.WEDGE)]
    flow, sd = (float(np.mean([getattr(r, name) for r in records])) for name in ("mass_flow_kg_s", "std_dev_kg_s"))
    assert abs(flow - FLOW_KG_S) < sd < 0.09 * FLOW_KG_S
    assert not any(FaultCode.WAVEFORM_CONTRADICTS in r.faults for r in records)


def test_a_layer_of_which_much_misses_the_plate_is_shown_although_the_shape_lies_outside_its_calibration() -> None:
    """The mean force is 62 % low. The two flows are 2.4 deviations apart; pulses are twice as far from those of that flow."""
    windows = last_windows(heaps.Stream("layer"))
    assert np.mean([w.waveform.mean_kg_s for w in windows]) < 0.5 * FLOW_KG_S
    assert all(np.isnan(w.record.shape_flow_kg_s) for w in windows)
    assert all(FaultCode.WAVEFORM_CONTRADICTS in w.record.faults for w in windows)


@pytest.mark.parametrize(("flow_kg_s", "least", "largest"), [(4.0, -0.1, 0.1), (14.0, -0.6, -0.3)])
def test_another_heap_at_the_same_force_is_another_flow(flow_kg_s: float, least: float, largest: float) -> None:
    angle, speed = MACHINE.home_plate_angle_rad, MACHINE.nominal_elevator_speed_rad_s
    slope = heap_slope(
        MODEL, KNOWN, mass_flow_kg_s=flow_kg_s, plate_angle_rad=angle, elevator_speed_rad_s=speed, moisture_pct=float("nan")
    )
    assert least <= slope <= largest
    at = Conditions(angle, speed, mass_flow_kg_s=flow_kg_s)
    force = MODEL.paddle_momentum(at, VALUES) * MACHINE.passes_per_s(speed)
    flows = []
    for ratio in (2.0 / 1.02, 2.0 * 1.02):
        known = replace(KNOWN, values={**VALUES, "shape_ratio": ratio})
        flows.append(float(np.squeeze(OpenLoop(MODEL, known).estimate(force, angle, speed).mass_flow_kg_s)))
    assert slope == pytest.approx(np.log(flows[1] / flows[0]) / (2.0 * np.log(1.02)), abs=0.01)


def test_a_heap_that_moves_both_flows_alike_widens_their_mean_and_does_not_average_out() -> None:
    plain, shared = (
        combine(8.0, 0.03, 8.0, 0.1, exponent=0.8, parameters=KNOWN, heap=heap) for heap in ((0.0, 0.0), (0.04, 0.06))
    )
    assert shared.mass_flow_kg_s == plain.mass_flow_kg_s
    assert shared.relative_sd > np.hypot(plain.relative_sd, 0.03)
