"""Settings of the self-calibration, which a configuration holds without the calibrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.self_calibration.drift_rates import STEADY_MEMORY_KT, DriftRates, steady_defaults
from yieldmon.estimation.self_calibration.moisture import MoistureMap
from yieldmon.setting_keys import quantity


@dataclass(frozen=True, slots=True)
class CalibratorSettings:
    """How sweeps and weighed loads update the parameters.

    `service.config.calibration_sections` makes a section of the configuration file from these keys and those of `closed_loop`.
    drift, steady_per_kilotonne: how parameters wander, and the standard deviations of their steady rates (`steady_drift`).
    moisture_map: moves the prior when the moisture changes; None: moisture is not used.
    """

    closed_loop: ClosedLoopSettings = field(
        default_factory=lambda: ClosedLoopSettings(flow="process", model_error=0.01, kept_ratio=1.0)
    )
    drift: DriftRates = field(default_factory=DriftRates)
    steady_per_kilotonne: Mapping[str, float] = field(default_factory=steady_defaults)
    steady_drift_memory_kt: float = quantity(
        STEADY_MEMORY_KT, 0.01, 1e6, "kt", "harvested mass after which a steady drift rate has decayed to 1/e"
    )
    pattern_sd: float = quantity(
        0.0, 0.0, 0.2, "1", "relative model error away from home that sweeps separate from the grain parameters; 0: none"
    )
    """See `estimation.self_calibration.angle_pattern`."""
    reference_error: float = quantity(0.005, 0.0, 0.5, "1", "relative error of a weighed load in addition to the scale's own")
    """By flow spread and model, added in quadrature."""
    density_ratio: float | None = quantity(
        None, 0.1, 10.0, "1", "density in the paddles over test weight, if known; null: test weight is not used"
    )
    density_ratio_std_dev: float = quantity(0.1, 0.0, 10.0, "1", "standard deviation of that ratio")
    test_weight_std_dev_kg_m3: float = quantity(10.0, 0.1, 500.0, "kg/m3", "standard deviation of the test weight")
    moisture_map: MoistureMap | None = None
