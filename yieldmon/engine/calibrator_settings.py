"""Settings of the self-calibration, which a configuration holds without the calibrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.self_calibration.drift_rates import STEADY_MEMORY_KT, DriftRates, steady_defaults

if TYPE_CHECKING:
    from yieldmon.estimation.self_calibration.moisture import MoistureMap


@dataclass(frozen=True, slots=True)
class CalibratorSettings:
    """Settings of the self-calibration.

    reference_error: relative error of a weighed load that is not the scale's (flow spread, model), added in quadrature.
    drift, steady_per_kilotonne: how parameters wander, and the standard deviations of their steady rates (`steady_drift`).
    steady_drift_memory_kt: harvested mass over which a steady rate falls to 1/e, kt.
    moisture_map: moves the prior when the moisture changes; None: moisture is not used.
    pattern_sd: relative standard deviation of the model's error away from the home angle that sweeps separate from the grain
    (`estimation.self_calibration.angle_pattern`); 0: none is looked for.
    density_ratio: parameter density over test weight, from a calibration in which both were known; None: test weight is not used.
    """

    closed_loop: ClosedLoopSettings = field(
        default_factory=lambda: ClosedLoopSettings(flow="process", model_error=0.01, kept_ratio=1.0)
    )
    drift: DriftRates = field(default_factory=DriftRates)
    steady_per_kilotonne: Mapping[str, float] = field(default_factory=steady_defaults)
    steady_drift_memory_kt: float = STEADY_MEMORY_KT
    reference_error: float = 0.005
    pattern_sd: float = 0.0
    density_ratio: float | None = None
    density_ratio_std_dev: float = 0.1
    test_weight_std_dev_kg_m3: float = 10.0
    moisture_map: MoistureMap | None = None
