"""The windows that a sweep has measured: whether it may continue with them, and whether the plate can have moved."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite, log

from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweeps.steady_home import spread
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort, SweepWindow


class SweepMeasurement:
    """The measured windows of one sweep at a time."""

    def __init__(self, settings: SweepSettings) -> None:
        self._settings = settings
        self._base_kg_s = self._base_rad_s = float("nan")
        self._seen: list[tuple[float, float]] = []
        self._of_step = 0

    def begin(self, base: tuple[float, float], before: Iterable[SweepWindow] = ()) -> None:
        """A sweep begins. base: mean flow, kg/s, and elevator speed, rad/s, before it. before: windows that already belong to
        it."""
        self._base_kg_s, self._base_rad_s = base
        self._seen = [(window.flow_kg_s, window.force_n) for window in before]
        self._of_step = 0

    def begin_step(self) -> None:
        """The windows of another step follow."""
        self._of_step = 0

    def add(self, window: SweepWindow) -> None:
        """A window counts for the step."""
        self._seen.append((window.flow_kg_s, window.force_n))
        self._of_step += 1

    @property
    def step_done(self) -> bool:
        """Whether the step has as many windows as it needs."""
        return self._of_step >= self._settings.windows_per_step

    def trouble(self, window: SweepWindow, *, usable: bool, at_home: bool) -> SweepAbort | None:
        """Why the sweep cannot continue with this window; None where it can. usable: its flow can be compared."""
        if not isfinite(window.flow_kg_s):
            return SweepAbort.NOT_MEASURED
        if abs(window.speed_rad_s / self._base_rad_s - 1.0) > self._settings.speed_change:
            return SweepAbort.SPEED_CHANGED
        limit = self._settings.flow_change if at_home else self._settings.flow_change_away
        if usable and abs(window.flow_kg_s / self._base_kg_s - 1.0) > limit:
            return SweepAbort.FLOW_CHANGED
        return None

    def implausible_feedback(self) -> bool:
        """Whether a plate that never moved explains the whole sweep: the force varies less than the flow computed from it."""
        if any(flow <= 0.0 or force <= 0.0 for flow, force in self._seen):
            return False
        flow_spread = spread([log(flow) for flow, _ in self._seen])
        force_spread = spread([log(force) for _, force in self._seen])
        least, share = self._settings.feedback_plausibility_flow_spread, self._settings.feedback_plausibility_force_ratio
        return flow_spread > least and force_spread < share * flow_spread
