"""The moisture for which the parameters hold, and the standard deviation of the flow of grain with another moisture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt

from yieldmon.engine.settings import BudgetSettings
from yieldmon.estimation.parameters import ParameterSet

_AVERAGED_READINGS = 6
_NOW_VARIANCE = 1.0 / (2 * _AVERAGED_READINGS - 1)
"""Variance of the exponentially weighted mean of the newest readings, relative to that of one reading."""
_SCATTER_READINGS = 60
"""Number of readings over which their scatter is estimated."""
_MOST_SCATTER_PCT = 0.5
"""Standard deviation of readings of the same grain, at most: a larger difference between two readings means other grain."""


@dataclass(frozen=True, slots=True)
class MoistureState:
    """The moisture for which parameters hold, and the readings since.

    Attributes
    ----------
    version : int
        Of the parameters.
    low_pct, high_pct : float
        Range of moistures for which they hold, %.
    now_pct : float
        Mean of the newest readings, %.
    readings : int
        Number of readings whose mean low_pct and high_pct are; 0: the range was given, not measured.
    last_pct : float or None
        Newest reading, %; None before the first.
    variance_pct2 : float
        Variance of the readings of the same grain, %^2.
    differences : int
        Number of differences between successive readings that variance_pct2 was estimated from.
    """

    version: int
    low_pct: float
    high_pct: float
    now_pct: float
    readings: int = 0
    last_pct: float | None = None
    variance_pct2: float = 0.0
    differences: int = 0


class MoistureReference:
    """The moisture for which the parameters hold: their calibrated range, the moisture of the load that set their scale, or the
    first moisture measured with them. A sweep does not change it, since a sweep leaves the scale unchanged.

    About six of the newest readings are averaged, because a moisture sensor scatters by some tenths of a percentage point. The
    squared difference of two such means exceeds that of the true moistures by the sum of their variances, which is subtracted.
    """

    def __init__(self, settings: BudgetSettings) -> None:
        self._settings = settings
        self._state: MoistureState | None = None

    @property
    def state(self) -> MoistureState | None:
        """None before the first reading."""
        return self._state

    def restore(self, state: MoistureState) -> None:
        """Continue from a stored state."""
        self._state = state

    def forget(self) -> None:
        """Other parameters are in use from now on, and their moisture is not known."""
        self._state = None

    def std_dev_by(self, moisture_pct: float, parameters: ParameterSet) -> float:
        """`relative_std_dev` with the parameters in use, at a moisture measured now, %."""
        calibrated, followed = parameters.calibrated.moisture_pct, "moisture_dependence" in parameters.effects
        return self.relative_std_dev(moisture_pct, parameters.version, calibrated, followed=followed)

    def relative_std_dev(
        self, moisture_pct: float, version: int, calibrated: tuple[float, float] | None, *, followed: bool
    ) -> float:
        """Relative standard deviation of flow from moisture.

        Parameters
        ----------
        moisture_pct : float
            Measured now, %; nan where it is not measured.
        version : int
            Of the parameters in use.
        calibrated : (float, float) or None
            Moistures that the parameters were calibrated over, %.
        followed : bool
            Whether the model has moisture among its inputs.

        Returns
        -------
        float
        """
        if followed:
            return 0.0
        known = self._state if self._state is not None and self._state.version == version else None
        if not isfinite(moisture_pct):
            unmeasured_pct = self._settings.unmeasured_moisture_pct
            return self._settings.moisture_per_pct * hypot(unmeasured_pct, 0.0 if known is None else _away_pct(known))
        known = _begun(version, moisture_pct, calibrated) if known is None else _with_reading(known, moisture_pct)
        self._state = known
        return self._settings.moisture_per_pct * _away_pct(known)

    def hold(self, version: int, moisture_pct: float) -> None:
        """Other parameters are in use from now on, valid for this moisture, %; nan: for that of the parameters before."""
        if isfinite(moisture_pct):
            if self._state is None:
                self._state = MoistureState(version, moisture_pct, moisture_pct, moisture_pct)
            else:
                self._state = replace(self._state, version=version, low_pct=moisture_pct, high_pct=moisture_pct, readings=0)
        elif self._state is not None:
            self._state = replace(self._state, version=version)


def _begun(version: int, moisture_pct: float, calibrated: tuple[float, float] | None) -> MoistureState:
    if calibrated is not None:
        return MoistureState(version, *calibrated, moisture_pct, last_pct=moisture_pct)
    return MoistureState(version, moisture_pct, moisture_pct, moisture_pct, 1, moisture_pct)


def _with_reading(known: MoistureState, moisture_pct: float) -> MoistureState:
    """The state with one more reading; the reference itself is the mean of the first few."""
    variance, differences = known.variance_pct2, known.differences
    if known.last_pct is not None:
        differences = min(differences + 1, _SCATTER_READINGS)
        variance += (min(0.5 * (moisture_pct - known.last_pct) ** 2, _MOST_SCATTER_PCT**2) - variance) / differences
    low_pct, high_pct, readings = known.low_pct, known.high_pct, known.readings
    if 0 < readings < _AVERAGED_READINGS:
        readings += 1
        low_pct = high_pct = now_pct = low_pct + (moisture_pct - low_pct) / readings
    else:
        now_pct = known.now_pct + (moisture_pct - known.now_pct) / _AVERAGED_READINGS
    return MoistureState(known.version, low_pct, high_pct, now_pct, readings, moisture_pct, variance, differences)


def _away_pct(known: MoistureState) -> float:
    """Root mean square distance of the grain's moisture from the reference, %, without the scatter of the readings."""
    apart = max(known.low_pct - known.now_pct, known.now_pct - known.high_pct, 0.0)
    of_means = _NOW_VARIANCE + (1.0 / known.readings if known.readings else 0.0)
    return sqrt(max(apart**2 - of_means * known.variance_pct2, 0.0))
