"""The error budget of mass: what averages out over seconds, and what all seconds of a load share.

Noise of the windows is independent from one to the next: its variances add. While the plate moves the flow has another error that
goes with the motion, out as much as back: it adds with its sign. Errors of the parameters (scale and model), of the zero and of a
moisture that the calibration does not follow are the same for neighbouring seconds: their standard deviations add, which is right
within a load and an upper bound beyond it (JCGM 100:2008, 5.2.2 with correlation 1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt

from yieldmon.engine.mass.unseen import SAME, UnseenChange
from yieldmon.engine.quick import maker_of
from yieldmon.engine.settings import BudgetSettings

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class FlowBudget:
    """Standard deviation of one window's flow by cause, kg/s; nan where the flow is not known.

    Attributes
    ----------
    noise_kg_s : float
        Scatter of the paddles, electrical noise: averages out.
    parameters_kg_s : float
        The parameters' covariance: scale and model.
    zero_kg_s : float
        The zero's uncertainty since the elevator last ran empty.
    moisture_kg_s : float
        Grain whose moisture differs from the calibration's, or is not measured.
    covariance_kg_s : float
        Of parameters_kg_s the part that is not the model's error by what sweeps show.
    per_error_kg_s : float
        Change of the flow by a relative error of 1 of the force.
    motion_kg_s : float
        Of noise_kg_s the part of a plate that moves, with the sign that it has in this direction: on the way back it is of the
        other.
    taken_off : float
        Relative error of the force away from home that was taken off the flow.
    """

    noise_kg_s: float = _NAN
    parameters_kg_s: float = _NAN
    zero_kg_s: float = 0.0
    moisture_kg_s: float = 0.0
    covariance_kg_s: float = 0.0
    per_error_kg_s: float = 0.0
    motion_kg_s: float = 0.0
    taken_off: float = 0.0

    def without(self, away: float, factor: float) -> FlowBudget:
        """Of the flow multiplied by a factor, by which a relative error of the force, `away`, is taken off it."""
        return FlowBudget(
            factor * self.noise_kg_s, factor * self.parameters_kg_s, factor * self.zero_kg_s, factor * self.moisture_kg_s,
            factor * self.covariance_kg_s, factor * self.per_error_kg_s, factor * self.motion_kg_s, away,
        )  # fmt: skip

    @property
    def std_dev_kg_s(self) -> float:
        """All causes together."""
        return hypot(self.noise_kg_s, self.parameters_kg_s, self.zero_kg_s, self.moisture_kg_s)


NO_BUDGET = FlowBudget()
"""Of a flow that is not known."""


@dataclass(frozen=True, slots=True)
class MassBudget:
    """Standard deviation of an accumulated mass by cause, kg; nan where a part of the mass has none.

    Attributes
    ----------
    noise_kg2 : float
        Variance of what no other mass shares, kg^2: noise, which averages out, and what may have come unseen.
    parameters_kg, zero_kg, moisture_kg : float
        Standard deviations of what the seconds share, as in FlowBudget.
    motion_kg : float
        Of a moving plate, with its sign: all of it has one cause, by which grain strikes later than the plate's angle was read.
    """

    noise_kg2: float = 0.0
    parameters_kg: float = 0.0
    zero_kg: float = 0.0
    moisture_kg: float = 0.0
    motion_kg: float = 0.0

    def plus(self, flow: FlowBudget, seconds: float) -> MassBudget:
        """The budget with `seconds` of a flow more."""
        return _made(
            self.noise_kg2 + (flow.noise_kg_s * seconds) ** 2 - (flow.motion_kg_s * seconds) ** 2,
            self.parameters_kg + flow.parameters_kg_s * seconds,
            self.zero_kg + flow.zero_kg_s * seconds,
            self.moisture_kg + flow.moisture_kg_s * seconds,
            self.motion_kg + flow.motion_kg_s * seconds,
        )

    def with_more(self, more: MassBudget) -> MassBudget:
        """The budget of both masses: what averages out does so over both, the rest they share."""
        return MassBudget(
            self.noise_kg2 + more.noise_kg2,
            self.parameters_kg + more.parameters_kg,
            self.zero_kg + more.zero_kg,
            self.moisture_kg + more.moisture_kg,
            self.motion_kg + more.motion_kg,
        )

    def minus(self, before: MassBudget) -> MassBudget:
        """The budget of what came after `before`."""
        return MassBudget(
            noise_kg2=max(self.noise_kg2 - before.noise_kg2, 0.0),
            parameters_kg=max(self.parameters_kg - before.parameters_kg, 0.0),
            zero_kg=max(self.zero_kg - before.zero_kg, 0.0),
            moisture_kg=max(self.moisture_kg - before.moisture_kg, 0.0),
            motion_kg=self.motion_kg - before.motion_kg,
        )

    def with_missed(
        self,
        missed_kg: float,
        before_kg: float,
        after_kg: float,
        again: MassBudget | None,
        unseen: UnseenChange = SAME,
        again_kg: float = _NAN,
    ) -> MassBudget:
        """Of a mass that was corrected, before_kg to after_kg, by what a wrong zero had missed.

        By the zero all is as sure as what was measured again; where that is not all since the wrong zero, and that was doubted,
        its error held about as much, which it does not any more. All else is relatively the same. Where there was no mass before,
        that of what was measured again comes to it; None: not known. unseen: of this mass; again_kg: of it what was measured
        again, nan where that is not all.
        """
        doubted = self.zero_kg >= _DOUBTED_SHARE * abs(missed_kg) > 0.0
        zero_kg = max(self.zero_kg - abs(missed_kg) - unseen.hidden_kg, 0.0) if doubted else self.zero_kg
        by_again = again is not None and isfinite(again.zero_kg) and again_kg > 0.0
        seen_kg2, unseen_kg2 = max(self.noise_kg2 - unseen.before_kg**2, 0.0), unseen.after_kg**2
        if not before_kg > 0.0 and after_kg > 0.0:
            if again is None:
                return MassBudget.unknown()
            zero_kg = 0.0 if by_again else zero_kg
            return replace(self, noise_kg2=seen_kg2 + unseen_kg2, zero_kg=zero_kg).with_more(again)
        if again is not None and by_again:
            zero_kg = again.zero_kg * max(after_kg / again_kg, 1.0)
        factor = after_kg / before_kg if before_kg != after_kg else 1.0
        causes = (seen_kg2, self.parameters_kg, self.zero_kg, self.moisture_kg, self.motion_kg)
        known = MassBudget(*(cause * factor for cause in causes))
        known = replace(known, noise_kg2=known.noise_kg2 + unseen_kg2)
        return replace(known, zero_kg=zero_kg) if doubted or by_again else known

    def with_unseen(self, unseen_kg: float, before_kg: float) -> MassBudget:
        """The budget of a mass of which so much more may be missing, before_kg of it already."""
        return replace(self, noise_kg2=self.noise_kg2 + unseen_kg * (2.0 * before_kg + unseen_kg))

    def with_zero(self, more_kg: float) -> MassBudget:
        """The budget of a mass that a wrong zero may have made less by so much more."""
        return replace(self, zero_kg=self.zero_kg + more_kg)

    def with_parameters(self, more_kg: float) -> MassBudget:
        """The budget of a mass whose parameters turn out to be less sure by so much, or surer (below 0)."""
        return replace(self, parameters_kg=max(self.parameters_kg + more_kg, 0.0))

    def with_common(self, parameters_kg: float) -> MassBudget:
        """The budget of a mass whose parameters turn out to be less sure than they were taken to be, by so much at least."""
        return replace(self, parameters_kg=max(self.parameters_kg, parameters_kg))

    @property
    def std_dev_kg(self) -> float:
        """All causes together."""
        return hypot(sqrt(self.noise_kg2), self.parameters_kg, self.zero_kg, self.moisture_kg, self.motion_kg)

    @classmethod
    def unknown(cls) -> MassBudget:
        """Of a mass that was accumulated without one."""
        return cls(_NAN, _NAN, _NAN, _NAN, _NAN)


_made = maker_of(MassBudget)
_DOUBTED_SHARE = 0.5
"""Of what a zero missed, from which its stated error is one that was doubted."""
EMPTY = MassBudget()
"""Of no mass."""
_CONTRADICTED = 3.0
"""Standard deviations from which on what is seen of the empty plate contradicts the drift that is expected of the zero."""
_AVERAGED_READINGS = 6
_NOW_VARIANCE = 1.0 / (2 * _AVERAGED_READINGS - 1)
"""Of the mean of the newest readings, over that of one: their weights fall by the same share from each to the one before it."""
_SCATTER_READINGS = 60
"""Over which the scatter of readings is estimated."""
_MOST_SCATTER_PCT = 0.5
"""Standard deviation beyond which a reading that differs from the one before it is of other grain."""


@dataclass(frozen=True, slots=True)
class MoistureState:
    """The moisture for which parameters hold. version: of the parameters. low_pct, high_pct: the moisture, or its range, %.
    now_pct: mean of the newest readings, %. readings: of which low_pct and high_pct are the mean; 0: they are stated.
    last_pct: newest reading, %, None before one. variance_pct2: of readings of the same grain, by so many differences from one
    to the next."""

    version: int
    low_pct: float
    high_pct: float
    now_pct: float
    readings: int = 0
    last_pct: float | None = None
    variance_pct2: float = 0.0
    differences: int = 0


class MoistureReference:
    """The moisture for which the parameters hold: their calibrated range, that of the load which set their scale, or what was
    first measured with them. A sweep does not change it, since it leaves the scale as it was.

    Readings are averaged, about the newest six: a moisture sensor scatters by some tenths of a point. The square of what two
    means are apart is larger than that of the grain's moistures by the variance of both, which is taken off.
    """

    def __init__(self, settings: BudgetSettings) -> None:
        self._settings = settings
        self._state: MoistureState | None = None

    @property
    def state(self) -> MoistureState | None:
        """What is known; None before a reading."""
        return self._state

    def restore(self, state: MoistureState) -> None:
        """Go on from a state that was kept."""
        self._state = state

    def forget(self) -> None:
        """Other parameters come, of which no moisture is known."""
        self._state = None

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
        """Other parameters come, which hold for grain of this moisture, %; nan: for that of those before."""
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
    """One reading more: the reference itself is the mean of the first few."""
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
    """Root of what the mean square of the grain's distance from the reference is expected to be."""
    apart = max(known.low_pct - known.now_pct, known.now_pct - known.high_pct, 0.0)
    of_means = _NOW_VARIANCE + (1.0 / known.readings if known.readings else 0.0)
    return sqrt(max(apart**2 - of_means * known.variance_pct2, 0.0))


def zero_std_dev_mv(settings: BudgetSettings, since_empty_s: float, away_mv: float = 0.0) -> float:
    """Standard deviation of the zero, mV: as it was taken, and the drift since.

    Parameters
    ----------
    settings : BudgetSettings
    since_empty_s : float
        Since the zero was last taken or followed, s.
    away_mv : float
        How far the empty plate was seen from the zero since, mV: beyond three deviations it is the deviation.

    Returns
    -------
    float
    """
    hours = max(0.0, since_empty_s) / 3600.0
    expected_mv = hypot(settings.zero_mv, settings.zero_drift_mv_per_root_h * sqrt(hours))
    return away_mv if away_mv > _CONTRADICTED * expected_mv else expected_mv
