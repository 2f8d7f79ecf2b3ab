"""What mean force and kernel noise lose or gain alike, as a machine's configuration states it, in the published deviation."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np
import pytest

from yieldmon.engine.flow import Flow
from yieldmon.engine.settings import WaveformSettings
from yieldmon.engine.waveform.channel_scales import ChannelScales, Scale
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import EstimateQuality
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

VALUES = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
MEAN_SD, KERNELS_SD = 0.08, 0.052


@pytest.mark.parametrize("hit_sd", [0.0, 0.05, 0.1])
def test_the_stated_share_of_grain_that_misses_or_strikes_again_does_not_average_out(hit_sd: float) -> None:
    """Half of the grain strikes again with 0.3 of its push: both channels are 17 and 21 % high, and agree."""
    estimator = OpenLoop(ForwardModel(Machine(), ("gravity",)), ParameterSet(VALUES, (), np.zeros((0, 0))))
    scales = ChannelScales(replace(WaveformSettings(), enabled=True, combine=True, hit_sd=hit_sd))
    scales.by_kernels(Scale(0.035, KERNELS_SD, 0.0, estimator, 10.0))
    mean_flow = Flow(8.0 * 1.17, MEAN_SD * 8.0 * 1.17, EstimateQuality.OK, 80.0, 1.0)
    found = scales.corrected(mean_flow, 11.0, estimator)
    assert found is not None
    flow, sd = found
    independent = MEAN_SD * KERNELS_SD / hypot(MEAN_SD, KERNELS_SD)
    assert sd / flow == pytest.approx(hypot(independent, hit_sd))
    assert (abs(flow / 8.0 - 1.0) < 2.0 * sd / flow) == (hit_sd == 0.1)
