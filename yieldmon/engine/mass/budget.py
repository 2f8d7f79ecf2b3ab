"""The error budget of mass: what averages out over seconds, and what all seconds of a load share.

Noise is independent from window to window: its variances add. While the plate moves, the flow has a further error whose sign
depends on the direction of motion: it adds with its sign. Errors of the parameters (scale and model), of the zero and of a
moisture that the calibration does not follow are the same for neighbouring seconds: their standard deviations add, which is right
within a load and an upper bound beyond it (JCGM 100:2008, 5.2.2 with correlation 1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.mass.unseen import SAME, UnseenChange
from yieldmon.engine.settings import BudgetSettings

_NAN = float("nan")
_DOUBTED_SHARE = 0.5
"""Least share of the missed mass that the zero's stated error had covered, for the zero to count as doubted."""
_CONTRADICTED = 3.0
"""Standard deviations beyond which the level of the empty plate contradicts the expected drift of the zero."""


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
        The part of parameters_kg_s that comes from the parameters' covariance, without the model error that sweeps show.
    per_error_kg_s : float
        Change of the flow by a relative error of 1 of the force.
    motion_kg_s : float
        The part of noise_kg_s due to the motion of the plate, signed: the sign is the opposite on the way back.
    taken_off : float
        Relative error of the force away from home for which the flow was corrected.
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
        """The budget after the flow was multiplied by factor, to remove the relative error `away` of the force."""
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
        Variance of the errors that no other mass shares, kg^2: noise, which averages out, and mass that was not measured.
    parameters_kg, zero_kg, moisture_kg : float
        Standard deviations of the errors that all seconds share, as in FlowBudget.
    motion_kg : float
        Error due to the motion of the plate, signed. Its one cause: the grain strikes later than the plate angle was read.
    """

    noise_kg2: float = 0.0
    parameters_kg: float = 0.0
    zero_kg: float = 0.0
    moisture_kg: float = 0.0
    motion_kg: float = 0.0

    def plus(self, flow: FlowBudget, seconds: float) -> MassBudget:
        """The budget after `seconds` more of a flow."""
        return _made(
            self.noise_kg2 + (flow.noise_kg_s * seconds) ** 2 - (flow.motion_kg_s * seconds) ** 2,
            self.parameters_kg + flow.parameters_kg_s * seconds,
            self.zero_kg + flow.zero_kg_s * seconds,
            self.moisture_kg + flow.moisture_kg_s * seconds,
            self.motion_kg + flow.motion_kg_s * seconds,
        )

    def with_more(self, more: MassBudget) -> MassBudget:
        """The budget of both masses together: independent errors add in variance, shared ones in standard deviation."""
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
        """The budget of a mass that was corrected from before_kg to after_kg, by what a wrong zero had missed.

        zero_kg becomes that of the mass measured again; where not all since the wrong zero was measured again and that zero was
        doubted, zero_kg had covered about missed_kg, which is subtracted. The other errors stay the same relative to the mass.
        Where there was no mass before, the budget of the mass measured again is added (again; None: not known). unseen: of this
        mass. again_kg: the part of it that was measured again, nan where that is not all since the wrong zero.
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
        """The budget when another unseen_kg may be missing, beside the before_kg that may be missing already."""
        return replace(self, noise_kg2=self.noise_kg2 + unseen_kg * (2.0 * before_kg + unseen_kg))

    def with_zero(self, more_kg: float) -> MassBudget:
        """The budget when a wrong zero may have hidden another more_kg."""
        return replace(self, zero_kg=self.zero_kg + more_kg)

    def with_parameters(self, more_kg: float) -> MassBudget:
        """The budget when the standard deviation by the parameters turns out more_kg larger (below 0: smaller)."""
        return _made(self.noise_kg2, max(self.parameters_kg + more_kg, 0.0), self.zero_kg, self.moisture_kg, self.motion_kg)

    def with_common(self, parameters_kg: float) -> MassBudget:
        """The budget when the standard deviation by the parameters turns out to be at least parameters_kg."""
        return replace(self, parameters_kg=max(self.parameters_kg, parameters_kg))

    @property
    def std_dev_kg(self) -> float:
        """All causes together."""
        return hypot(sqrt(self.noise_kg2), self.parameters_kg, self.zero_kg, self.moisture_kg, self.motion_kg)

    @classmethod
    def unknown(cls) -> MassBudget:
        """The budget of a mass that was accumulated without one."""
        return cls(_NAN, _NAN, _NAN, _NAN, _NAN)


_made = maker_of(MassBudget)
EMPTY = MassBudget()
"""Of no mass."""


def zero_std_dev_mv(settings: BudgetSettings, since_empty_s: float, away_mv: float = 0.0) -> float:
    """Standard deviation of the zero, mV: as it was taken, and the drift since.

    Parameters
    ----------
    settings : BudgetSettings
    since_empty_s : float
        Since the zero was last taken or followed, s.
    away_mv : float
        Difference of the empty plate from the zero since then, mV; beyond three standard deviations it is the result.

    Returns
    -------
    float
    """
    return away_mv if contradicts_drift(settings, since_empty_s, away_mv) else _drift_mv(settings, since_empty_s)


def contradicts_drift(settings: BudgetSettings, since_empty_s: float, away_mv: float) -> bool:
    """Whether the expected drift does not explain that the empty plate is so far from the zero.

    Parameters
    ----------
    settings, since_empty_s, away_mv
        As of `zero_std_dev_mv`.

    Returns
    -------
    bool
    """
    return away_mv > _CONTRADICTED * _drift_mv(settings, since_empty_s)


def _drift_mv(settings: BudgetSettings, since_empty_s: float) -> float:
    hours = max(0.0, since_empty_s) / 3600.0
    return hypot(settings.zero_mv, settings.zero_drift_mv_per_root_h * sqrt(hours))
