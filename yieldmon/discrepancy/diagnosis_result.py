"""Options and result of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.arguments import require_type
from yieldmon.documents.diagnose import Verdict
from yieldmon.errors import InputError
from yieldmon.physics.effects import registry

from .choice import Choice
from .experiment import Plan
from .fit import Fit
from .lack_of_fit import Region
from .noise import Noise
from .observations import Rows
from .policy import Policy
from .stopgap import Correction
from .validation import Share, Validation

_FORMS = ("auto", "restitution", "exchange")


@dataclass(frozen=True)
class Options:
    """Options of `diagnose`.

    Parameters
    ----------
    form : {"auto", "restitution", "exchange"}
        Form of the impact: one restitution, or k1 and k2.
    hold_out : str
        Rows held out of the fit: "cells", "trials", "none", or a column and value such as "plate_angle_deg=70".
    without : tuple of str
        Effects that are excluded from the library.
    keep_effects : bool
        Whether the model contains the effects of the parameters, with their values; default: none.
    seed : int
        Seed of the random numbers.
    policy : Policy
        Thresholds for naming an effect.

    Raises
    ------
    InputError
        For another form, and for an effect that is not known.

    Examples
    --------
    >>> api.Options(hold_out="none").form
    'auto'
    """

    form: str = "auto"
    hold_out: str = "cells"
    without: tuple[str, ...] = ()
    keep_effects: bool = False
    seed: int = 1
    policy: Policy = field(default_factory=Policy)

    def __post_init__(self) -> None:
        if self.form not in _FORMS:
            raise InputError("form", f"is {self.form!r}", f"{', '.join(_FORMS[:-1])} or {_FORMS[-1]}")
        require_type("without", self.without, (tuple, list), "names such as ('gravity',)")
        for name in self.without:
            if name not in registry():
                raise InputError("without", f"{name!r} is not an effect", f"one of {', '.join(registry())}")


DEFAULT = Options()


@dataclass(frozen=True)
class Measure:
    """Misfit of model and rows: rms in the reading's unit, and the two numbers of the lack-of-fit test if they apply."""

    rms: float
    rms_over_max_pct: float
    lack_of_fit_f: float | None
    p_value: float | None


def share_closed_pct(before: float, after: float, floor: float) -> float | None:
    """Removed share of the misfit from its rms before, after and by noise alone, %; None if the misfit is within the noise."""
    return 100.0 * (before - after) / (before - floor) if before > floor else None


@dataclass(frozen=True)
class HeldOut:
    """Score on the held-out rows: their number, misfit before and after, noise floor, and 100 (before - after) / (before -
    floor), which is None if the misfit is within the noise."""

    rows: int
    before: Measure
    after: Measure
    noise_floor_rms: float
    closed_pct: float | None
    closed_interval_pct: tuple[float, float] | None = None
    """95 % interval by the noise of the same rows and the model error."""
    f_interval: tuple[tuple[float, float], tuple[float, float]] | None = None
    """95 % intervals of the lack of fit before and after."""
    share: Share | None = None


@dataclass(frozen=True)
class Examination:
    """The verdict and its validation on held-out rows. is_held_out, outlier: masks (rows,). validation: None if there are no
    effects."""

    form: str
    noise: Noise
    choice: Choice
    held_out: HeldOut | None
    is_held_out: NDArray[np.bool_]
    outlier: NDArray[np.bool_]
    notes: tuple[str, ...]
    validation: Validation | None


@dataclass(frozen=True)
class Diagnosis:
    """The result of `diagnose`.

    Parameters
    ----------
    options : Options
    form : str
        Form of the impact: "restitution" or "exchange".
    noise : Noise
        Noise of the rows.
    outliers : int
        Number of rows that are left out.
    choice : Choice
        Steps, candidates and confidence, from the rows that were not held out.
    base, best : Fit
        Fits without and with the named effects, to all rows except outliers.
    leading : Fit, optional
        The fit with the leading candidates if the verdict is "unknown".
    rows : Rows
        All n rows of the table.
    is_held_out : ndarray of bool
        (n,) True for rows that were held out.
    before, after : Measure
        Misfit of the model to the rows without and with the effects.
    with_leading : Measure, optional
        The same with the leading candidates.
    held_out : HeldOut, optional
        Misfit of the held-out rows; None if there are none.
    noise_floor_rms : float
        Smallest possible rms, in the reading's unit.
    regions, remaining : tuple of Region
        Regions in which model and rows differ, without and with the effects.
    plan : Plan
        The next experiment.
    minimum_detectable : dict of str to float
        Smallest size of each effect that these rows can detect.
    undetectable : tuple of str
        Effects that these rows cannot detect at any size within physical bounds, without those that are named or tied.
    correction : Correction, optional
        Empirical correction for the remaining misfit.
    notes : tuple of str

    Examples
    --------
    See `diagnose`.
    """

    options: Options
    form: str
    noise: Noise
    outliers: int
    choice: Choice
    base: Fit
    best: Fit
    rows: Rows
    is_held_out: NDArray[np.bool_]
    before: Measure
    after: Measure
    held_out: HeldOut | None
    noise_floor_rms: float
    regions: tuple[Region, ...]
    remaining: tuple[Region, ...]
    plan: Plan
    minimum_detectable: dict[str, float]
    undetectable: tuple[str, ...]
    correction: Correction | None
    notes: tuple[str, ...] = field(default=())
    leading: Fit | None = None
    with_leading: Measure | None = None

    @property
    def verdict(self) -> Verdict:
        """ "effect", "none" or "unknown"."""
        return self.choice.verdict

    @property
    def fitted_rows(self) -> str:
        """The rows to which `before`, `after` and `with_leading` refer."""
        return f"all {len(self.rows) - self.outliers} rows"

    @property
    def closed_pct(self) -> float | None:
        """Removed share of the misfit of held-out rows, or of all rows if none are held out; None without an effect or a
        misfit."""
        if self.verdict != "effect":
            return None
        if self.held_out is not None:
            return self.held_out.closed_pct
        return share_closed_pct(self.before.rms, self.after.rms, self.noise_floor_rms)
