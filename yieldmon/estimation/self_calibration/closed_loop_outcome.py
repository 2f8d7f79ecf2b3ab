"""Result of the closed loop: flows of the sweeps, updates of the parameters, and the scale, which no sweep determines."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from yieldmon.estimation.fitting.identifiability import Direction
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class FlowPosterior:
    """Mean mass flow of one sweep, kg/s. log_sd: standard deviation of its logarithm, including the parameters' uncertainty."""

    mass_flow_kg_s: float
    log_sd: float

    @property
    def std_dev_kg_s(self) -> float:
        """Standard deviation, kg/s."""
        return self.mass_flow_kg_s * self.log_sd

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Central interval, kg/s; its upper end is inf if nothing is known of the flow."""
        from scipy.special import ndtri

        reach = float(ndtri(0.5 + 0.5 * level)) * self.log_sd
        with np.errstate(over="ignore"):
            return self.mass_flow_kg_s * float(np.exp(-reach)), self.mass_flow_kg_s * float(np.exp(reach))


@dataclass(frozen=True, slots=True)
class ParameterUpdate:
    """Prior and posterior of one parameter, with standard deviations. learned: whether value and variance were updated."""

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

    Attributes
    ----------
    prior_sd, posterior_sd : float
        Standard deviation of ln a.
    shift : float
        ln a from the prior to the result.
    observable : bool
        Whether something other than the prior determines it: a weighed mass, or an effect that breaks the symmetry.
    unobservable_directions : tuple of Direction
        Directions that the sweeps alone do not determine, found numerically.
    """

    prior_sd: float
    posterior_sd: float
    shift: float
    observable: bool
    unobservable_directions: tuple[Direction, ...]

    @property
    def ratio(self) -> float:
        """Posterior over prior standard deviation; nan if the latter is 0."""
        return self.posterior_sd / self.prior_sd if self.prior_sd > 0.0 else float("nan")


NO_SCALE = ScaleReport(0.0, 0.0, 0.0, observable=False, unobservable_directions=())
"""Result if the scale cannot be judged."""


@dataclass(frozen=True)
class Outcome:
    """The result of `self_calibrate`.

    Parameters
    ----------
    parameter_set : ParameterSet
        The one to use from now on; the prior's own if `updated` is False.
    updated : bool
    consistent : bool
        Whether the misfit is no more than noise and model error explain; if not, nothing is updated.
    reason : str
        One sentence for the operator.
    region : str
        Where the sweeps' misfit is largest.
    flows : tuple of FlowPosterior
        Mean mass flow of each sweep, kg/s, with its standard deviation. If the sweeps are not consistent, the standard deviation
        is computed with a model error large enough to explain the misfit, independent at each angle, and widened by the change of
        the flow that this error causes.
    parameters : tuple of ParameterUpdate
        Prior and posterior of each parameter that was updated.
    scale : ScaleReport
        Prior and posterior of the scale, which no sweep determines alone.
    chi2, dof, p_value : float, int, float
        Misfit, its degrees of freedom, and the probability of so large a misfit by chance.
    residuals : tuple of ndarray
        Measured less predicted force of each sweep's windows, N.
    prior_widening : float
        Factor by which `update_from_tickets` multiplied the prior's covariance until it agreed with the weighed masses.

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
        """The outcome without any measurement.

        Parameters
        ----------
        parameter_set : ParameterSet

        Returns
        -------
        Outcome
            With nothing updated.
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
        """Names of the parameters that were updated.

        Returns
        -------
        tuple of str
        """
        return tuple(p.name for p in self.parameters if p.learned)
