"""A flow whose force goes beyond what sensor or model can show is stated with what may be beyond it."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite

import numpy as np
import pytest
from engine_bench import MACHINE
from test_measurement_by_a_table import Seconds

from yieldmon.engine.flow import Circumstances, Flow, FlowMeter, estimates
from yieldmon.engine.measurement import Reading
from yieldmon.engine.sampling.hidden_force import hidden_share
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.files import parameter_file
from yieldmon.physics.model import ForwardModel

PARAMETERS = parameter_file.load()
KNOWN = OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS)
CALM = Circumstances(sweeping=False, calibration_old=False)
FULL_SCALE_MV = MACHINE.sensor.full_scale_mv


def reading(**of: float) -> Reading:
    """Of a second of harvest at 60 N; of: fields of the window."""
    machine = Seconds()
    machine.harvest(3)
    return machine.harvest(**of)


def flow(of: Reading) -> Flow:
    (found,) = estimates(KNOWN, [of])
    return FlowMeter(EngineSettings(), MACHINE).flow(of, found, KNOWN, CALM)


@pytest.mark.parametrize("duty", [0.3, 0.6])
@pytest.mark.parametrize("shape", [lambda x: 1.0 - abs(x), lambda x: np.cos(0.5 * np.pi * x)], ids=["triangle", "half a sine"])
@pytest.mark.parametrize("share", [0.02, 0.08, 0.15])
def test_what_is_cut_off_is_known_to_a_factor_of_two(duty, shape, share) -> None:  # type: ignore[no-untyped-def]
    """Paddles that throw 7 % more or less than the mean one."""
    time = np.linspace(-1.0, 1.0, 2001)
    peaks = 1.0 + 0.07 * np.random.default_rng(4).standard_normal(200)
    pulses = np.where(np.abs(time) < duty, shape(time / duty), 0.0)[None, :] * peaks[:, None]
    end = float(np.quantile(pulses, 1.0 - share))
    cut = np.minimum(pulses, end)
    lost = float(pulses.mean() / cut.mean()) - 1.0
    assert 0.5 * lost - 0.001 < hidden_share(float(cut.mean()), end, share) < 2.0 * lost


def test_it_is_as_much_again_at_most_and_nothing_without_such_samples() -> None:
    assert hidden_share(60.0, 100.0, 0.0) == 0.0
    assert hidden_share(90.0, 100.0, 0.95) == hidden_share(50.0, 100.0, 0.5) == 1.0
    assert hidden_share(-1.0, 100.0, 0.2) == hidden_share(60.0, 0.0, 0.2) == 0.0


@pytest.mark.parametrize("ceiling_mv", [0.0, 700.0])
def test_a_sensor_at_the_end_of_its_range_widens_the_flow(ceiling_mv: float) -> None:
    """15 % of samples cut off took a fifth off a load that was stated to 1 %."""
    below = flow(reading())
    plain, cut = (reading(saturated_share=share, ceiling_mv=ceiling_mv) for share in (0.0, 0.15))
    found = flow(cut)
    assert found.rate_kg_s == below.rate_kg_s
    assert flow(plain).std_dev_kg_s == pytest.approx(below.std_dev_kg_s)
    zero_mv = 0.0 if cut.zero is None else cut.zero.zero_mv
    hidden = hidden_share(cut.window.mean_mv - zero_mv, (ceiling_mv or FULL_SCALE_MV) - zero_mv, 0.15)
    assert found.std_dev_kg_s >= hidden * found.rate_kg_s > 3.0 * below.std_dev_kg_s


def test_a_force_above_a_full_paddles_is_stated_with_what_the_model_cannot_explain() -> None:
    """Its load and all further totals had no standard deviation at all."""
    of = reading()
    largest = replace(of, force_n=1.0)
    for _ in range(40):
        more = replace(largest, force_n=1.2 * largest.force_n)
        if estimates(KNOWN, [more])[0].status == 3:  # type: ignore[union-attr]
            break
        largest = more
    full, above = flow(largest), flow(replace(largest, force_n=2.0 * largest.force_n))
    assert above.saturated
    assert isfinite(above.std_dev_kg_s)
    assert isfinite(above.budget.noise_kg_s)
    assert above.std_dev_kg_s > 0.6 * above.rate_kg_s > 10.0 * full.std_dev_kg_s
