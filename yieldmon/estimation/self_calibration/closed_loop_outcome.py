"""What the closed loop found: flows of the sweeps, what became of each parameter, and of the scale that no sweep determines."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from yieldmon.estimation.fitting.identifiability import Direction
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class FlowPosterior:
    """Mean mass flow of one sweep, kg/s; log_sd: standard deviation of its logarithm, parameters' uncertainty included."""

    mass_flow_kg_s: float
    log_sd: float

    @property
    def std_dev_kg_s(self) -> float:
        """Standard deviation, kg/s."""
        return self.mass_flow_kg_s * self.log_sd

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Central interval, kg/s; to inf where nothing is known of the flow."""
        from scipy.special import ndtri

        reach = float(ndtri(0.5 + 0.5 * level)) * self.log_sd
        with np.errstate(over="ignore"):
            return self.mass_flow_kg_s * float(np.exp(-reach)), self.mass_flow_kg_s * float(np.exp(reach))


@dataclass(frozen=True, slots=True)
class ParameterUpdate:
    """Prior and posterior of one parameter. learned: whether value and variance were updated."""

    name: str
    prior: float
    prior_sd: float
    value: float
    sd: float
    learned: bool

    @property
    def ratio(self) -> float:
        """Posterior over prior standard deviation."""
        return self.sd / self.prior_sd

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Central interval."""
        from scipy.special import ndtri

        reach = float(ndtri(0.5 + 0.5 * level)) * self.sd
        return self.value - reach, self.value + reach


@dataclass(frozen=True, slots=True)
class ScaleReport:
    """The direction (mass flow, density, impact gain) -> (a, a, 1/a).

    prior_sd, posterior_sd of ln a; shift: ln a from the prior to the answer. observable: whether something other than the prior
    (a weighed mass, an effect that breaks the symmetry) speaks of it.
    """

    prior_sd: float
    posterior_sd: float
    shift: float
    observable: bool
    unobservable_directions: tuple[Direction, ...]
    """Found numerically from the sweeps alone, whatever they may be."""

    @property
    def ratio(self) -> float:
        """Posterior over prior width."""
        return self.posterior_sd / self.prior_sd if self.prior_sd > 0.0 else float("nan")


NO_SCALE = ScaleReport(0.0, 0.0, 0.0, observable=False, unobservable_directions=())
"""Where the scale cannot be judged."""


@dataclass(frozen=True)
class Outcome:
    """The result of `self_calibrate`.

    Parameters
    ----------
    parameter_set : ParameterSet
        The one to use from now on; the prior's own where updated is False.
    updated : bool
    consistent : bool
        Whether the misfit is no more than noise and model error explain; if not, nothing is updated.
    reason : str
        One sentence for the operator.
    region : str
        Where the sweeps' misfit is largest.
    flows : tuple of FlowPosterior
        Mean mass flow of each sweep, kg/s, with its deviation; where it is not consistent, that which as large an error of the
        model as makes it so, one draw an angle, leaves and moves it by.
    parameters : tuple of ParameterUpdate
        Prior and posterior of each parameter that was updated.
    scale : ScaleReport
        Prior and posterior of the scale, which no sweep determines alone.
    chi2, dof, p_value : float, int, float
        Misfit, its degrees of freedom, and the probability of so large a misfit by chance.
    residuals : tuple of ndarray
        Of each sweep, N: measured less predicted force, in the order of its windows.
    prior_widening : float
        What `update_from_tickets` multiplied the prior's covariance by before it agreed with the weighed masses.

    Examples
    --------
    See `self_calibrate`.
    """

    parameter_set: ParameterSet
    updated: bool
    consistent: bool
    reason: str
    region: str
    flows: tuple[FlowPosterior, ...]
    parameters: tuple[ParameterUpdate, ...]
    scale: ScaleReport
    chi2: float
    dof: int
    p_value: float
    residuals: tuple[Array, ...] = field(repr=False)
    prior_widening: float = 1.0

    @classmethod
    def unchanged(cls, parameter_set: ParameterSet) -> Outcome:
        """Where no measurement came.

        Parameters
        ----------
        parameter_set : ParameterSet

        Returns
        -------
        Outcome
            That nothing is updated.
        """
        return cls(
            parameter_set,
            updated=False,
            consistent=True,
            reason="",
            region="",
            flows=(),
            parameters=(),
            scale=NO_SCALE,
            chi2=0.0,
            dof=0,
            p_value=1.0,
            residuals=(),
        )

    def learned(self) -> tuple[str, ...]:
        """Names of the parameters that moved.

        Returns
        -------
        tuple of str
        """
        return tuple(p.name for p in self.parameters if p.learned)
